"""Residue of fingers on the glass: a weak, soft-edged haze that scatters guided light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evanesce.core.quantities import Strict, field
from evanesce.core.states import PlateLight
from evanesce.effects.inference_hints import Blot
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.render.fast.defects import contact_radiance, plate_points


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
    r2 = ((x - mx) ** 2 + (y - my) ** 2) / parameters.radius_mm**2
    added = np.zeros(light.radiance.shape)
    there = r2 < 50.0  # beyond, exp(-25)
    shape = np.exp(-0.5 * r2[there].astype(float))
    added[there] = parameters.relative_radiance * shape * contact_radiance(context.scene, x[there], y[there])
    return replace(light, radiance=light.radiance + added)


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
