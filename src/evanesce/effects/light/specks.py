"""Dust on the glass: specks that scatter guided light without contact, at the same locations in every frame.

Statistics are those of the rig's photograph (``docs/validation/specks_fit.py``).
"""

from __future__ import annotations

import numpy as np
from pydantic import model_validator

from evanesce.core.quantities import Strict, field
from evanesce.core.states import PlateLight
from evanesce.effects.inference_hints import Marks
from evanesce.effects.particles import MAX_PER_CM2, draw_particles, listed_values, require_one_length
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.render.fast.defects import add_points, contact_radiance
from evanesce.rig import Scene

# A disc by seven points: its middle and the corners of a hexagon at 0.7 of its radius (they share its second moment).
DISC_POINTS = [(0.0, 0.0)] + [(np.cos(a), np.sin(a)) for a in np.arange(6) * np.pi / 3]
DISC_RADIUS = 0.5 * np.sqrt(7 / 6) * np.sqrt(0.5)


class Parameters(Strict):
    """Density, brightness and size."""

    per_cm2: float = field(
        0.0,
        unit="1/cm^2",
        bounds=(0.0, MAX_PER_CM2),
        null=0.0,
        source="rig photograph: 418, 204 of them above the photograph's limit",
        doc="specks per area of the top face, of all brightnesses",
    )
    median_light_mm2: float = field(
        1.8e-4,
        unit="mm^2",
        bounds=(1e-7, 1.0),
        source="rig photograph: exp(-8.62)",
        doc="area of white paper as bright as a speck; log-normal median",
    )
    log_spread: float = field(
        1.5, unit="1", bounds=(0.0, 3.0), source="rig photograph: 1.505", doc="standard deviation of its logarithm"
    )
    paper_over_contact: float = field(
        0.35,
        unit="1",
        bounds=(0.001, 100.0),
        doc="radiance of the white paper over that of a contact; not measured: no photograph shows both",
    )
    diameter_mm: float = field(
        0.02, unit="mm", bounds=(0.0, 1.0), source="rig photograph: below 0.06 mm, not resolved", doc="of each speck"
    )
    marks: float = field(0.0, unit="1", bounds=(0.0, 10.0), null=0.0, doc="multiplies the light of the listed specks")
    mark_x_mm: tuple[float, ...] = listed_values("mm", (-500.0, 500.0), "listed specks, on the plate")
    mark_y_mm: tuple[float, ...] = listed_values("mm", (-500.0, 500.0), "listed specks, on the plate")
    mark_light_mm2: tuple[float, ...] = listed_values(
        "mm^2", (0.0, 100.0), "of each listed speck: area of contact there that is as bright"
    )

    @model_validator(mode="after")
    def _lists(self) -> Parameters:
        require_one_length({name: getattr(self, name) for name in ("mark_x_mm", "mark_y_mm", "mark_light_mm2")})
        return self


def apply(light: PlateLight, parameters: Parameters, context: Context) -> PlateLight:
    """Add the specks, drawn and listed; a higher density keeps those of a lower one.

    Parameters
    ----------
    light : PlateLight
    parameters : Parameters
    context : Context

    Returns
    -------
    PlateLight
    """
    scene = context.scene
    if parameters.marks > 0.0:
        at_x, at_y = np.array(parameters.mark_x_mm), np.array(parameters.mark_y_mm)
        bright = parameters.marks * np.array(parameters.mark_light_mm2) * contact_radiance(scene, at_x, at_y)
        light = add_points(scene, light, at_x, at_y, bright)
    return light if parameters.per_cm2 == 0.0 else _drawn(light, parameters, context)


def _drawn(light: PlateLight, parameters: Parameters, context: Context) -> PlateLight:
    """Add specks at random locations."""
    scene, rng = context.scene, context.generator("specks", per_frame=False)
    width, height = scene.plate.size_mm
    place, relative_area = draw_particles(rng, (width, height), parameters.per_cm2, parameters.log_spread)
    x, y = (place[:, 0] - 0.5) * width, (place[:, 1] - 0.5) * height
    area = parameters.median_light_mm2 * relative_area
    flux = area * parameters.paper_over_contact * contact_radiance(scene, x, y)
    if parameters.diameter_mm == 0.0:
        return add_points(scene, light, x, y, flux)
    offset = DISC_RADIUS * parameters.diameter_mm * np.array(DISC_POINTS)
    spread_x, spread_y = x[:, None] + offset[:, 0], y[:, None] + offset[:, 1]
    shared = np.repeat(flux[:, None] / len(offset), len(offset), axis=1)
    return add_points(scene, light, spread_x.ravel(), spread_y.ravel(), shared.ravel())


def _noticeable(scene: Scene, area_mm2: float) -> float:
    """Return the area of contact that is as bright as a hundredth of a cell in contact [mm^2]."""
    return 0.01 * area_mm2


EFFECT = Effect(
    id="specks",
    stage=Stage.PLATE_LIGHT,
    parameters=Parameters,
    amplitudes=("per_cm2", "marks"),
    null_when="all",
    apply=apply,
    # Half of the photograph's 418: a plate that was wiped, or a dustier one.
    fitted={"per_cm2": 200.0},
    scaling="points at fixed locations: follow LED power, do not move with force; there without contact",
    marks=Marks(scale="marks", x="mark_x_mm", y="mark_y_mm", amount="mark_light_mm2", where="plate", unit=_noticeable),
)
