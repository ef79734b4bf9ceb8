"""Contact states from the half-space solver: any height map, smooth or ridged, with or without adhesion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, maximum_filter
from scipy.optimize import brentq

from evanesce.contact.halfspace.adhesion import press_adhesive_height_map, resolved_cohesive_stress
from evanesce.contact.halfspace.operators import free_operator
from evanesce.contact.halfspace.solver import HalfspaceSolution, press_height_map
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Adhesion:
    """Adhesion of a half-space.

    Attributes
    ----------
    work : float
        Work of adhesion [N/mm].
    stress : float or None
        Cohesive stress [MPa]; None: as large as the grid resolves.
    """

    work: float
    stress: float | None = None


def contact_area(touching: NDArray[np.bool_], pitch: float) -> float:
    """Return the area of contact [mm^2] from which cells touch [bool, (rows, cols)], corrected for the border's cells.

    A cell that touches at all counts as touching, which adds (pi - 1 + ln 2)/24 of a cell per cell side of border on
    average over its directions.

    Parameters
    ----------
    touching : ndarray of bool (rows, cols)
        Cells in contact.
    pitch : float
        [mm].

    Returns
    -------
    float
        [mm^2].

    References
    ----------
    V. A. Yastrebov, G. Anciaux, J.-F. Molinari, Tribology Int. 114 (2017) 161.
    """
    sides = np.count_nonzero(touching[1:] != touching[:-1]) + np.count_nonzero(touching[:, 1:] != touching[:, :-1])
    cells = np.count_nonzero(touching) - (np.pi - 1.0 + np.log(2.0)) / 24.0 * sides
    return float(max(cells, 0.0) * pitch**2)


def contact_coverage(reaction: Array, pitch: float) -> Array:
    """Return the share of each cell in contact (rows, cols), its sum the corrected area.

    Near a border the pressure grows as the root of the distance d inwards, so that the ratio of the squares in a border
    cell and in the deepest of its neighbours is d/(d + 1), in cells: that places the border within the cell. One offset
    common to all makes the sum right.

    Parameters
    ----------
    reaction : ndarray (rows, cols)
        Pressure of the constraint [MPa]: positive in contact, zero elsewhere.
    pitch : float
        [mm].

    Returns
    -------
    ndarray (rows, cols)
    """
    touching = reaction > 0
    share = touching.astype(float)
    border = touching & ~binary_erosion(touching)
    if not border.any():
        return share
    square = reaction**2
    ratio = (square / maximum_filter(square, 3, mode="constant", cval=0.0, output=float).clip(min=1e-300))[border]
    place = np.minimum(ratio / np.maximum(1.0 - ratio, 1e-3), 1.0)
    wanted = contact_area(touching, pitch) / pitch**2 - (np.count_nonzero(touching) - place.size)
    wanted = min(max(wanted, 0.0), float(place.size))
    offset = brentq(lambda shift: np.clip(place + shift, 0.0, 1.0).sum() - wanted, -1.0, 1.0)
    share[border] = np.clip(place + offset, 0.0, 1.0)
    return share


def pressed_profile(smooth_pressure: Array, smooth_gap: Array, ridges: Array, pitch: float, modulus: float) -> Array:
    """Return the height map that stands for a ridged finger whose smooth contact is given.

    In the smooth contact the glass has flattened the finger: its shape plus the displacement by its pressure is its gap
    plus a constant. So gap minus displacement is a shape that a half-space presses to the same contact, whatever the
    finger's own elasticity (a finite-element finger with bone and shaft); on it lie the ridges, which are small enough
    for a half-space.

    Parameters
    ----------
    smooth_pressure, smooth_gap : ndarray (rows, cols)
        Of the smooth finger [MPa], [mm].
    ridges : ndarray (rows, cols)
        Depth below the crests [mm].
    pitch : float
        [mm].
    modulus : float
        E* at the scale of the ridges [MPa]: local stiffness.

    Returns
    -------
    ndarray (rows, cols)
        [mm], up to a constant.
    """
    return smooth_gap - free_operator(smooth_pressure.shape, pitch, modulus)(smooth_pressure) + ridges


def resolved_state(
    grid: PlateGrid,
    heights: Array,
    modulus: float,
    force: float,
    *,
    law: str,
    adhesion: Adhesion | None = None,
    layer: float | None = None,
    parameters: Mapping[str, Any] | None = None,
    time: float = 0.0,
) -> ContactState:
    """Press a height map and return the state.

    Parameters
    ----------
    grid : PlateGrid
    heights : ndarray (rows, cols)
        Undeformed distance from the glass [mm], zero at the first point of contact.
    modulus : float
        E* [MPa].
    force : float
        Normal force [N], not negative.
    law, parameters, time
        Passed on.
    adhesion : Adhesion, optional
    layer : float, optional
        Thickness [mm] of an incompressible layer on rigid bone, instead of a half-space; without adhesion.

    Returns
    -------
    ContactState

    Raises
    ------
    InputError
        If the contact reaches the grid's border.
    WorkError
        If the solver does not settle.
    """
    named = dict(parameters or {})
    if adhesion is not None and adhesion.work > 0:
        stress = adhesion.stress or resolved_cohesive_stress(modulus, adhesion.work, grid.pitch)
        named |= {"work_of_adhesion_N_per_mm": adhesion.work, "cohesive_stress_MPa": stress}
        found = press_adhesive_height_map(heights, grid.pitch, modulus, force, adhesion.work, stress)
        reaction = np.where(found.gap == 0, np.maximum(found.pressure + stress, 0.0), 0.0)
    elif force > 0:
        found = press_height_map(heights, grid.pitch, modulus, force, layer=layer)
        reaction = found.pressure
    else:
        nothing = np.zeros(grid.shape)
        found, reaction = HalfspaceSolution(nothing, heights - heights.min(), 0.0, 0, 0.0), nothing
    if reaction[[0, -1]].any() or reaction[:, [0, -1]].any():
        side = min(grid.shape) * grid.pitch
        raise InputError(
            f"contact reaches the border of the contact grid of {side:.4g} mm",
            key="grid.size_mm",
            allowed=f"more than {side:.4g} mm",
        )
    return ContactState(
        grid=grid,
        pressure=found.pressure,
        gap=found.gap,
        contact_mask=contact_coverage(reaction, grid.pitch),
        normal_force=force,
        nominal_contact_area=contact_area(reaction > 0, grid.pitch),
        depth=found.depth,
        law=law,
        parameters=named | {"iterations": found.iterations, "residual": found.residual},
        time=time,
    )
