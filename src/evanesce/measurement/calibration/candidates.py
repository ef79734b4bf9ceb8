"""Candidates for the corners of a checkerboard: saddle points of the smoothed image, and 3 x 3 patches among them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

Array = NDArray[np.float64]

SEEDS_PER_SCALE = 400


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
    return Candidates(np.stack([cols, rows], axis=-1).astype(np.float64), edges, bright)


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
    tried = 0
    for k in range(len(candidates.position)):
        if taken[k]:
            continue
        if tried == SEEDS_PER_SCALE:
            return
        tried += 1
        members = _patch(candidates, tree, k)
        if members is not None:
            yield members, candidates.position[members].reshape(3, 3, 2)


def _patch(candidates: Candidates, tree: KDTree, centre: int) -> list[int] | None:
    """Return the 3 x 3 patch around a candidate, [i, j] flattened, or None if its neighbours do not fit."""
    position = candidates.position
    steps, found = [], {(0, 0): centre}
    for axis, unit in enumerate(((1, 0), (0, 1))):
        for sign in (1, -1):
            other = _neighbour(candidates, tree, centre, sign * candidates.edges[centre, axis])
            if other is None:
                return None
            found[sign * unit[0], sign * unit[1]] = other
            steps.append(sign * (position[other] - position[centre]))
    lengths = np.linalg.norm(steps, axis=-1)
    if np.linalg.norm(steps[0] - steps[1]) > 0.35 * lengths[:2].min():
        return None
    if np.linalg.norm(steps[2] - steps[3]) > 0.35 * lengths[2:].min():
        return None
    for i in (-1, 1):
        for j in (-1, 1):
            expected = position[found[i, 0]] + position[found[0, j]] - position[centre]
            distance, near = tree.query(expected)
            same = abs(candidates.bright[near] @ candidates.bright[centre]) > 0.8
            if distance > 0.25 * lengths.min() or not same:
                return None
            found[i, j] = int(near)
    members = [found[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return members if len(set(members)) == 9 else None


def _neighbour(candidates: Candidates, tree: KDTree, centre: int, direction: Array) -> int | None:
    """Return the nearest candidate of opposite polarity along an edge, within 15 degrees of it."""
    _, near = tree.query(candidates.position[centre], k=min(25, len(candidates.position)))
    for other in near[1:]:
        offset = candidates.position[other] - candidates.position[centre]
        if offset @ direction < np.cos(np.deg2rad(15.0)) * np.linalg.norm(offset):
            continue
        if abs(candidates.bright[other] @ candidates.bright[centre]) < 0.6:
            return int(other)
    return None
