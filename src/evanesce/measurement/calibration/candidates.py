"""Candidates for the corners of a checkerboard: saddle points of the smoothed image, and 3 x 3 patches among them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Indices = NDArray[np.int64]

SEEDS_PER_SCALE = 400
NEAREST = 24  # candidates among which a neighbour is sought
FINEST_PX = 1.25  # smoothing that the reduced image keeps, in its own pixels


@dataclass(frozen=True)
class Candidates:
    """Saddle points of the smoothed image.

    Attributes
    ----------
    position : ndarray (n, 2)
        (x, y) [px].
    edges : ndarray (n, 2, 2)
        Unit vectors along the two edges that cross there.
    bright : ndarray (n, 2)
        Unit vector towards a bright square.
    """

    position: Array
    edges: Array
    bright: Array


def candidates_of(image: Array, sigma: float) -> Candidates:
    """Return the saddle points of an image at one smoothing, weakest removed, strongest first.

    Parameters
    ----------
    image : ndarray (rows, cols)
        Grey values.
    sigma : float
        Standard deviation of the smoothing [px].

    Returns
    -------
    Candidates
    """
    # wide smoothing needs no fine pixels: on an image reduced by `factor` it costs factor^2 less
    factor = max(1, int(sigma / FINEST_PX))
    (rows, cols), full = image.shape, image.astype(np.float32)
    size = max(1, cols // factor), max(1, rows // factor)
    small = cv2.resize(full, size, interpolation=cv2.INTER_AREA) if factor > 1 else full
    sigma, step = sigma / factor, np.array([cols / size[0], rows / size[1]])
    taps = _gaussian_taps(sigma)
    hxx, hyy, hxy = (_separable(small, taps[kx], taps[ky]) for kx, ky in ((2, 0), (0, 2), (1, 1)))
    # eigenvalues of the Hessian: mean +- root; a saddle has one of each sign
    mean, root = (hxx + hyy) / 2, np.asarray(cv2.magnitude((hxx - hyy) / 2, hxy))
    strength = np.maximum(root - np.abs(mean), 0.0) * np.float32(sigma**2)
    floor = max(1e-3 * float(np.ptp(image)), 1e-12)
    # a sharp corner of contrast a has strength 2 a/pi and local deviation a
    side = 2 * int(np.ceil(1.5 * sigma)) + 1
    peaks = cv2.dilate(strength, np.ones((side, side), np.uint8), borderType=cv2.BORDER_REPLICATE)
    down, along_x = np.nonzero((strength == peaks) & (strength > 0.15 * floor))
    deviation = _local_deviation(small, 6 * sigma)
    local = deviation[down * deviation.shape[0] // small.shape[0], along_x * deviation.shape[1] // small.shape[1]]
    ratio = strength[down, along_x] / np.maximum(local, floor)
    order = np.argsort(-ratio, kind="stable")
    order = order[(ratio > 0.15)[order] & (local > floor)[order]]
    down, along_x = down[order], along_x[order]
    xx, yy, xy = hxx[down, along_x], hyy[down, along_x], hxy[down, along_x]
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)  # of the eigenvector with the larger eigenvalue
    bright = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    dark = np.stack([-bright[:, 1], bright[:, 0]], axis=-1)
    high, low = mean[down, along_x] + root[down, along_x], mean[down, along_x] - root[down, along_x]
    along, across = np.sqrt(-low)[:, None] * bright, np.sqrt(high)[:, None] * dark  # directions of zero curvature
    edges = np.stack([along + across, along - across], axis=1)
    edges /= np.linalg.norm(edges, axis=-1, keepdims=True)
    position = (np.stack([along_x, down], axis=-1) + 0.5) * step - 0.5
    return Candidates(position, edges.astype(np.float64), bright.astype(np.float64))


def _gaussian_taps(sigma: float) -> tuple[Array, Array, Array]:
    """Return a Gaussian and its first and second derivative, sampled to four standard deviations."""
    x = np.arange(-int(4 * sigma + 0.5), int(4 * sigma + 0.5) + 1, dtype=np.float64)
    gauss = np.exp(-0.5 * (x / sigma) ** 2)
    gauss /= gauss.sum()
    return gauss, x / sigma**2 * gauss, (x**2 / sigma**2 - 1) / sigma**2 * gauss


def _separable(image: Single, along_x: Array, along_y: Array) -> Single:
    """Correlate with a separable kernel, the border repeated."""
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, along_x, along_y, borderType=cv2.BORDER_REPLICATE))


def _local_deviation(image: Single, sigma: float) -> Single:
    """Return the standard deviation within a wide Gaussian, on an image so small that the Gaussian's is 3 px there."""
    rows, cols = image.shape
    factor = max(1.0, sigma / 3.0)
    size = max(1, round(cols / factor)), max(1, round(rows / factor))
    centred = image - np.float32(image.mean())
    first, second = (
        cv2.GaussianBlur(
            cv2.resize(part, size, interpolation=cv2.INTER_AREA),
            (0, 0),
            sigma / factor,
            borderType=cv2.BORDER_REPLICATE,
        )
        for part in (centred, centred * centred)
    )
    return np.asarray(np.sqrt(np.maximum(second - first * first, 0)), dtype=np.float32)


def seeds(candidates: Candidates, taken: NDArray[np.bool_]) -> Iterator[tuple[list[int], Array]]:
    """Yield sets of nine candidates that form a 3 x 3 patch.

    Parameters
    ----------
    candidates : Candidates
    taken : ndarray of bool (n,)
        Candidates that start no patch; the caller may set more while it iterates.

    Yields
    ------
    members : list of int
        Numbers of the candidates.
    positions : ndarray (3, 3, 2)
        (x, y) [px].
    """
    if len(candidates.position) < 9:
        return
    tree = KDTree(candidates.position)
    centres = np.flatnonzero(~taken)[:SEEDS_PER_SCALE]
    members, fits = _patches(candidates, tree, centres)
    for k, patch in zip(centres[fits], members[fits], strict=True):
        if not taken[k]:
            yield patch.tolist(), candidates.position[patch].reshape(3, 3, 2)


def _patches(candidates: Candidates, tree: KDTree, centres: Indices) -> tuple[Indices, NDArray[np.bool_]]:
    """Return the 3 x 3 patch around each centre, [i, j] flattened (m, 9), and whether its neighbours fit."""
    position, bright = candidates.position, candidates.bright
    beside, good = _neighbours(candidates, tree, centres)  # +i, -i, +j, -j
    steps = position[beside] - position[centres, None]
    lengths = np.linalg.norm(steps, axis=-1)
    for one, other in ((0, 1), (2, 3)):
        unlike = np.linalg.norm(steps[:, one] + steps[:, other], axis=-1)
        good &= unlike <= 0.35 * lengths[:, [one, other]].min(axis=1)
    diagonal = [(1, 3), (1, 2), (0, 3), (0, 2)]  # (-i, -j), (-i, +j), (+i, -j), (+i, +j)
    expected = position[centres, None] + np.stack([steps[:, i] + steps[:, j] for i, j in diagonal], axis=1)
    distance, corner = tree.query(expected)
    good &= (distance <= 0.25 * lengths.min(axis=1, keepdims=True)).all(axis=1)
    good &= (np.abs((bright[corner] * bright[centres, None]).sum(axis=-1)) > 0.8).all(axis=1)
    columns = [corner[:, 0], beside[:, 1], corner[:, 1], beside[:, 3], centres, beside[:, 2], corner[:, 2],
               beside[:, 0], corner[:, 3]]  # fmt: skip
    members = np.stack(columns, axis=-1).astype(np.int64)
    good &= (np.diff(np.sort(members, axis=1), axis=1) > 0).all(axis=1)
    return members, good


def _neighbours(candidates: Candidates, tree: KDTree, centres: Indices) -> tuple[Indices, NDArray[np.bool_]]:
    """Return the nearest candidate of opposite polarity along +-i and +-j (m, 4), within 15 degrees, and if all are."""
    position, bright = candidates.position, candidates.bright
    _, near = tree.query(position[centres], k=min(NEAREST + 1, len(position)))
    near = near[:, 1:]
    offset = position[near] - position[centres, None]
    length = np.linalg.norm(offset, axis=-1)
    edges = candidates.edges[centres]
    along = np.stack([edges[:, 0], -edges[:, 0], edges[:, 1], -edges[:, 1]], axis=1)
    ahead = along @ offset.swapaxes(1, 2) >= np.cos(np.deg2rad(15.0)) * length[:, None]
    opposite = np.abs((bright[near] * bright[centres, None]).sum(axis=-1)) < 0.6
    fits = ahead & opposite[:, None]
    return np.take_along_axis(near, fits.argmax(axis=2), axis=1), fits.any(axis=2).all(axis=1)
