"""The soft spot of marks that explains most of what a model leaves: a film, a fingerprint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.criticism.features import smoothed

Array = NDArray[Any]

RADII_BINS = (3.0, 4.2, 6.0, 8.5, 12.0, 17.0, 24.0)
"""Of the spots that are tried, where they have fallen to exp(-1/2); smaller ones are marks, larger ones no spots."""


@dataclass(frozen=True)
class FoundBlot:
    """A spot.

    Attributes
    ----------
    middle : tuple of float
        (column, row), integer = a bin's middle.
    radius : float
        [bins].
    amount : float
        In its middle, in a bin [of the template's unit].
    penalty : float
        What the choice of the spot costs [nats].
    """

    middle: tuple[float, float]
    radius: float
    amount: float
    penalty: float


def brightest_blot(residual: Array, template: Array) -> FoundBlot | None:
    """Return the bright spot that explains most, None where that is not worth its choice.

    Parameters
    ----------
    residual, template : ndarray (views, rows, cols)
        Whitened; the template per unit of a mark in each bin.
    """
    product = np.einsum("vrc,vrc->rc", residual, template).astype(np.float32)
    information = np.einsum("vrc,vrc->rc", template, template).astype(np.float32)
    best, found = 0.0, (0, 0.0, 0.0)
    for radius in RADII_BINS:
        # Sums with weights exp(-r^2/2R^2), and with their squares, which are as wide as R over the root of 2.
        total = smoothed(product, radius) * 2 * np.pi * radius**2
        size = smoothed(information, radius / np.sqrt(2)) * np.pi * radius**2
        seen = (total > 0) & (size > 0)
        square = np.where(seen, total**2 / np.where(seen, size, 1.0), 0.0)
        k = int(np.argmax(square))
        if square.flat[k] > best:
            best, found = float(square.flat[k]), (k, radius, float(total.flat[k] / size.flat[k]))
    # Spots nearer than their radius are one and the same.
    number = sum(max(product.size / (2 * np.pi * radius**2), 1.0) for radius in RADII_BINS)
    penalty = float(np.log(number) + 0.5 * np.log1p(best))
    if 0.5 * best <= penalty:
        return None
    k, radius, amount = found
    return FoundBlot((float(k % product.shape[1]), float(k // product.shape[1])), radius, amount, penalty)
