"""By how much fitted causes' forms may be off: the noise of intervals.

A real LED strip or halo is of another form than any figure's. What a cause does to the frames is then known to a share,
that varies smoothly over the frame and from its strongest to its faintest parts (a halo falls off by another law). What
a fit leaves does not say to which share: other figures make up for most of what is wrong, and leave noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.constants import WAVES
from evanesce.inference.data import DataVector
from evanesce.inference.discrepancy import cosines, rows_by_view
from evanesce.prediction.linear import CovarianceRows

Array = NDArray[Any]

FORM_SHARE = 0.15
"""Standard deviation of a change's form over the change: where 90 % intervals hold the figures of development rigs as
often as they say (``benchmarks/fit_rigs.py``)."""
FAINT = 1e-3
"""Squared size of a row, over noise, below which it is left out: it adds less than that to any variance."""
DECADES, SIZES = 3.0, 6
"""Over which a change's size is told apart below its largest, and half waves along them: one to half a decade."""


def form_errors(data: DataVector, change: Array, share: float) -> CovarianceRows:
    """Return the whitened rows of errors of form: their outer products add up to the errors' covariance.

    Parameters
    ----------
    data : DataVector
    change : ndarray (views, rows, cols)
        By a cause [DN]; NaN where there is none.
    share : float
        By which it may be off in each view by itself.
    """
    rows = form_rows(data, change) * np.float32(FORM_SHARE)
    shown = np.square(rows).sum(axis=1) > FAINT
    return CovarianceRows(rows[shown], rows_by_view(data, change, share / np.sqrt(2.0)))


def form_rows(data: DataVector, change: Array) -> Array:
    """Return the whitened rows (k, bins) of a change that is wholly unknown: its own size at each place, smooth.

    Parameters
    ----------
    data : DataVector
    change : ndarray (views, rows, cols)
        [DN]; NaN where there is none.
    """
    change = np.nan_to_num(change)
    valid = data.valid[list(data.open)]
    largest = max(float(np.abs(change).max()), 1e-300)
    below = np.clip(-np.log10(np.abs(change) / largest + 1e-12) / DECADES, 0.0, 1.0)[list(data.open)]
    over_noise = data.over_noise(change)
    smooth = [over_noise * wave for wave in cosines(change.shape[1:], WAVES)]
    by_size = [over_noise * np.sqrt(2.0) * np.cos(np.pi * k * below) for k in range(1, SIZES + 1)]
    rows = [one[valid] / np.sqrt(2.0 * len(group)) for group in (smooth, by_size) for one in group]
    return np.array(rows, np.float32)
