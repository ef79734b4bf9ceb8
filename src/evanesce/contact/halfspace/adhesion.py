"""Adhesion between the limits of JKR and DMT: Maugis's closed forms, and Dugdale's cohesive zone on any height map.

A constant tension sigma0 acts across gaps below w/sigma0. For a sphere its strength is Maugis's parameter; above about
5 the contact is JKR's, below 0.1 DMT's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from evanesce.contact.halfspace.operators import free_operator
from evanesce.contact.halfspace.solver import HalfspaceSolution, conjugate_gradients, press_height_map
from evanesce.core.errors import WorkError

Array = NDArray[np.float64]


def maugis_parameter(tip_radius: float, modulus: float, work_of_adhesion: float, cohesive_stress: float) -> float:
    """Return Maugis's lambda = 2 sigma0 (9 R/(16 pi w E*^2))^(1/3).

    Parameters
    ----------
    tip_radius : float
        R [mm].
    modulus : float
        E* [MPa].
    work_of_adhesion : float
        w [N/mm].
    cohesive_stress : float
        sigma0 [MPa].

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If one of them is not positive.

    References
    ----------
    D. Maugis, J. Colloid Interface Sci. 150 (1992) 243, with his K = 4 E*/3.
    """
    if not min(tip_radius, modulus, work_of_adhesion, cohesive_stress) > 0:
        raise ValueError("tip radius, E*, work of adhesion and cohesive stress must be positive")
    length = 9.0 * tip_radius / (16.0 * np.pi * work_of_adhesion * modulus**2)
    return float(2.0 * cohesive_stress * np.cbrt(length))


def resolved_cohesive_stress(modulus: float, work_of_adhesion: float, pitch: float, cells: float = 4.0) -> float:
    """Return the sigma0 [MPa] whose cohesive zone is a given number of cells wide.

    The zone ahead of a crack is pi E* w/(4 sigma0^2) wide (Dugdale with the stress intensity sqrt(2 E* w)).

    Parameters
    ----------
    modulus : float
        E* [MPa].
    work_of_adhesion : float
        w [N/mm].
    pitch : float
        Sampling [mm].
    cells : float

    Returns
    -------
    float
        [MPa].
    """
    return float(np.sqrt(np.pi * modulus * work_of_adhesion / (4.0 * cells * pitch)))


def maugis_force_and_depth(
    contact_radius: float, tip_radius: float, modulus: float, work_of_adhesion: float, cohesive_stress: float
) -> tuple[float, float]:
    """Return force [N] and depth [mm] in equilibrium with a contact radius [mm].

    Parameters
    ----------
    contact_radius : float
        [mm].
    tip_radius : float
        [mm].
    modulus : float
        E* [MPa].
    work_of_adhesion : float
        [N/mm].
    cohesive_stress : float
        [MPa].

    Returns
    -------
    tuple of float
        [N], [mm].

    References
    ----------
    Maugis (1992), the equations for the ratio m = c/a of cohesive to contact radius, for the force and for the depth.
    """
    strength = maugis_parameter(tip_radius, modulus, work_of_adhesion, cohesive_stress)
    stiffness = 4.0 * modulus / 3.0
    a = contact_radius * np.cbrt(stiffness / (np.pi * work_of_adhesion * tip_radius**2))

    def surplus(m: float) -> float:
        root, angle = np.sqrt(m * m - 1.0), np.arccos(1.0 / m)
        opening = 0.5 * strength * a * a * (root + (m * m - 2.0) * angle)
        return float(opening + 4.0 / 3.0 * strength**2 * a * (root * angle - m + 1.0) - 1.0)

    top = 2.0
    while surplus(top) < 0:
        top *= 2.0
    m = float(brentq(surplus, 1.0, top, xtol=1e-14))
    root = np.sqrt(m * m - 1.0)
    force = a**3 - strength * a * a * (root + m * m * np.arccos(1.0 / m))
    depth = a * a - 4.0 / 3.0 * strength * a * root
    unit = np.cbrt(np.pi**2 * work_of_adhesion**2 * tip_radius / stiffness**2)
    return float(np.pi * work_of_adhesion * tip_radius * force), float(unit * depth)


def maugis_pull_off_force(tip_radius: float, modulus: float, work_of_adhesion: float, cohesive_stress: float) -> float:
    """Return the smallest force in equilibrium [N], between -2 pi w R (DMT) and -1.5 pi w R (JKR).

    Parameters
    ----------
    tip_radius : float
        [mm].
    modulus : float
        E* [MPa].
    work_of_adhesion : float
        [N/mm].
    cohesive_stress : float
        [MPa].

    Returns
    -------
    float
        [N].
    """
    unit = np.cbrt(np.pi * work_of_adhesion * tip_radius**2 / (4.0 * modulus / 3.0))

    def force(log_radius: float) -> float:
        found = maugis_force_and_depth(
            unit * np.exp(log_radius), tip_radius, modulus, work_of_adhesion, cohesive_stress
        )
        return found[0]

    return float(minimize_scalar(force, bounds=(-5.0, 1.5), method="bounded", options={"xatol": 1e-8}).fun)


def press_adhesive_height_map(
    heights: Array,
    pitch: float,
    modulus: float,
    force: float,
    work_of_adhesion: float,
    cohesive_stress: float,
    *,
    preload: float | None = None,
    tolerance: float = 1e-4,
    max_rounds: int = 400,
) -> HalfspaceSolution:
    """Press (or pull) an adhesive elastic half-space of a given height map on rigid glass.

    Where the gap is below w/sigma0 the tension sigma0 acts. With that region D held, pressure plus sigma0 on D is the
    solution of a contact without adhesion on a map that sigma0 on D has pulled down; D follows from its gap, and so
    on. More of D means more pull and smaller gaps, so the rounds are monotonic: from a small D they end in the state
    reached by loading, from a large one in that reached by unloading.

    Parameters
    ----------
    heights, pitch, modulus
        As :func:`~evanesce.contact.halfspace.solver.press_height_map`, free at its border.
    force : float
        Normal force [N]; negative pulls.
    work_of_adhesion, cohesive_stress : float
        w [N/mm] and sigma0 [MPa].
    preload : float, optional
        Larger force [N] that was applied before: the state on unloading from it. None: the state on loading.
    tolerance : float
        Change of D in a round, relative to D, at which to stop.
    max_rounds : int

    Returns
    -------
    HalfspaceSolution
        ``iterations`` counts rounds.

    Raises
    ------
    ValueError
        If w or sigma0 is not positive, or a tensile force is given without a preload.
    WorkError
        If the finger lets go of the glass, or the rounds do not settle.

    References
    ----------
    D. S. Dugdale, J. Mech. Phys. Solids 8 (1960) 100; Maugis (1992); the constrained conjugate gradients are Polonsky
    and Keer's (1999).
    """
    if not (work_of_adhesion > 0 and cohesive_stress > 0):
        raise ValueError("work of adhesion and cohesive stress must be positive")
    reach = work_of_adhesion / cohesive_stress
    operator = free_operator(heights.shape, pitch, modulus)
    forces = [force] if preload is None else [preload, force]
    if preload is None and force < 0:
        raise ValueError("without a preload only a pressing force has a state")
    if preload is not None and not preload >= max(force, 0.0):
        raise ValueError(f"preload {preload:g} N must be at least the force {force:g} N")
    if forces[0] > 0:
        first = press_height_map(heights, pitch, modulus, forces[0])
        zone, lifted = _zone(first.gap, reach), first.pressure
    else:
        zone, lifted = _zone(heights - heights.min(), reach), np.zeros(heights.shape)
    rounds, change = 0, 1.0
    for target in forces:
        for _ in range(max_rounds):
            rounds += 1
            carried = target + cohesive_stress * float(zone.sum()) * pitch**2
            if carried <= 0:
                raise WorkError(f"the finger lets go of the glass at {target:g} N")
            pulled = heights - operator(cohesive_stress * zone)
            inner = min(1e-3, max(0.03 * change, 1e-6))  # no need to be finer than the zone itself
            found = conjugate_gradients(pulled, operator, pitch, carried, lifted, tolerance=inner, max_iterations=4000)
            lifted = found.pressure
            updated = _zone(found.gap, reach)
            change = float(np.abs(updated - zone).sum()) / max(float(zone.sum()), 1.0)
            zone = updated
            if change < tolerance:
                break
        else:
            raise WorkError(f"the cohesive zone has not settled after {max_rounds} rounds (change {change:.1e})")
    pressure = lifted - cohesive_stress * zone
    return HalfspaceSolution(pressure, found.gap, found.depth, rounds, change)


def _zone(gap: Array, reach: float) -> Array:
    """Return the share of each cell whose gap is below the reach, its border taken as straight."""
    slope_y, slope_x = np.gradient(gap)
    slope = np.abs(slope_x) + np.abs(slope_y)
    share = 0.5 + np.divide(reach - gap, slope, out=np.full_like(gap, np.inf), where=slope > 0)
    share[(slope == 0) & (gap > reach)] = 0.0
    return np.clip(share, 0.0, 1.0)
