"""The reference renderer: paths traced through the plate, averaged over independent passes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateLight
from evanesce.optics.carried import carried_finger
from evanesce.optics.emitters import led_table
from evanesce.optics.haze import FACES
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.reference.haze import face_share
from evanesce.render.reference.led_groups import LedChoice, LedGroups, Powers, in_units, lit_powers
from evanesce.render.reference.passes import Until, Welford, channel_levels, pass_samples, trace
from evanesce.render.reference.scene import PlateModel, camera_dict, plate_scene
from evanesce.render.reference.surroundings import backdrop_shape, render_spill
from evanesce.render.reference.views import (
    FOCUS_MARGIN_MM,
    SamplingRun,
    enlarged,
    focus_window,
    sampling_runs,
)
from evanesce.render.variant import VariantInfo, select
from evanesce.rig import Scene

Array = NDArray[np.float64]
# Where an error is required, the part of the variance that is left to the light beside the contact, at least.
BACKGROUND_VARIANCE = 0.1
MAX_VIEW_PIXELS = 200_000_000
MAX_PASSES = 4096
"""Most passes, where a required error is not reached sooner."""
POLISHED_DEPTH = 4096
"""Light goes round between polished edges until it meets an LED, a ground part, or leaves."""


def integrator_for(
    scene: Scene,
    info: VariantInfo,
    model: PlateModel | None,
    powers: Mapping[str, Powers],
    *,
    connect: bool = True,
    groups: LedGroups | None = None,
) -> Any:
    """Return the integrator of a variant: the plate's own for llvm and cuda, built-in ones for scalar.

    Parameters
    ----------
    scene : Scene
    info : VariantInfo
    model : PlateModel or None
        None without contact and groups.
    powers : mapping
        Radiant power of one LED [W] by edge.
    connect : bool
        Whether paths are connected to the LEDs (llvm and cuda); the mean is the same without, the noise larger.
    groups : LedGroups, optional
        Whose light is separated (llvm and cuda).
    """
    plate, depth = scene.plate, scene.render.max_depth
    if not info.is_jit:
        kind = "volpath" if plate.absorption_coefficient_per_mm > 0 else "path"
        # Roulette would act on every bounce of a guided path; such a path ends at an edge by itself.
        return {"type": kind, "max_depth": depth, "rr_depth": depth}
    from evanesce.render.reference.connect import Guide, LedConnector
    from evanesce.render.reference.integrator import guided_integrator

    guide = Guide(
        (plate.size_mm[0] / 2, plate.size_mm[1] / 2), plate.thickness_mm, plate.refractive_index,
        plate.absorption_coefficient_per_mm, scene.leds.air_gap_share,
        (face_share(scene, "top"), face_share(scene, "bottom")),
    )  # fmt: skip
    patch = model.patch if model else None
    frustrated = (patch.extent, patch.reflectance) if patch else (None, None)
    numbers = groups.numbers if groups else None
    connector = LedConnector(led_table(plate, scene.leds, powers, numbers), guide, *frustrated) if connect else None
    depth = max(depth, POLISHED_DEPTH) if plate.edge_polish > 0 else depth
    named = (groups.names, model.group_of) if groups and model else ()
    return guided_integrator(guide, depth, connector, *named)


def require_traceable(scene: Scene, jit: bool = True) -> None:
    """Refuse what only the fast renderer models, or only the path tracer's llvm and cuda variants.

    Parameters
    ----------
    scene : Scene
    jit : bool
        Whether the variant is llvm or cuda.

    Raises
    ------
    InputError
        Naming the key.
    """
    if scene.finger.scattering_length_mm != 0.0:
        raise InputError(
            f"{scene.finger.scattering_length_mm:g}: the path tracer does not model it",
            key="finger.scattering_length_mm",
            allowed="0, or the fast renderer",
        )
    own = {"plate.edge_polish": scene.plate.edge_polish, "leds.air_gap_share": scene.leds.air_gap_share}
    own |= {f"surroundings.haze.{face}_share": face_share(scene, face) for face in FACES}
    for key, value in own.items():
        if value != 0.0 and not jit:
            raise InputError(
                f"{value:g}: scalar variants do not model it", key=key, allowed="0, or llvm, cuda, the fast renderer"
            )


def render(
    scene: Scene,
    state: ContactState | None,
    *,
    variant: str = "auto",
    samples_per_pixel: int | None = None,
    passes: int | None = None,
    until_error: float | None = None,
    max_passes: int = MAX_PASSES,
    seed: int | None = None,
    view: IdealView | None = None,
    leds: LedChoice = "all",
    powers: Mapping[str, Powers] | None = None,
    focus: bool = True,
    connect: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> PlateLight:
    """Path trace the light that leaves the plate towards the lens; the same arguments give the same bytes.

    Parameters
    ----------
    scene : Scene
    state : ContactState or None
        None with the finger lifted away.
    variant : {"auto", "llvm", "scalar", "cuda"}
    samples_per_pixel, passes : int, optional
        Samples in all passes together; independent passes that the variance is estimated from, at least 2. Defaults
        are the scene's, as that of ``seed``.
    until_error : float, optional
        Add passes until the standard error of the radiance, RMS over the pixels, is this part of its RMS
        (:func:`evanesce.render.reference.passes.relative_error`); with ``focus`` window and rest apart.
    max_passes : int
        Where that error is not reached sooner.
    seed : int, optional
    view : IdealView, optional
        Pixels to render; all that the camera's distorted frame sees if not given.
    leds : {"all", "left", "right", "top", "bottom"}
        Which edges are lit. Light is linear in LED power: edges may be rendered apart and added.
    powers : mapping, optional
        Radiant power [W] by edge, of each LED there or of every one, instead of what the supply voltages give.
    focus : bool
        Spend the samples around the contact and an eighth of them elsewhere, there on coarser pixels: light beside
        a contact is dim and smooth, and few samples a pixel would leave single bright pixels.
    connect : bool
        See :func:`integrator_for`.
    progress : callable, optional
        Called as ``progress(done, total)`` after each pass; where an error is required, ``total`` is what is expected.

    Returns
    -------
    PlateLight

    Raises
    ------
    InputError
        If the variant does not work here, or the sampling is out of range.
    """
    scene = scene if state is None else carried_finger(scene, state)
    powers = lit_powers(scene, leds) if powers is None else powers
    job = _Job.of(scene, state, variant, powers, view, None, connect)
    sampling = _sampling(scene, samples_per_pixel, passes, until_error, max_passes, seed)
    light = job.run(sampling, focus, progress)[0]
    if scene.surroundings is None or scene.surroundings.spill.share == 0:
        return light
    spill = render_spill(
        scene, state, powers, job.view, variant=variant, samples_per_pixel=sampling.per_pass * sampling.until.passes,
        passes=sampling.until.passes, seed=sampling.seed,
    )  # fmt: skip
    return replace(light, radiance=light.radiance + spill.radiance, variance=light.variance + spill.variance)


def render_groups(
    scene: Scene,
    state: ContactState | None,
    groups: LedGroups | None = None,
    *,
    variant: str = "auto",
    samples_per_pixel: int | None = None,
    passes: int | None = None,
    until_error: float | None = None,
    max_passes: int = MAX_PASSES,
    seed: int | None = None,
    view: IdealView | None = None,
    powers: Mapping[str, Powers] | None = None,
    focus: bool = True,
    connect: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, PlateLight]:
    """Path trace the light of groups of LEDs apart, all by the same paths.

    A path is followed once and its light booked to the LED that it came from, so that the groups cost one rendering
    together and add up to :func:`render` with the same seed. Any voltage, dimming or dead group follows by weights. As
    they share paths their errors are correlated: the variance of a sum is not the sum of the variances.

    Parameters
    ----------
    groups : LedGroups, optional
        Edge by edge if not given.
    until_error : float, optional
        To be reached in every group.
    scene, state, variant, samples_per_pixel, passes, max_passes, seed, view, powers, focus, connect, progress
        As for :func:`render`. Scalar variants render one group after the other.

    Returns
    -------
    dict of PlateLight
        By the group's name.

    Raises
    ------
    InputError
        As :func:`render`.
    """
    if scene.surroundings is not None and scene.surroundings.spill.share > 0:
        raise InputError("spill is not traced by groups", key="surroundings.spill", allowed="none, or render")
    scene = scene if state is None else carried_finger(scene, state)
    groups = LedGroups.of(scene) if groups is None else groups
    lit = lit_powers(scene, "all") if powers is None else powers
    sampling = _sampling(scene, samples_per_pixel, passes, until_error, max_passes, seed)
    if select(variant).is_jit:
        lights = _Job.of(scene, state, variant, lit, view, groups, connect).run(sampling, focus, progress)
        return dict(zip(groups.names, lights[1:], strict=True))
    alone = {}
    for k, name in enumerate(groups.names):
        part = {edge: np.where(groups.numbers[edge] == k, p, 0.0) for edge, p in lit.items()}
        alone[name] = _Job.of(scene, state, variant, part, view, None, connect).run(sampling, focus, progress)[0]
    return alone


@dataclass(frozen=True)
class _Sampling:
    """Samples per pixel of a pass, when to stop, seed."""

    per_pass: int
    until: Until
    seed: int


def _sampling(
    scene: Scene, total: int | None, passes: int | None, error: float | None, limit: int, seed: int | None
) -> _Sampling:
    """Return checked sampling; what is not given is the scene's."""
    total = scene.render.samples_per_pixel if total is None else total
    passes = scene.render.passes if passes is None else passes
    if total < 1:
        raise InputError(f"{total}", key="samples_per_pixel", allowed="at least 1")
    if passes < 2:
        raise InputError(f"{passes}", key="passes", allowed="at least 2: the variance comes from them")
    if error is not None and not 0 < error < 1:
        raise InputError(f"{error:g}", key="until_error", allowed="above 0, below 1")
    if limit < passes:
        raise InputError(f"{limit}", key="max_passes", allowed=f"at least the {passes} passes")
    until = Until(passes, error, limit)
    return _Sampling(pass_samples(total, passes), until, scene.render.seed if seed is None else seed)


@dataclass(frozen=True)
class _Job:
    """A scene made ready for one view: shapes, integrator, and the unit of its powers."""

    scene: Scene
    state: ContactState | None
    projection: Projection
    view: IdealView
    model: PlateModel
    integrator: Any
    unit: float

    @classmethod
    def of(
        cls, scene: Scene, state: ContactState | None, variant: str, powers: Mapping[str, Powers],
        view: IdealView | None, groups: LedGroups | None, connect: bool,
    ) -> _Job:  # fmt: skip
        lit, unit = in_units(powers)
        projection = Projection.of(scene.camera, scene.plate)
        view = projection.ideal_view() if view is None else view
        if view.shape[0] * view.shape[1] > MAX_VIEW_PIXELS:
            raise InputError(f"a view of {view.shape[1]} x {view.shape[0]} pixels", allowed=f"{MAX_VIEW_PIXELS} pixels")
        info = select(variant)
        require_traceable(scene, info.is_jit)
        model = plate_scene(scene, state, lit, info.is_jit, groups.numbers if groups else None)
        model.shapes.update(backdrop_shape(scene))
        integrator = integrator_for(scene, info, model, lit, connect=connect, groups=groups)
        return cls(scene, state, projection, view, model, integrator, unit)

    def run(self, sampling: _Sampling, focus: bool, progress: Callable[[int, int], None] | None) -> list[PlateLight]:
        """Return all light, then that of each group."""
        view, state = self.view, self.state
        window = focus_window(self.projection, view, state, FOCUS_MARGIN_MM) if focus and state is not None else None
        scale = self.scene.camera.scale_px_per_mm * view.focal_px / self.projection.focal_px
        runs, results = sampling_runs(view, window, sampling.per_pass, scale), []
        levels, before, budget = None, 0, 1.0 - BACKGROUND_VARIANCE if window is not None else 1.0
        # The window around the contact comes first: it gives the level that errors are relative to.
        for left, run in enumerate(reversed(runs), 1 - len(runs)):

            def tick(done: int, total: int, before: int = before, left: int = left) -> None:
                if progress is not None:
                    progress(before + done, before + total - left * sampling.until.passes)

            sums = trace(
                self.model.shapes, camera_dict(self.projection, run.view, run.window), self.integrator,
                samples=run.samples, until=sampling.until.within(budget), seed=sampling.seed, name=run.name,
                levels=levels, tick=tick,
            )  # fmt: skip
            before += sums.count
            results.append((run, sums))
            if run.window is not None:
                # So that variances and squares, each summed over the whole view, have the ratio that is required.
                share = np.prod(run.window.shape) / np.prod(view.shape)
                budget = 1.0 - sampling.until.used(sums, channel_levels(sums))
                levels = channel_levels(sums) * np.sqrt(share / max(1.0 - share, 1e-9))
                levels[levels == 0] = np.inf
        return [self._light(results[::-1], k, sampling) for k in range(results[0][1].mean.shape[2])]

    def _light(self, results: list[tuple[SamplingRun, Welford]], channel: int, sampling: _Sampling) -> PlateLight:
        """Put the window onto the whole."""
        for run, sums in results:
            mean, variance = sums.mean[..., channel], sums.variance_of_mean[..., channel]
            if (part := run.window) is None:
                radiance, spread = (enlarged(image, self.view.shape) for image in (mean, variance))
            else:
                where = np.s_[part.row0 : part.row1, part.col0 : part.col1]
                radiance[where], spread[where] = mean, variance
        return PlateLight(
            radiance=radiance * self.unit,
            variance=spread * self.unit**2,
            focal_px=self.view.focal_px,
            principal_point=self.view.principal_point,
            samples=sampling.per_pass * results[-1][1].count,
        )
