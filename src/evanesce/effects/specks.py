"""Dust on the glass: specks that scatter guided light without contact, at the same places in every frame.

Statistics are those of the rig's photograph (``docs/validation/specks_fit.py``).
"""

from __future__ import annotations

import numpy as np

from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.quantities import Strict, field
from evanesce.render.marks import add_points, contact_radiance
from evanesce.states import PlateLight

MAX_PER_CM2 = 2000.0
MM2_PER_CM2 = 100.0
# A disc by seven points: its middle and the corners of a hexagon at 0.7 of its radius (they share its second moment).
DISC_POINTS = [(0.0, 0.0)] + [(np.cos(a), np.sin(a)) for a in np.arange(6) * np.pi / 3]
DISC_RADIUS = 0.5 * np.sqrt(7 / 6) * np.sqrt(0.5)


class Parameters(Strict):
    """How many, how bright, how large."""

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
        doc="radiance of the white paper over that of a contact; not known: no photograph shows both",
    )
    diameter_mm: float = field(
        0.02, unit="mm", bounds=(0.0, 1.0), source="rig photograph: below 0.06 mm, not resolved", doc="of each speck"
    )


def apply(light: PlateLight, parameters: Parameters, context: Context) -> PlateLight:
    """Add the specks; a higher density keeps those of a lower one."""
    if parameters.per_cm2 == 0.0:
        return light
    scene, rng = context.scene, context.generator("specks", per_frame=False)
    width, height = scene.plate.size_mm
    count = rng.poisson(MAX_PER_CM2 / MM2_PER_CM2 * width * height)
    place, size, order = rng.random((count, 2)) - 0.5, rng.standard_normal(count), rng.random(count)
    there = order < parameters.per_cm2 / MAX_PER_CM2
    x, y = place[there, 0] * width, place[there, 1] * height
    area = parameters.median_light_mm2 * np.exp(parameters.log_spread * size[there])
    flux = area * parameters.paper_over_contact * contact_radiance(scene, x, y)
    if parameters.diameter_mm == 0.0:
        return add_points(scene, light, x, y, flux)
    offset = DISC_RADIUS * parameters.diameter_mm * np.array(DISC_POINTS)
    spread_x, spread_y = x[:, None] + offset[:, 0], y[:, None] + offset[:, 1]
    shared = np.repeat(flux[:, None] / len(offset), len(offset), axis=1)
    return add_points(scene, light, spread_x.ravel(), spread_y.ravel(), shared.ravel())


EFFECT = Effect(
    id="specks",
    stage=Stage.PLATE_LIGHT,
    parameters=Parameters,
    amplitudes=("per_cm2",),
    apply=apply,
    # Half of the photograph's 418: a plate that was wiped, or a dustier one.
    fitted={"per_cm2": 200.0},
    scaling="points at fixed places: follow LED power, do not move with force; there before the finger touches",
)
