"""Adhesion added to a contact that was solved without it, whatever the law.

A round contact takes JKR's argument as it stands: the radius is that of a dry contact under a larger force, less the
pull of a flat punch of that radius. For Hertz's law this is JKR. A ridged contact is pressed on a half-space twice,
with and without adhesion, and what differs is added to what its law says, so that no adhesion adds nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.contact.halfspace.resolved import Adhesion, resolved_state
from evanesce.contact.patch import AxisymmetricContact, box_around, grid_part
from evanesce.contact.reshape import mask_with_sum
from evanesce.core.states import ContactState

Array = NDArray[np.float64]

MARGIN = 1.5
"""Half side of the window that is solved, over the radius of contact without adhesion."""

MIN_WINDOW_MM = 1.0


_FIRST_FORCE = 1e-6
_MAX_ITERATIONS = 200


def adhered_contact(
    dry: Callable[[float], AxisymmetricContact], force: float, modulus: float, work: float
) -> tuple[AxisymmetricContact, float]:
    """Return a round contact with adhesion: dry at the force F1 = F + sqrt(8 pi w E* a(F1)^3), less a punch's pull.

    Parameters
    ----------
    dry : callable
        Force [N] -> contact without adhesion; its radius rises with force, slower than its power 2/3.
    force : float
        [N], not negative.
    modulus : float
        E* at the edge of contact [MPa].
    work : float
        Work of adhesion [N/mm].

    Returns
    -------
    contact : AxisymmetricContact
    dry_force : float
        F1 [N].

    References
    ----------
    D. Maugis, *Contact, Adhesion and Rupture of Elastic Solids* (2000), section 4.2, for any axisymmetric shape.
    """

    def pull(radius: float) -> float:
        return math.sqrt(8.0 * math.pi * work * modulus * radius**3)

    dry_force, contact = max(force, _FIRST_FORCE), dry(max(force, _FIRST_FORCE))
    for _ in range(_MAX_ITERATIONS):  # the pull rises slower than the force, so this rises to the stable contact
        wanted = force + pull(contact.contact_radius)
        settled = abs(wanted - dry_force) <= 1e-13 * wanted
        dry_force, contact = wanted, dry(wanted)
        if settled:
            break
    radius, strength = contact.contact_radius, pull(contact.contact_radius)
    neck = math.sqrt(8.0 * radius * work / (math.pi * modulus))

    def force_within(r: ArrayLike) -> Array:
        inner = np.clip(1.0 - (np.asarray(r, dtype=float) / radius) ** 2, 0.0, None)
        return contact.force_within(np.asarray(r, dtype=float)) - strength * (1.0 - np.sqrt(inner))

    def gap(r: ArrayLike) -> Array:
        outside = np.maximum(np.asarray(r, dtype=float) / radius, 1.0)
        return contact.gap(np.asarray(r, dtype=float)) + neck * np.arccos(1.0 / outside)

    found = AxisymmetricContact(
        contact_radius=radius,
        normal_force=force,
        depth=contact.depth - math.sqrt(2.0 * math.pi * work * radius / modulus),
        force_within=force_within,
        gap=gap,
        shape_exponent=None,
    )
    return found, dry_force


def adhered_state(state: ContactState, heights: Array, modulus: float, adhesion: Adhesion) -> ContactState:
    """Add adhesion to a state.

    Parameters
    ----------
    state : ContactState
        Without adhesion.
    heights : ndarray (rows, cols)
        What a half-space would have to be to make that contact [mm]
        (:func:`~evanesce.contact.halfspace.resolved.pressed_profile`).
    modulus : float
        E* at the edge of contact [MPa].
    adhesion : Adhesion
        Its work positive.

    Returns
    -------
    ContactState

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
    box = box_around(grid, centre, MARGIN * max(float(np.ptp(x)), float(np.ptp(y))) / 2 + MIN_WINDOW_MM)
    part = grid_part(grid, box)
    shape = heights[box] - heights[box].min()
    without = resolved_state(part, shape, modulus, state.normal_force, law=state.law)
    found = resolved_state(part, shape, modulus, state.normal_force, law=state.law, adhesion=adhesion)

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
