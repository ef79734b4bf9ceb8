"""Residue of fingers on the glass: a weak, soft-edged haze that scatters guided light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evanesce.core.quantities import Strict, field
from evanesce.core.states import PlateLight
from evanesce.effects.inference_hints import Blot
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.render.fast.defects import contact_radiance_seen, plate_points


class Parameters(Strict):
    """Radiance, location and radius."""

    relative_radiance: float = field(
        0.0, unit="1", bounds=(0.0, 1.0), null=0.0, doc="radiance at its middle over that of a contact there"
    )
    middle_mm: tuple[float, float] = field((0.0, 0.0), unit="mm", bounds=(-500.0, 500.0), doc="(x, y) on the plate")
    radius_mm: float = field(5.0, unit="mm", bounds=(0.1, 200.0), doc="where it has fallen to exp(-1/2)")


def apply(light: PlateLight, parameters: Parameters, context: Context) -> PlateLight:
    """Add relative_radiance exp(-r^2/(2 radius^2)) times a contact's radiance.

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
    x, y = plate_points(context.scene, light)
    mx, my = parameters.middle_mm
    r2 = ((x - np.float32(mx)) ** 2 + (y - np.float32(my)) ** 2) * np.float32(-0.5 / parameters.radius_mm**2)
    added = np.exp(r2) * contact_radiance_seen(context.scene, light)
    return replace(light, radiance=light.radiance + np.float32(parameters.relative_radiance) * added)


EFFECT = Effect(
    id="residue_film",
    stage=Stage.PLATE_LIGHT,
    parameters=Parameters,
    amplitudes=("relative_radiance",),
    apply=apply,
    # Assumed: some per cent of what a contact scatters, where fingers were pressed.
    fitted={"relative_radiance": 0.05, "middle_mm[0]": 3.0, "middle_mm[1]": 3.0, "radius_mm": 2.0},
    scaling="a haze at a fixed location: follows LED power, does not grow with force; there without contact",
    blot=Blot(amount="relative_radiance", middle="middle_mm", radius="radius_mm", like="specks"),
)
