"""Predictive score of conditions left out, within the open part: what a further cause gains beyond the discrepancy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.criticism.gain import leave_one_out
from evanesce.inference.data import DataVector
from evanesce.inference.joint import JointFit

Array = NDArray[Any]


def condition_scores(data: DataVector, fitted: JointFit, tied: Array) -> Array:
    """Return the log predictive score of each condition, all else refitted without it [nats].

    Parameters
    ----------
    data : DataVector
    fitted : JointFit
    tied : ndarray (k, bins)
        Rows of the discrepancy.
    """
    jitter = fitted.metric.rows
    rows = np.concatenate([fitted.solution.rows, jitter, tied]).astype(np.float32)
    deviations = np.concatenate([[p.deviation for p in fitted.parameters], np.ones(len(jitter) + len(tied))])
    away = np.concatenate([fitted.departures(), np.zeros(len(jitter) + len(tied))])
    return leave_one_out(rows, fitted.residual.astype(np.float32), deviations, away, data.conditions)


def gain_of(before: Array, after: Array) -> tuple[float, float]:
    """Return the gain over all conditions [nats], and its standard error by the model's own noise.

    Between Gaussian predictions a squared distance d^2 apart the log score differs by d^2/2 on average, with a standard
    deviation of d. Scatter over conditions is no measure of it: a change that shows at the least force alone is none
    the less sure. The gain is that without the condition which gains most, so that none carries it alone.

    Parameters
    ----------
    before, after : ndarray (conditions,)
        Log scores [nats].
    """
    difference = np.sort(after - before)
    gain = float(difference.sum() - (difference[-1] if len(difference) > 1 else 0.0))
    return gain, float(np.sqrt(2.0 * abs(gain)))
