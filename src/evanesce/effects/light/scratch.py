"""Scratch on the glass that scatters guided light: a straight line, the same in every frame."""

from __future__ import annotations

import math

import numpy as np

from evanesce.core.quantities import Strict, field
from evanesce.core.states import PlateLight
from evanesce.effects.inference_hints import Line
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.render.fast.defects import add_points, contact_radiance

WIDTH_UM = 15.0


class Parameters(Strict):
    """Radiance, location and size."""

    relative_radiance: float = field(
        0.0, unit="1", bounds=(0.0, 3.0), null=0.0, doc="radiance of the scratch over that of a contact there"
    )
    middle_mm: tuple[float, float] = field((0.0, 0.0), unit="mm", bounds=(-500.0, 500.0), doc="(x, y) on the plate")
    direction_deg: float = field(30.0, unit="deg", bounds=(-180.0, 180.0), doc="along the scratch, from +x towards +y")
    length_mm: float = field(8.0, unit="mm", bounds=(0.01, 500.0), doc="end to end")
    width_um: float = field(WIDTH_UM, unit="um", bounds=(0.1, 1000.0), doc="below a pixel it only scales the light")


def apply(light: PlateLight, parameters: Parameters, context: Context) -> PlateLight:
    """Add points of light along the scratch, a quarter of a pixel apart, and across it where it is wider than that.

    Parameters
    ----------
    light : PlateLight
    parameters : Parameters
    context : Context

    Returns
    -------
    PlateLight
    """
    if parameters.relative_radiance == 0.0:
        return light
    scene, step = context.scene, 0.25 / context.scene.camera.scale_px_per_mm
    length, width = parameters.length_mm, parameters.width_um * 1e-3
    along, across = (_middles(extent, step) for extent in (length, width))
    angle = math.radians(parameters.direction_deg)
    s, t = np.meshgrid(along, across)
    x = parameters.middle_mm[0] + s * math.cos(angle) - t * math.sin(angle)
    y = parameters.middle_mm[1] + s * math.sin(angle) + t * math.cos(angle)
    area = length * width / s.size
    flux = parameters.relative_radiance * area * contact_radiance(scene, x, y)
    return add_points(scene, light, x.ravel(), y.ravel(), flux.ravel())


def _middles(extent: float, step: float) -> np.ndarray:
    count = max(1, math.ceil(extent / step))
    return ((np.arange(count) + 0.5) / count - 0.5) * extent


EFFECT = Effect(
    id="scratch",
    stage=Stage.PLATE_LIGHT,
    parameters=Parameters,
    amplitudes=("relative_radiance",),
    apply=apply,
    # Assumed: as bright as dust; anywhere in view, at any angle.
    fitted={
        "relative_radiance": 0.3,
        "middle_mm[0]": 8.0,
        "middle_mm[1]": 6.0,
        "direction_deg": 60.0,
        "length_mm": 5.0,
    },
    scaling="a line at a fixed location: follows LED power, does not move with force; there without contact",
    # Where it lies and how has no derivative while it is not there.
    start={"relative_radiance": (0.3,), "direction_deg": (0.0, 45.0, 90.0, 135.0)},
    line=Line(
        amount="relative_radiance",
        middle="middle_mm",
        direction="direction_deg",
        length="length_mm",
        like="specks",
        per_mm=lambda amount: amount * WIDTH_UM * 1e-3,
    ),
)
