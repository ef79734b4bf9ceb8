"""Corners that no lens explains: found where a finger's edge, glare or a speck drew another corner.

Least squares lets a handful of such corners pull a coefficient by standard errors. They are left out by a rule: a
corner that misses the fit by more than ``OUTLIER_DEVIATIONS`` of its own view's robust standard deviation. Among
corners with Gaussian errors in x and y one in 65 million lies so far off (exp(-6^2 / 2)), so that what the rule takes
is none of them. The fit is repeated without them until their number no longer changes: a gross miss bends the first
fit, and hides smaller ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from evanesce.measurement.calibration.planar import BoardFit
from evanesce.measurement.calibration.points import BoardView

Array = NDArray[np.float64]
Fit = TypeVar("Fit", bound=BoardFit)

OUTLIER_DEVIATIONS = 6.0
"""Robust standard deviations of its view beyond which a corner is left out."""

MAX_SHARE = 0.2
"""Share of a view's corners that may be left out: where more miss, it is the view that does not fit."""

ROUNDS = 10
RAYLEIGH_MEDIAN = float(np.sqrt(2 * np.log(2)))
"""Median length of a vector with two Gaussian components of standard deviation 1."""

SMALLEST_PX = 5e-4
"""Standard deviation [px] below which misses are rounding errors, of single precision at 2000 px for instance."""


def without_outliers(
    views: Sequence[BoardView], refit: Callable[[list[BoardView]], Fit]
) -> tuple[Fit, list[NDArray[np.bool_]]]:
    """Fit, leave out the corners that the fit does not explain, and fit again until nothing changes.

    Parameters
    ----------
    views : sequence of BoardView
    refit : callable
        Takes views, returns their fit.

    Returns
    -------
    fit : BoardFit
        To the corners that are kept.
    kept : list of ndarray of bool (n,)
        Of each view.
    """
    kept = [np.ones(len(view), dtype=bool) for view in views]
    fit = refit(list(views))
    for _ in range(ROUNDS):
        now = [_within(view, fit, number, old) for number, (view, old) in enumerate(zip(views, kept, strict=True))]
        if all(np.array_equal(a, b) for a, b in zip(now, kept, strict=True)):
            break
        kept = now
        fit = refit([chosen(view, which) for view, which in zip(views, kept, strict=True)])
    return fit, kept


def chosen(view: BoardView, which: NDArray[np.bool_]) -> BoardView:
    """Return a view with some of its corners.

    Parameters
    ----------
    view : BoardView
    which : ndarray of bool (n,)

    Returns
    -------
    BoardView
    """
    return view if which.all() else BoardView(view.name, view.world[which], view.image[which])


def _within(view: BoardView, fit: BoardFit, number: int, old: NDArray[np.bool_]) -> NDArray[np.bool_]:
    miss = np.linalg.norm(view.image - fit.predict(number, view.world), axis=1)
    deviation = max(float(np.median(miss[old])) / RAYLEIGH_MEDIAN, SMALLEST_PX)
    inside = miss <= OUTLIER_DEVIATIONS * deviation
    return inside if inside.mean() >= 1 - MAX_SHARE else np.ones(len(view), dtype=bool)
