"""Linear features of residual maps: contrasts over views, cosines, smoothing, straight lines, rings and bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, vstack

Array = NDArray[Any]

COSINES = 5
"""Orders of the cosine basis along one axis."""

BANDS_MM = (-np.inf, -3.0, -2.0, -1.4, -1.0, -0.6, -0.3, 0.0, 0.3, 0.6, 1.0, 1.5, 2.2, 3.2, 4.7, 7.0, 10.0)
"""Borders of the bands of distance from the edge of contact [mm]."""


@dataclass(frozen=True)
class Contrasts:
    """Weighted means over views, each of unit variance where the residuals are white.

    Attributes
    ----------
    names : tuple of str
        ``mean``, ``voltage``, ``force``, ``time``, ``displacement`` over the press frames, and one for each other kind.
    weights : ndarray (contrasts, views)
    norm : ndarray (contrasts, rows, cols)
        Divided by it; 1 where nothing is valid.
    seen : ndarray (contrasts, rows, cols)
        1 where any view with weight is valid, else 0.
    """

    names: tuple[str, ...]
    weights: Array
    norm: Array
    seen: Array

    def maps(self, cube: Array) -> Array:
        """Return the contrasts' maps of cubes (draws, views, rows, cols): (draws, contrasts, rows, cols)."""
        flat = self.weights.astype(np.float32) @ cube.reshape(*cube.shape[:2], -1).astype(np.float32, copy=False)
        return np.asarray(flat.reshape(len(cube), *self.norm.shape) / self.norm.astype(np.float32))


def contrasts(kinds: tuple[str, ...], covariates: Mapping[str, Array], valid: NDArray[np.bool_]) -> Contrasts:
    """Return the contrasts that the views allow, each orthogonal to those before it.

    Parameters
    ----------
    kinds : tuple of str (views,)
    covariates : mapping of str to ndarray (views,)
    valid : ndarray of bool (views, rows, cols)
    """
    press = np.array([kind == "press" for kind in kinds])
    rows: list[Array] = []
    names: list[str] = []
    if press.any():
        rows.append(press / np.sqrt(press.sum()))
        names.append("mean")
    for key in ("voltage_V", "force_N", "time_s", "displacement_mm"):
        values = np.asarray(covariates.get(key, np.full(press.size, np.nan)), float)
        if not press.any() or not np.isfinite(values[press]).all():
            continue
        row = np.where(press, np.log1p(values - values[press].min()) if key == "time_s" else values, 0.0)
        whole = float(np.sqrt((row**2).sum()))
        for before in rows:
            row = row - (row @ before) * before
        size = float(np.sqrt((row**2).sum()))
        # What is left of a covariate that runs with another one is rounding.
        if size > 1e-2 * whole:
            rows.append(row / size)
            names.append(key.rsplit("_", 1)[0])
    for kind in dict.fromkeys(k for k in kinds if k != "press"):
        of_kind = np.array([k == kind for k in kinds])
        rows.append(of_kind / np.sqrt(of_kind.sum()))
        names.append(kind)
    weights = np.array(rows).reshape(len(rows), press.size)
    square = np.tensordot(weights**2, valid.astype(float), 1)
    return Contrasts(tuple(names), weights, np.sqrt(np.where(square > 0, square, 1.0)), (square > 0).astype(float))


def cosine_features(shape: tuple[int, int], orders: int = COSINES) -> tuple[Array, Array]:
    """Return orthonormal cosines along y (orders, rows) and x (orders, cols), as in the discrete cosine transform."""

    def along(n: int) -> Array:
        k = np.arange(min(orders, n))[:, None]
        wave = np.cos(np.pi * k * (np.arange(n) + 0.5) / n)
        return np.asarray(wave / np.sqrt((wave**2).sum(axis=1, keepdims=True)))

    return along(shape[0]), along(shape[1])


def smoothed(image: Array, sigma: float) -> Array:
    """Return an image (float32) smoothed by a Gaussian [bins], dark around; itself for 0."""
    if sigma == 0.0:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT))


def smoothed_size(seen: Array, sigma: float) -> Array:
    """Return the standard deviation that white noise, where ``seen`` is 1, has after :func:`smoothed`."""
    if sigma == 0.0:
        return np.ones(seen.shape, np.float32)
    point = np.zeros((8 * int(np.ceil(sigma)) + 1,) * 2, np.float32)
    point[point.shape[0] // 2, point.shape[1] // 2] = 1.0
    kernel = smoothed(point, sigma) ** 2
    power = cv2.filter2D(seen.astype(np.float32), -1, kernel, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(np.sqrt(np.maximum(power, 1e-3 * kernel.sum())))


def line_features(shape: tuple[int, int], angles: int = 24) -> csr_matrix:
    """Return sums along straight lines one bin wide over the square root of their length: (lines, rows * cols)."""
    rows, cols = shape
    y, x = np.mgrid[0:rows, 0:cols]
    y, x = y.ravel() - (rows - 1) / 2, x.ravel() - (cols - 1) / 2
    blocks = []
    for angle in np.pi * np.arange(angles) / angles:
        place = np.round(x * np.cos(angle) + y * np.sin(angle)).astype(int)
        place -= place.min()
        length = np.bincount(place)
        block = csr_matrix((1.0 / np.sqrt(length[place]), (place, np.arange(place.size))), (length.size, place.size))
        # Corners are cut by many short lines, which are but single bins.
        blocks.append(block[np.flatnonzero(length >= 0.3 * min(shape))])
    return vstack(blocks).tocsr()


def ring_features(values: Array, count: int) -> Array:
    """Return the number of each bin's class, ``count`` classes of equal occupation by a value; -1 where not finite."""
    finite = np.isfinite(values)
    if not finite.any():
        return np.full(values.shape, -1)
    borders = np.unique(np.quantile(values[finite], np.linspace(0, 1, count + 1)[1:-1]))
    return np.where(finite, np.searchsorted(borders, np.where(finite, values, 0.0), side="right"), -1)


def band_features(distance_mm: Array) -> Array:
    """Return the number of each bin's band of distance from the edge of contact; -1 where nothing touches."""
    number = np.digitize(distance_mm, BANDS_MM) - 1
    return np.where(np.isfinite(distance_mm), number, -1)
