"""The straight line of marks that explains most of what a model leaves: a scratch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

Array = NDArray[Any]

DIRECTIONS = 24
LENGTHS = (6.0, 12.0, 24.0, 48.0)
"""Of the lines that are tried [bins]."""
POINTS = 128
"""That stand for a line."""
ROUNDS = 3
BEST = 2
"""Coarse lines of each length that are refined."""


@dataclass(frozen=True)
class FoundLine:
    """A line.

    Attributes
    ----------
    ends : tuple of tuple of float
        (column, row) of both, integer = a bin's middle.
    amount : float
        All of it together [of the template's unit].
    penalty : float
        What the choice of the line costs [nats].
    """

    ends: tuple[tuple[float, float], tuple[float, float]]
    amount: float
    penalty: float


def brightest_line(residual: Array, template: Array) -> FoundLine | None:
    """Return the line of marks that explains most, None where that is not worth its choice.

    Parameters
    ----------
    residual, template : ndarray (views, rows, cols)
        Whitened; the template per unit of a mark in each bin.
    """
    product = np.einsum("vrc,vrc->rc", residual, template)
    information = np.einsum("vrc,vrc->rc", template, template)
    rows, cols = product.shape
    angles = np.arange(DIRECTIONS) * np.pi / DIRECTIONS

    # All lines of one direction and length at once, moved over the bins.
    starts: list[tuple[float, ...]] = []
    for length in LENGTHS:
        tried = []
        for angle in angles:
            worth = _slid(product, information, angle, length)
            k = int(np.argmax(worth))
            tried.append((float(worth.flat[k]), (float(k % cols), float(k // cols), float(angle), length)))
        starts += [start for _, start in sorted(tried, key=lambda entry: -entry[0])[:BEST]]
    worth_of = _worth(product, information)
    best = max((_refined(worth_of, start) for start in starts), key=lambda at: worth_of(at)[0])
    square, amount = worth_of(best)
    # A line among those that were tried, and four numbers refined within their steps.
    penalty = float(np.log(rows * cols * DIRECTIONS * len(LENGTHS)) + 0.5 * np.log1p(square))
    if 0.5 * square <= penalty or amount <= 0:
        return None
    u, v, angle, length = best
    along = 0.5 * length * np.array([np.cos(angle), np.sin(angle)])
    first, last = (float(u - along[0]), float(v - along[1])), (float(u + along[0]), float(v + along[1]))
    return FoundLine((first, last), amount, penalty)


def _refined(worth_of: Callable[[Any], tuple[float, float]], start: tuple[float, ...]) -> Array:
    """Return the line near a start that is worth most; the simplex is set up anew as it tends to shrink too early."""
    at = np.array(start)
    for _ in range(ROUNDS):
        steps = np.diag([0.7, 0.7, np.pi / DIRECTIONS / 2, 0.25 * at[3]])
        simplex = np.array([at, *(at + step for step in steps)])
        options = {"initial_simplex": simplex, "maxiter": 150, "xatol": 0.02, "fatol": 0.02}
        at = optimize.minimize(lambda x: -worth_of(x)[0], at, method="Nelder-Mead", options=options).x
    return at


def _points(u: float, v: float, angle: float, length: float, count: int) -> tuple[Array, Array]:
    s = ((np.arange(count) + 0.5) / count - 0.5) * length
    return u + s * np.cos(angle), v + s * np.sin(angle)


def _slid(product: Array, information: Array, angle: float, length: float) -> Array:
    """Return the squared significance (rows, cols) of a bright line about each bin; 0 where it is dark."""
    u, v = _points(0.0, 0.0, angle, length, round(2 * length))
    places, counts = np.unique(np.round(np.stack([v, u])).astype(int), axis=1, return_counts=True)
    weights = counts / counts.sum()
    reach = int(np.abs(places).max())
    s, i = np.pad(product, reach), np.pad(information, reach)
    rows, cols = product.shape
    total, size = np.zeros((rows, cols)), np.zeros((rows, cols))
    for (dv, du), w in zip(places.T, weights, strict=True):
        box = slice(reach + dv, reach + dv + rows), slice(reach + du, reach + du + cols)
        total += w * s[box]
        size += w**2 * i[box]
    return np.where((total > 0) & (size > 0), total**2 / np.where(size > 0, size, 1.0), 0.0)


def _worth(product: Array, information: Array) -> Callable[[Any], tuple[float, float]]:
    """Return a function of (u, v, angle, length) that gives a line's squared significance and its amount."""
    rows, cols = product.shape

    def found(at: Any) -> tuple[float, float]:
        # As many points for any length: how much a line is worth then has no steps.
        u, v = _points(at[0], at[1], at[2], at[3], POINTS)
        col, row = np.floor(u).astype(int), np.floor(v).astype(int)
        weights: dict[int, float] = {}
        for dv, du in ((0, 0), (0, 1), (1, 0), (1, 1)):
            part = np.abs(1 - dv - (v - row)) * np.abs(1 - du - (u - col)) / len(u)
            inside = (row + dv >= 0) & (row + dv < rows) & (col + du >= 0) & (col + du < cols)
            for k, w in zip(((row + dv) * cols + col + du)[inside], part[inside], strict=True):
                weights[int(k)] = weights.get(int(k), 0.0) + float(w)
        if not weights:
            return 0.0, 0.0
        bins, w = np.array(list(weights)), np.array(list(weights.values()))
        total, size = float(w @ product.flat[bins]), float(w**2 @ information.flat[bins])
        if size <= 0 or total <= 0:
            return 0.0, 0.0
        return total**2 / size, total / size

    return found
