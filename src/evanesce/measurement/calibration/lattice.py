"""Growth of a corner lattice from a 3 x 3 patch: each corner predicted from its neighbours, fitted, kept if it fits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from evanesce.measurement.calibration.saddle import SaddleFit, fit_saddles, quadrants

Array = NDArray[np.float64]

MAX_SIDE = 512  # corners along one side of a board
# While the lattice grows, a position only has to predict its neighbours; the last fit of each corner is to the end.
# Two of three places tried are no corners, whose fit never converges: few steps leave them early.
GROWTH: dict[str, Any] = {"limit_px": 9.0, "tolerance_px": 0.02, "iterations": 8}
_ORIGIN = MAX_SIDE
_PADDED = 2 * MAX_SIDE + 1
_REACH = 3  # squares over which the local lattice is fitted

# Limits for a fitted corner, in units of the local square or of its neighbours' contrast.
MAX_SHIFT = 0.22
MIN_EXPLAINED = 0.7
CONTRAST_RANGE = (0.25, 3.0)
MAX_TURN = np.deg2rad(20.0)
MIN_SUPPORT = 0.5
MIN_ALTERNATION = 0.5


class Lattice:
    """A corner lattice that grows.

    Parameters
    ----------
    image : ndarray (rows, cols)
        Grey values.
    patch : ndarray (3, 3, 2)
        (x, y) of the first nine corners [px].
    """

    def __init__(self, image: Array, patch: Array) -> None:
        self.image = image
        self.position = np.full((_PADDED, _PADDED, 2), np.nan)
        self.contrast = np.full((_PADDED, _PADDED), np.nan)  # as of an even corner: the sign alternates taken out
        middle = slice(_ORIGIN - 1, _ORIGIN + 2)
        self.position[middle, middle] = patch
        if np.linalg.det(np.stack([patch[2, 1] - patch[0, 1], patch[1, 2] - patch[1, 0]])) < 0:
            self.position[middle, middle] = patch[:, ::-1]  # right-handed in (x right, y down)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which lattice positions are filled."""
        return np.isfinite(self.position[..., 0])

    @property
    def count(self) -> int:
        """Number of corners."""
        return int(self.known.sum())

    @property
    def pitch(self) -> float:
        """Median distance of neighbouring corners [px]."""
        steps = [np.linalg.norm(np.diff(self.position, axis=axis), axis=-1) for axis in (0, 1)]
        return float(np.nanmedian(np.concatenate([step[np.isfinite(step)] for step in steps])))

    def run(self) -> None:
        """Fit the patch, then grow at the border until nothing fits; then once more after pruning."""
        if not self._fit_patch():
            return
        for _ in range(2):
            while self._grow_border():
                pass
            self._prune()

    def covers(self, points: Array) -> NDArray[np.bool_]:
        """Return which points (n, 2) [px] lie within a third of a square of a corner of this lattice.

        Parameters
        ----------
        points : ndarray (n, 2)
            (x, y) [px].

        Returns
        -------
        ndarray of bool (n,)
        """
        if self.count < 9 or not len(points):
            return np.zeros(len(points), dtype=bool)
        cells = np.argwhere(self.known)
        distance, near = KDTree(self.position[self.known]).query(points)
        lattice = self._predict(cells[np.unique(near)])[1]
        pitch = np.full(len(cells), np.nan)
        pitch[np.unique(near)] = np.sqrt(np.abs(np.linalg.det(lattice)))
        return distance < pitch[near] / 3

    def result(self) -> tuple[NDArray[np.int64], SaddleFit, Array]:
        """Return index (n, 2), fit and lattice vectors (n, 2, 2) [px] of the corners after a last fit of each.

        The first axis runs along the image's x; indices start at 0.

        Returns
        -------
        index : ndarray of int (n, 2)
        fit : SaddleFit
        lattice : ndarray (n, 2, 2)
            [px].
        """
        cells = np.argwhere(self.known)
        _, lattice, _ = self._predict(cells)
        fit = fit_saddles(self.image, self.position[self.known], lattice)
        mean = lattice.mean(axis=0)
        index = cells - cells.min(axis=0)
        turns = int(np.rint(np.arctan2(mean[1, 0], mean[0, 0]) / (np.pi / 2))) % 4
        for _ in range(turns):  # a quarter turn: the new first axis is minus the second, the new second the first
            index = np.stack([-index[:, 1], index[:, 0]], axis=-1)
            lattice = np.stack([-lattice[..., 1], lattice[..., 0]], axis=-1)
            normals = np.stack([-fit.normals[:, 1], fit.normals[:, 0]], axis=1)
            fit = replace(fit, normals=normals, sigma=fit.sigma[:, ::-1], contrast=-fit.contrast)
        index = index - index.min(axis=0)
        order = np.lexsort((index[:, 1], index[:, 0]))
        ordered = {name: getattr(fit, name)[order] for name in SaddleFit.__dataclass_fields__}
        return index[order].astype(np.int64), SaddleFit(**ordered), lattice[order]

    def _fit_patch(self) -> bool:
        cells = np.argwhere(self.known)
        _, lattice, _ = self._predict(cells)
        fit = fit_saddles(self.image, self.position[self.known], lattice)
        even = fit.contrast * _parity(cells)
        good = (fit.explained > MIN_EXPLAINED) & (np.sign(even) == np.sign(np.median(even))) & (fit.support > 0.9)
        # the outer corner of a border square is a saddle of the smoothed image, too: three of its quadrants are alike
        good &= _alternation(self.image, fit, lattice) > MIN_ALTERNATION * np.abs(np.median(even))
        self.position[self.known] = fit.position
        self.contrast[tuple(cells.T)] = even
        return bool(good.all())

    def _grow_border(self) -> int:
        """Try every empty position beside the lattice; return how many corners were added."""
        known = self.known
        beside = (cv2.dilate(known.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0) & ~known
        beside[:_REACH] = beside[-_REACH:] = False
        beside[:, :_REACH] = beside[:, -_REACH:] = False
        cells = np.argwhere(beside)
        position, lattice, sure = self._predict(cells)
        rows, cols = self.image.shape
        sure &= (position > -0.5).all(axis=1) & (position[:, 0] < cols - 0.5) & (position[:, 1] < rows - 0.5)
        cells, position, lattice = cells[sure], position[sure], lattice[sure]
        if not len(cells):
            return 0
        fit = fit_saddles(self.image, position, lattice, **GROWTH)
        even = fit.contrast * _parity(cells)
        good = self._fits(cells, position, lattice, fit, even)
        self.position[tuple(cells[good].T)] = fit.position[good]
        self.contrast[tuple(cells[good].T)] = even[good]
        return int(good.sum())

    def _fits(
        self, cells: NDArray[np.int64], position: Array, lattice: Array, fit: SaddleFit, even: Array
    ) -> NDArray[np.bool_]:
        """Return which fitted corners may join: position, pattern, contrast, edge directions and light as expected."""
        inverse = np.linalg.inv(lattice)
        shift = np.abs(np.einsum("kab,kb->ka", inverse, fit.position - position)).max(axis=1)
        expected = inverse / np.linalg.norm(inverse, axis=2, keepdims=True)
        turn = np.arccos(np.clip((expected * fit.normals).sum(axis=2), -1, 1)).max(axis=1)
        around = np.array([np.nanmedian(self.contrast[_window(cell, _REACH)]) for cell in cells])
        ratio = even / around
        rows, cols = self.image.shape
        inside = (fit.position >= 0).all(axis=1) & (fit.position <= (cols - 1, rows - 1)).all(axis=1)
        return (
            inside
            & (shift < MAX_SHIFT)
            & (turn < MAX_TURN)
            & (fit.explained > MIN_EXPLAINED)
            & (fit.support > MIN_SUPPORT)
            & (ratio > CONTRAST_RANGE[0])
            & (ratio < CONTRAST_RANGE[1])
            & (_alternation(self.image, fit, lattice) > MIN_ALTERNATION * np.abs(around))
        )

    def _prune(self) -> None:
        """Drop corners farther from their neighbours' prediction than six deviations of the whole lattice."""
        cells = np.argwhere(self.known)
        position, lattice, sure = self._predict(cells, leave_out=True)
        off = np.linalg.norm(position - self.position[self.known], axis=1)
        pitch = np.sqrt(np.abs(np.linalg.det(lattice)))
        limit = np.maximum(6 * 1.4826 * np.median(off), 0.05 * pitch)
        lost = cells[(sure & (off > limit)) | ~np.isfinite(off)]
        self.position[tuple(lost.T)] = np.nan
        self.contrast[tuple(lost.T)] = np.nan

    def _predict(self, cells: NDArray[np.int64], leave_out: bool = False) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return position, local lattice and whether the corners around determine them."""
        position = np.full((len(cells), 2), np.nan)
        lattice = np.tile(np.eye(2), (len(cells), 1, 1))
        sure = np.zeros(len(cells), dtype=bool)
        for k, cell in enumerate(cells):
            around = self.position[_window(cell, _REACH)]
            if leave_out:
                around = around.copy()
                around[_REACH, _REACH] = np.nan
            there = np.isfinite(around[..., 0])
            fitted = _local_fit(_OFFSETS[there], around[there])
            if fitted is not None:
                position[k], lattice[k], sure[k] = fitted[0], fitted[1:3].T, True
        sure &= np.linalg.det(lattice) > 1.0
        lattice[~sure] = np.eye(2)
        return position, lattice, sure


_OFFSETS = np.stack(np.meshgrid(*2 * [np.arange(-_REACH, _REACH + 1)], indexing="ij"), axis=-1).astype(np.float64)


def _window(cell: NDArray[np.int64], reach: int) -> tuple[slice, slice]:
    i, j = cell
    return slice(i - reach, i + reach + 1), slice(j - reach, j + reach + 1)


def _local_fit(offsets: Array, positions: Array) -> Array | None:
    """Return the coefficients (1, u, v[, u^2, u v, v^2]) x (x, y) of the lattice around offset 0, or None."""
    if len(offsets) < 3:
        return None
    u, v = offsets.T
    near = np.exp(-(u * u + v * v) / 8.0)[:, None]
    quadratic = len(offsets) >= 10 and len(np.unique(u)) >= 3 and len(np.unique(v)) >= 3
    columns = [np.ones_like(u), u, v, *([u * u, u * v, v * v] if quadratic else [])]
    design = np.stack(columns, axis=-1)
    solved, _, rank, _ = np.linalg.lstsq(design * near, positions * near, rcond=1e-6)
    return solved if rank == design.shape[1] else None


def _alternation(image: Array, fit: SaddleFit, lattice: Array) -> Array:
    """Return by how much the darkest bright square around a corner exceeds the brightest dark one (NaN: unknown).

    At the outer border of a board, where a corner model can still be fitted, it is about zero.
    """
    squares = quadrants(image, fit.position, lattice)
    signed = squares * np.sign(fit.contrast)[:, None]
    bright, dark = signed[:, 0::2], signed[:, 1::2]
    return np.fmin(bright[:, 0], bright[:, 1]) - np.fmax(dark[:, 0], dark[:, 1])


def _parity(cells: NDArray[np.int64]) -> Array:
    return 1.0 - 2.0 * (cells.sum(axis=1) % 2)
