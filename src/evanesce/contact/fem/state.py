"""A footprint sampled on a plate grid as a ContactState."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay, cKDTree

from evanesce.contact.fem.surface import Footprint
from evanesce.contact.patch import AxisymmetricContact, axisymmetric_state, box_around, grid_part, radii, require_fit
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid, SurfaceState

Floats = NDArray[np.float64]

NEAR_GAP = 0.01  # [mm]: silicone this close to the glass is labelled near; some ten times the reach of evanescent light
SUPERSAMPLE = 4  # points a side at which a cell is tested for contact
RADIAL_POINTS = 400  # of the pressure's force integral


@dataclass(frozen=True)
class AxisymmetricProfile:
    """A footprint of a press, reduced to what a grid needs; a few kilobytes.

    Attributes
    ----------
    r, gap, pressure, traction : ndarray (k,)
        By node of the cap, from the apex: radius [mm], gap [mm], pressure and radial traction [MPa].
    slip : ndarray (k,)
        Radial slip since contact [mm].
    slipping : ndarray of bool (k,)
    contact_radius, depth, normal_force : float
        [mm], [mm], [N].
    """

    r: Floats
    gap: Floats
    pressure: Floats
    traction: Floats
    slip: Floats
    slipping: NDArray[np.bool_]
    contact_radius: float
    depth: float
    normal_force: float


def profile_of(print_: Footprint, depth: float, normal_force: float) -> AxisymmetricProfile:
    """Return the profile of an axisymmetric footprint.

    Parameters
    ----------
    print_ : Footprint
    depth : float
        [mm].
    normal_force : float
        [N].

    Returns
    -------
    AxisymmetricProfile
    """
    return AxisymmetricProfile(
        r=print_.place[:, 0],
        gap=print_.gap,
        pressure=print_.pressure,
        traction=print_.traction[:, 0],
        slip=print_.slip[:, 0],
        slipping=print_.slipping,
        contact_radius=float(np.sqrt(print_.area / np.pi)),
        depth=depth,
        normal_force=normal_force,
    )


def pressure_at(profile: AxisymmetricProfile, r: Floats) -> Floats:
    """Return the pressure [MPa] between nodes.

    p^2 is straight at the edge. The last node in contact is left out: its area reaches beyond the edge, so that its
    force over its area is not a pressure.

    Parameters
    ----------
    profile : AxisymmetricProfile
    r : ndarray
        [mm].

    Returns
    -------
    ndarray
        [MPa], in the shape of ``r``.
    """
    a = profile.contact_radius
    inside = np.flatnonzero((profile.pressure > 0) & (profile.r < a))
    inside = inside[:-1] if inside.size > 2 else inside
    if inside.size == 0 or a == 0:
        return np.zeros_like(r)
    knots, squares = np.append(profile.r[inside], a), np.append(profile.pressure[inside] ** 2, 0.0)
    return np.asarray(np.sqrt(np.interp(r, knots, squares, right=0.0)))


def gap_at(profile: AxisymmetricProfile, r: Floats, beyond: float) -> Floats:
    """Return the gap [mm] between nodes; ``beyond`` where there is no skin over the glass.

    Parameters
    ----------
    profile : AxisymmetricProfile
    r : ndarray
        [mm].
    beyond : float
        [mm].

    Returns
    -------
    ndarray
        [mm], in the shape of ``r``.
    """
    a = profile.contact_radius
    outside = (profile.gap > 0) & (profile.r > a)
    if not outside.any():
        return np.where(r > a, beyond, 0.0)
    widest = int(np.argmax(np.where(outside, profile.r, -1.0)))
    kept = outside & (np.arange(profile.r.size) <= widest)
    knots, values = np.append(a, profile.r[kept]), np.append(0.0, np.cbrt(profile.gap[kept]) ** 2)
    order = np.argsort(knots, kind="stable")
    q = np.interp(r, knots[order], values[order], left=0.0)
    return np.where(r > profile.r[widest], beyond, q**1.5)


def axisymmetric_contact(profile: AxisymmetricProfile, beyond: float) -> AxisymmetricContact:
    """Return a profile as the contact that every axisymmetric law gives, its pressure scaled to carry the force.

    Parameters
    ----------
    profile : AxisymmetricProfile
    beyond : float
        Gap where there is no finger over the glass [mm].

    Returns
    -------
    AxisymmetricContact
    """
    r = np.linspace(0.0, max(profile.contact_radius, 1e-9), RADIAL_POINTS)
    p = pressure_at(profile, r)
    line_force = 2 * np.pi * r * p
    within = np.concatenate([[0.0], np.cumsum(0.5 * (line_force[1:] + line_force[:-1]) * np.diff(r))])
    scale = profile.normal_force / within[-1] if within[-1] > 0 else 0.0

    def force_within(radius: Floats) -> Floats:
        return np.asarray(np.interp(radius, r, within * scale))

    return AxisymmetricContact(
        contact_radius=profile.contact_radius,
        normal_force=profile.normal_force,
        depth=profile.depth,
        force_within=force_within,
        gap=lambda radius: gap_at(profile, np.asarray(radius, dtype=float), beyond),
    )


def press_state(
    grid: PlateGrid,
    centre: tuple[float, float],
    profile: AxisymmetricProfile,
    *,
    beyond: float,
    parameters: Mapping[str, Any],
    law: str = "fem_press",
    time: float = 0.0,
) -> ContactState:
    """Sample an axisymmetric solution on a grid.

    Parameters
    ----------
    grid : PlateGrid
    centre : tuple of float
        (x, y) of the finger's axis [mm].
    profile : AxisymmetricProfile
    beyond : float
        Gap where there is no finger over the glass [mm].
    parameters : mapping
        Passed on to the state.
    law : str
    time : float
        [s].

    Returns
    -------
    ContactState

    Raises
    ------
    InputError
        If the contact does not fit on the grid.
    """
    require_fit(grid, centre, profile.contact_radius)
    contact = axisymmetric_contact(profile, beyond)
    base = axisymmetric_state(grid, centre, contact, law=law, parameters=parameters, time=time)
    covered = np.asarray(base.contact_mask, dtype=np.float64)
    traction, slip = np.zeros((2, *grid.shape)), np.zeros((2, *grid.shape))
    slipping = np.zeros(grid.shape, dtype=bool)
    box = box_around(grid, centre, profile.contact_radius)
    part, whole = grid_part(grid, box), (slice(None), *box)
    r = radii(part, centre)
    way = np.stack(np.meshgrid(part.x - centre[0], part.y - centre[1])) / np.where(r > 0, r, 1.0)
    # a cell on the border is whole as a state, but carries only its covered share of traction and slip
    traction[whole] = np.interp(r, profile.r, profile.traction) * covered[box] * way
    slip[whole] = np.interp(r, profile.r, profile.slip) * (covered[box] > 0) * way
    # beyond the last node in contact, its own label goes on to the edge
    inside = profile.pressure > 0
    if inside.any():
        slipping[box] = np.interp(r, profile.r[inside], profile.slipping[inside].astype(float)) >= 0.5
    return ContactState(
        grid=grid, pressure=base.pressure, gap=base.gap, contact_mask=covered, normal_force=base.normal_force,
        nominal_contact_area=base.nominal_contact_area, law=law, depth=base.depth, traction=traction,
        slip=slip, state=surface_states(covered, np.asarray(base.gap, dtype=np.float64), slipping), time=time,
        parameters=dict(parameters),
    )  # fmt: skip


def surface_states(covered: Floats, gap: Floats, slipping: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return none, near, stick or slip of each cell; a cell is in contact when half of it is covered.

    Parameters
    ----------
    covered : ndarray (rows, cols)
        Share of each cell in contact.
    gap : ndarray (rows, cols)
        [mm].
    slipping : ndarray of bool (rows, cols)

    Returns
    -------
    ndarray of uint8 (rows, cols)
        :class:`~evanesce.core.states.SurfaceState`.
    """
    state = np.where(gap < NEAR_GAP, SurfaceState.NEAR, SurfaceState.NONE)
    state = np.where(covered >= 0.5, np.where(slipping, SurfaceState.SLIP, SurfaceState.STICK), state)
    return np.asarray(state, dtype=np.uint8)


_SCALARS = ("pressure", "gap", "opening", "touching", "slipping")
_VECTORS = ("traction", "slip")


def _one_piece(print_: Footprint) -> tuple[Floats, dict[str, Floats]]:
    """Return positions and fields as they are."""
    return print_.place, {key: np.asarray(getattr(print_, key)) for key in _SCALARS + _VECTORS}


def _both_halves(print_: Footprint) -> tuple[Floats, dict[str, Floats]]:
    """Return positions and fields of a half y >= 0 together with its mirror image."""
    own = print_.place[:, 1] > 1e-6
    mirror = np.array([1.0, -1.0])
    fields = {key: np.concatenate([getattr(print_, key), getattr(print_, key)[own]]) for key in _SCALARS}
    for key in _VECTORS:
        fields[key] = np.vstack([getattr(print_, key), getattr(print_, key)[own] * mirror])
    return np.vstack([print_.place, print_.place[own] * mirror]), fields


def surface_state(
    grid: PlateGrid,
    centre: tuple[float, float],
    print_: Footprint,
    *,
    depth: float,
    normal_force: float,
    tangential_force: float,
    beyond: float,
    parameters: Mapping[str, Any],
    mirrored: bool = True,
    law: str = "fem_slide",
    time: float = 0.0,
) -> ContactState:
    """Sample a three-dimensional footprint on a grid.

    Parameters
    ----------
    grid : PlateGrid
    centre : tuple of float
        Plate point (x, y) under the middle of the finger's top [mm].
    print_ : Footprint
    depth : float
        [mm].
    normal_force, tangential_force : float
        On the whole finger [N].
    beyond : float
        Gap where there is no finger over the glass [mm].
    mirrored : bool
        The footprint is the half y >= 0; its mirror image is added.
    parameters, law, time
        Passed on to the state.

    Returns
    -------
    ContactState

    Raises
    ------
    InputError
        If the contact does not fit on the grid.
    """
    place, fields = _both_halves(print_) if mirrored else _one_piece(print_)
    place = place + np.asarray(centre)
    touching = fields["touching"].astype(bool)
    if touching.any():
        x_min, x_max, y_min, y_max = grid.extent
        low, high = place[touching].min(axis=0), place[touching].max(axis=0)
        if low[0] < x_min or high[0] > x_max or low[1] < y_min or high[1] > y_max:
            raise InputError(
                f"contact from ({low[0]:.3g}, {low[1]:.3g}) to ({high[0]:.3g}, {high[1]:.3g}) is off the contact grid",
                key="grid.size_mm", allowed=f"inside {x_min:g} to {x_max:g}, {y_min:g} to {y_max:g} mm",
            )  # fmt: skip
    tessellation = Delaunay(place)
    at_x, at_y = np.meshgrid(grid.x, grid.y)
    # p^2 and q are straight at the edge: interpolate them, not p and the gap; p^2 goes on below zero outside
    inside, q = touching, fields["opening"]
    steepest = float((fields["pressure"][inside] ** 2).max()) if inside.any() else 0.0
    reach = float(-q[inside].min()) if inside.any() else 1.0
    square = np.where(inside, fields["pressure"] ** 2, -np.abs(q) * steepest / max(reach, 1e-12))
    table = np.column_stack([q, square, fields["traction"], fields["slip"]])
    sample = LinearNDInterpolator(tessellation, table)(at_x, at_y)
    off = ~np.isfinite(sample[..., 0])
    sample = np.where(off[..., None], 0.0, sample)
    opening = np.where(off, np.cbrt(beyond) ** 2, sample[..., 0])
    covered = _coverage(grid, tessellation, q)
    pressure = np.where(covered > 0, np.sqrt(np.maximum(sample[..., 1], 0.0)), 0.0)
    carried = float(pressure.sum()) * grid.pitch**2
    if carried > 0:
        pressure = pressure * (normal_force / carried)
    traction = np.moveaxis(sample[..., 2:4], -1, 0) * covered
    slipping = np.zeros(grid.shape, dtype=bool)
    if touching.any():  # the label of the nearest node in contact, also on the border beyond the last one
        nearest = cKDTree(place[touching]).query(np.stack([at_x, at_y], axis=-1))[1]
        slipping = fields["slipping"].astype(bool)[touching][nearest]
    gap = np.where(covered >= 1.0, 0.0, np.maximum(opening, 0.0) ** 1.5)
    return ContactState(
        grid=grid, pressure=pressure, gap=gap, contact_mask=covered, normal_force=normal_force,
        nominal_contact_area=print_.area, law=law, depth=depth, traction=traction,
        slip=np.moveaxis(sample[..., 4:6], -1, 0) * (covered > 0),
        state=surface_states(covered, gap, slipping), tangential_force=(tangential_force, 0.0), time=time,
        parameters=dict(parameters),
    )  # fmt: skip


def _coverage(grid: PlateGrid, tessellation: Delaunay, opening: Floats) -> Floats:
    """Return the share of each cell whose opening is negative, from a finer grid of points."""
    n = SUPERSAMPLE
    offset = ((np.arange(n) + 0.5) / n - 0.5) * grid.pitch
    fine_x = (grid.x[:, None] + offset).ravel()
    fine_y = (grid.y[:, None] + offset).ravel()
    value = LinearNDInterpolator(tessellation, opening)(*np.meshgrid(fine_x, fine_y))
    below = np.nan_to_num(value, nan=1.0) < 0
    rows, cols = grid.shape
    return np.asarray(below.reshape(rows, n, cols, n).mean(axis=(1, 3)))
