"""Linear algebra of the critic: whitened data, known directions taken off, scores, evidence.

All vectors are whitened: divided by the standard deviation of their bin. Nuisances with Gaussian priors are
marginalised exactly: the data's covariance is I + N' S N with N the nuisances' rows and S their prior variances, and
every inner product below is taken in its inverse, the ``metric``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Array = NDArray[Any]
Factor = tuple[Array, bool]
"""Of Cholesky."""

CHUNK = 16_384
"""Bins at a time: rows are kept in single precision, and what their products leave of each other is small."""


@dataclass(frozen=True)
class CovarianceRows:
    """Rows of a covariance, the sum of their outer products; many are zero but for one stretch of the data.

    Attributes
    ----------
    whole : ndarray (n, d)
    stretches : mapping of int to ndarray (m, length)
        Rows over one stretch alone, by its first place; stretches do not overlap.
    """

    whole: Array
    stretches: Mapping[int, Array] = field(default_factory=dict)

    @classmethod
    def joined(cls, *parts: CovarianceRows | Array) -> CovarianceRows:
        """Return the rows of several parts, arrays (k, d) among them."""
        every = [part if isinstance(part, CovarianceRows) else cls(part) for part in parts]
        by_start: dict[int, list[Array]] = {}
        for part in every:
            for start, rows in part.stretches.items():
                by_start.setdefault(start, []).append(rows)
        stretches = {start: np.concatenate(rows) for start, rows in by_start.items()}
        return cls(np.concatenate([part.whole for part in every]), stretches)

    def times(self, factor: float) -> CovarianceRows:
        """Return all rows times a factor."""
        factor = self.whole.dtype.type(factor)
        return CovarianceRows(self.whole * factor, {start: rows * factor for start, rows in self.stretches.items()})

    def __len__(self) -> int:
        return len(self.whole) + sum(len(rows) for rows in self.stretches.values())

    def dense(self) -> Array:
        """Return them as one array (k, d)."""
        found = np.zeros((len(self), self.whole.shape[1]), self.whole.dtype)
        found[: len(self.whole)] = self.whole
        at = len(self.whole)
        for start, rows in self.stretches.items():
            found[at : at + len(rows), start : start + rows.shape[1]] = rows
            at += len(rows)
        return found

    def products(self, vectors: Array) -> Array:
        """Return inner products (n, k) with vectors (n, d)."""
        parts = [vectors[:, start : start + rows.shape[1]] @ rows.T for start, rows in self.stretches.items()]
        return np.concatenate([products(vectors, self.whole), *parts], axis=1)


def products(left: Array, right: Array) -> Array:
    """Return inner products (n, m) of rows (n, d) and (m, d) in double precision, whatever that of the rows is."""
    total = np.zeros((len(left), len(right)))
    for start in range(0, left.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        total += left[:, part].astype(float) @ right[:, part].astype(float).T
    return total


@dataclass(frozen=True)
class Metric:
    """Inner product with nuisances marginalised.

    Those that touch one stretch of the data alone are marginalised first, stretch by stretch: P = (1 + A'A)^-1. With
    the others' rows R the metric is P - P R' (1 + R P R')^-1 R P (Woodbury).

    Attributes
    ----------
    rows : ndarray (q, d)
        Whitened derivative of the data by each other nuisance, times its prior's standard deviation.
    factor : tuple
        Cholesky factor of 1 + R P R'.
    stretches : mapping of int to tuple (rows (m, length), factor)
        By its first place: A, and the Cholesky factor of 1 + A A'.
    """

    rows: Array
    factor: Factor
    stretches: Mapping[int, tuple[Array, Factor]] = field(default_factory=dict)

    @classmethod
    def of(cls, rows: Array, deviations: Array) -> Metric:
        """Return the metric of nuisances (q, d) with prior standard deviations (q,)."""
        return cls._of(np.asarray(rows, float) * np.asarray(deviations, float)[:, None], {})

    @classmethod
    def _of(cls, rows: Array, stretches: Mapping[int, Array]) -> Metric:
        inner, factors = products(rows, rows), {}
        for start, own in stretches.items():
            factors[start] = own, linalg.cho_factor(np.eye(len(own)) + products(own, own), lower=True)
            cross = products(own, rows[:, start : start + own.shape[1]])
            inner -= cross.T @ linalg.cho_solve(factors[start][1], cross)
        return cls(rows, linalg.cho_factor(np.eye(len(rows)) + inner, lower=True), factors)

    def with_rows(self, rows: CovarianceRows | Array) -> Metric:
        """Return the metric with more nuisances, of unit prior standard deviation; as precise as those.

        Parameters
        ----------
        rows : CovarianceRows or ndarray (k, d)
        """
        own = {start: known[0] for start, known in self.stretches.items()}
        more = CovarianceRows.joined(rows)
        every = CovarianceRows.joined(CovarianceRows(self.rows.astype(more.whole.dtype), own), more)
        return Metric._of(every.whole, every.stretches)

    @property
    def log_det(self) -> float:
        """Log determinant of the covariance of noise and nuisances."""
        factors = [self.factor, *(factor for _, factor in self.stretches.values())]
        return float(sum(2.0 * np.log(np.diag(factor[0])).sum() for factor in factors))

    def project(self, vectors: Array) -> Array:
        """Return the metric times vectors (..., d): what no plausible nuisance explains of them."""
        left = self._alone(np.asarray(vectors, float), root=False)
        if len(self.rows) == 0:
            return left
        flat = left.reshape(-1, left.shape[-1])
        along = self._combined(linalg.cho_solve(self.factor, products(flat, self.rows).T).T)
        return left - self._alone(along, root=False).reshape(left.shape)

    def whiten(self, vectors: Array) -> Array:
        """Return vectors (..., d) whose squares sum to those of ``vectors`` in this metric."""
        left = self._alone(np.asarray(vectors, float), root=True)
        if len(self.rows) == 0:
            return left
        # 1 + R P R' = L L', of which the root of P has taken its own part.
        lower = np.tril(self.factor[0])
        size2, turn = np.linalg.eigh(lower @ lower.T - np.eye(len(lower)))
        taken = _taken(size2)
        once = self._alone(left, root=True)
        flat = once.reshape(-1, once.shape[-1])
        along = self._combined((products(flat, self.rows) @ turn * taken) @ turn.T)
        return left - self._alone(along, root=True).reshape(left.shape)

    def gram(self, left: Array, right: Array | None = None) -> Array:
        """Return inner products (n, m) of vectors (n, d) and (m, d)."""
        return np.asarray(self.project(left) @ (left if right is None else right).T)

    def _alone(self, vectors: Array, *, root: bool) -> Array:
        """Return vectors (..., d) times P, or its symmetric root."""
        if not self.stretches:
            return vectors
        found = vectors.copy()
        for start, (rows, factor) in self.stretches.items():
            part = slice(start, start + rows.shape[1])
            along = vectors[..., part] @ rows.T
            if root:
                lower = np.tril(factor[0])
                size2, turn = np.linalg.eigh(lower @ lower.T - np.eye(len(lower)))
                found[..., part] -= (along @ turn * _taken(size2)) @ turn.T @ rows
            else:
                found[..., part] -= (
                    linalg.cho_solve(factor, along.reshape(-1, len(rows)).T).T.reshape(along.shape) @ rows
                )
        return found

    def _combined(self, weights: Array) -> Array:
        """Return sums (n, d) of the rows, times weights (n, q)."""
        starts = range(0, self.rows.shape[1], CHUNK)
        parts = [weights @ self.rows[:, start : start + CHUNK].astype(float) for start in starts]
        return np.concatenate(parts, axis=1)


def _taken(size2: Array) -> Array:
    """Return (1 - 1/sqrt(1 + s^2)) / s^2 of squares s^2: what a root of 1/(1 + s^2) takes off, over s^2."""
    size2 = np.maximum(size2, 1e-300)
    return np.asarray(-np.expm1(-0.5 * np.log1p(size2)) / size2)
