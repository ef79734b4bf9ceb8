"""Noise that is correlated between places and between views, and how it is made white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Array = NDArray[Any]

RINGS = 12
"""Of as many frequencies each, over which a spectrum is averaged."""
FLAT = 4.0
"""Standard errors within which each ring of white noise stays."""


@dataclass(frozen=True)
class Correlation:
    """Noise that hangs together, over its own standard deviation.

    Its covariance is the product of one between views, the same everywhere, and one between places, by distance alone.

    Attributes
    ----------
    views : ndarray (views, views)
        Correlation between views.
    spectrum : ndarray (views, rows, cols)
        Variance of the coefficients of each view's cosine transform (type 2, orthonormal); independent bins have 1.
    """

    views: Array
    spectrum: Array

    @property
    def size(self) -> float:
        """Geometric mean of the standard deviations of independent combinations of views [1]."""
        return float(np.exp(0.5 * np.linalg.slogdet(self.views)[1] / len(self.views)))

    def whitened(self, cube: Array, chosen: Sequence[int]) -> Array:
        """Return noise (chosen views, rows, cols) made white, each value as near to its own place and view as can be.

        By symmetric roots of the inverse covariance (Kessy, Lewin and Strimmer, 2018).
        """
        waves = fft.dctn(cube, axes=(1, 2), norm="ortho") / np.sqrt(self.spectrum[list(chosen)])
        waves = np.tensordot(_root(self.views[np.ix_(chosen, chosen)], -0.5), waves, 1)
        return np.asarray(fft.idctn(waves, axes=(1, 2), norm="ortho"))

    def scaled(self, chosen: Sequence[int], covariance: Array) -> Correlation:
        """Return it with the variance of some views as large as was found; other views get the mean factor.

        Combinations of views keep the variance that they have where less was found.

        Parameters
        ----------
        chosen : sequence of int
        covariance : ndarray (chosen views, chosen views)
            Between the whitened views.
        """
        size, modes = np.linalg.eigh(covariance)
        size = np.maximum(size, 1.0)
        root = np.sqrt(float(np.mean(size))) * np.eye(len(self.views))
        known = _root(self.views[np.ix_(chosen, chosen)], 0.5)
        root[np.ix_(chosen, chosen)] = known @ ((modes * np.sqrt(size)) @ modes.T) @ np.linalg.inv(known)
        return replace(self, views=root @ self.views @ root.T)


def of_fields(fields: Array, views: int) -> Correlation | None:
    """Return the correlation between places that fields of noise show, the same in all views; None if they show none.

    A lens or sensor that low-passes its noise leaves each bin as it is known, and sums over many bins worse known than
    of independent ones: smooth fields of noise were taken for something unknown.

    Parameters
    ----------
    fields : ndarray (fields, rows, cols)
        Of unit variance.
    views : int
        How many.
    """
    rows, cols = fields.shape[1:]
    power = (fft.dctn(fields, axes=(1, 2), norm="ortho") ** 2).mean(axis=0)
    frequency = np.hypot(np.arange(rows)[:, None] / rows, np.arange(cols) / cols)
    borders = np.quantile(frequency, np.linspace(0.0, 1.0, RINGS + 1)[1:-1])
    ring = np.searchsorted(borders, frequency)
    count = np.bincount(ring.ravel())
    mean = np.bincount(ring.ravel(), power.ravel()) / count
    centre = np.bincount(ring.ravel(), frequency.ravel()) / count
    mean = mean / float(power.mean())
    if np.all(np.abs(mean - 1.0) < FLAT * np.sqrt(2.0 / (count * len(fields)))):
        return None
    spectrum = np.interp(frequency, centre, mean)
    return Correlation(np.eye(views), np.broadcast_to(spectrum, (views, rows, cols)))


def _root(matrix: Array, power: float) -> Array:
    size, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * size**power) @ vectors.T)
