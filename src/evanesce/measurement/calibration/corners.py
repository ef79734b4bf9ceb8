"""Find the corners of a checkerboard in one image, also where the board fills, leaves or blurs into its border.

Saddle points of the smoothed image give candidates with edge directions and polarity; nine of them that fit make a
seed; from there the lattice grows outwards, each corner predicted from its neighbours, fitted, and kept only if its
contrast has the sign that its position on a checkerboard demands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import WorkError
from evanesce.measurement.calibration.candidates import candidates_of, seeds
from evanesce.measurement.calibration.lattice import Lattice
from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.calibration.saddle import SaddleFit

Array = NDArray[np.float64]

SCALES_PX = (1.5, 2.5, 4.0, 6.5)  # smoothing at which candidates are sought; squares of about 7 to 100 px
MIN_CORNERS = 16
COARSER = 1.25  # squares that only a larger smoothing finds are at least this much larger


@dataclass(frozen=True)
class CornerGrid:
    """Corners of one board.

    Attributes
    ----------
    index : ndarray of int (n, 2)
        (i, j) along the two grid axes, from 0; the first axis is the one nearer to the image's x.
    fit : SaddleFit
        Position, blur and contrast of each, in the same order.
    lattice : ndarray (n, 2, 2)
        Local steps [px per square]: columns are the steps along i and j.
    """

    index: NDArray[np.int64]
    fit: SaddleFit
    lattice: Array

    def __len__(self) -> int:
        return len(self.index)

    def view(self, name: str, square_mm: float) -> BoardView:
        """Return the corners as calibration takes them, in mm on the board.

        A board shows no origin. It is put on the first lines that are at least half as long as the median line: stray
        corners beyond, which are found or not depending on the light, get negative coordinates instead of shifting all
        others.

        Parameters
        ----------
        name : str
            Of the image.
        square_mm : float
            Side of a square [mm].

        Returns
        -------
        BoardView
        """
        origin = [_first_filled(self.index[:, 0]), _first_filled(self.index[:, 1])]
        return BoardView(name, (self.index - origin).astype(np.float64) * square_mm, self.fit.position)


def grey(image: NDArray[np.generic]) -> Array:
    """Return the grey values of an image as float.

    Parameters
    ----------
    image : ndarray (rows, cols) or (rows, cols, 3)
        Grey or RGB; RGB gets the luma weights of Rec. 601.

    Returns
    -------
    ndarray (rows, cols)

    Raises
    ------
    ValueError
        If the image has another shape.
    """
    values = np.asarray(image, dtype=np.float64)
    if values.ndim == 3:
        values = values[..., :3] @ np.array([0.299, 0.587, 0.114])
    if values.ndim != 2:
        raise ValueError(f"an image of shape {np.shape(image)}")
    return values


def find_corners(image: NDArray[np.generic]) -> CornerGrid:
    """Find the largest checkerboard in an image.

    Parameters
    ----------
    image : ndarray (rows, cols) or (rows, cols, 3)
        Grey or RGB.

    Returns
    -------
    CornerGrid

    Raises
    ------
    WorkError
        If there is no board of at least ``MIN_CORNERS`` corners.
    """
    values = grey(image)
    best: Lattice | None = None
    for sigma in SCALES_PX:
        candidates = candidates_of(values, sigma)
        taken = np.zeros(len(candidates.position), dtype=bool)
        if best is not None:
            taken |= best.covers(candidates.position)
        for members, patch in seeds(candidates, taken):
            growth = Lattice(values, patch)
            growth.run()
            taken[members] = True
            taken |= growth.covers(candidates.position)
            if best is None or growth.count > best.count:
                best = growth
        if best is not None and best.count * (COARSER * best.pitch) ** 2 > values.size:
            break  # a board of the next scale's larger squares has no room for as many corners
    grid = None if best is None or best.count < MIN_CORNERS else CornerGrid(*best.result())
    if grid is None or len(grid) < MIN_CORNERS:
        found = len(grid) if grid is not None else 0 if best is None else best.count
        raise WorkError(f"no checkerboard found: {found} corners that fit one grid (needed: at least {MIN_CORNERS})")
    return grid


def _first_filled(line: NDArray[np.int64]) -> int:
    """Return the number of the first line with at least half as many corners as the median line."""
    numbers, counts = np.unique(line, return_counts=True)
    return int(numbers[np.argmax(counts >= 0.5 * np.median(counts))])
