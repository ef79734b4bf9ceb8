"""Uneven light of a photographed board: smooth fields for bright and dark squares, and the blocks held out of them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator, RectBivariateSpline
from scipy.ndimage import map_coordinates
from scipy.spatial import KDTree

from evanesce.core.errors import WorkError
from evanesce.measurement.calibration.corners import CornerGrid

Array = NDArray[np.float64]

BLOCK = 2
"""Side of the blocks of squares that go alternately into the fit and into the evaluation."""

SMOOTHING = 0.05
"""Of the thin-plate splines, in units of 100 px: structure finer than some three squares is left to the residual."""

MIN_SQUARES = 12
_COARSE_PX = 8
_OUTLIER = 4.0
_SMALL = 0.1  # of the level: less is never an outlier
_NEIGHBOURS = 12


@dataclass(frozen=True)
class Squares:
    """Whole squares of a board in a photograph.

    Attributes
    ----------
    centre : ndarray (n, 2)
        (x, y) [px].
    value : ndarray (n,)
        Median over the middle 40 % of the square.
    bright, held_out : ndarray of bool (n,)
        Bright print; block held out of the fit.
    """

    centre: Array
    value: Array
    bright: NDArray[np.bool_]
    held_out: NDArray[np.bool_]


def held_out_block(index: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which grid positions (n, 2) belong to blocks that are held out of every fit.

    Parameters
    ----------
    index : ndarray of int (n, 2)
        Of squares or corners.

    Returns
    -------
    ndarray of bool (n,)
    """
    return np.asarray((index // BLOCK).sum(axis=1) % 2 == 1)


def _whole_squares(grid: CornerGrid) -> tuple[NDArray[np.int64], Array]:
    """Return index (n, 2) and corners (n, 4, 2) [px] of every square whose four corners were found."""
    number = np.full(grid.index.max(axis=0) + 1, -1)
    number[tuple(grid.index.T)] = np.arange(len(grid))
    corners = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    cells = np.argwhere((corners >= 0).all(axis=-1))
    return cells, grid.fit.position[corners[tuple(cells.T)]]


def squares(image: Array, grid: CornerGrid, even_is_bright: bool) -> Squares:
    """Measure every square whose four corners were found.

    Parameters
    ----------
    image : ndarray (rows, cols)
        Any grey scale.
    grid : CornerGrid
    even_is_bright : bool
        Whether the square between lines 0 and 1 of both axes is bright.

    Returns
    -------
    Squares
    """
    cells, around = _whole_squares(grid)
    inner = np.linspace(0.3, 0.7, 7)
    a, b = (g.ravel() for g in np.meshgrid(inner, inner))
    weights = np.stack([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b])
    points = np.einsum("kca,cm->kma", around, weights)
    values = map_coordinates(image, [points[..., 1], points[..., 0]], order=1, mode="nearest")
    bright = (cells.sum(axis=1) % 2 == 0) == even_is_bright
    return Squares(around.mean(axis=1), np.median(values, axis=1), bright, held_out_block(cells))


def smooth_field(centre: Array, value: Array, shape: tuple[int, int]) -> Array:
    """Return a smooth field over the frame through scattered values, specks and reflections weighted out.

    Parameters
    ----------
    centre : ndarray (n, 2)
        (x, y) [px].
    value : ndarray (n,)
    shape : tuple of int
        (rows, cols).

    Returns
    -------
    ndarray (rows, cols)
        In the unit of ``value``.

    Raises
    ------
    WorkError
        If there are fewer than twelve values.
    """
    if len(value) < MIN_SQUARES:
        raise WorkError(f"{len(value)} whole squares of one colour in half of the picture (needed: {MIN_SQUARES})")
    # an interpolating spline follows an outlier: each value is held against the plane through its neighbours instead
    _, near = KDTree(centre).query(centre, k=min(_NEIGHBOURS + 1, len(value)))
    off = np.empty(len(value))
    for i, others in enumerate(near[:, 1:]):
        design = np.column_stack([np.ones(len(others)), centre[others] - centre[i]])
        off[i] = value[i] - np.linalg.lstsq(design, value[others], rcond=None)[0][0]
    spread = 1.4826 * np.median(np.abs(off))
    keep = np.abs(off) <= max(_OUTLIER * spread, _SMALL * float(np.median(np.abs(value))))
    spline = RBFInterpolator(centre[keep] / 100, value[keep], smoothing=SMOOTHING, kernel="thin_plate_spline")
    rows, cols = shape
    coarse_x = np.linspace(0, cols - 1, cols // _COARSE_PX + 2)
    coarse_y = np.linspace(0, rows - 1, rows // _COARSE_PX + 2)
    nodes = np.stack(np.meshgrid(coarse_x, coarse_y), axis=-1)
    field = spline(nodes.reshape(-1, 2) / 100).reshape(nodes.shape[:2])
    fine = RectBivariateSpline(coarse_y, coarse_x, field)(np.arange(rows), np.arange(cols))
    # beyond the outermost squares a spline may run off: it stays within what was seen
    low, high = value[keep].min(), value[keep].max()
    return np.asarray(np.clip(fine, low, high), dtype=np.float64)


def block_mask(grid: CornerGrid, shape: tuple[int, int], held_out: bool) -> NDArray[np.bool_]:
    """Return the pixels of whole squares that belong to the held-out blocks, or to those of the fit; never to both.

    Parameters
    ----------
    grid : CornerGrid
    shape : tuple of int
        (rows, cols).
    held_out : bool
        Whether the held-out blocks are meant, or those of the fit.

    Returns
    -------
    ndarray of bool (rows, cols)
    """
    cells, around = _whole_squares(grid)
    outlines = np.rint(around * 16).astype(np.int32)
    masks = {True: np.zeros(shape, dtype=np.uint8), False: np.zeros(shape, dtype=np.uint8)}
    for outline, part in zip(outlines, held_out_block(cells), strict=True):
        cv2.fillConvexPoly(masks[bool(part)], outline, 1, shift=4)
    return np.asarray((masks[held_out] > 0) & (masks[not held_out] == 0))
