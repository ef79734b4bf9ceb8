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


def gains_beyond_chance(before: Array, after: Array) -> tuple[float, float]:
    """Return the gain [nats], and its standard error from its scatter over conditions."""
    difference = after - before
    error = float(np.std(difference, ddof=1) * np.sqrt(len(difference))) if len(difference) > 1 else float("inf")
    return float(difference.sum()), error
