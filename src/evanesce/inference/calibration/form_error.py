"""By how much fitted causes' forms are off, as what a fit leaves says: the noise of intervals.

A real LED strip or halo is of another form than any figure's. What a cause does to the frames is then known to a share,
that varies smoothly over the frame and from its strongest to its faintest parts (a halo falls off by another law). The
shares are those that what is left makes probable, each beside the others' likeliest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.constants import TIED_SHARE, WAVES
from evanesce.inference.data import DataVector
from evanesce.inference.discrepancy import MOST_SHARE, Discrepancy, cosines
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.removal import everything_marginalised

Array = NDArray[Any]

DECADES, SIZES = 3.0, 6
"""Over which a change's size is told apart below its largest, and half waves along them: one to half a decade."""
SHARES = np.concatenate([[0.0], np.geomspace(TIED_SHARE, MOST_SHARE, 4)])
"""That are tried, finely enough to come within a half."""
ROUNDS = 3
"""In which each cause's is sought given the others'."""
LEAST_LIKELY = 0.01
"""Likelihood over the largest, below which a share is not counted."""
LEAST_CHANGE = 20.0
"""Standard deviations of a change along its largest row: of less, noise hides any share."""


def form_errors(discrepancy: Discrepancy, fitted: JointFit) -> tuple[Array, dict[str, float]]:
    """Return the rows of errors of form, and the share of each cause's change that they are.

    Parameters
    ----------
    discrepancy : Discrepancy
        Knows what each cause changes.
    fitted : JointFit

    Returns
    -------
    rows : ndarray of float32 (k, d)
        Whitened; their outer products add up to the errors' covariance.
    shares : dict of str to float
        By cause; 0 where its form is as right as the data can tell.
    """
    size, blocks = fitted.residual.size, {}
    for name, change in discrepancy.changes(fitted).items():
        rows = form_rows(discrepancy.model.data, change)
        if np.square(rows).sum(axis=1).max() > LEAST_CHANGE**2:
            # Rows of series, where there are any, follow the bins.
            blocks[name] = np.pad(rows, ((0, 0), (0, size - rows.shape[1])))
    shares = probable_shares(fitted, blocks)
    off = [blocks[name] * np.float32(share) for name, share in shares.items() if share]
    return np.concatenate([np.zeros((0, size), np.float32), *off]), shares


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


def probable_shares(fitted: JointFit, blocks: Mapping[str, Array]) -> dict[str, float]:
    """Return the shares of rows, by cause, that what a fit leaves makes probable, all that is fitted marginalised.

    Parameters
    ----------
    fitted : JointFit
    blocks : mapping of str to ndarray (k, d)
        Whitened rows of unit share.
    """
    if not blocks:
        return {}
    metric, left = everything_marginalised(fitted)
    rows = np.concatenate(list(blocks.values()))
    own = np.repeat(np.arange(len(blocks)), [len(block) for block in blocks.values()])
    projected = np.asarray(metric.project(rows.astype(float)))
    gram, along = projected @ rows.T, projected @ left

    def cost(shares: Array) -> float:
        """Return twice the negative log evidence, up to what all shares have."""
        each = shares[own]
        used = each > 0.0
        scaled = each[used, None] * gram[np.ix_(used, used)] * each[used] + np.eye(int(used.sum()))
        to = each[used] * along[used]
        return float(np.linalg.slogdet(scaled)[1] - to @ np.linalg.solve(scaled, to))

    now = np.zeros(len(blocks))
    for _ in range(ROUNDS):
        for place in range(len(now)):
            tried = [np.where(np.arange(len(now)) == place, share, now) for share in SHARES]
            now = min(tried, key=cost)
    return {name: _mean_square(now, place, cost) for place, name in enumerate(blocks)}


def _mean_square(shares: Array, place: int, cost: Callable[[Array], float]) -> float:
    """Return the root of a share's mean square over what the data leave probable: the likeliest alone is too small."""
    costs = np.array([cost(np.where(np.arange(len(shares)) == place, share, shares)) for share in SHARES])
    weight = np.exp(-0.5 * (costs - costs.min()))
    weight[weight < LEAST_LIKELY] = 0.0
    return float(np.sqrt(weight @ SHARES**2 / weight.sum()))
