"""Light lost to a hood or a decentred stop: a further r^2 loss about a point that need not be the optical axis."""

from __future__ import annotations

import numpy as np

from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.quantities import Strict, field
from evanesce.sensor.lens import vignetting
from evanesce.states import SensorLight


class Parameters(Strict):
    """Loss and where it starts."""

    k: float = field(0.0, unit="1", bounds=(0.0, 0.95), null=0.0, doc="loss at the corner farthest from the centre")
    centre_offset_px: tuple[float, float] = field(
        (0.0, 0.0), unit="px", bounds=(-2000.0, 2000.0), doc="centre from the frame's middle, (x, y)"
    )


def apply(light: SensorLight, parameters: Parameters, context: Context) -> SensorLight:
    """Multiply the irradiance by 1 - k rho^2, rho = 1 at the corner farthest from the centre."""
    rows, cols = light.irradiance.shape
    dx, dy = parameters.centre_offset_px
    centre = ((cols - 1) / 2 + dx, (rows - 1) / 2 + dy)
    return SensorLight(irradiance=np.asarray(light.irradiance) * vignetting((rows, cols), centre, parameters.k))


EFFECT = Effect(
    id="vignetting",
    stage=Stage.SENSOR_LIGHT,
    parameters=Parameters,
    amplitudes=("k",),
    apply=apply,
    # Lenses of this kind lose up to 0.4 in the corners, cos^4 included; what is unknown is a part of that.
    fitted={"k": 0.15},
    scaling="a fixed pattern that multiplies the light: follows LED power, same at every force and time",
)
