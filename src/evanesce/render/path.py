"""The reference renderer: paths traced through the plate, averaged over independent passes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.errors import InputError
from evanesce.optics.emitters import led_table
from evanesce.optics.led import each_led_power
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.scene import Patch, Window, camera_dict, plate_scene
from evanesce.render.variant import VariantInfo, select
from evanesce.rig import Scene
from evanesce.rng import integer_seed
from evanesce.states import ContactState, PlateLight

Array = NDArray[np.float64]
Powers = float | Array
LedChoice = Literal["all", "left", "right", "top", "bottom"]
# Around the contact's bounding box; wider than lens blur and dilation by the pipeline.
FOCUS_MARGIN_MM = 1.0
# Outside that window this fraction of the samples: there is next to nothing to see.
BACKGROUND_SHARE = 0.125
MAX_BACKGROUND_FACTOR = 8
MAX_VIEW_PIXELS = 200_000_000


class Welford:
    """Running mean and sum of squared deviations, one array each.

    References
    ----------
    B. P. Welford, "Note on a method for calculating corrected sums of squares and products", Technometrics 4 (1962)
    419.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.count = 0
        self.mean: Array = np.zeros(shape)
        self._squares: Array = np.zeros(shape)

    def add(self, value: NDArray[Any]) -> None:
        """Take in one pass."""
        self.count += 1
        step = value - self.mean
        self.mean += step / self.count
        self._squares += step * (value - self.mean)

    @property
    def variance_of_mean(self) -> Array:
        """Variance of the mean; infinite after a single pass, which tells nothing of it."""
        if self.count < 2:
            return np.full(self.mean.shape, np.inf)
        return np.asarray(self._squares / (self.count - 1) / self.count)


def scaled_view(view: IdealView, factor: float) -> IdealView:
    """Return a view of the same field with ``factor`` times as many pixels a side, for previews.

    Raises
    ------
    ValueError
        If the factor is not above 0.
    """
    if not factor > 0:
        raise ValueError(f"factor {factor} is not above 0")
    rows, cols = (max(1, round(n * factor)) for n in view.shape)
    # Outer borders of the pixels map onto each other: (p + 1/2) scales.
    px, py = ((p + 0.5) * factor - 0.5 for p in view.principal_point)
    return IdealView((rows, cols), view.focal_px * factor, (px, py))


def focus_window(projection: Projection, view: IdealView, state: ContactState, margin: float) -> Window | None:
    """Return the view's pixels around the contact (bounding box plus ``margin`` [mm]); None where none is in view."""
    rows, cols = np.nonzero(np.asarray(state.contact_mask) > 0)
    if rows.size == 0:
        return None
    x, y = state.grid.x[cols], state.grid.y[rows]
    box_x, box_y = (x.min() - margin, x.max() + margin), (y.min() - margin, y.max() + margin)
    side = np.linspace(0.0, 1.0, 33)
    border_x = np.concatenate([np.interp(side, [0, 1], box_x)] * 2 + [np.full(33, v) for v in box_x])
    border_y = np.concatenate([np.full(33, v) for v in box_y] + [np.interp(side, [0, 1], box_y)] * 2)
    u, v = projection.plate_to_ray(border_x, border_y)
    u, v = u * view.focal_px + view.principal_point[0], v * view.focal_px + view.principal_point[1]
    row0, row1 = max(0, int(np.floor(v.min()))), min(view.shape[0], int(np.ceil(v.max())) + 1)
    col0, col1 = max(0, int(np.floor(u.min()))), min(view.shape[1], int(np.ceil(u.max())) + 1)
    return Window(row0, row1, col0, col1) if row1 > row0 and col1 > col0 else None


def background_factor(px_per_mm: float) -> int:
    """Return how many pixels a side share one sample region beside the contact: at least three such to the margin."""
    return int(np.clip(FOCUS_MARGIN_MM * px_per_mm / 3, 1, MAX_BACKGROUND_FACTOR))


def enlarged(image: Array, shape: tuple[int, int]) -> Array:
    """Return an image of the same field on more pixels, bilinear; the same array where the shape is the same."""
    if image.shape == shape:
        return image
    return np.asarray(cv2.resize(image, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR))


def pass_samples(total: int, passes: int) -> int:
    """Return samples per pixel of one pass, at least 1, so that all passes together have at least ``total``."""
    return max(1, -(-total // passes))


def trace(
    shapes: dict[str, Any],
    sensor: dict[str, Any],
    integrator: Any,
    *,
    samples: int,
    passes: int,
    seed: int,
    name: str,
    tick: Callable[[], None],
) -> Welford:
    """Average independently seeded passes of a scene through one sensor.

    Returns
    -------
    Welford
        Of images (rows, cols).
    """
    import mitsuba as mi

    # Python plugins do not survive loading in parallel.
    loaded = mi.load_dict(shapes | {"sensor": sensor, "integrator": integrator}, parallel=False)
    film = sensor["film"]
    sums = Welford((film.get("crop_height", film["height"]), film.get("crop_width", film["width"])))
    for k in range(passes):
        image = mi.render(loaded, spp=samples, seed=integer_seed(seed, "render", name, k))
        sums.add(np.asarray(np.array(image), float)[:, :, 0])
        tick()
    return sums


def integrator_for(
    scene: Scene, info: VariantInfo, patch: Patch | None, powers: Mapping[str, Powers], *, connect: bool = True
) -> Any:
    """Return the integrator of a variant: the plate's own for llvm and cuda, built-in ones for scalar.

    Parameters
    ----------
    scene : Scene
    info : VariantInfo
    patch : Patch or None
    powers : mapping
        Radiant power of one LED [W] by edge.
    connect : bool
        Whether paths are connected to the LEDs (llvm and cuda); the mean is the same without, the noise larger.
    """
    plate, depth = scene.plate, scene.render.max_depth
    if not info.is_jit:
        kind = "volpath" if plate.absorption_coefficient_per_mm > 0 else "path"
        # Roulette would act on every bounce of a guided path; such a path ends at an edge by itself.
        return {"type": kind, "max_depth": depth, "rr_depth": depth}
    from evanesce.render.connect import LedConnector
    from evanesce.render.integrator import guided_integrator

    geometry = plate.thickness_mm, plate.refractive_index, plate.absorption_coefficient_per_mm
    place = (patch.extent, patch.reflectance) if patch else (None, None)
    connector = LedConnector(led_table(plate, scene.leds, powers), *geometry, *place) if connect else None
    half = (plate.size_mm[0] / 2, plate.size_mm[1] / 2)
    return guided_integrator(plate.absorption_coefficient_per_mm, plate.thickness_mm, half, depth, connector)


def require_traceable(scene: Scene) -> None:
    """Refuse what only the fast renderer knows.

    Raises
    ------
    InputError
        Naming the key.
    """
    only_fast = {
        "plate.edge_polish": scene.plate.edge_polish,
        "leds.air_gap_share": scene.leds.air_gap_share,
        "finger.scattering_length_mm": scene.finger.scattering_length_mm,
    }
    for key, value in only_fast.items():
        if value != 0.0:
            raise InputError(
                f"{value:g}: the path tracer does not model it", key=key, allowed="0, or the fast renderer"
            )


def lit_powers(scene: Scene, leds: LedChoice) -> dict[str, Powers]:
    """Return the radiant power of each LED [W] on the edges that are lit in this rendering."""
    powers: dict[str, Powers] = dict(each_led_power(scene.plate, scene.leds))
    if leds == "all":
        return powers
    if leds not in powers:
        raise InputError(f"'{leds}'", key="leds", allowed=", ".join(["all", *powers]))
    return {leds: powers[leds]}


@dataclass(frozen=True)
class SamplingRun:
    """One view (or a window of it) with its samples per pixel and pass."""

    name: str
    view: IdealView
    window: Window | None
    samples: int


def sampling_runs(view: IdealView, window: Window | None, samples: int, px_per_mm: float) -> list[SamplingRun]:
    """Return what to render: all of the view alike, or its window finely over a coarse whole."""
    if window is None:
        return [SamplingRun("whole", view, None, samples)]
    coarse = background_factor(px_per_mm)
    background = pass_samples(round(samples * BACKGROUND_SHARE * coarse**2), 1)
    return [
        SamplingRun("whole", scaled_view(view, 1 / coarse), None, background),
        SamplingRun("focus", view, window, samples),
    ]


def in_units(powers: Mapping[str, Powers]) -> tuple[dict[str, Powers], float]:
    """Return powers over a power of two that makes them of order one, and that unit.

    Light is linear in them and the division is exact, but below the knee of the LEDs' characteristic they fall out of
    the range of the renderer's 32-bit numbers.
    """
    largest = max((float(np.max(p, initial=0.0)) for p in powers.values()), default=0.0)
    unit = 2.0 ** np.floor(np.log2(largest)) if largest > 0 else 1.0
    return {edge: np.asarray(p) / unit for edge, p in powers.items()}, float(unit)


def render(
    scene: Scene,
    state: ContactState | None,
    *,
    variant: str = "auto",
    samples_per_pixel: int | None = None,
    passes: int | None = None,
    seed: int | None = None,
    view: IdealView | None = None,
    leds: LedChoice = "all",
    powers: Mapping[str, Powers] | None = None,
    focus: bool = True,
    connect: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> PlateLight:
    """Path trace the light that leaves the plate towards the lens.

    The same arguments give the same bytes.

    Parameters
    ----------
    scene : Scene
    state : ContactState or None
        What touches the glass; None with the finger lifted away.
    variant : {"auto", "llvm", "scalar", "cuda"}
    samples_per_pixel : int, optional
        In all passes together; ``scene.render`` has the default, as for the next two.
    passes : int, optional
        Independent passes that the variance is estimated from, at least 2.
    seed : int, optional
    view : IdealView, optional
        Pixels to render; all that the camera's distorted frame sees if not given.
    leds : {"all", "left", "right", "top", "bottom"}
        Which edges are lit. Light is linear in LED power: edges may be rendered apart and added.
    powers : mapping, optional
        Radiant power [W] by edge, of each LED there or of every one, instead of what the supply voltages give.
    focus : bool
        Spend the samples around the contact and an eighth of them elsewhere, there on coarser pixels: what little
        light there is beside a contact is smooth, and few samples a pixel would leave it as bright single specks.
    connect : bool
        See :func:`integrator_for`.
    progress : callable, optional
        Called as ``progress(done, total)`` after each pass.

    Returns
    -------
    PlateLight

    Raises
    ------
    InputError
        If the variant does not work here, or the sampling is out of range.
    """
    total = scene.render.samples_per_pixel if samples_per_pixel is None else samples_per_pixel
    passes = scene.render.passes if passes is None else passes
    seed = scene.render.seed if seed is None else seed
    if total < 1:
        raise InputError(f"{total}", key="samples_per_pixel", allowed="at least 1")
    if passes < 2:
        raise InputError(f"{passes}", key="passes", allowed="at least 2: the variance comes from them")
    require_traceable(scene)
    lit, unit = in_units(lit_powers(scene, leds) if powers is None else powers)
    projection = Projection.of(scene.camera, scene.plate)
    view = projection.ideal_view() if view is None else view
    if view.shape[0] * view.shape[1] > MAX_VIEW_PIXELS:
        raise InputError(f"a view of {view.shape[1]} x {view.shape[0]} pixels", allowed=f"{MAX_VIEW_PIXELS} pixels")
    info = select(variant)
    model = plate_scene(scene, state, lit, info.is_jit)
    integrator = integrator_for(scene, info, model.patch, lit, connect=connect)
    per_pass = pass_samples(total, passes)
    window = focus_window(projection, view, state, FOCUS_MARGIN_MM) if focus and state is not None else None
    runs = sampling_runs(view, window, per_pass, scene.camera.scale_px_per_mm * view.focal_px / projection.focal_px)
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, passes * len(runs))

    for run in runs:
        sums = trace(
            model.shapes,
            camera_dict(projection, run.view, run.window),
            integrator,
            samples=run.samples,
            passes=passes,
            seed=seed,
            name=run.name,
            tick=tick,
        )
        if (part := run.window) is None:
            radiance, variance = (enlarged(image, view.shape) for image in (sums.mean, sums.variance_of_mean))
        else:
            where = np.s_[part.row0 : part.row1, part.col0 : part.col1]
            radiance[where], variance[where] = sums.mean, sums.variance_of_mean
    return PlateLight(
        radiance=radiance * unit,
        variance=variance * unit**2,
        focal_px=view.focal_px,
        principal_point=view.principal_point,
        samples=per_pass * passes,
    )
