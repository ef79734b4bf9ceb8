"""Local scale in pixels per square millimetre, from the cells of a corner grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.measurement.calibration.points import BoardView

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScaleMap:
    """Local scale at the middle of each cell.

    Attributes
    ----------
    centre : ndarray (n, 2)
        (x, y) in the picture [px].
    px_per_mm2 : ndarray (n,)
        Area of the cell in the picture over its area on the board.
    """

    centre: Array
    px_per_mm2: Array

    def summary(self) -> dict[str, float]:
        """Return median, smallest and greatest scale and the 5th and 95th percentile [px/mm^2]; NaN without cells.

        Returns
        -------
        dict of str to float
            ``median``, ``min``, ``max``, ``p05``, ``p95``.
        """
        names = {"median": 50, "min": 0, "max": 100, "p05": 5, "p95": 95}
        if not len(self.px_per_mm2):
            return dict.fromkeys(names, float("nan"))
        return {name: float(np.percentile(self.px_per_mm2, q)) for name, q in names.items()}


def local_scale(view: BoardView) -> ScaleMap:
    """Measure the local scale of each cell whose four corners are there.

    Cells lie between neighbouring grid lines of the board, which may be spaced unequally. Their edges count as
    straight: opposite edges bend alike, so that this costs only the second difference of the scale.

    Parameters
    ----------
    view : BoardView

    Returns
    -------
    ScaleMap
    """
    xs, ix = np.unique(view.world[:, 0], return_inverse=True)
    ys, iy = np.unique(view.world[:, 1], return_inverse=True)
    number = np.full((len(xs), len(ys)), -1)
    number[ix, iy] = np.arange(len(view))
    corners = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    i, j = np.nonzero((corners >= 0).all(axis=-1))
    around = view.image[corners[i, j]]
    diagonal_1, diagonal_2 = around[:, 2] - around[:, 0], around[:, 3] - around[:, 1]
    area = 0.5 * np.abs(diagonal_1[:, 0] * diagonal_2[:, 1] - diagonal_1[:, 1] * diagonal_2[:, 0])
    return ScaleMap(around.mean(axis=1), area / (np.diff(xs)[i] * np.diff(ys)[j]))
