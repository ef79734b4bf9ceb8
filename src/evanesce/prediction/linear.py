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

    def with_rows(self, rows: Array) -> Metric:
        """Return the metric with more nuisances (k, d), of unit prior standard deviation."""
        every = np.concatenate([self.rows, rows])
        return Metric.of(every, np.ones(len(every)))

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
