"""Positions of the lines of a printed board: a printer rounds them to its own dots.

A square of 1 mm is 23.62 dots of a 600-dpi printer and comes out 23 or 24 dots wide, so that lines lie up to half a dot
(21 um) off their nominal positions, whole lines at a time. At 30 px/mm this is the largest part of what a smooth lens
model leaves of a corner grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.measurement.calibration.planar import BoardFit, apply_homography, fit_planar
from evanesce.measurement.calibration.points import BoardView

Array = NDArray[np.float64]

ROUNDS = 3
SMOOTH_DEGREE = 3
MIN_PER_LINE = 3


@dataclass(frozen=True)
class BoardLines:
    """Nominal and fitted positions of a board's grid lines.

    Attributes
    ----------
    nominal : tuple of ndarray
        Positions of the lines of constant x and of constant y [mm].
    offset : tuple of ndarray
        Fitted minus nominal [mm]; free of any trend smoother than a cubic, which cannot be separated from the lens.
    """

    nominal: tuple[Array, Array]
    offset: tuple[Array, Array]

    def place(self, world: Array) -> Array:
        """Return nominal corners (n, 2) [mm] moved to the fitted lines; corners between known lines move by neither.

        Parameters
        ----------
        world : ndarray (n, 2)
            Nominal corners [mm].

        Returns
        -------
        ndarray (n, 2)
            [mm].
        """
        moved = world.copy()
        for axis in (0, 1):
            index = np.clip(np.searchsorted(self.nominal[axis], world[:, axis]), 0, len(self.nominal[axis]) - 1)
            on_line = self.nominal[axis][index] == world[:, axis]
            moved[:, axis] += np.where(on_line, self.offset[axis][index], 0.0)
        return moved

    @property
    def spacings_um(self) -> tuple[Array, Array]:
        """Width of each square minus its nominal width [um], along x and along y."""
        return 1e3 * np.diff(self.offset[0]), 1e3 * np.diff(self.offset[1])


def nominal_lines(view: BoardView) -> BoardLines:
    """Return the lines of a view's corners without any offset.

    Parameters
    ----------
    view : BoardView

    Returns
    -------
    BoardLines
    """
    lines = (np.unique(view.world[:, 0]), np.unique(view.world[:, 1]))
    return BoardLines(lines, (np.zeros(len(lines[0])), np.zeros(len(lines[1]))))


def fit_lines(
    view: BoardView, image_size: tuple[int, int], focal_px: float, model: str = "radial2"
) -> tuple[BoardLines, BoardFit]:
    """Fit line positions and lens in turn: each line moves to the median of its corners, then the lens is fitted anew.

    Parameters
    ----------
    view : BoardView
        One view of a board; lines with fewer than three corners keep their nominal position.
    image_size, focal_px, model
        As for :func:`evanesce.measurement.calibration.planar.fit_planar`.

    Returns
    -------
    lines : BoardLines
    fit : BoardFit
        With the fitted lines.

    Raises
    ------
    WorkError
        If the corners determine no fit.
    """
    lines = nominal_lines(view)
    index = [np.searchsorted(lines.nominal[axis], view.world[:, axis]) for axis in (0, 1)]
    fit = fit_planar([view], image_size, focal_px, model)
    for _ in range(ROUNDS):
        placed = lines.place(view.world)
        back = apply_homography(np.linalg.inv(fit.homographies[0]), fit.undistort(view.image))
        offsets = []
        for axis in (0, 1):
            offset = lines.offset[axis].copy()
            for k in range(len(offset)):
                on_line = index[axis] == k
                if on_line.sum() >= MIN_PER_LINE:
                    offset[k] += np.median((back - placed)[on_line, axis])
            counts = np.bincount(index[axis], minlength=len(offset))
            offsets.append(_rough(lines.nominal[axis], offset, counts))
        lines = BoardLines(lines.nominal, (offsets[0], offsets[1]))
        fit = fit_planar([BoardView(view.name, lines.place(view.world), view.image)], image_size, focal_px, model)
    return lines, fit


def _rough(at: Array, offset: Array, counts: NDArray[np.int64]) -> Array:
    """Subtract the smooth trend: it belongs to homography and lens."""
    known = counts >= MIN_PER_LINE
    if known.sum() <= SMOOTH_DEGREE + 1:
        return np.zeros_like(offset)
    trend = np.polynomial.Polynomial.fit(at[known], offset[known], SMOOTH_DEGREE)
    return np.where(known, offset - trend(at), 0.0)
