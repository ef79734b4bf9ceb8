"""Find the corners of a checkerboard in one picture, also where the board fills, leaves or blurs into its border.

Saddle points of the smoothed picture give candidates with edge directions and polarity; nine of them that fit make a
seed; from there the lattice grows outwards, each corner predicted from its neighbours, fitted, and kept only if its
contrast has the sign that its place on a checkerboard demands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from evanesce.core.errors import WorkError
from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.calibration.saddle import SaddleFit, fit_saddles, quadrants

Array = NDArray[np.float64]

SCALES_PX = (1.5, 2.5, 4.0, 6.5)  # smoothing at which candidates are sought; squares of about 7 to 100 px
MAX_SIDE = 512  # corners along one side of a board
MIN_CORNERS = 16
COARSER = 1.25  # squares that only a larger smoothing finds are at least this much larger
GROWTH_WINDOW_PX = 9.0  # windows while growing; the last fit of each corner takes a wider one
_SEEDS_PER_SCALE = 400
_ORIGIN = MAX_SIDE
_PADDED = 2 * MAX_SIDE + 1
_REACH = 3  # squares over which the local lattice is fitted

# What a fitted corner has to satisfy, in units of the local square or of its neighbours' contrast.
MAX_SHIFT = 0.22
MIN_EXPLAINED = 0.7
CONTRAST_RANGE = (0.25, 3.0)
MAX_TURN = np.deg2rad(20.0)
MIN_SUPPORT = 0.5
MIN_ALTERNATION = 0.5


@dataclass(frozen=True)
class CornerGrid:
    """Corners of one board.

    Attributes
    ----------
    index : ndarray of int (n, 2)
        (i, j) along the two grid axes, from 0; the first axis is the one nearer to the picture's x.
    fit : SaddleFit
        Place, blur and contrast of each, in the same order.
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
        corners on a fringe beyond, which come and go with the light, get negative places instead of
        shifting all others.
        """
        origin = [_first_filled(self.index[:, 0]), _first_filled(self.index[:, 1])]
        return BoardView(name, (self.index - origin).astype(np.float64) * square_mm, self.fit.position)


@dataclass(frozen=True)
class _Candidates:
    """Saddle points of the smoothed picture: place and bright direction (n, 2), the two edge directions (n, 2, 2)."""

    position: Array
    edges: Array
    bright: Array


def grey(image: NDArray[np.generic]) -> Array:
    """Return grey values as float from a grey or RGB picture (luma weights of Rec. 601)."""
    values = np.asarray(image, dtype=np.float64)
    if values.ndim == 3:
        values = values[..., :3] @ np.array([0.299, 0.587, 0.114])
    if values.ndim != 2:
        raise ValueError(f"an image of shape {np.shape(image)}")
    return values


def find_corners(image: NDArray[np.generic]) -> CornerGrid:
    """Find the largest checkerboard in a picture.

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
        If no board of at least ``MIN_CORNERS`` corners is there.
    """
    values = grey(image)
    best: _Growth | None = None
    for sigma in SCALES_PX:
        candidates = _candidates(values, sigma)
        taken = np.zeros(len(candidates.position), dtype=bool)
        if best is not None:
            taken |= best.covers(candidates.position)
        for members, places in _seeds(candidates, taken):
            growth = _Growth(values, places)
            growth.run()
            taken[members] = True
            taken |= growth.covers(candidates.position)
            if best is None or growth.count > best.count:
                best = growth
        if best is not None and best.count * (COARSER * best.pitch) ** 2 > values.size:
            break  # a board of the next scale's larger squares has no room for as many corners
    if best is None or best.count < MIN_CORNERS:
        found = 0 if best is None else best.count
        raise WorkError(f"no checkerboard found: {found} corners that fit one grid (needed: at least {MIN_CORNERS})")
    return best.result()


def _candidates(image: Array, sigma: float) -> _Candidates:
    """Return the saddle points at one smoothing, weakest removed, strongest first."""
    taps = _gaussian_taps(sigma)
    hxx, hyy, hxy = (_separable(image, taps[kx], taps[ky]) for kx, ky in ((2, 0), (0, 2), (1, 1)))
    # eigenvalues of the Hessian: mean +- root; a saddle has one of each sign
    mean, root = (hxx + hyy) / 2, np.hypot((hxx - hyy) / 2, hxy)
    strength = np.maximum(root - np.abs(mean), 0.0) * sigma**2
    smooth = _widely_smoothed(image, 6 * sigma)
    local = np.sqrt(np.maximum(_widely_smoothed((image - smooth) ** 2, 6 * sigma), 0.0))
    floor = max(1e-3 * float(np.ptp(image)), 1e-12)
    # a sharp corner of contrast a has strength 2 a/pi and local deviation a
    side = 2 * int(np.ceil(1.5 * sigma)) + 1
    peaks = cv2.dilate(strength, np.ones((side, side), np.uint8), borderType=cv2.BORDER_REPLICATE)
    rows, cols = np.nonzero((strength == peaks) & (strength > 0.15 * local) & (local > floor))
    order = np.argsort(-(strength / np.maximum(local, floor))[rows, cols], kind="stable")
    rows, cols = rows[order], cols[order]
    xx, yy, xy = hxx[rows, cols], hyy[rows, cols], hxy[rows, cols]
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)  # of the eigenvector with the larger eigenvalue
    bright = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    dark = np.stack([-bright[:, 1], bright[:, 0]], axis=-1)
    high, low = mean[rows, cols] + root[rows, cols], mean[rows, cols] - root[rows, cols]
    along, across = np.sqrt(-low)[:, None] * bright, np.sqrt(high)[:, None] * dark  # directions of zero curvature
    edges = np.stack([along + across, along - across], axis=1)
    edges /= np.linalg.norm(edges, axis=-1, keepdims=True)
    return _Candidates(np.stack([cols, rows], axis=-1).astype(np.float64), edges, bright)


def _gaussian_taps(sigma: float) -> tuple[Array, Array, Array]:
    """Return a Gaussian and its first and second derivative, sampled to four standard deviations."""
    x = np.arange(-int(4 * sigma + 0.5), int(4 * sigma + 0.5) + 1, dtype=np.float64)
    gauss = np.exp(-0.5 * (x / sigma) ** 2)
    gauss /= gauss.sum()
    return gauss, x / sigma**2 * gauss, (x**2 / sigma**2 - 1) / sigma**2 * gauss


def _separable(image: Array, along_x: Array, along_y: Array) -> Array:
    """Correlate with a separable kernel, the border repeated."""
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_64F, along_x, along_y, borderType=cv2.BORDER_REPLICATE))


def _widely_smoothed(image: Array, sigma: float) -> Array:
    """Smooth by a wide Gaussian, on an image reduced so far that its standard deviation is 3 px there."""
    rows, cols = image.shape
    factor = max(1.0, sigma / 3.0)
    size = max(1, round(cols / factor)), max(1, round(rows / factor))
    small = cv2.GaussianBlur(
        cv2.resize(image, size, interpolation=cv2.INTER_AREA), (0, 0), sigma / factor, borderType=cv2.BORDER_REPLICATE
    )
    return np.asarray(cv2.resize(small, (cols, rows), interpolation=cv2.INTER_LINEAR))


def _seeds(candidates: _Candidates, taken: NDArray[np.bool_]) -> Iterator[tuple[list[int], Array]]:
    """Yield nine candidates that form a 3 x 3 patch: their numbers, and their places as an array (3, 3, 2)."""
    if len(candidates.position) < 9:
        return
    tree = KDTree(candidates.position)
    tried = 0
    for k in range(len(candidates.position)):
        if taken[k]:
            continue
        if tried == _SEEDS_PER_SCALE:
            return
        tried += 1
        members = _patch(candidates, tree, k)
        if members is not None:
            yield members, candidates.position[members].reshape(3, 3, 2)


def _patch(candidates: _Candidates, tree: KDTree, centre: int) -> list[int] | None:
    """Return the 3 x 3 patch around a candidate, [i, j] flattened, or None if its neighbours do not fit."""
    place = candidates.position
    steps, found = [], {(0, 0): centre}
    for axis, unit in enumerate(((1, 0), (0, 1))):
        for sign in (1, -1):
            other = _neighbour(candidates, tree, centre, sign * candidates.edges[centre, axis])
            if other is None:
                return None
            found[sign * unit[0], sign * unit[1]] = other
            steps.append(sign * (place[other] - place[centre]))
    lengths = np.linalg.norm(steps, axis=-1)
    if np.linalg.norm(steps[0] - steps[1]) > 0.35 * lengths[:2].min():
        return None
    if np.linalg.norm(steps[2] - steps[3]) > 0.35 * lengths[2:].min():
        return None
    for i in (-1, 1):
        for j in (-1, 1):
            expected = place[found[i, 0]] + place[found[0, j]] - place[centre]
            distance, near = tree.query(expected)
            same = abs(candidates.bright[near] @ candidates.bright[centre]) > 0.8
            if distance > 0.25 * lengths.min() or not same:
                return None
            found[i, j] = int(near)
    members = [found[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return members if len(set(members)) == 9 else None


def _neighbour(candidates: _Candidates, tree: KDTree, centre: int, direction: Array) -> int | None:
    """Return the nearest candidate of opposite polarity along an edge, within 15 degrees of it."""
    _, near = tree.query(candidates.position[centre], k=min(25, len(candidates.position)))
    for other in near[1:]:
        offset = candidates.position[other] - candidates.position[centre]
        if offset @ direction < np.cos(np.deg2rad(15.0)) * np.linalg.norm(offset):
            continue
        if abs(candidates.bright[other] @ candidates.bright[centre]) < 0.6:
            return int(other)
    return None


def _first_filled(line: NDArray[np.int64]) -> int:
    """Return the number of the first line with at least half as many corners as the median line."""
    numbers, counts = np.unique(line, return_counts=True)
    return int(numbers[np.argmax(counts >= 0.5 * np.median(counts))])


class _Growth:
    """A lattice that grows from a 3 x 3 patch; the one mutable thing here, private to :func:`find_corners`."""

    def __init__(self, image: Array, patch: Array) -> None:
        self.image = image
        self.place = np.full((_PADDED, _PADDED, 2), np.nan)
        self.contrast = np.full((_PADDED, _PADDED), np.nan)  # as of an even corner: the sign alternates taken out
        middle = slice(_ORIGIN - 1, _ORIGIN + 2)
        self.place[middle, middle] = patch
        if np.linalg.det(np.stack([patch[2, 1] - patch[0, 1], patch[1, 2] - patch[1, 0]])) < 0:
            self.place[middle, middle] = patch[:, ::-1]  # right-handed in (x right, y down)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which lattice places are filled."""
        return np.isfinite(self.place[..., 0])

    @property
    def count(self) -> int:
        """Number of corners."""
        return int(self.known.sum())

    @property
    def pitch(self) -> float:
        """Median distance of neighbouring corners [px]."""
        steps = [np.linalg.norm(np.diff(self.place, axis=axis), axis=-1) for axis in (0, 1)]
        return float(np.nanmedian(np.concatenate([step[np.isfinite(step)] for step in steps])))

    def run(self) -> None:
        """Fit the patch, then grow ring by ring until nothing fits; then once more after pruning."""
        if not self._fit_patch():
            return
        for _ in range(2):
            while self._grow_ring():
                pass
            self._prune()

    def covers(self, points: Array) -> NDArray[np.bool_]:
        """Tell which points lie within a third of a square of a corner of this grid."""
        if self.count < 9 or not len(points):
            return np.zeros(len(points), dtype=bool)
        cells = np.argwhere(self.known)
        distance, near = KDTree(self.place[self.known]).query(points)
        lattice = self._predict(cells[np.unique(near)])[1]
        pitch = np.full(len(cells), np.nan)
        pitch[np.unique(near)] = np.sqrt(np.abs(np.linalg.det(lattice)))
        return distance < pitch[near] / 3

    def result(self) -> CornerGrid:
        """Return the grid, its first axis along the picture's x, with a last fit of each corner."""
        cells = np.argwhere(self.known)
        _, lattice, _ = self._predict(cells)
        fit = fit_saddles(self.image, self.place[self.known], lattice)
        mean = lattice.mean(axis=0)
        index = cells - cells.min(axis=0)
        turns = int(np.rint(np.arctan2(mean[1, 0], mean[0, 0]) / (np.pi / 2))) % 4
        for _ in range(turns):  # a quarter turn: the new first axis is minus the second, the new second the first
            index = np.stack([-index[:, 1], index[:, 0]], axis=-1)
            lattice = np.stack([-lattice[..., 1], lattice[..., 0]], axis=-1)
            normals = np.stack([-fit.normals[:, 1], fit.normals[:, 0]], axis=1)
            fit = _replaced(fit, normals=normals, sigma=fit.sigma[:, ::-1], contrast=-fit.contrast)
        index = index - index.min(axis=0)
        order = np.lexsort((index[:, 1], index[:, 0]))
        ordered = {name: getattr(fit, name)[order] for name in SaddleFit.__dataclass_fields__}
        return CornerGrid(index[order].astype(np.int64), SaddleFit(**ordered), lattice[order])

    def _fit_patch(self) -> bool:
        cells = np.argwhere(self.known)
        _, lattice, _ = self._predict(cells)
        fit = fit_saddles(self.image, self.place[self.known], lattice)
        even = fit.contrast * _parity(cells)
        good = (fit.explained > MIN_EXPLAINED) & (np.sign(even) == np.sign(np.median(even))) & (fit.support > 0.9)
        self.place[self.known] = fit.position
        self.contrast[tuple(cells.T)] = even
        return bool(good.all())

    def _grow_ring(self) -> int:
        """Try every empty place beside the lattice; return how many corners were added."""
        known = self.known
        beside = ndimage.binary_dilation(known, structure=np.ones((3, 3))) & ~known
        beside[:_REACH] = beside[-_REACH:] = False
        beside[:, :_REACH] = beside[:, -_REACH:] = False
        cells = np.argwhere(beside)
        place, lattice, sure = self._predict(cells)
        rows, cols = self.image.shape
        sure &= (place > -0.5).all(axis=1) & (place[:, 0] < cols - 0.5) & (place[:, 1] < rows - 0.5)
        cells, place, lattice = cells[sure], place[sure], lattice[sure]
        if not len(cells):
            return 0
        fit = fit_saddles(self.image, place, lattice, limit_px=GROWTH_WINDOW_PX)
        even = fit.contrast * _parity(cells)
        good = self._fits(cells, place, lattice, fit, even)
        self.place[tuple(cells[good].T)] = fit.position[good]
        self.contrast[tuple(cells[good].T)] = even[good]
        return int(good.sum())

    def _fits(
        self, cells: NDArray[np.int64], place: Array, lattice: Array, fit: SaddleFit, even: Array
    ) -> NDArray[np.bool_]:
        """Tell which fitted corners may join: place, pattern, contrast, edge directions and light as expected."""
        inverse = np.linalg.inv(lattice)
        shift = np.abs(np.einsum("kab,kb->ka", inverse, fit.position - place)).max(axis=1)
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
        """Drop corners that their neighbours, without them, put elsewhere: beyond six deviations of the whole grid."""
        cells = np.argwhere(self.known)
        place, lattice, sure = self._predict(cells, leave_out=True)
        off = np.linalg.norm(place - self.place[self.known], axis=1)
        pitch = np.sqrt(np.abs(np.linalg.det(lattice)))
        limit = np.maximum(6 * 1.4826 * np.median(off), 0.05 * pitch)
        lost = cells[(sure & (off > limit)) | ~np.isfinite(off)]
        self.place[tuple(lost.T)] = np.nan
        self.contrast[tuple(lost.T)] = np.nan

    def _predict(self, cells: NDArray[np.int64], leave_out: bool = False) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the place, the local lattice and whether there was enough to tell, from the corners around."""
        place = np.full((len(cells), 2), np.nan)
        lattice = np.tile(np.eye(2), (len(cells), 1, 1))
        sure = np.zeros(len(cells), dtype=bool)
        for k, cell in enumerate(cells):
            around = self.place[_window(cell, _REACH)]
            if leave_out:
                around = around.copy()
                around[_REACH, _REACH] = np.nan
            there = np.isfinite(around[..., 0])
            fitted = _local_fit(_OFFSETS[there], around[there])
            if fitted is not None:
                place[k], lattice[k], sure[k] = fitted[0], fitted[1:3].T, True
        sure &= np.linalg.det(lattice) > 1.0
        lattice[~sure] = np.eye(2)
        return place, lattice, sure


_OFFSETS = np.stack(np.meshgrid(*2 * [np.arange(-_REACH, _REACH + 1)], indexing="ij"), axis=-1).astype(np.float64)


def _window(cell: NDArray[np.int64], reach: int) -> tuple[slice, slice]:
    i, j = cell
    return slice(i - reach, i + reach + 1), slice(j - reach, j + reach + 1)


def _local_fit(offsets: Array, places: Array) -> Array | None:
    """Return the coefficients (1, u, v[, u^2, u v, v^2]) x (x, y) of the lattice around offset 0, or None."""
    if len(offsets) < 3:
        return None
    u, v = offsets.T
    near = np.exp(-(u * u + v * v) / 8.0)[:, None]
    quadratic = len(offsets) >= 10 and len(np.unique(u)) >= 3 and len(np.unique(v)) >= 3
    columns = [np.ones_like(u), u, v, *([u * u, u * v, v * v] if quadratic else [])]
    design = np.stack(columns, axis=-1)
    solved, _, rank, _ = np.linalg.lstsq(design * near, places * near, rcond=1e-6)
    return solved if rank == design.shape[1] else None


def _alternation(image: Array, fit: SaddleFit, lattice: Array) -> Array:
    """Return by how much the darkest bright square around a corner exceeds the brightest dark one (NaN: not told).

    At the outer border of a board, where a corner model can still be fitted, it is about zero.
    """
    squares = quadrants(image, fit.position, lattice)
    signed = squares * np.sign(fit.contrast)[:, None]
    bright, dark = signed[:, 0::2], signed[:, 1::2]
    return np.fmin(bright[:, 0], bright[:, 1]) - np.fmax(dark[:, 0], dark[:, 1])


def _parity(cells: NDArray[np.int64]) -> Array:
    return 1.0 - 2.0 * (cells.sum(axis=1) % 2)


def _replaced(fit: SaddleFit, **changes: Array) -> SaddleFit:
    return SaddleFit(**{name: changes.get(name, getattr(fit, name)) for name in SaddleFit.__dataclass_fields__})
