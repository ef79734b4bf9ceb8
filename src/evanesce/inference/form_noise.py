"""Noise along the forms of causes, measured by draws of it.

A covariance of few parameters describes a codec's noise bin by bin and band by band. Along the forms of causes, which
are few directions of all, what the same draws scatter is known by itself; where that is more, the rest is added.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, stats

Array = NDArray[Any]

LEAST_DIRECTION = 0.1
"""Singular value of unit forms below which a direction is left out: forms have less than that in it."""

ROWS = 60
"""Directions whose noise has a row of its own; the rest have the largest noise of any of them."""
LEAST_DRAWS = 6
"""Fewer say nothing of each other."""
SHRINKAGES = (0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9)
"""Shares of a covariance of few draws that are tried in place of it by variances alone."""
ALIKE = 7
"""Directions, in the order of how much of the forms lies in them, over which variances are averaged."""


@dataclass(frozen=True)
class FormNoise:
    """What noise has along forms, in units of what it was believed to have.

    Attributes
    ----------
    variance : float
        Of all directions but a few [1].
    factors : ndarray (k, forms)
        Of the few: sums of forms, times these, are rows of noise, each of unit standard deviation once data are divided
        by the root of ``variance``.
    """

    variance: float
    factors: Array


def noise_along(gram: Array, along: Array) -> FormNoise:
    """Return the noise along forms by the covariance of draws in their span; never less than is believed.

    Parameters
    ----------
    gram : ndarray (forms, forms)
        Inner products of whitened forms, nuisances marginalised.
    along : ndarray (forms, draws)
        Of the forms with whitened draws of the noise that have no mean.
    """
    size = np.sqrt(np.diag(gram))
    shown = np.flatnonzero(size > 1e-6 * size.max(initial=1e-300))
    if shown.size == 0 or along.shape[1] < LEAST_DRAWS:
        return FormNoise(1.0, np.zeros((0, len(gram))))
    unit = gram[np.ix_(shown, shown)] / np.outer(size[shown], size[shown])
    squares, turn = np.linalg.eigh(unit)
    kept = squares > LEAST_DIRECTION**2
    to_forms = (turn[:, kept] / np.sqrt(squares[kept])).T / size[shown]
    variances, axes = np.linalg.eigh(predictive_covariance(to_forms @ along[shown]))
    even = max(float(np.sort(variances)[::-1][min(ROWS, len(variances) - 1)]), 1.0)
    more = variances > even
    factors = np.zeros((int(more.sum()), len(gram)))
    factors[:, shown] = np.sqrt(variances[more] / even - 1.0)[:, None] * (axes[:, more].T @ to_forms)
    return FormNoise(even, factors)


def predictive_covariance(samples: Array) -> Array:
    """Return the covariance (r, r) that a further sample has, as samples (r, n) foretell each other.

    That of few samples is too small along what they lack and too large along what they have: a share of it is replaced,
    so that each sample is likeliest by the others (leave-one-out). It is enlarged until its normal law holds the
    largest of each sample's coordinates as well: errors of whole regions come and go, and causes are judged by the
    direction that stands out most.

    Parameters
    ----------
    samples : ndarray (r, n)
    """
    size, count = samples.shape
    usual_largest = float(stats.norm.isf(0.5 * (1.0 - 0.5 ** (1.0 / size))))
    found = []
    for share in SHRINKAGES:
        squares, largest, logs = [], [], []
        for left_out in range(count):
            rest = np.delete(samples, left_out, axis=1)
            values, axes = np.linalg.eigh(_shrunk(rest, share))
            standard = (axes.T @ (samples[:, left_out] - rest.mean(axis=1))) ** 2 / values
            squares.append(float(standard.mean()))
            largest.append(float(standard.max()))
            logs.append(float(np.log(values).sum()))
        scale = float(np.mean(squares))
        tail = float(np.mean(np.sqrt(largest))) / usual_largest
        found.append((size * np.log(scale) + float(np.mean(logs)), max(scale, tail**2), share))
    _, scale, share = min(found)
    return np.asarray(scale * _shrunk(samples, share))


def _shrunk(samples: Array, share: float) -> Array:
    """Return the covariance of samples (r, n), a share of it replaced by variances alone, smooth over directions."""
    about = samples - samples.mean(axis=1, keepdims=True)
    covariance = about @ about.T / (samples.shape[1] - 1)
    alone = ndimage.uniform_filter1d(np.diag(covariance), ALIKE, mode="nearest")
    return np.asarray((1.0 - share) * covariance + share * np.diag(alone))
