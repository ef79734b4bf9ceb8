"""Linear algebra of the critic: whitened data, known directions taken off, scores, evidence.

All vectors are whitened: divided by the standard deviation of their bin. Nuisances with Gaussian priors are
marginalised exactly: the data's covariance is I + N' S N with N the nuisances' rows and S their prior variances, and
every inner product below is taken in its inverse, the ``metric``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Array = NDArray[Any]


@dataclass(frozen=True)
class Metric:
    """Inner product with nuisances marginalised.

    Attributes
    ----------
    rows : ndarray (q, d)
        Whitened derivative of the data by each nuisance, times its prior's standard deviation.
    factor : tuple
        Cholesky factor of 1 + rows rows'.
    """

    rows: Array
    factor: tuple[Array, bool]

    @classmethod
    def of(cls, rows: Array, deviations: Array) -> Metric:
        """Return the metric of nuisances (q, d) with prior standard deviations (q,)."""
        scaled = np.asarray(rows, float) * np.asarray(deviations, float)[:, None]
        return cls(scaled, linalg.cho_factor(np.eye(len(scaled)) + scaled @ scaled.T, lower=True))

    def project(self, vectors: Array) -> Array:
        """Return the metric times vectors (..., d): what no plausible nuisance explains of them."""
        if len(self.rows) == 0:
            return np.asarray(vectors, float)
        inner = np.asarray(vectors) @ self.rows.T
        return np.asarray(vectors - linalg.cho_solve(self.factor, inner.T).T @ self.rows)

    def whiten(self, vectors: Array) -> Array:
        """Return vectors (..., d) whose squares sum to those of ``vectors`` in this metric: its square root."""
        if len(self.rows) == 0:
            return np.asarray(vectors, float)
        size2, turn = np.linalg.eigh(self.rows @ self.rows.T)
        size2 = np.maximum(size2, 1e-300)
        taken = -np.expm1(-0.5 * np.log1p(size2)) / size2  # (1 - 1/sqrt(1 + s^2)) / s^2
        along = np.asarray(vectors) @ self.rows.T @ turn
        return np.asarray(vectors - (along * taken) @ turn.T @ self.rows)

    def gram(self, left: Array, right: Array | None = None) -> Array:
        """Return inner products (n, m) of vectors (n, d) and (m, d)."""
        return np.asarray(self.project(left) @ (left if right is None else right).T)

    def nuisances_of(self, vector: Array) -> Array:
        """Return the nuisances' most probable values, over their prior standard deviations, given a data vector."""
        return np.asarray(linalg.cho_solve(self.factor, self.rows @ vector))


@dataclass(frozen=True)
class Score:
    """Of one candidate against the base model.

    Attributes
    ----------
    statistic : float
        Squared score: drop of the squared residual if the candidate were free [1].
    degrees : int
        Of freedom.
    estimate : ndarray (k,)
        Most probable parameters under their priors.
    covariance : ndarray (k, k)
        Posterior.
    log_bayes : float
        Logarithm of the Bayes factor against the base model.
    """

    statistic: float
    degrees: int
    estimate: Array
    covariance: Array
    log_bayes: float


def score(information: Array, gradient: Array, deviations: Array, inflation: float = 1.0) -> Score:
    """Return a candidate's score test and its linear (Laplace) evidence.

    Parameters
    ----------
    information : ndarray (k, k)
        Metric inner products of the candidate's columns.
    gradient : ndarray (k,)
        Of the columns with the residual.
    deviations : ndarray (k,)
        Priors' standard deviations, about zero.
    inflation : float
        Variance of the gradient under the null over ``information``: correlated noise makes it exceed 1, and the
        likelihood is tempered by it.
    """
    info, grad = np.atleast_2d(information) / inflation, np.atleast_1d(gradient) / inflation
    values, vectors = np.linalg.eigh(info)
    good = values > 1e-9 * max(values.max(), 1e-300)
    along = vectors[:, good].T @ grad
    statistic = float((along**2 / values[good]).sum())
    precision = np.diag(1.0 / np.asarray(deviations, float) ** 2)
    covariance = np.linalg.inv(info + precision)
    estimate = covariance @ grad
    scaled = np.eye(len(grad)) + info * np.outer(deviations, deviations)
    log_bayes = 0.5 * float(grad @ estimate) - 0.5 * float(np.linalg.slogdet(scaled)[1])
    return Score(statistic, int(good.sum()), estimate, covariance, log_bayes)


def distance2(signal: Array, metric: Metric, columns: Array, deviations: Array | None = None) -> float:
    """Return the least squared distance of a signal (d,) from the span of columns (k, d), nuisances refitted.

    With ``deviations`` the columns' amplitudes keep to their priors.
    """
    projected = metric.project(signal)
    whole = float(projected @ signal)
    if len(columns) == 0:
        return whole
    info, grad = metric.gram(columns), columns @ projected
    if deviations is not None:
        info = info + np.diag(1.0 / np.asarray(deviations, float) ** 2)
    return max(whole - float(grad @ np.linalg.lstsq(info, grad, rcond=None)[0]), 0.0)
