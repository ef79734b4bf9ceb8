"""How a checkerboard is printed, by a picture of it: whether the square at its upper left is black."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.measurement.calibration.corners import grey
from evanesce.measurement.calibration.points import BoardView

Array = NDArray[np.float64]

WITHIN = 0.2
"""Half-width of the part of a square that is read, in squares: clear of blur and of its neighbours."""
SAMPLES = 5
"""Along either side of that part."""


def print_of(
    views: Sequence[BoardView], pictures: Sequence[NDArray[np.generic]], square_mm: float, squares: tuple[int, int]
) -> bool | None:
    """Return whether the square at the upper left is black in all pictures of a board that say so.

    Parameters
    ----------
    views : sequence of BoardView
    pictures : sequence of ndarray
    square_mm, squares
        See :func:`upper_left_black`.

    Returns
    -------
    bool or None
        None where no picture says, or where they do not agree: the board was turned between them.
    """
    said = {upper_left_black(*one, square_mm, squares) for one in zip(views, pictures, strict=True)} - {None}
    return said.pop() if len(said) == 1 else None


def upper_left_black(
    view: BoardView, picture: NDArray[np.generic], square_mm: float, squares: tuple[int, int]
) -> bool | None:
    """Return whether a board's square that is at the upper left of a picture is black.

    Parameters
    ----------
    view : BoardView
        Corners of the picture.
    picture : ndarray (rows, cols) or (rows, cols, 3)
    square_mm : float
        By which the view was found.
    squares : tuple of int
        Columns and rows of the board.

    Returns
    -------
    bool or None
        None where not all of the board's corners span the picture, or the square is not whole within it.
    """
    index = np.round(view.world / square_mm)
    first, last = index.min(axis=0), index.max(axis=0)
    if tuple(int(n) for n in last - first + 2) != tuple(squares):
        return None
    to_picture, _ = cv2.findHomography(index, view.image)
    if to_picture is None:
        return None
    outer = np.array([[i, j] for i in (first[0] - 0.5, last[0] + 0.5) for j in (first[1] - 0.5, last[1] + 0.5)])
    place = outer[int(np.argmin(_applied(to_picture, outer).sum(axis=1)))]
    inwards = np.where(place < (first + last) / 2, 1.0, -1.0)
    image = grey(picture)
    own = _level(image, to_picture, place)
    beside = [_level(image, to_picture, place + np.array(step) * inwards) for step in ((1.0, 0.0), (0.0, 1.0))]
    if own is None or None in beside:
        return None
    return bool(own < np.mean([level for level in beside if level is not None]))


def _applied(homography: Array, points: Array) -> Array:
    return np.asarray(cv2.perspectiveTransform(points[None].astype(np.float64), homography)[0], np.float64)


def _level(image: Array, to_picture: Array, square: Array) -> float | None:
    """Return the median level of the middle of a square; None if it is not within the picture."""
    step = np.linspace(-WITHIN, WITHIN, SAMPLES)
    points = square + np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    x, y = np.round(_applied(to_picture, points)).astype(int).T
    rows, cols = image.shape
    if x.min() < 0 or y.min() < 0 or x.max() >= cols or y.max() >= rows:
        return None
    return float(np.median(image[y, x]))
