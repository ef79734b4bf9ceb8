"""Where the fine model was evaluated, and how far a point may be from there for what it added to be kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

STAYS = 0.3
"""Standard deviations, of all bins together, up to which what the fine model adds may change unseen: the fine model
itself is off by 2 to 3."""
UNSEEN = 0.01
"""Share of what a model leaves unexplained, in amplitude, up to which what the fine model adds may change as well."""
KEEP = 4
"""Evaluations that are kept, of ten megabytes each."""


@dataclass(frozen=True)
class Evaluated:
    """What the fine model added at a point.

    Attributes
    ----------
    coarse : ndarray (views, rows, cols)
        Bins of the coarse prediction there [DN].
    added : ndarray of float32 (views, pixel rows, pixel cols)
        To its frames [DN].
    correction : ndarray (views, rows, cols)
        To its bins [DN].
    discretisation : ndarray (views, rows, cols)
        Part of it that comes from extrapolation to finer pixels [DN].
    """

    coarse: Array
    added: Array
    correction: Array
    discretisation: Array


class Anchors:
    """Evaluations of the fine model for some views.

    What it adds changes in proportion to the coarse prediction, by a rate that the evaluations themselves show: a
    point is evaluated anew only where, by the largest rate seen, the addition would have changed by more than
    :data:`STAYS`, or by a hundredth of what is not explained anyway, and where it lies farther away than any two points
    that showed a rate.

    Parameters
    ----------
    size : callable
        ``size(bins (views, rows, cols)) -> float``: root of the sum of squares over the noise.
    """

    def __init__(self, size: Callable[[Array], float]) -> None:
        self._size = size
        self._kept: list[Evaluated] = []
        self._rate, self._reach = 0.0, 0.0

    def at(self, coarse: Array, evaluate: Callable[[], Evaluated], unexplained: float = 0.0) -> Evaluated:
        """Return what the fine model adds where the coarse one predicts some bins: kept, or evaluated.

        Parameters
        ----------
        coarse : ndarray (views, rows, cols)
            [DN].
        evaluate : callable
            Evaluates the fine model at that point.
        unexplained : float
            Root of the sum of squares over the noise that a fit left beyond noise's.
        """
        stays = max(STAYS, UNSEEN * unexplained)
        if self._kept:
            away = [self._size(coarse - one.coarse) for one in self._kept]
            nearest = int(np.argmin(away))
            if away[nearest] <= self._reach and self._rate * away[nearest] < stays:
                return self._kept[nearest]
        made = evaluate()
        if self._kept:
            change = self._size(made.correction - self._kept[nearest].correction)
            self._rate = max(self._rate, change / away[nearest])
            self._reach = max(self._reach, away[nearest])
        self._kept = [*self._kept, made][-KEEP:]
        return made

    def stay(self, coarse: Array, found: Evaluated) -> None:
        """Take what the fine model added somewhere for what it adds where the coarse one predicts other bins.

        Parameters
        ----------
        coarse : ndarray (views, rows, cols)
            [DN].
        found : Evaluated
        """
        self._kept = [*self._kept, replace(found, coarse=coarse)][-KEEP:]
