"""Ground truth in the pixels of one view at the rate of a slider: the share in contact, by cached maps."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState, PlateGrid
from evanesce.evaluation.labels import ViewGeometry

Image = NDArray[np.float32]


class ContactShare:
    """Mask of :func:`evanesce.evaluation.labels.label` for many states on one grid.

    Parameters
    ----------
    geometry : ViewGeometry
    grid : PlateGrid
        Of the states.
    supersample : int
        Samples along each side of a pixel.
    """

    def __init__(self, geometry: ViewGeometry, grid: PlateGrid, supersample: int = 2) -> None:
        self.grid, self.shape = grid, geometry.shape
        x_min, x_max, y_min, y_max = grid.extent
        x, y = geometry.corner_x, geometry.corner_y
        inside = (x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)
        self._window, self._maps = np.s_[0:0, 0:0], []
        if not inside.any():
            return
        rows, cols = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
        r0, r1 = max(int(rows[0]) - 1, 0), min(int(rows[-1]) + 1, self.shape[0])
        c0, c1 = max(int(cols[0]) - 1, 0), min(int(cols[-1]) + 1, self.shape[1])
        self._window = np.s_[r0:r1, c0:c1]
        corners = np.s_[r0 : r1 + 1, c0 : c1 + 1]
        at_row, at_col = grid.index(x=x[corners], y=y[corners])
        parts = (np.arange(supersample) + 0.5) / supersample
        self._maps = [(_within(at_col, a, b), _within(at_row, a, b)) for a in parts for b in parts]

    def of(self, state: ContactState | None) -> Image:
        """Return the share of each pixel of the view in nominal contact, 0 to 1.

        Raises
        ------
        ValueError
            If the state is on another grid.
        """
        share = np.zeros(self.shape, np.float32)
        if state is None or not self._maps:
            return share
        if state.grid != self.grid:
            raise ValueError("the state is on another grid")
        mask = np.asarray(state.contact_mask, np.float32)
        found = sum(cv2.remap(mask, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT) for u, v in self._maps)
        share[self._window] = np.clip(np.asarray(found) / np.float32(len(self._maps)), 0.0, 1.0)
        return share


def _within(corners: NDArray[np.floating], down: float, right: float) -> Image:
    """Interpolate between the four corners of each pixel."""
    top = (1 - right) * corners[:-1, :-1] + right * corners[:-1, 1:]
    bottom = (1 - right) * corners[1:, :-1] + right * corners[1:, 1:]
    return np.asarray((1 - down) * top + down * bottom, np.float32)
