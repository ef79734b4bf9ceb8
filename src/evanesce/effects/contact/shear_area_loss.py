"""Loss of contact area under shear, as the square of the tangential force (Sahli et al. 2018)."""

from __future__ import annotations

import math

from evanesce.contact.reshape import contact_centre, reshaped_state
from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field
from evanesce.core.states import ContactState
from evanesce.effects.protocol import Context, Effect, Stage

MIN_AREA_SHARE = 0.3
"""Of the area without shear; the law is a fit to larger shares."""


class Parameters(Strict):
    """Area loss, and the tangential force of a press."""

    loss_mm2_per_N2: float = field(
        0.0,
        unit="mm^2/N^2",
        bounds=(0.0, 1000.0),
        null=0.0,
        source="R. Sahli et al., PNAS 115 (2018) 471",
        doc="alpha_A: area lost over the square of the tangential force",
    )
    side_load_share: float = field(
        0.3,
        unit="1",
        bounds=(0.0, 2.0),
        doc="tangential over normal force in a press; a slide has its own force, 0 too",
    )
    direction_deg: float = field(
        0.0, unit="deg", bounds=(-180.0, 180.0), doc="of that force on the finger, from x towards y"
    )


def apply(state: ContactState, parameters: Parameters, context: Context) -> ContactState:
    """Shorten the contact along the tangential force, about its leading edge, until alpha Q^2 of its area is gone.

    Parameters
    ----------
    state : ContactState
    parameters : Parameters
    context : Context

    Returns
    -------
    ContactState

    Raises
    ------
    InputError
        For a ridged finger: ridges keep their pitch.
    """
    if parameters.loss_mm2_per_N2 == 0.0 or state.nominal_contact_area <= 0.0:
        return state
    if not context.scene.finger.is_smooth:
        raise InputError(
            "loss of area under shear is not modelled for ridges",
            key="effects.shear_area_loss",
            allowed="a smooth finger",
        )
    qx, qy = state.tangential_force
    direction, shear = math.atan2(qy, qx), math.hypot(qx, qy)
    if shear == 0.0 and state.traction is None:
        direction = math.radians(parameters.direction_deg)
        shear = parameters.side_load_share * state.normal_force
    left = max(1.0 - parameters.loss_mm2_per_N2 * shear**2 / state.nominal_contact_area, MIN_AREA_SHARE)
    if left == 1.0:
        return state
    x, y = contact_centre(state)
    radius = math.sqrt(state.nominal_contact_area / math.pi)
    lead = (x + radius * math.cos(direction), y + radius * math.sin(direction))
    return reshaped_state(state, left, 1.0, direction, lead)


EFFECT = Effect(
    id="shear_area_loss",
    stage=Stage.CONTACT,
    parameters=Parameters,
    amplitudes=("loss_mm2_per_N2",),
    apply=apply,
    fitted={"loss_mm2_per_N2": 2.0},
    needs=("press", "force"),
    scaling="takes area from the trailing edge, as the square of force in a press; the same at every voltage",
)
