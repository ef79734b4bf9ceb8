"""What a cause would remove of a fit's misfit, and what a fit would lose without it: linear about the fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.causes import Entry
from evanesce.inference.gauss_newton import bounded_step
from evanesce.inference.joint_fit import JointFit
from evanesce.prediction.linear import Metric

Array = NDArray[Any]


@dataclass(frozen=True)
class Removal:
    """What a cause would remove of the misfit, linear about the present fit.

    Attributes
    ----------
    entry : Entry
    removed : float
        Of the misfit, priors and bounds kept.
    coordinates : ndarray (k,)
    """

    entry: Entry
    removed: float
    coordinates: Array


def everything_marginalised(now: JointFit) -> tuple[Metric, Array]:
    """Return the metric with all that is fitted marginalised, and the data less the prediction of the priors' means.

    What a bound holds stays where it is.
    """
    free = ~now.solution.held
    own = now.solution.rows[free]
    deviations = np.array([p.deviation for p in now.parameters])[free]
    return now.metric.with_rows(own * deviations[:, None]), now.residual + now.departures()[free] @ own


def removal(entry: Entry, metric: Metric, projected: Array) -> Removal:
    """Return what a cause would remove, its coordinates kept to their priors and bounds.

    Parameters
    ----------
    entry : Entry
    metric : Metric
        With all that is fitted marginalised.
    projected : ndarray (bins,)
        The metric times the data less the prediction of the priors' means.
    """
    rows = entry.rows
    precision = np.asarray(metric.project(rows) @ rows.T, float) + np.diag(1.0 / entry.deviation**2)
    gradient = np.asarray(rows @ projected, float)
    step = bounded_step(precision, gradient, entry.low, entry.high)
    return Removal(entry, 2.0 * float(step @ gradient) - float(step @ precision @ step), step)


def loss_of(now: JointFit, cause: str) -> float:
    """Return by how much the misfit rises without a cause, all else refitted, linear about the fit."""
    places = now.of_cause(cause)
    away = now.departures()[places]
    covariance = now.solution.covariance[np.ix_(places, places)]
    return float(away @ np.linalg.solve(covariance, away))
