"""Causes that one photograph of a printed board can be asked for, what a fit varies of each, and their forms."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.rng import generator
from evanesce.effects import all_effects
from evanesce.inference.constants import DRAWS
from evanesce.inference.data import DataVector
from evanesce.inference.laws import Seen, all_laws
from evanesce.inference.photograph.light import COSINES, SHIFTS, SIDES, UNEVEN, LightModel
from evanesce.inference.photograph.picture import Photograph
from evanesce.inference.shapes import Forms, drawn_point
from evanesce.inference.unknown import unknown_blocks
from evanesce.optics.projection import Projection
from evanesce.prediction.parameters import STEP_SHARE, Parameter
from evanesce.prediction.views import View
from evanesce.sensor.tone import CURVES

Array = NDArray[Any]

FILM_STEP_MM = 4.0
"""Distance of the places at which a haze is sought: about its radius."""
LAW_IDS = ("tone_curve", "vignetting")
"""Effects whose other laws hold for a photographed board: those of room light leave a card out, and that of defocus
blurs bins of four pixels."""

ABSORBED = {
    "ambient_light's even part": "taken up by the level of dark print, which is fitted",
    "defocus on the axis": "taken up by the even blur, which is fitted",
    "distortion_drift": "taken up by the geometry, which is fitted to the corners",
    "plate_tilt": "taken up by the geometry, which is fitted to the corners",
}


@dataclass(frozen=True)
class PhotoCause:
    """A cause as the joint fit of :mod:`evanesce.inference` takes it.

    Attributes
    ----------
    id : str
    parameters : tuple of Parameter
    grown : tuple of str
        Parameters that grow from nothing.
    starts : tuple of mapping
        Points to enter by where there is no derivative at nothing.
    """

    id: str
    parameters: tuple[Parameter, ...]
    grown: tuple[str, ...] = ()
    starts: tuple[Mapping[str, float], ...] = ()
    costly: bool = False

    @property
    def one_sided(self) -> bool:
        """Whether its amplitudes can only grow from nothing."""
        return all(p.null in p.bounds for p in self.parameters if p.name in self.amplitudes)

    @property
    def amplitudes(self) -> frozenset[str]:
        """Names of the parameters that grow from nothing."""
        return frozenset(self.grown)

    @property
    def candidate(self) -> PhotoCause:
        """Itself: the joint fit asks a cause's candidate for its starts."""
        return self


def _free(
    effect: str, name: str, unit: str, deviation: float, low: float = -np.inf, high: float = np.inf, null: float = 0.0
) -> Parameter:
    return Parameter(
        name=f"{effect}:{name}", unit=unit, null=null, deviation=deviation, bounds=(low, high),
        step=STEP_SHARE * deviation * 0.2,
    )  # fmt: skip


def photo_causes(photograph: Photograph) -> tuple[PhotoCause, ...]:
    """Return the causes, in alphabetical order.

    Parameters
    ----------
    photograph : Photograph
    """
    own = {
        name: tuple(dict(effect.parameters.quantities())[p] for p in wanted)
        for name, wanted in {"black_level": ("offset_DN",), "tone_curve": ("gamma", "contrast")}.items()
        for effect in [all_effects()[name]]
    }
    half_width = photograph.data.shape[1] / 2
    found = [
        # Its even part adds to the level of dark print, which is fitted: only what slopes over the frame is left.
        PhotoCause(
            "ambient_light", tuple(_free("ambient_light", a, "of bright print, per tangent", 0.1) for a in "xy")
        ),
        PhotoCause("black_level", (_free("black_level", "offset_DN", "DN", 5.0, *own["black_level"][0].bounds),)),
        PhotoCause("defocus", (_free("defocus", "corner_blur_um", "um", 10.0, -60.0, 60.0),)),
        _reflections(photograph),
        _film(photograph),
        PhotoCause(
            "tone_curve",
            tuple(
                _free("tone_curve", n, "1", 0.1, *q.bounds)
                for n, q in zip(("gamma", "contrast"), own["tone_curve"], strict=True)
            ),
        ),
        PhotoCause(UNEVEN, tuple(_free(UNEVEN, f"c{i}{j}", "log of light", 0.15, -2.0, 2.0) for i, j in COSINES)),
        _grown(
            "vignetting",
            {
                "k": (_free("vignetting", "k", "1", 0.15, 0.0, 0.95), (0.15,)),
                "centre_x_px": (_free("vignetting", "centre_x_px", "bins", half_width / 4), (0.0,)),
                "centre_y_px": (_free("vignetting", "centre_y_px", "bins", half_width / 4), (0.0,)),
            },
        ),
    ]  # fmt: skip
    return tuple(sorted(found, key=lambda cause: cause.id))


def _grown(name: str, table: Mapping[str, tuple[Parameter, tuple[float, ...]]]) -> PhotoCause:
    """Return a cause whose first parameter grows from nothing, entered at all combinations of starts."""
    parameters = tuple(p for p, _ in table.values())
    points = itertools.product(*(starts for _, starts in table.values()))
    starts = tuple(dict(zip((p.name for p in parameters), point, strict=True)) for point in points)
    return PhotoCause(name, parameters, (parameters[0].name,), starts)


def _reflections(photograph: Photograph) -> PhotoCause:
    """Return the reflections of the edge LEDs: one veil for each LED, which stand at their pitch along each edge."""
    name, pitch = "led_edge_reflections", photograph.scene.leds.pitch_mm
    sides = tuple(_free(name, side, "of bright print", 0.3, 0.0, 3.0) for side in SIDES)
    form = (
        _free(name, "decay_mm", "mm", 2.0, 0.3, 30.0, null=3.1),
        _free(name, "along_mm", "mm", 3.0, 0.8, 60.0, null=3.0),
        _free(name, "offset_mm", "mm", pitch / 4, -pitch / 2, pitch / 2),
    )
    starts = tuple(
        {f"{name}:{side}": 0.3, f"{name}:decay_mm": 2.5, f"{name}:along_mm": 3.5, f"{name}:offset_mm": share * pitch}
        for side in SIDES
        for share in (-0.25, 0.0, 0.25, 0.5)
    )
    return PhotoCause(name, (*sides, *form), tuple(p.name for p in sides), starts)


def _film(photograph: Photograph) -> PhotoCause:
    """Return a haze of one place, sought all over the frame."""
    name, scene = "residue_film", photograph.scene
    rows, cols = photograph.data.shape
    projection = Projection.of(scene.camera, scene.plate)
    x, y = projection.to_plate(
        np.array([0.0, cols - 1, cols / 2, cols / 2]), np.array([rows / 2, rows / 2, 0.0, rows - 1.0])
    )
    places = itertools.product(*(np.arange(a, b + 0.1, FILM_STEP_MM) for a, b in ((x[0], x[1]), (y[2], y[3]))))
    starts = tuple(
        {f"{name}:relative_radiance": 0.1, f"{name}:middle_x_mm": float(a), f"{name}:middle_y_mm": float(b),
         f"{name}:radius_mm": 2.0}
        for a, b in places
    )  # fmt: skip
    parameters = (
        _free(name, "relative_radiance", "1", 0.2, 0.0, 1.0),
        _free(name, "middle_x_mm", "mm", 10.0, -500.0, 500.0),
        _free(name, "middle_y_mm", "mm", 10.0, -500.0, 500.0),
        _free(name, "radius_mm", "mm", 1.5, 0.3, 15.0, null=1.5),
    )
    return PhotoCause(name, parameters, (parameters[0].name,), starts)


def photo_nuisances(photograph: Photograph) -> tuple[Parameter, ...]:
    """Return what every fit varies: levels of the print, even blur and how much of it a disc has, ink, smooth shifts.

    Parameters
    ----------
    photograph : Photograph
    """
    data, share = (x[photograph.opened] for x in (photograph.data, photograph.share))
    light = np.linspace(0.0, 1.0, 8192)
    table = 255.0 * CURVES[photograph.curve](light)
    level = {
        name: float(np.interp(np.median(data[which]), table, light))
        for name, which in (("@bright", share > 0.98), ("@dark", share < 0.02))
    }
    pixel = photograph.scene.camera.pixel.pitch_um / photograph.bin_px * 1e-3
    shift = max(photograph.corner_error_px, 0.01)
    return (
        *(
            Parameter(name=name, null=at, deviation=max(0.5 * at, 0.01), bounds=(0.0, 1.0), step=max(0.01 * at, 1e-4))
            for name, at in level.items()
        ),
        Parameter(name="@blur", unit="bins", null=1.0, deviation=1.0, bounds=(0.15, 6.0), step=0.02),
        Parameter(name="@disc", null=0.5, deviation=0.3, bounds=(0.0, 1.0), step=0.05),
        Parameter(name="@ink", unit="mm", deviation=10 * pixel, bounds=(-0.15, 0.15), step=0.002),
        *(
            Parameter(name=name, unit="bins", deviation=shift, bounds=(-10 * shift, 10 * shift), step=0.2 * shift)
            for name in SHIFTS
        ),
    )


@dataclass
class PhotoForms:
    """Forms of every cause about the nominal picture, for :class:`~evanesce.inference.judge.Judge`.

    Attributes
    ----------
    light : LightModel
    point : mapping
        Nuisances at which they are drawn.
    views : tuple of View
    """

    light: LightModel
    point: Mapping[str, float]
    views: tuple[View, ...]

    @property
    def nominal(self) -> Array:
        """Prediction without any cause (views, rows, cols) [DN]."""
        return np.repeat(self.light(self.point)[None], len(self.views), axis=0)

    @property
    def seen(self) -> Seen:
        """The nominal prediction for laws that change it."""
        one, level = self.light.photograph, self.nominal
        step = 0.01
        linear = self.light.linear(self.point)
        by_light = 255.0 * (CURVES[one.curve](np.clip(linear * (1 + step), 0, 1)) - CURVES[one.curve](linear)) / step
        by_light = np.broadcast_to(by_light, level.shape)
        rows, cols = one.data.shape
        x, y = np.meshgrid((np.arange(cols) + 0.5) * 2 / cols - 1, (np.arange(rows) + 0.5 - rows / 2) * 2 / cols)
        return Seen(one.scene, self.views, level, by_light, np.zeros_like(level), x, y)

    def blocks(self, causes: Sequence[PhotoCause], data: DataVector) -> dict[str, Array]:
        """Return the whitened forms (forms, bins) of causes that show, and rows of something unknown."""
        found = {forms.id: forms.rows(data) for forms in self.of(causes)}
        return {**found, **unknown_blocks(data, self.nominal)}

    def of(self, causes: Sequence[PhotoCause]) -> list[Forms]:
        """Return the forms of causes: drawn from their parameters, and by the other laws that they may follow."""
        found, nominal, seen = [], self.nominal[0], self.seen
        for cause in causes:
            rng = generator(0, "forms", cause.id)
            points = [drawn_point(cause, rng) for _ in range(DRAWS)]  # type: ignore[arg-type]
            if cause.id == "residue_film":
                points = [dict(start) for start in cause.starts]
            changes = [self.light(self._whole(cause, point)) - nominal for point in points]
            laws = all_laws().get(cause.id, ()) if cause.id in LAW_IDS else ()
            changes += [law.change(seen, rng)[0] for law in laws if law.change is not None]
            names = ("",) * len(points) + tuple(law.name for law in laws)
            found.append(Forms(cause.id, np.array(changes, np.float16)[:, None], names))
        return found

    def _whole(self, cause: PhotoCause, point: Mapping[str, float]) -> dict[str, float]:
        return {**self.point, **{p.name: p.null for p in cause.parameters}, **point}
