"""Growth of a corner lattice from a 3 x 3 patch: each corner predicted from its neighbours, fitted, kept if it fits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from evanesce.measurement.calibration.saddle import SaddleFit, fit_saddles, quadrants

Array = NDArray[np.float64]

MAX_SIDE = 512  # corners along one side of a board
# While the lattice grows, a position only has to predict its neighbours; the last fit of each corner is to the end.
# Two of three places tried are no corners, whose fit never converges: few steps leave them early.
GROWTH: dict[str, Any] = {"limit_px": 9.0, "tolerance_px": 0.02, "iterations": 8}
LAST_PX = 1e-3  # step at which the last fit of a corner has converged: a tenth of what noise moves it at best
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
NEAR_PART = (0.06, 0.18)  # squares from a corner, seen of a square that the frame cuts
HINT_ALTERNATION = 0.1  # at the predicted place, up to MAX_SHIFT off, before a fit is tried
FRAME_MARGIN = 0.25  # squares from the frame's border within which a corner may be missed
MIN_EIGENVALUE = 1e-10  # of the largest, below which the corners around determine no local lattice


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
        # only where `known`; zeros cost no memory before they are written to
        self.position = np.zeros((_PADDED, _PADDED, 2))
        self.contrast = np.zeros((_PADDED, _PADDED))  # as of an even corner: the sign alternates taken out
        self.shape = np.zeros((_PADDED, _PADDED, 2, 3))  # normals and blur of the last fit, for the next to start from
        self.known = np.zeros((_PADDED, _PADDED), dtype=bool)
        self.cells = np.argwhere(np.ones((3, 3), dtype=bool)) + (_ORIGIN - 1)
        self.known[tuple(self.cells.T)] = True
        middle = slice(_ORIGIN - 1, _ORIGIN + 2)
        self.position[middle, middle] = patch
        if np.linalg.det(np.stack([patch[2, 1] - patch[0, 1], patch[1, 2] - patch[1, 0]])) < 0:
            self.position[middle, middle] = patch[:, ::-1]  # right-handed in (x right, y down)

    @property
    def count(self) -> int:
        """Number of corners."""
        return len(self.cells)

    @property
    def pitch(self) -> float:
        """Median distance of neighbouring corners [px]."""
        steps = []
        for unit in ((1, 0), (0, 1)):
            pairs = self.cells[self.known[tuple((self.cells + unit).T)]]
            steps.append(np.linalg.norm(self._at(pairs + unit) - self._at(pairs), axis=-1))
        return float(np.median(np.concatenate(steps)))

    def run(self) -> None:
        """Fit the patch, then grow at the border until nothing fits; then once more after pruning."""
        if not self._fit_patch():
            return
        for _ in range(2):
            while self._grow_border():
                pass
            if not self._prune():
                break

    def _at(self, cells: NDArray[np.int64]) -> Array:
        return np.asarray(self.position[tuple(cells.T)])

    def _keep(self, cells: NDArray[np.int64], fit: SaddleFit, even: Array) -> None:
        where = tuple(cells.T)
        self.position[where], self.contrast[where] = fit.position, even
        self.shape[where] = np.concatenate([fit.normals, fit.sigma[..., None]], axis=-1)

    def _drop(self, lost: NDArray[np.bool_]) -> None:
        self.known[tuple(self.cells[lost].T)] = False
        self.cells = self.cells[~lost]

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
        distance, near = KDTree(self._at(self.cells)).query(points)
        used, back = np.unique(near, return_inverse=True)
        lattice = self._predict(self.cells[used])[1]
        pitch = np.sqrt(np.abs(np.linalg.det(lattice)))
        return np.asarray(distance < pitch[back] / 3)

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
        cells, fit, lattice = self._settled()
        if not len(cells):
            return cells, fit, lattice
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

    def _settled(self) -> tuple[NDArray[np.int64], SaddleFit, Array]:
        """Fit each corner to the end; those that no longer alternate, or belong to no complete cell, are dropped."""
        _, lattice, _ = self._predict(self.cells)
        shape = self.shape[tuple(self.cells.T)]
        fit = fit_saddles(
            self.image, self._at(self.cells), lattice, tolerance_px=LAST_PX, start=(shape[..., :2], shape[..., 2])
        )
        even = fit.contrast * _parity(self.cells)
        self._keep(self.cells, fit, even)
        position, lattice, sure = self._predict(self.cells, leave_out=True)
        good = sure & self._fits(self.cells, position, lattice, fit, even)
        self._drop(~good)
        whole = self._in_cells(lattice[good])
        self._drop(~whole)
        kept = np.flatnonzero(good)[whole]
        return self.cells, _chosen(fit, kept), self._predict(self.cells)[1]

    def _in_cells(self, lattice: Array) -> NDArray[np.bool_]:
        """Return which corners belong to a square whose other corners are known, as far as the frame shows them."""
        rows, cols = self.image.shape
        here, pitch = self._at(self.cells), np.sqrt(np.abs(np.linalg.det(lattice)))[:, None]

        def there(step: tuple[int, int]) -> NDArray[np.bool_]:
            place = here + lattice @ np.array(step, dtype=np.float64)
            cut = (place < FRAME_MARGIN * pitch) | (place > [cols - 1, rows - 1] - FRAME_MARGIN * pitch)
            return np.asarray(self.known[tuple((self.cells + step).T)] | cut.any(axis=1))

        whole = np.zeros(len(here), dtype=bool)
        for i, j in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            whole |= there((i, 0)) & there((0, j)) & there((i, j))
        return whole

    def _fit_patch(self) -> bool:
        _, lattice, _ = self._predict(self.cells)
        places = self._at(self.cells)
        height = alternation(self.image, places, lattice, _parity(self.cells))
        if not ((height > 0).all() or (alternation(self.image, places, lattice, -_parity(self.cells)) > 0).all()):
            return False
        fit = fit_saddles(self.image, places, lattice, **GROWTH)
        even = fit.contrast * _parity(self.cells)
        good = (fit.explained > MIN_EXPLAINED) & (np.sign(even) == np.sign(np.median(even))) & (fit.support > 0.9)
        # the outer corner of a border square is a saddle of the smoothed image, too: three of its quadrants are alike
        height = alternation(self.image, fit.position, lattice, fit.contrast)
        good &= height > MIN_ALTERNATION * np.abs(np.median(even))
        self._keep(self.cells, fit, even)
        return bool(good.all())

    def _grow_border(self) -> int:
        """Try every empty position beside the lattice; return how many corners were added."""
        around = (self.cells[:, None] + _AROUND).reshape(-1, 2)
        flat = np.unique(around @ [_PADDED, 1])
        cells = np.stack([flat // _PADDED, flat % _PADDED], axis=-1)
        free = (cells >= _REACH).all(axis=1) & (cells < _PADDED - _REACH).all(axis=1)
        cells = cells[free & ~self.known[tuple(cells.T)]]
        position, lattice, sure = self._predict(cells)
        rows, cols = self.image.shape
        sure &= (position > -0.5).all(axis=1) & (position[:, 0] < cols - 0.5) & (position[:, 1] < rows - 0.5)
        cells, position, lattice = cells[sure], position[sure], lattice[sure]
        # where the four squares around the predicted place do not alternate, no fit is worth its time
        expected = self._contrast_around(cells)
        height = alternation(self.image, position, lattice, expected * _parity(cells))
        likely = height > HINT_ALTERNATION * np.abs(expected)
        cells, position, lattice = cells[likely], position[likely], lattice[likely]
        if not len(cells):
            return 0
        fit = fit_saddles(self.image, position, lattice, start=self._shape_beside(cells, lattice), **GROWTH)
        even = fit.contrast * _parity(cells)
        good = self._fits(cells, position, lattice, fit, even)
        self._keep(cells[good], _chosen(fit, good), even[good])
        self.known[tuple(cells[good].T)] = True
        self.cells = np.concatenate([self.cells, cells[good]])
        return int(good.sum())

    def _shape_beside(self, cells: NDArray[np.int64], lattice: Array) -> tuple[Array, Array]:
        """Return normals by the lattice, and the blur of a known corner beside each cell."""
        beside = cells[:, None] + _AROUND
        first = self.known[beside[..., 0], beside[..., 1]].argmax(axis=1)
        near = beside[np.arange(len(cells)), first]
        inverse = np.linalg.inv(lattice)
        normals = inverse / np.linalg.norm(inverse, axis=2, keepdims=True)
        return normals, self.shape[near[:, 0], near[:, 1], :, 2]

    def _contrast_around(self, cells: NDArray[np.int64]) -> Array:
        """Return the median contrast of the known corners near each cell, of which there is at least one."""
        near = cells[:, None] + _WINDOW
        there = self.known[near[..., 0], near[..., 1]]
        ordered = np.sort(np.where(there, self.contrast[near[..., 0], near[..., 1]], np.inf), axis=1)
        count = there.sum(axis=1)
        low, high = np.maximum(count - 1, 0) // 2, count // 2
        rows = np.arange(len(cells))
        return np.asarray(0.5 * (ordered[rows, low] + ordered[rows, np.minimum(high, np.maximum(count - 1, 0))]))

    def _fits(
        self, cells: NDArray[np.int64], position: Array, lattice: Array, fit: SaddleFit, even: Array
    ) -> NDArray[np.bool_]:
        """Return which fitted corners may join: position, pattern, contrast, edge directions and light as expected."""
        inverse = np.linalg.inv(lattice)
        shift = np.abs(np.einsum("kab,kb->ka", inverse, fit.position - position)).max(axis=1)
        expected = inverse / np.linalg.norm(inverse, axis=2, keepdims=True)
        turn = np.arccos(np.clip((expected * fit.normals).sum(axis=2), -1, 1)).max(axis=1)
        around = self._contrast_around(cells)
        ratio = even / around
        rows, cols = self.image.shape
        inside = (fit.position >= 0).all(axis=1) & (fit.position <= (cols - 1, rows - 1)).all(axis=1)
        return np.asarray(
            inside
            & (shift < MAX_SHIFT)
            & (turn < MAX_TURN)
            & (fit.explained > MIN_EXPLAINED)
            & (fit.support > MIN_SUPPORT)
            & (ratio > CONTRAST_RANGE[0])
            & (ratio < CONTRAST_RANGE[1])
            & (alternation(self.image, fit.position, lattice, fit.contrast) > MIN_ALTERNATION * np.abs(around))
        )

    def _prune(self) -> int:
        """Drop corners farther from their neighbours' prediction than six deviations of the whole lattice."""
        position, lattice, sure = self._predict(self.cells, leave_out=True)
        off = np.linalg.norm(position - self._at(self.cells), axis=1)
        pitch = np.sqrt(np.abs(np.linalg.det(lattice)))
        limit = np.maximum(6 * 1.4826 * np.median(off[sure]) if sure.any() else 0.0, 0.05 * pitch)
        lost = (sure & (off > limit)) | ~sure
        self._drop(lost)
        return int(lost.sum())

    def _predict(self, cells: NDArray[np.int64], leave_out: bool = False) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return position, local lattice and whether the corners around determine them.

        A local polynomial (1, u, v[, u^2, u v, v^2]) of the corners' places within ``_REACH`` squares.
        """
        near = cells[:, None] + _WINDOW
        there = self.known[near[..., 0], near[..., 1]]
        if leave_out:
            there[:, len(_WINDOW) // 2] = False
        places = self.position[near[..., 0], near[..., 1]]
        count = there.sum(axis=1)
        middle = (places * there[..., None]).sum(axis=1) / np.maximum(count, 1)[:, None]
        weight = there * _NEARNESS
        normal = (weight @ _PRODUCTS).reshape(-1, 6, 6)
        right = _BASIS.T @ (weight[..., None] * (places - middle[:, None]))
        grid = there.reshape(-1, 2 * _REACH + 1, 2 * _REACH + 1)
        lines = np.minimum(grid.any(axis=1).sum(axis=1), grid.any(axis=2).sum(axis=1))
        quadratic = (count >= 10) & (lines >= 3)
        position, lattice = np.full((len(cells), 2), np.nan), np.tile(np.eye(2), (len(cells), 1, 1))
        sure = np.zeros(len(cells), dtype=bool)
        for terms, which in ((3, ~quadratic & (count >= 3)), (6, quadratic)):
            rows = np.flatnonzero(which)
            part = normal[rows, :terms, :terms]
            spread = np.linalg.eigvalsh(part)
            fine = spread[:, 0] > MIN_EIGENVALUE * spread[:, -1]
            rows, part = rows[fine], part[fine]
            solved = np.linalg.solve(part, right[rows, :terms])
            position[rows] = solved[:, 0] + middle[rows]
            lattice[rows] = solved[:, 1:3].swapaxes(1, 2)
            sure[rows] = True
        sure &= np.linalg.det(lattice) > 1.0
        lattice[~sure] = np.eye(2)
        return position, lattice, sure


_WINDOW = np.stack(np.meshgrid(*2 * [np.arange(-_REACH, _REACH + 1)], indexing="ij"), axis=-1).reshape(-1, 2)
_AROUND = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j])
_U, _V = _WINDOW.T.astype(np.float64)
_NEARNESS = np.exp(-(_U * _U + _V * _V) / 4.0)  # weight of a squared miss
_BASIS = np.stack([np.ones_like(_U), _U, _V, _U * _U, _U * _V, _V * _V], axis=-1)
_PRODUCTS = (_BASIS[:, :, None] * _BASIS[:, None, :]).reshape(-1, 36)


def _chosen(fit: SaddleFit, which: NDArray[Any]) -> SaddleFit:
    return SaddleFit(**{name: getattr(fit, name)[which] for name in SaddleFit.__dataclass_fields__})


def alternation(image: Array, position: Array, lattice: Array, contrast: Array) -> Array:
    """Return by how much the darkest bright square around a corner exceeds the brightest dark one.

    At the outer border of a board, where a corner model can still be fitted, it is about zero. All four squares count:
    where the frame cuts one off, its part next to the corner; NaN, which passes no limit, where that is out of sight.

    Parameters
    ----------
    image : ndarray (rows, cols)
    position : ndarray (n, 2)
        (x, y) [px].
    lattice : ndarray (n, 2, 2)
        Local steps [px per square].
    contrast : ndarray (n,)
        Only the sign counts: positive where the square towards +u +v is bright.

    Returns
    -------
    ndarray (n,)
        [the image's unit]
    """
    squares = quadrants(image, position, lattice)
    cut = np.isnan(squares).any(axis=1)
    if cut.any():
        near = quadrants(image, position[cut], lattice[cut], NEAR_PART)
        squares[cut] = np.where(np.isnan(squares[cut]), near, squares[cut])
    signed = squares * np.sign(contrast)[:, None]
    bright, dark = signed[:, 0::2], signed[:, 1::2]
    return np.asarray(bright.min(axis=1) - dark.max(axis=1))


def _parity(cells: NDArray[np.int64]) -> Array:
    return 1.0 - 2.0 * (cells.sum(axis=1) % 2)
