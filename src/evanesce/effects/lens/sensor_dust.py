"""Dust on the sensor's cover glass: soft dark spots at the same pixels in every frame, whatever the light."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import model_validator

from evanesce.core.quantities import Strict, field
from evanesce.core.states import SensorLight
from evanesce.effects.inference_hints import Marks
from evanesce.effects.particles import MAX_PER_CM2, draw_particles, listed_values, require_one_length
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene
from evanesce.sensor.lens import magnification, working_f_number

Array = NDArray[np.float64]

SMALLEST_CONE_MM = 1e-6


class Parameters(Strict):
    """Density, size, height over the pixels and opacity of the grains."""

    per_cm2: float = field(
        0.0, unit="1/cm^2", bounds=(0.0, MAX_PER_CM2), null=0.0, doc="grains per area of the sensor (0.29 cm^2)"
    )
    median_diameter_um: float = field(
        25.0, unit="um", bounds=(0.5, 500.0), doc="of a grain; log-normal median. Not published for any sensor"
    )
    log_spread: float = field(0.5, unit="1", bounds=(0.0, 2.0), doc="standard deviation of its logarithm")
    height_mm: float = field(
        1.0, unit="mm", bounds=(0.0, 20.0), doc="of the glass's outer face over the pixels, as if in air"
    )
    opacity: float = field(1.0, unit="1", bounds=(0.0, 1.0), doc="share of its light that a grain stops")
    marks: float = field(0.0, unit="1", bounds=(0.0, 10.0), null=0.0, doc="multiplies what listed grains stop")
    mark_x_mm: tuple[float, ...] = listed_values("mm", (0.0, 100.0), "listed grains, from the sensor's left edge")
    mark_y_mm: tuple[float, ...] = listed_values("mm", (0.0, 100.0), "from its upper edge")
    mark_area_mm2: tuple[float, ...] = listed_values("mm^2", (0.0, 100.0), "of each listed grain")

    @model_validator(mode="after")
    def _lists(self) -> Parameters:
        require_one_length({name: getattr(self, name) for name in ("mark_x_mm", "mark_y_mm", "mark_area_mm2")})
        return self


def obstructed_share(distance: ArrayLike, grain_mm: float, cone_mm: float) -> Array:
    """Return the share of a pixel's cone of light that an opaque disc stops.

    The cone has the diameter height/N where the grain sits; the share is the area that two circles have in common.

    Parameters
    ----------
    distance : array_like
        Of the pixel from below the grain's middle [mm].
    grain_mm, cone_mm : float
        Diameters of the grain and, at its height, of the cone [mm].

    Returns
    -------
    ndarray
        0 to 1, in the shape of ``distance``.
    """
    r = np.asarray(distance, np.float64)
    a, b = grain_mm / 2, cone_mm / 2
    small = min(a, b)
    apart = np.clip(r, abs(a - b), a + b)
    safe = np.maximum(apart, 1e-300)
    alpha = np.arccos(np.clip((safe**2 + a * a - b * b) / (2 * safe * a), -1.0, 1.0))
    beta = np.arccos(np.clip((safe**2 + b * b - a * a) / (2 * safe * b), -1.0, 1.0))
    kite = (a + b + apart) * (a + b - apart) * (apart + a - b) * (apart - a + b)
    common = a * a * alpha + b * b * beta - 0.5 * np.sqrt(np.maximum(kite, 0.0))
    common = np.where(r <= abs(a - b), math.pi * small * small, np.where(r >= a + b, 0.0, common))
    return np.asarray(common / (math.pi * b * b))


def _transmitted(shape: tuple[int, int], size_mm: tuple[float, float], grains: Array, cone_mm: float) -> Array:
    """Return the light that opaque grains (x, y, diameter) [mm] leave to each pixel [1]."""
    pitch = np.array([size_mm[0] / shape[1], size_mm[1] / shape[0]])
    left = np.ones(shape)
    for x, y, diameter in grains:
        reach = (diameter + cone_mm) / 2
        # Means over a pixel by sub-samples a quarter of the shadow's sharpest length apart.
        fine = int(np.clip(math.ceil(4 * pitch.max() / max(reach, 1e-9)), 1, 12))
        c0, r0 = (max(0, math.floor((p - reach) / w)) for p, w in zip((x, y), pitch, strict=True))
        c1 = min(shape[1], math.floor((x + reach) / pitch[0]) + 1)
        r1 = min(shape[0], math.floor((y + reach) / pitch[1]) + 1)
        if r1 <= r0 or c1 <= c0:
            continue
        u = (c0 + (np.arange((c1 - c0) * fine) + 0.5) / fine) * pitch[0] - x
        v = (r0 + (np.arange((r1 - r0) * fine) + 0.5) / fine) * pitch[1] - y
        share = obstructed_share(np.hypot(u[None, :], v[:, None]), diameter, cone_mm)
        left[r0:r1, c0:c1] *= 1.0 - share.reshape(r1 - r0, fine, c1 - c0, fine).mean(axis=(1, 3))
    return left


@functools.lru_cache(maxsize=4)
def _of_grains(shape: tuple[int, int], size_mm: tuple[float, float], grains: bytes, cone_mm: float) -> Array:
    """Return :func:`_transmitted`; the frames of a camera all have the same dust."""
    left = _transmitted(shape, size_mm, np.frombuffer(grains, np.float64).reshape(-1, 3), cone_mm)
    left.setflags(write=False)
    return left


def apply(light: SensorLight, parameters: Parameters, context: Context) -> SensorLight:
    """Remove the light that the grains stop; a higher density keeps the grains of a lower one.

    Locations are in mm on the sensor, so that a seed has the same dust at every pixel size.

    Parameters
    ----------
    light : SensorLight
    parameters : Parameters
    context : Context

    Returns
    -------
    SensorLight
    """
    camera = context.scene.camera
    pitch_mm = camera.pixel.pitch_um * 1e-3
    width, height = (n * pitch_mm for n in camera.resolution_px)
    grains = np.concatenate([_drawn(parameters, (width, height), context), _listed(parameters)])
    if not len(grains):
        return light
    m = magnification(camera.scale_px_per_mm, camera.pixel.pitch_um)
    cone = max(parameters.height_mm / working_f_number(camera.lens.f_number, m), SMALLEST_CONE_MM)
    rows, cols = light.irradiance.shape
    left = _of_grains((rows, cols), (width, height), np.ascontiguousarray(grains, np.float64).tobytes(), cone)
    return SensorLight(irradiance=light.irradiance * (1.0 - parameters.opacity * (1.0 - left)))


def _drawn(parameters: Parameters, size_mm: tuple[float, float], context: Context) -> Array:
    """Return grains at random locations: x, y, diameter [mm]."""
    rng = context.generator("sensor_dust", per_frame=False)
    place, relative_diameter = draw_particles(rng, size_mm, parameters.per_cm2, parameters.log_spread)
    diameter = parameters.median_diameter_um * 1e-3 * relative_diameter
    return np.column_stack([place * size_mm, diameter])


def _listed(parameters: Parameters) -> Array:
    """Return the listed grains: x, y, diameter [mm]."""
    if parameters.marks == 0.0:
        return np.zeros((0, 3))
    area = parameters.marks * np.array(parameters.mark_area_mm2)
    return np.column_stack([parameters.mark_x_mm, parameters.mark_y_mm, 2 * np.sqrt(area / math.pi)])


def _noticeable(scene: Scene, area_mm2: float) -> float:
    """Return a hundredth of an area [mm^2]."""
    return 0.01 * area_mm2


EFFECT = Effect(
    id="sensor_dust",
    stage=Stage.SENSOR_LIGHT,
    parameters=Parameters,
    amplitudes=("per_cm2", "marks"),
    null_when="all",
    apply=apply,
    # Assumed: nine grains on the sensor.
    fitted={"per_cm2": 30.0},
    scaling="a fixed pattern that multiplies the light: follows LED power, does not move with force or time",
    # A cell that is darker says how much is stopped there; a shadow that is soft spreads over several.
    marks=Marks(
        scale="marks",
        x="mark_x_mm",
        y="mark_y_mm",
        amount="mark_area_mm2",
        where="sensor",
        unit=_noticeable,
        fixed={"height_mm": 0.0},
    ),
)
