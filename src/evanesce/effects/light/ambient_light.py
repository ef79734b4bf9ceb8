"""Ambient light scattered towards the lens: a smooth radiance over the view, linear and quadratic in the tangent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evanesce.core.quantities import Strict, field
from evanesce.core.states import PlateLight
from evanesce.effects.protocol import Context, Effect, Stage


class Parameters(Strict):
    """Veiling radiance, and how it changes over the pinhole's view."""

    radiance_W_per_mm2_sr: float = field(
        0.0, unit="W mm^-2 sr^-1", bounds=(0.0, 1.0), null=0.0, doc="on the optical axis"
    )
    gradient: tuple[float, float] = field(
        (0.0, 0.0), unit="1", bounds=(-5.0, 5.0), doc="relative change per unit of tangent from the axis, (x, y)"
    )
    bow: float = field(
        0.0, unit="1", bounds=(-20.0, 20.0), doc="relative change per squared tangent from the axis, any direction"
    )


def apply(light: PlateLight, parameters: Parameters, context: Context) -> PlateLight:
    """Add L0 (1 + g_x tan_x + g_y tan_y + b tan^2), never below zero; ambient light has no sampling variance.

    Parameters
    ----------
    light : PlateLight
    parameters : Parameters
    context : Context

    Returns
    -------
    PlateLight
    """
    rows, cols = light.radiance.shape
    gx, gy = parameters.gradient
    x = (np.arange(cols) - light.principal_point[0]) / light.focal_px
    y = (np.arange(rows) - light.principal_point[1]) / light.focal_px
    share = 1.0 + gx * x[None, :] + gy * y[:, None] + parameters.bow * (x[None, :] ** 2 + y[:, None] ** 2)
    return replace(light, radiance=light.radiance + parameters.radiance_W_per_mm2_sr * np.clip(share, 0.0, None))


EFFECT = Effect(
    id="ambient_light",
    stage=Stage.PLATE_LIGHT,
    parameters=Parameters,
    amplitudes=("radiance_W_per_mm2_sr",),
    apply=apply,
    # Assumed: 4 % of the light of a contact, which is 2.6e-6 in the thesis scene at 9 V. A bow compensates what the
    # lens leaves of an even radiance: 2 without distortion (cos^4), 0.2 with that of the thesis.
    fitted={"radiance_W_per_mm2_sr": 1e-7, "gradient[0]": 0.5, "gradient[1]": 0.5, "bow": 0.5},
    scaling="constant at every voltage and force, smooth over the frame; there with the LEDs off, gone with the cap on",
)
