"""Share of each cell of a grid that a contact covers: disc, half plane, positive part of a smooth function."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import PlateGrid

Array = NDArray[np.float64]

_SUBCELLS = 4


def disc_coverage(grid: PlateGrid, centre: tuple[float, float], radius: float) -> Array:
    """Return the share of each cell that a disc covers, exact to rounding.

    The area of the disc left of and above each cell corner has a closed form; a cell's share is its second
    difference, so that the sum over a grid that holds the disc telescopes to pi radius^2.

    Parameters
    ----------
    grid : PlateGrid
    centre : tuple of float
        (x, y) [mm].
    radius : float
        [mm], not negative.

    Returns
    -------
    ndarray (rows, cols)
        0 to 1.
    """
    if radius == 0:
        return np.zeros(grid.shape)
    half = grid.pitch / 2
    x = (np.append(grid.x - half, grid.x[-1] + half) - centre[0]) / radius
    y = (np.append(grid.y - half, grid.y[-1] + half) - centre[1]) / radius
    corner = _unit_disc_quadrant(x[None, :], y[:, None])
    share = np.diff(np.diff(corner, axis=0), axis=1) * (radius / grid.pitch) ** 2
    return np.clip(share, 0.0, 1.0)


def _unit_disc_quadrant(x: Array, y: Array) -> Array:
    """Return the area of the unit disc where u <= x and v <= y (broadcast)."""
    x, y = np.clip(x, -1.0, 1.0), np.clip(y, -1.0, 1.0)

    def below_arc(u: Array) -> Array:
        """Integral of sqrt(1 - u^2) from -1."""
        return 0.5 * (u * np.sqrt(1.0 - u**2) + np.arcsin(u)) + np.pi / 4

    half_chord = np.sqrt(1.0 - y**2)
    inside = np.clip(x, -half_chord, half_chord)
    # columns |u| < half_chord are cut at v = y; for y >= 0 those further out are whole, for y < 0 they are empty
    cut = below_arc(inside) - below_arc(-half_chord) + y * (inside + half_chord)
    whole = 2.0 * (below_arc(np.minimum(x, -half_chord)) + below_arc(np.maximum(x, half_chord)) - below_arc(half_chord))
    return np.where(y >= 0, cut + whole, cut)


def half_plane_share(distance: Array, nx: Array, ny: Array) -> Array:
    """Return the share of a unit square in a half plane.

    Parameters
    ----------
    distance : ndarray
        Of the half plane's border outside the square's middle, in sides of the square.
    nx, ny : ndarray
        Magnitudes of the components of the border's unit normal.

    Returns
    -------
    ndarray
        0 to 1.
    """
    large, small = np.maximum(nx, ny), np.minimum(nx, ny)
    d = np.abs(distance)
    straight, corner = 0.5 * (large - small), 0.5 * (large + small)
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = d / large
        cut = 0.5 - (corner - d) ** 2 / (2.0 * large * small)
    part = np.where(d <= straight, flat, np.where(d < corner, cut, 0.5))
    return 0.5 + np.sign(distance) * part


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
        0 to 1.
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


def level_area(level: Callable[[Array, Array], Array], radius: float, lines: int = 1000, nodes: int = 1001) -> float:
    """Return the area on which a function is positive inside a circle: midpoint rule across, linear roots along.

    Parameters
    ----------
    level : callable
        (x, y) [mm] -> values, positive inside; broadcasts.
    radius : float
        Of the circle about the origin [mm].
    lines, nodes : int
        Lines across the circle, nodes along each.

    Returns
    -------
    float
        [mm^2].
    """
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
