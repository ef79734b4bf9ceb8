"""Adhesion on top of a contact that was found without it, whatever the law: what it adds on a half-space.

In the contact at hand, gap less the displacement by its pressure is a shape that a half-space presses to the same
contact (:func:`~evanesce.contact.resolved.pressed_profile`). That shape is pressed twice, with and without adhesion,
and what differs is added. So ridges, finite elements and power laws keep what makes them differ from a half-space, and
no adhesion adds nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.patch import box_around, grid_part
from evanesce.contact.reshape import mask_with_sum
from evanesce.contact.resolved import Adhesion, pressed_profile, resolved_state
from evanesce.states import ContactState

Array = NDArray[np.float64]

MARGIN = 1.5
"""Half side of the window that is solved, over the radius of what touches already."""

LEAST_WINDOW_MM = 1.0


def adhered_state(state: ContactState, modulus: float, adhesion: Adhesion) -> ContactState:
    """Add adhesion to a state.

    Parameters
    ----------
    state : ContactState
        Without adhesion.
    modulus : float
        E* at the rim of contact [MPa].
    adhesion : Adhesion
        Its work positive.

    Raises
    ------
    InputError
        If the contact would reach the border of the window that is solved.
    WorkError
        If the solver does not settle.
    """
    grid = state.grid
    rows, cols = np.nonzero(np.asarray(state.contact_mask) > 0)
    if rows.size:
        x, y = grid.x[[cols.min(), cols.max()]], grid.y[[rows.min(), rows.max()]]
    else:
        row, col = np.unravel_index(int(np.argmin(state.gap)), grid.shape)
        x, y = grid.x[[col, col]], grid.y[[row, row]]
    centre = (float(x.mean()), float(y.mean()))
    box = box_around(grid, centre, MARGIN * max(float(np.ptp(x)), float(np.ptp(y))) / 2 + LEAST_WINDOW_MM)
    part = grid_part(grid, box)
    pressure, gap = (np.asarray(a[box], dtype=float) for a in (state.pressure, state.gap))
    heights = pressed_profile(pressure, gap, np.zeros(part.shape), grid.pitch, modulus)
    heights -= heights.min()
    without = resolved_state(part, heights, modulus, state.normal_force, law=state.law)
    found = resolved_state(part, heights, modulus, state.normal_force, law=state.law, adhesion=adhesion)

    def added(name: str) -> Array:
        whole = np.array(getattr(state, name), dtype=float)
        whole[box] += np.asarray(getattr(found, name)) - np.asarray(getattr(without, name))
        return whole

    area = state.nominal_contact_area + found.nominal_contact_area - without.nominal_contact_area
    mask = mask_with_sum(added("contact_mask"), np.asarray(state.contact_mask), area / grid.pitch**2)
    return replace(
        state,
        pressure=added("pressure"),
        gap=np.where(mask >= 1.0, 0.0, np.maximum(added("gap"), 0.0)),
        contact_mask=mask,
        nominal_contact_area=area,
        depth=state.depth + found.depth - without.depth,
        parameters={
            **state.parameters,
            **{key: found.parameters[key] for key in ("work_of_adhesion_N_per_mm", "cohesive_stress_MPa")},
        },
    )
