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
from evanesce.inference.discrepancy import Discrepancy, cosines
from evanesce.inference.joint_fit import JointFit

Array = NDArray[Any]

FORM_SHARE = 0.15
"""Standard deviation of a change's form over the change: where 90 % intervals hold the figures of development rigs as
often as they say (``benchmarks/fit_rigs.py``)."""
DECADES, SIZES = 3.0, 6
"""Over which a change's size is told apart below its largest, and half waves along them: one to half a decade."""


def form_errors(discrepancy: Discrepancy, fitted: JointFit) -> Array:
    """Return the rows (k, d) of errors of form, whitened: their outer products add up to the errors' covariance.

    Parameters
    ----------
    discrepancy : Discrepancy
        Knows what each cause changes.
    fitted : JointFit
    """
    size, found = fitted.residual.size, [np.zeros((0, fitted.residual.size), np.float32)]
    for change in discrepancy.changes(fitted).values():
        if np.nan_to_num(change).any():
            rows = form_rows(discrepancy.model.data, change) * np.float32(FORM_SHARE)
            # Rows of series, where there are any, follow the bins.
            found.append(np.pad(rows, ((0, 0), (0, size - rows.shape[1]))))
    return np.concatenate(found)


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
