"""A ridged finger, first model: the smooth finger's pressure is handed to its ridges, each of which closes locally.

Scales are separated: the macroscopic contact (radius, pressure, gap) is that of the smooth finger, and where its
pressure is p, a ridge looks like one of an endless periodic row under the mean pressure p (:mod:`.profile`). Its
limits: the pitch must be small against the contact radius (error of the order pitch/radius at the rim); ridges do not
change the macroscopic radius or depth; curvature of concentric ridges is ignored, which their innermost ring feels;
no adhesion, no friction, small slopes. The half-space solver has none of the first three limits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.patch import (
    AxisymmetricContact,
    axisymmetric_state,
    box_around,
    cell_pressure,
    grid_part,
    radii,
    require_fit,
)
from evanesce.contact.ridges.heightmap import RidgeRow, furrow_depth
from evanesce.contact.ridges.profile import closure_pressure, profile_exponent, ridge_gap, ridge_pressure
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid

Array = NDArray[np.float64]

MIN_SAMPLES_PER_PITCH = 8
_SUBCELLS = 4
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
    """Sample the contact of a ridged finger.

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
        Each ridge carries on the grid the share of the smooth finger's force that falls on its pitch (at the rim see
        :func:`share_forces`), so that the total is the normal force.

    Raises
    ------
    InputError
        If the contact does not fit on the grid, or the grid is too coarse for the ridges.
    ValueError
        If ``smooth`` has no pressure of that form, or a figure of ``ridges`` is impossible.
    """
    require_resolved(grid, ridges)
    exponent = profile_exponent(ridges.width, ridges.pitch)
    closure = closure_pressure(modulus, ridges.height, ridges.pitch, exponent)
    named = {**(parameters or {}), "ridge_profile_exponent": exponent, "ridge_closure_pressure_MPa": closure}
    x, y = grid.x[None, :] - centre[0], grid.y[:, None] - centre[1]
    number, distance = ridges.locate(x, y)
    if smooth.contact_radius == 0:
        open_state = axisymmetric_state(grid, centre, smooth, law=law, parameters=named, time=time)
        furrow = ridge_gap(distance, 0.0, ridges.pitch, ridges.height, closure, exponent)
        return replace(open_state, gap=open_state.gap + furrow)
    if smooth.shape_exponent is None:
        raise ValueError("the first ridged model needs a macroscopic law without adhesion")
    require_fit(grid, centre, smooth.contact_radius)
    # nothing touches outside the smooth circle: only the gap is needed there, and its furrows are undeformed
    box = box_around(grid, centre, smooth.contact_radius)
    part = grid_part(grid, box)
    mean = cell_pressure(part, centre, smooth)
    r = radii(grid, centre)
    local = _mean_pressure(smooth, r[box])
    inner = ridge_pressure(distance[box], local, ridges.pitch, closure, exponent)
    inner = share_forces(inner, mean, number[box]) * (smooth.normal_force / (mean.sum() * grid.pitch**2))
    furrow = furrow_depth(distance, ridges.pitch, ridges.width, ridges.height)
    furrow[box] = ridge_gap(distance[box], local, ridges.pitch, ridges.height, closure, exponent)
    pressure, covered = np.zeros(grid.shape), np.zeros(grid.shape)
    pressure[box] = inner
    covered[box] = level_coverage(_level(smooth, ridges, closure, exponent), part, centre)
    return ContactState(
        grid=grid,
        pressure=pressure,
        gap=smooth.gap(r) + furrow,
        contact_mask=covered,
        normal_force=smooth.normal_force,
        nominal_contact_area=ridged_area(smooth, ridges, closure, exponent),
        depth=smooth.depth,
        law=law,
        parameters=named,
        time=time,
    )


def require_resolved(grid: PlateGrid, ridges: RidgeRow) -> None:
    """Refuse a grid with fewer than :data:`MIN_SAMPLES_PER_PITCH` samples to a ridge.

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
        Sums to the sum of ``mean``. At the rim a crest may barely reach the glass, or not at all: what a ridge would
        have to carry beyond a quarter more than its local pressure, its inner neighbour takes.

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


def _level(
    smooth: AxisymmetricContact, ridges: RidgeRow, closure: float, exponent: float
) -> Callable[[Array, Array], Array]:
    """Return a smooth function of points (relative to the tip) that is positive in contact.

    Contact is where the macroscopic pressure exceeds what the local height takes, p > p_c |sin|^m, and inside the
    macroscopic circle. To the power k this is (a^k - r^k) - a^k (p_c/p0)^k |sin|^(m k), without the steep rim of p.
    """
    k = smooth.shape_exponent or 2.0
    radius = smooth.contact_radius
    need = (closure / _peak(smooth)) ** k

    def level(x: Array, y: Array) -> Array:
        _, distance = ridges.locate(x, y)
        s = np.abs(np.sin(np.pi * distance / ridges.pitch))
        return 1.0 - (np.hypot(x, y) / radius) ** k - need * s ** (exponent * k)

    return level


def level_coverage(level: Callable[[Array, Array], Array], grid: PlateGrid, centre: tuple[float, float]) -> Array:
    """Return the share of each cell where a smooth function is positive.

    Cells whose corners and centre agree in sign are full or empty. The others are split into 4 x 4 and each part is
    covered as by a straight edge at level/|gradient| from its middle, so that errors are of second order in the
    part's size and of either sign.

    Parameters
    ----------
    level : callable
        (x, y) relative to ``centre`` [mm] -> values, positive inside.
    grid : PlateGrid
    centre : tuple of float
        [mm].

    Returns
    -------
    ndarray (rows, cols)
    """
    h = grid.pitch
    x, y = grid.x - centre[0], grid.y - centre[1]
    middle = level(x[None, :], y[:, None]) > 0
    edge_x, edge_y = np.append(x - h / 2, x[-1] + h / 2), np.append(y - h / 2, y[-1] + h / 2)
    corner = level(edge_x[None, :], edge_y[:, None]) > 0
    votes = middle.astype(int) + corner[:-1, :-1] + corner[1:, :-1] + corner[:-1, 1:] + corner[1:, 1:]
    share = (votes == 5).astype(float)
    rows, cols = np.nonzero((votes > 0) & (votes < 5))
    part = h / _SUBCELLS
    offset = (np.arange(-1, _SUBCELLS + 1) - (_SUBCELLS - 1) / 2) * part
    at = level(x[cols][:, None, None] + offset[None, None, :], y[rows][:, None, None] + offset[None, :, None])
    slope_x = 0.5 * (at[:, 1:-1, 2:] - at[:, 1:-1, :-2])
    slope_y = 0.5 * (at[:, 2:, 1:-1] - at[:, :-2, 1:-1])
    reach = np.abs(slope_x) + np.abs(slope_y)
    inner = at[:, 1:-1, 1:-1]
    cover = np.clip(0.5 + np.divide(inner, reach, out=np.sign(inner), where=reach > 0), 0.0, 1.0)
    share[rows, cols] = cover.mean(axis=(1, 2))
    return share


def ridged_area(smooth: AxisymmetricContact, ridges: RidgeRow, closure: float, exponent: float) -> float:
    """Return the area of contact [mm^2] by quadrature, without a grid of the plate.

    At distance d from its crest a ridge touches inside the circle on which the macroscopic pressure is
    p_c |sin(pi d/lambda)|^m, of radius rho(d). A parallel ridge at u adds the chords 2 sqrt(rho^2 - (u + d)^2); other
    patterns are integrated along 1,000 lines, on each of which the edges are found between nodes, to 2e-4 of the area.
    """
    if ridges.pattern != "parallel":
        return _area_by_lines(_level(smooth, ridges, closure, exponent), smooth.contact_radius)
    k, radius, pitch = smooth.shape_exponent or 2.0, smooth.contact_radius, ridges.pitch
    need = closure / _peak(smooth)
    # midpoint rule: the integrand's only kinks are roots at the ends of chords, error below 1e-5 of a pitch
    nodes = 4000
    d = ((np.arange(nodes) + 0.5) / nodes - 0.5) * pitch
    s = np.abs(np.sin(np.pi * d / pitch))
    rho = radius * np.clip(1.0 - (need * s**exponent) ** k, 0.0, None) ** (1.0 / k)
    reach = int(np.ceil(radius / pitch)) + 1
    across = np.arange(-reach, reach + 1)[:, None] * pitch + d[None, :]
    chord = 2.0 * np.sqrt(np.clip(rho**2 - across**2, 0.0, None))
    return float(chord.sum() * pitch / nodes)


def _area_by_lines(
    level: Callable[[Array, Array], Array], radius: float, lines: int = 1000, nodes: int = 1001
) -> float:
    """Return the area on which a function is positive inside a circle: midpoint rule across, linear roots along."""
    step = 2.0 * radius / lines
    x = np.linspace(-radius, radius, nodes)
    area = 0.0
    for block in np.array_split(-radius + (np.arange(lines) + 0.5) * step, 20):
        value = level(x[None, :], block[:, None])
        left, right = value[:, :-1], value[:, 1:]
        rise = np.abs(left) + np.abs(right)
        part = np.divide(np.maximum(left, 0) + np.maximum(right, 0), rise, out=np.zeros_like(rise), where=rise > 0)
        area += float(part.sum()) * (x[1] - x[0]) * step
    return area
