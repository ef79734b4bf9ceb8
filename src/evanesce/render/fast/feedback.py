"""What a contact does to its own light through the plate: annuli of loss and gain, and what the edges return."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from evanesce.core.states import PlateGrid
from evanesce.render.fast.fields import Fields
from evanesce.render.fast.rig_fields import FEEDBACK_CELL

Array = NDArray[Any]
Image = NDArray[np.float32]

ROUNDS = 2
"""Of the feedback; each is some 1 % of the one before, the third would change 3e-6 of the light."""


@dataclass(frozen=True)
class CoarseGrid:
    """Coarse cells over a contact grid, and all that the feedback needs on them.

    Attributes
    ----------
    shape : tuple of int
        (rows, cols) of cells.
    area : float
        Of a cell [mm^2].
    contact : ndarray (rows, cols)
        Irradiance into silicone in full contact, without feedback [W mm^-2].
    spectrum : ndarray of complex64
        Transform of the kernel, gain less loss.
    padded : tuple of int
        Shape of the transforms.
    onto_x, onto_y : ndarray (nodes, cells)
        Linear interpolation between the field's nodes, along x and y.
    """

    shape: tuple[int, int]
    area: float
    contact: Array
    spectrum: NDArray[np.complex64]
    padded: tuple[int, int]
    onto_x: Array
    onto_y: Array

    @classmethod
    def of(cls, fields: Fields, grid: PlateGrid) -> Self:
        """Return the coarse grid of a contact grid."""
        rows, cols = (max(1, round(n * grid.pitch / FEEDBACK_CELL)) for n in grid.shape)
        x0, x1, y0, y1 = grid.extent
        dx, dy = (x1 - x0) / cols, (y1 - y0) / rows
        x, y = x0 + (np.arange(cols) + 0.5) * dx, y0 + (np.arange(rows) + 0.5) * dy
        onto_x, onto_y = _hats(fields.x, x), _hats(fields.y, y)
        contact = onto_y.T @ np.tensordot(fields.coupling[:, 0], fields.modes, 1) @ onto_x
        padded = (fft.next_fast_len(2 * rows, real=True), fft.next_fast_len(2 * cols, real=True))
        kernel = fields.rig.gain - fields.rig.loss
        middle = kernel.shape[0] // 2
        reach_y, reach_x = min(rows - 1, middle), min(cols - 1, middle)
        around = np.zeros(padded, np.float32)
        iy, ix = np.arange(-reach_y, reach_y + 1), np.arange(-reach_x, reach_x + 1)
        around[iy[:, None] % padded[0], ix[None, :] % padded[1]] = kernel[middle + iy[:, None], middle + ix[None, :]]
        return cls((rows, cols), dx * dy, contact, fft.rfft2(around), padded, onto_x, onto_y)


def _hats(nodes: Array, x: Array) -> Array:
    """Return the weights (nodes, points) of linear interpolation between even nodes, ends continued."""
    index = np.clip((x - nodes[0]) / (nodes[1] - nodes[0]), 0, nodes.size - 1)
    return np.asarray(np.clip(1.0 - np.abs(index[None, :] - np.arange(nodes.size)[:, None]), 0.0, None))


def coarse_mean(part: Image, first: tuple[int, int], fine: tuple[int, int], coarse: tuple[int, int]) -> Array:
    """Return the mean of each coarse cell of an image that is 0 outside a part of it.

    Parameters
    ----------
    part : ndarray (rows, cols)
    first : tuple of int
        Row and column of the part's upper left sample.
    fine, coarse : tuple of int
        (rows, cols) of the image's samples and of the cells.
    """
    cell = [n / c for n, c in zip(fine, coarse, strict=True)]
    if all(side == int(side) for side in cell):
        # Whole samples to a cell: only the cells that the part overlaps.
        high, wide = (int(side) for side in cell)
        (row, above), (col, left) = divmod(first[0], high), divmod(first[1], wide)
        below, right = -(above + part.shape[0]) % high, -(left + part.shape[1]) % wide
        whole = cv2.copyMakeBorder(part, above, below, left, right, cv2.BORDER_CONSTANT)
        small = cv2.resize(whole, (whole.shape[1] // wide, whole.shape[0] // high), interpolation=cv2.INTER_AREA)
        found = np.zeros(coarse)
        found[row : row + small.shape[0], col : col + small.shape[1]] = small
        return found
    full = np.zeros(fine, np.float32)
    full[first[0] : first[0] + part.shape[0], first[1] : first[1] + part.shape[1]] = part
    return np.asarray(cv2.resize(full, coarse[::-1], interpolation=cv2.INTER_AREA), np.float64)


def feedback(fields: Fields, coarse: CoarseGrid, entering: Array) -> tuple[Array, Array]:
    """Return what the contact does to its own light.

    Parameters
    ----------
    fields : Fields
    coarse : CoarseGrid
    entering : ndarray (rows, cols)
        Irradiance that enters the silicone, mean of each cell, without feedback [W mm^-2].

    Returns
    -------
    change : ndarray (rows, cols)
        Of the irradiance, relative [1].
    taken : ndarray (points,)
        Power that the contact takes in, shared among the field's nodes [W].
    """
    rows, cols = coarse.shape
    level = np.maximum(coarse.contact, 1e-300)
    change, taken = np.zeros_like(entering), np.zeros(0)
    for _ in range(ROUNDS):
        inside = entering * (1.0 + change)
        # The loss is relative to the field at the second element; the field is nearly even, and the first's serves.
        net = coarse.spectrum * fft.rfft2(inside.astype(np.float32), coarse.padded)
        taken = (coarse.onto_y @ inside @ coarse.onto_x.T).ravel() * coarse.area
        edges = (fields.rig.edges @ taken).reshape(fields.y.size, fields.x.size)
        returned = fft.irfft2(net, coarse.padded)[:rows, :cols] + coarse.onto_y.T @ edges @ coarse.onto_x
        change = returned / level
    return change, taken
