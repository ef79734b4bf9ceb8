"""Load off the finger's axis: the contact shifts sideways and becomes oval as force grows."""

from __future__ import annotations

import math
from dataclasses import replace

from evanesce.contact.reshape import contact_centre, reshaped_state
from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field
from evanesce.core.states import ContactState, PlateGrid
from evanesce.effects.protocol import Context, Effect, Stage


class Parameters(Strict):
    """Shift and ovality by force."""

    shift_x_mm_per_N: float = field(0.0, unit="mm/N", bounds=(-2.0, 2.0), null=0.0, doc="of the contact towards +x")
    shift_y_mm_per_N: float = field(0.0, unit="mm/N", bounds=(-2.0, 2.0), null=0.0, doc="of the contact towards +y")
    oval_x_per_N: float = field(
        0.0, unit="1/N", bounds=(-0.2, 0.2), null=0.0, doc="logarithm of the axis along x over that along y"
    )
    oval_diagonal_per_N: float = field(
        0.0, unit="1/N", bounds=(-0.2, 0.2), null=0.0, doc="logarithm of the axis between +x and +y over the other"
    )


def apply(state: ContactState, parameters: Parameters, context: Context) -> ContactState:
    """Shift the contact by its force, and stretch it about its centre at constant area.

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
        For an oval contact of a ridged finger: ridges keep their pitch.
    """
    force = state.normal_force
    dx, dy = parameters.shift_x_mm_per_N * force, parameters.shift_y_mm_per_N * force
    if dx != 0.0 or dy != 0.0:
        grid = state.grid
        centre = (grid.centre[0] + dx, grid.centre[1] + dy)
        state = replace(state, grid=PlateGrid(grid.shape, grid.pitch, centre))
    oval = math.hypot(parameters.oval_x_per_N, parameters.oval_diagonal_per_N) * force
    if oval == 0.0:
        return state
    if not context.scene.finger.is_smooth:
        raise InputError(
            "an oval contact of a ridged finger is not modelled",
            key="effects.off_axis_load",
            allowed="oval_x_per_N and oval_diagonal_per_N of 0, or a smooth finger",
        )
    direction = 0.5 * math.atan2(parameters.oval_diagonal_per_N, parameters.oval_x_per_N)
    return reshaped_state(state, math.exp(oval / 2), math.exp(-oval / 2), direction, contact_centre(state))


EFFECT = Effect(
    id="off_axis_load",
    stage=Stage.CONTACT,
    parameters=Parameters,
    amplitudes=("shift_x_mm_per_N", "shift_y_mm_per_N", "oval_x_per_N", "oval_diagonal_per_N"),
    apply=apply,
    null_when="all",
    fitted={
        "shift_x_mm_per_N": 0.05,
        "shift_y_mm_per_N": 0.05,
        "oval_x_per_N": 0.02,
        "oval_diagonal_per_N": 0.02,
    },
    needs=("press", "force"),
    scaling="place and shape of the contact follow force; area does not change; the same at every voltage and time",
)
