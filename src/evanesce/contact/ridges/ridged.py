"""A ridged finger on two scales: its ridges carry the smooth finger's pressure, and each closes locally.

Scales are separated: the macroscopic contact (radius, pressure, gap) is that of the smooth finger, and where its
pressure is p, a ridge is one of a periodic row under the mean pressure p (:mod:`evanesce.contact.ridges.profile`).
:func:`ridged_state` puts ridges on a pressed finger, :func:`with_ridges` on any smooth contact state, in which they
move with the skin. Limits: the pitch must be small against the contact radius (error of the order pitch/radius at the
edge of contact); ridges do not change the macroscopic radius or depth; curvature of concentric ridges is neglected,
which affects their innermost one; no adhesion, small slopes; whether a ridge slips is decided on the scale of the whole
contact. The half-space solver has none of the first three limits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.contact.coverage import level_area, level_coverage
from evanesce.contact.patch import (
    AxisymmetricContact,
    axisymmetric_state,
    box_around,
    cell_pressure,
    grid_part,
    radii,
    require_fit,
)
from evanesce.contact.ridges.carried import on_ridges, ridge_traction
from evanesce.contact.ridges.closure import RidgeClosure
from evanesce.contact.ridges.heightmap import RidgeRow
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid, SurfaceState

Array = NDArray[np.float64]

MIN_SAMPLES_PER_PITCH = 8
_MAX_OVERLOAD = 1.25


def ridged_state(
    grid: PlateGrid,
    centre: tuple[float, float],
    smooth: AxisymmetricContact,
    ridges: RidgeRow,
    modulus: float,
    *,
    law: str,
    parameters: Mapping[str, Any] | None = None,
    time: float = 0.0,
) -> ContactState:
    """Sample the contact of a pressed finger with ridges.

    Parameters
    ----------
    grid : PlateGrid
    centre : tuple of float
        Tip (x, y) on the plate [mm].
    smooth : AxisymmetricContact
        The macroscopic contact; its pressure must have the form p0 (1 - (r/a)^k)^(1/k).
    ridges : RidgeRow
    modulus : float
        E* at the scale of the ridges [MPa].
    law, parameters, time
        Passed on to the state.

    Returns
    -------
    ContactState
        Each ridge carries on the grid the share of the smooth finger's force that falls on its pitch (at the edge of
        contact see :func:`share_forces`), so that the total is the normal force.

    Raises
    ------
    InputError
        If the contact does not fit on the grid, or the grid is too coarse for the ridges.
    ValueError
        If ``smooth`` has no pressure of that form, or a dimension of ``ridges`` is impossible.
    """
    require_resolved(grid, ridges)
    closure = RidgeClosure.of(ridges, modulus)
    named = {
        **(parameters or {}),
        "ridge_profile_exponent": closure.exponent,
        "ridge_closure_pressure_MPa": closure.pressure,
    }
    x, y = grid.x[None, :] - centre[0], grid.y[:, None] - centre[1]
    number, distance = ridges.locate(x, y)
    if smooth.contact_radius == 0:
        open_state = axisymmetric_state(grid, centre, smooth, law=law, parameters=named, time=time)
        return replace(open_state, gap=open_state.gap + closure.gap(distance, 0.0))
    if smooth.shape_exponent is None:
        raise ValueError("the first ridged model needs a macroscopic law without adhesion")
    require_fit(grid, centre, smooth.contact_radius)
    # nothing touches outside the smooth circle: only the gap is needed there, and its furrows are undeformed
    box = box_around(grid, centre, smooth.contact_radius)
    part = grid_part(grid, box)
    mean = cell_pressure(part, centre, smooth)
    r = radii(grid, centre)
    local = _mean_pressure(smooth, r[box])
    inner = closure.local_pressure(distance[box], local)
    inner = share_forces(inner, mean, number[box]) * (smooth.normal_force / (mean.sum() * grid.pitch**2))
    furrow = closure.undeformed_gap(distance)
    furrow[box] = closure.gap(distance[box], local)
    pressure, covered = np.zeros(grid.shape), np.zeros(grid.shape)
    pressure[box] = inner
    covered[box] = level_coverage(_level(smooth, closure), part, centre)
    return ContactState(
        grid=grid,
        pressure=pressure,
        gap=smooth.gap(r) + furrow,
        contact_mask=covered,
        normal_force=smooth.normal_force,
        nominal_contact_area=ridged_area(smooth, closure),
        depth=smooth.depth,
        law=law,
        parameters=named,
        time=time,
    )


def with_ridges(
    smooth: ContactState,
    ridges: RidgeRow,
    modulus: float,
    *,
    origin: tuple[float, float],
    outer_slip: tuple[ArrayLike, ArrayLike] = (0.0, 0.0),
    skin: tuple[ArrayLike, ArrayLike] | None = None,
    near_gap: float = 0.01,
    outline_alone: bool = False,
) -> ContactState:
    """Put ridges on a smooth finger's contact state, in which they move with the skin.

    A ridge belongs to the finger's skin: it stands where its piece of skin first touched, plus the slip since then, so
    that it stays on the glass where the contact sticks and moves where it slips. The pressure and strength of the
    smooth contact about a point are those of the ridges within a pitch of it, shared as their local pressure. Traction
    over strength stays what it is at each place, so that what slips carries its strength; what the sums then lack of
    the smooth contact's force and torque, what sticks carries.

    Parameters
    ----------
    smooth : ContactState
        With pressure and gap; slip, its velocity, traction, strength and state where it slides.
    ridges : RidgeRow
    modulus : float
        E* at the scale of the ridges [MPa].
    origin : tuple of float
        Plate point (x, y) on which the finger's tip first rested [mm].
    outer_slip : tuple of float or ndarray (rows, cols)
        Displacement (x, y) of the skin outside the contact [mm].
    skin : tuple of ndarray (rows, cols), optional
        Displacement (x, y) of the skin everywhere [mm], in place of slip and ``outer_slip``.
    near_gap : float
        Gap below which a surface counts as near [mm].
    outline_alone : bool
        Leave pressure, traction and strength as they are: the light of touching ridges is that of mask and gap.

    Returns
    -------
    ContactState
        Carries the same forces; ``nominal_contact_area`` is that of the ridges' contact, counted from the mask.
    """
    grid, closure = smooth.grid, RidgeClosure.of(ridges, modulus)
    whole = np.asarray(smooth.contact_mask, dtype=float)
    touched = whole > 0
    drift = np.asarray(skin) if skin is not None else _drift(smooth, touched, outer_slip)
    x, y = grid.x[None, :] - origin[0] - drift[0], grid.y[:, None] - origin[1] - drift[1]
    distance = ridges.locate(x, y)[1]
    furrow = closure.undeformed_gap(distance)
    mask, local = np.zeros(grid.shape), np.zeros(grid.shape)
    if touched.any():
        mean = np.asarray(smooth.pressure, dtype=float)[touched]
        d = distance[touched]
        furrow[touched] = closure.gap(d, mean)
        mask[touched] = whole[touched] * _strip_coverage(d, mean, closure, grid.pitch)
        if not outline_alone:
            local[touched] = np.where(mask[touched] > 0, closure.local_pressure(d, mean), 0.0)
    gap = np.where(mask >= 1.0, 0.0, np.asarray(smooth.gap) + furrow)
    changes = {} if outline_alone else on_ridges(smooth, local, touched, ridges.pitch)
    if not outline_alone and smooth.traction is not None and smooth.strength is not None:
        changes["traction"] = ridge_traction(smooth, changes["strength"])
    for name in ("slip", "slip_velocity"):
        if getattr(smooth, name) is not None:
            changes[name] = np.asarray(getattr(smooth, name)) * (mask > 0)
    if smooth.state is not None:
        state = np.where(gap < near_gap, np.uint8(SurfaceState.NEAR), np.uint8(SurfaceState.NONE))
        held = mask >= 0.5
        state[held] = np.maximum(np.asarray(smooth.state)[held], np.uint8(SurfaceState.STICK))
        changes["state"] = state
    return replace(
        smooth,
        gap=gap,
        contact_mask=mask,
        nominal_contact_area=float(mask.sum()) * grid.pitch**2,
        law=f"{smooth.law}+ridges",
        parameters={**smooth.parameters, **replace(ridges, rounding=None).parameters()},
        **changes,
    )


def _drift(smooth: ContactState, touched: NDArray[np.bool_], outer_slip: tuple[ArrayLike, ArrayLike]) -> Array:
    """Return how far the skin has moved over the glass [mm], (2, rows, cols)."""
    drift = np.empty((2, *smooth.grid.shape))
    for axis in (0, 1):
        drift[axis] = (
            outer_slip[axis] if smooth.slip is None else np.where(touched, smooth.slip[axis], outer_slip[axis])
        )
    return drift


def _strip_coverage(distance: Array, mean: Array, closure: RidgeClosure, cell: float) -> Array:
    """Return the share of each cell within the half width of its ridge's contact, the border cut as a straight edge."""
    half = closure.half_width(mean)
    share = np.clip(0.5 + (half - np.abs(distance)) / cell, 0.0, 1.0)
    return np.where(half >= 0.5 * closure.ridges.pitch, 1.0, np.where(half > 0, share, 0.0))


def require_resolved(grid: PlateGrid, ridges: RidgeRow) -> None:
    """Refuse a grid with fewer than :data:`MIN_SAMPLES_PER_PITCH` samples to a ridge.

    Parameters
    ----------
    grid : PlateGrid
    ridges : RidgeRow

    Raises
    ------
    InputError
    """
    if grid.pitch * MIN_SAMPLES_PER_PITCH > ridges.pitch:
        raise InputError(
            f"contact grid of {1e3 * grid.pitch:.4g} um per sample is too coarse for ridges {1e3 * ridges.pitch:.4g} um"
            " apart",
            key="grid.samples",
            allowed=f"at least {MIN_SAMPLES_PER_PITCH} samples per ridge pitch",
        )


def _peak(smooth: AxisymmetricContact) -> float:
    """Return p0 [MPa] from the force inside a small circle, exact to the square of its relative radius."""
    small = 1e-4 * smooth.contact_radius
    return float(smooth.force_within(np.array(small)) / (np.pi * small**2))


def _mean_pressure(smooth: AxisymmetricContact, r: Array) -> Array:
    """Return the macroscopic pressure at radii r [MPa]."""
    k = smooth.shape_exponent or 2.0
    return _peak(smooth) * np.clip(1.0 - (r / smooth.contact_radius) ** k, 0.0, None) ** (1.0 / k)


def share_forces(pressure: Array, mean: Array, number: NDArray[np.int64]) -> Array:
    """Scale the pressure of each ridge so that it carries the macroscopic pressure on its own strip.

    Parameters
    ----------
    pressure : ndarray (rows, cols)
        Local pressure [MPa].
    mean : ndarray (rows, cols)
        Macroscopic pressure [MPa].
    number : ndarray of int (rows, cols)
        Ridge of each sample.

    Returns
    -------
    ndarray (rows, cols)
        Sums to the sum of ``mean``. At the edge of contact a crest may barely reach the glass, or not at all: what a
        ridge would have to carry beyond a quarter more than its local pressure, its inner neighbour takes.

    Raises
    ------
    ValueError
        If no ridge touches.
    """
    first = int(number.min())
    index = (number - first).ravel()
    share = np.bincount(index, mean.ravel())
    local = np.bincount(index, pressure.ravel())
    strongest = int(np.argmax(local))
    if local[strongest] <= 0:
        raise ValueError("no ridge touches on this grid")
    inwards = [*range(strongest), *range(len(share) - 1, strongest, -1)]
    for ridge in inwards:
        surplus = share[ridge] - _MAX_OVERLOAD * local[ridge]
        if surplus > 0:
            share[ridge] -= surplus
            share[ridge + (1 if ridge < strongest else -1)] += surplus
    factor = np.divide(share, local, out=np.zeros_like(share), where=local > 0)
    return pressure * factor[index].reshape(pressure.shape)


def _level(smooth: AxisymmetricContact, closure: RidgeClosure) -> Callable[[Array, Array], Array]:
    """Return a smooth function of points (relative to the tip) that is positive in contact.

    Contact is where the macroscopic pressure exceeds what the local height takes, p > p_c |sin|^m, and inside the
    macroscopic circle. To the power k this is (a^k - r^k) - a^k (p_c/p0)^k |sin|^(m k), without the steep edge of p.
    """
    k, ridges = smooth.shape_exponent or 2.0, closure.ridges
    radius = smooth.contact_radius
    need = (closure.pressure / _peak(smooth)) ** k

    def level(x: Array, y: Array) -> Array:
        _, distance = ridges.locate(x, y)
        s = np.abs(np.sin(np.pi * distance / ridges.pitch))
        return 1.0 - (np.hypot(x, y) / radius) ** k - need * s ** (closure.exponent * k)

    return level


def ridged_area(smooth: AxisymmetricContact, closure: RidgeClosure) -> float:
    """Return the area of contact of a pressed finger with ridges by quadrature, without a grid of the plate.

    At distance d from its crest a ridge touches inside the circle on which the macroscopic pressure is
    p_c |sin(pi d/lambda)|^m, of radius rho(d). A parallel ridge at u adds the chords 2 sqrt(rho^2 - (u + d)^2); other
    patterns are integrated along 1,000 lines, on each of which the edges are found between nodes, to 2e-4 of the area.

    Parameters
    ----------
    smooth : AxisymmetricContact
        As in :func:`ridged_state`.
    closure : RidgeClosure

    Returns
    -------
    float
        [mm^2].
    """
    ridges = closure.ridges
    if ridges.pattern != "parallel":
        return level_area(_level(smooth, closure), smooth.contact_radius)
    k, radius, pitch = smooth.shape_exponent or 2.0, smooth.contact_radius, ridges.pitch
    need = closure.pressure / _peak(smooth)
    # midpoint rule: the integrand's only kinks are roots at the ends of chords, error below 1e-5 of a pitch
    nodes = 4000
    d = ((np.arange(nodes) + 0.5) / nodes - 0.5) * pitch
    s = np.abs(np.sin(np.pi * d / pitch))
    rho = radius * np.clip(1.0 - (need * s**closure.exponent) ** k, 0.0, None) ** (1.0 / k)
    reach = int(np.ceil(radius / pitch)) + 1
    across = np.arange(-reach, reach + 1)[:, None] * pitch + d[None, :]
    chord = 2.0 * np.sqrt(np.clip(rho**2 - across**2, 0.0, None))
    return float(chord.sum() * pitch / nodes)
