"""Noise along the forms of causes, measured by draws of it.

A covariance of few parameters describes a codec's noise bin by bin and band by band. Along the forms of causes, which
are few directions of all, what the same draws scatter is known by itself; where that is more, the rest is added.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize

Array = NDArray[Any]
Evidence = Callable[[Array, Array], float]

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
MOST_WIDENED = 100.0
"""Times its variance up to which noise is widened."""


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

    def marginalised(self, gram: Array, along: Array) -> tuple[Array, Array]:
        """Return inner products of forms, and theirs with data, in the metric of this noise.

        Parameters
        ----------
        gram : ndarray (forms, forms)
            In the metric of what noise was believed to be.
        along : ndarray (forms,)
        """
        inner, to = gram / self.variance, along / self.variance
        rows = self.factors @ inner
        weights = np.linalg.solve(np.eye(len(rows)) + rows @ self.factors.T, np.column_stack([rows, self.factors @ to]))
        return inner - rows.T @ weights[:, :-1], to - rows.T @ weights[:, -1]


def noise_along(gram: Array, along: Array, evidence: Evidence, kinds: Sequence[Hashable] = ()) -> FormNoise:
    """Return the noise along forms by the covariance of draws in their span; never less than is believed.

    Noise of a codec is not normal, and few draws show where it is largest. So the covariance is widened until a draw,
    judged by those of other kinds, is evidence for nothing: a Bayes factor has a mean of 1 where there is nothing to
    find, and the data's noise is of no kind that was drawn.

    Parameters
    ----------
    gram : ndarray (forms, forms)
        Inner products of whitened forms, nuisances marginalised.
    along : ndarray (forms, draws)
        Of the forms with whitened draws of the noise that have no mean.
    evidence : callable
        ``evidence(gram, along (forms,)) -> float``: log Bayes factor of all causes over none, by inner products in a
        metric [nats].
    kinds : sequence, optional
        Of each draw. Without them, or of one kind alone, draws are judged by all others.
    """
    size, count = np.sqrt(np.diag(gram)), along.shape[1]
    shown = np.flatnonzero(size > 1e-6 * size.max(initial=1e-300))
    if shown.size == 0 or count < LEAST_DRAWS:
        return FormNoise(1.0, np.zeros((0, len(gram))))
    unit = gram[np.ix_(shown, shown)] / np.outer(size[shown], size[shown])
    squares, turn = np.linalg.eigh(unit)
    kept = squares > LEAST_DIRECTION**2
    to_forms = np.zeros((int(kept.sum()), len(gram)))
    to_forms[:, shown] = (turn[:, kept] / np.sqrt(squares[kept])).T / size[shown]
    samples = to_forms @ along
    folds = _folds(kinds, count)
    scale, share = _most_predictive(samples, folds)
    by_others = []
    for fold in folds:
        others = _along(to_forms, scale * _shrunk(np.delete(samples, fold, axis=1), share))
        by_others += [others.marginalised(gram, along[:, drawn]) for drawn in fold]
    widened = widening(lambda times: [evidence(inner / times, to / times) for inner, to in by_others])
    found = _along(to_forms, scale * _shrunk(samples, share))
    return replace(found, variance=found.variance * widened)


def widening(evidence: Callable[[float], Sequence[float]]) -> float:
    """Return by how much variance has to grow, at least 1, for noise to be evidence for nothing.

    Parameters
    ----------
    evidence : callable
        ``evidence(times) -> log Bayes factors`` of what is judged by so many times the variance and was drawn as noise.
    """

    def mean_factor(times: float) -> float:
        each = evidence(times)
        return float(np.logaddexp.reduce(each) - np.log(len(each)))

    if mean_factor(1.0) <= 0.0:
        return 1.0
    if mean_factor(MOST_WIDENED) > 0.0:
        return MOST_WIDENED
    return float(optimize.brentq(mean_factor, 1.0, MOST_WIDENED, xtol=0.02))


def _along(to_forms: Array, covariance: Array) -> FormNoise:
    """Return noise of a covariance (r, r) in coordinates that are sums of forms (r, forms)."""
    variances, axes = np.linalg.eigh(covariance)
    even = max(float(np.sort(variances)[::-1][min(ROWS, len(variances) - 1)]), 1.0)
    more = variances > even
    return FormNoise(even, np.sqrt(variances[more] / even - 1.0)[:, None] * (axes[:, more].T @ to_forms))


def _folds(kinds: Sequence[Hashable], count: int) -> list[list[int]]:
    """Return the numbers of draws that are left out together: those of a kind, or each by itself."""
    folds = [[k for k, kind in enumerate(kinds) if kind == one] for one in dict.fromkeys(kinds)]
    left = count - max((len(fold) for fold in folds), default=count)
    return folds if left >= LEAST_DRAWS else [[k] for k in range(count)]


def _most_predictive(samples: Array, folds: Sequence[Sequence[int]]) -> tuple[float, float]:
    """Return the scale of the covariance of samples (r, n), and the share of it that is replaced.

    That of few samples is too small along what they lack and too large along what they have: a share of it is replaced,
    so that each fold of samples is likeliest by the others.
    """
    size = len(samples)
    squares, logs = np.zeros((len(SHRINKAGES), 0)), np.zeros((len(SHRINKAGES), 0))
    for fold in folds:
        rest = np.delete(samples, fold, axis=1)
        about, away = rest - rest.mean(axis=1, keepdims=True), samples[:, fold] - rest.mean(axis=1, keepdims=True)
        alone = _alone(about)
        # As many rows as samples beside a diagonal: no matrix of all directions has to be turned around.
        between, to = about.T @ (about / alone[:, None]), about.T @ (away / alone[:, None])
        own, each = (away**2 / alone[:, None]).sum(axis=0), []
        for share in SHRINKAGES:
            weight = (1.0 - share) / (share * (rest.shape[1] - 1))
            inner = np.eye(len(between)) + weight * between
            square = (own - weight * (to * np.linalg.solve(inner, to)).sum(axis=0)) / (share * size)
            each.append((square, size * np.log(share) + np.log(alone).sum() + np.linalg.slogdet(inner)[1]))
        squares = np.column_stack([squares, [square for square, _ in each]])
        logs = np.column_stack([logs, [[log] * len(fold) for _, log in each]])
    scale = squares.mean(axis=1)
    best = int(np.argmin(size * np.log(scale) + logs.mean(axis=1)))
    return float(scale[best]), SHRINKAGES[best]


def _alone(about: Array) -> Array:
    """Return the variances (r,) of samples (r, n) less their mean, smooth over directions."""
    variances = (about**2).sum(axis=1) / (about.shape[1] - 1)
    return np.asarray(ndimage.uniform_filter1d(variances, ALIKE, mode="nearest"))


def _shrunk(samples: Array, share: float) -> Array:
    """Return the covariance of samples (r, n), a share of it replaced by variances alone, smooth over directions."""
    about = samples - samples.mean(axis=1, keepdims=True)
    covariance = about @ about.T / (samples.shape[1] - 1)
    return np.asarray((1.0 - share) * covariance + share * np.diag(_alone(about)))
