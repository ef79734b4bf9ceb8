"""What an extension gains on views that it never saw: log score, level and area, with intervals by bootstrap."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

BLOCK_BINS = 10
"""Residuals of one block are kept together: their errors are not independent."""


def log_scores(residual: Array, valid: NDArray[np.bool_]) -> Array:
    """Return the Gaussian log score of each block, without its constant (views, block rows, block cols) [nats].

    Parameters
    ----------
    residual : ndarray (views, rows, cols)
        Standardised.
    valid : ndarray of bool (views, rows, cols)
    """
    square = np.where(valid, -0.5 * residual**2, 0.0)
    rows, cols = (-(-n // BLOCK_BINS) for n in square.shape[1:])
    padded = np.zeros((len(square), rows * BLOCK_BINS, cols * BLOCK_BINS))
    padded[:, : square.shape[1], : square.shape[2]] = square
    return np.asarray(padded.reshape(len(square), rows, BLOCK_BINS, cols, BLOCK_BINS).sum(axis=(2, 4)))


def bootstrap_sum(blocks: Array, *, level: float, count: int, rng: np.random.Generator) -> tuple[float, float, float]:
    """Return the sum over blocks (views, ...), and an interval by drawing views and, within them, blocks anew."""
    flat = blocks.reshape(len(blocks), -1)
    views, size = flat.shape
    found = np.empty(count)
    for k in range(count):
        chosen = rng.integers(0, views, views)
        places = rng.integers(0, size, (views, size))
        found[k] = flat[chosen[:, None], places].sum()
    tail = (1 - level) / 2
    lo, hi = np.quantile(found, [tail, 1 - tail])
    return float(flat.sum()), float(lo), float(hi)


def rmse(data: Array, predicted: Array) -> float:
    """Return the root mean square error [DN]."""
    return float(np.sqrt(np.mean((data - predicted) ** 2)))
