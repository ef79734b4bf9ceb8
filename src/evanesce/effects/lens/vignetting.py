"""Vignetting by a hood or a decentred stop: a further loss about a point that need not be the optical axis.

It goes as the square of the radius where a pupil shrinks smoothly, and is steeper or flatter where an edge cuts into
it: a mask as large as the stop takes light in proportion to the radius, a larger one none near the middle.
"""

from __future__ import annotations

import numpy as np

from evanesce.core.quantities import Strict, field
from evanesce.core.states import SensorLight
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.sensor.lens import field_radius2


class Parameters(Strict):
    """Loss, its exponent and its centre."""

    k: float = field(0.0, unit="1", bounds=(0.0, 0.95), null=0.0, doc="loss at the corner farthest from the centre")
    exponent: float = field(
        2.0, unit="1", bounds=(0.5, 12.0), doc="of the radius; 2: the usual polynomial's first term"
    )
    centre_offset_px: tuple[float, float] = field(
        (0.0, 0.0), unit="px", bounds=(-2000.0, 2000.0), doc="centre from the frame's middle, (x, y)"
    )


def apply(light: SensorLight, parameters: Parameters, context: Context) -> SensorLight:
    """Multiply the irradiance by 1 - k rho^exponent, rho = 1 at the corner farthest from the centre.

    Parameters
    ----------
    light : SensorLight
    parameters : Parameters
    context : Context

    Returns
    -------
    SensorLight
    """
    rows, cols = light.irradiance.shape
    dx, dy = parameters.centre_offset_px
    centre = ((cols - 1) / 2 + dx, (rows - 1) / 2 + dy)
    left = 1.0 - parameters.k * field_radius2((rows, cols), centre) ** (0.5 * parameters.exponent)
    return SensorLight(irradiance=np.asarray(light.irradiance) * left)


EFFECT = Effect(
    id="vignetting",
    stage=Stage.SENSOR_LIGHT,
    parameters=Parameters,
    amplitudes=("k",),
    apply=apply,
    # Lenses of this kind lose up to 0.4 in the corners, cos^4 included; what is unknown is a part of that.
    fitted={"k": 0.15, "exponent": 1.5, "centre_offset_px[0]": 60.0, "centre_offset_px[1]": 60.0},
    scaling="a fixed pattern that multiplies the light: follows LED power, same at every force and time",
    # Without loss its shape has no derivative.
    start={"k": (0.15,), "exponent": (1.0, 2.0, 4.0)},
)
