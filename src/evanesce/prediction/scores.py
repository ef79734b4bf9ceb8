"""What an extension gains on views that it never saw: log score, level and area, with intervals by bootstrap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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


def area_error_percent(images: Sequence[Array], predicted: Sequence[Array], area: Callable[[Array], float]) -> float:
    """Return the mean absolute error of the area that the reference segmentation reads, over that of the data [%].

    Views whose measured area is nothing are left out; NaN if none is left.
    """
    errors = []
    for image, other in zip(images, predicted, strict=True):
        measured = area(image)
        if measured > 0:
            errors.append(abs(area(other) / measured - 1.0))
    return 100.0 * float(np.mean(errors)) if errors else float("nan")


def leave_one_out(rows: Array, residual: Array, deviations: Array, away: Array, groups: NDArray[np.int_]) -> Array:
    """Return each group's log predictive score, its parameters refitted without it, linear about the whole fit [nats].

    Parameters
    ----------
    rows : ndarray (parameters, bins)
        Whitened derivatives at the fit.
    residual : ndarray (bins,)
        Whitened, at the fit.
    deviations, away : ndarray (parameters,)
        Priors' standard deviations, and the fitted values' distance from the priors' means.
    groups : ndarray of int (bins,)
    """
    found = []
    precision = np.asarray(rows @ rows.T, float) + np.diag(1.0 / deviations**2)
    gradient = rows @ residual - away / deviations**2
    for group in np.unique(groups):
        mine = groups == group
        part = rows[:, mine]
        without = precision - part @ part.T
        covariance = np.linalg.inv(without)
        step = covariance @ (gradient - part @ residual[mine])
        left = residual[mine] - part.T @ step
        # Predictive covariance 1 + part' C part, by its k x k form.
        inner = np.linalg.inv(covariance) + part @ part.T
        along = part @ left
        square = float(left @ left) - float(along @ np.linalg.solve(inner, along))
        log_det = float(np.linalg.slogdet(inner)[1] + np.linalg.slogdet(covariance)[1])
        found.append(-0.5 * (square + log_det))
    return np.array(found)
