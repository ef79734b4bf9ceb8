"""Intervals of fitted figures: the joint posterior with the discrepancy in its noise, within the figures' bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from evanesce.inference.answer import scaled
from evanesce.inference.joint import JointFit
from evanesce.prediction.parameters import Parameter

Array = NDArray[Any]

TOLD = 0.5
"""Posterior over prior standard deviation below which the data determine a figure: three quarters of the prior's
variance are theirs then."""
TAIL = 0.05


@dataclass(frozen=True)
class Interval:
    """A figure's posterior.

    Attributes
    ----------
    parameter : Parameter
    value, low, high : float
        Most probable value, and 90 % interval, in the parameter's unit.
    narrowing : float
        Posterior over prior standard deviation [1].
    """

    parameter: Parameter
    value: float
    low: float
    high: float
    narrowing: float

    @property
    def told(self) -> bool:
        """Whether the data determine it."""
        return self.narrowing < TOLD

    @property
    def away(self) -> float:
        """Distance from the nominal value, in prior standard deviations."""
        return (self.value - self.parameter.null) / self.parameter.deviation


def intervals(fitted: JointFit, tied: Array) -> dict[str, Interval]:
    """Return the intervals of all parameters of a joint fit, by name.

    Parameters
    ----------
    fitted : JointFit
    tied : ndarray (k, bins)
        Rows of the discrepancy.

    Notes
    -----
    Covariance of the estimate as in :func:`evanesce.inference.answer.widened_covariance` (Huber 1967), but with what a
    bound holds left free: its mean lies beyond the bound, by the gradient there, and the marginal normal is cut off at
    the bounds.
    """
    solution = fitted.solution
    own = np.linalg.inv(solution.precision)
    projected = fitted.metric.project(fitted.residual)
    deviation = np.array([p.deviation for p in fitted.parameters])
    gradient = np.asarray(solution.rows @ projected, float) - fitted.departures() / deviation**2
    mean = solution.values + own @ np.where(solution.held, gradient, 0.0)
    cross = solution.rows @ np.asarray(fitted.metric.project(tied.astype(float))).T
    spread = own @ cross
    covariance = (own + spread @ spread.T) * scaled(fitted.metric, fitted.residual)
    sd = np.sqrt(np.diag(covariance))
    found = {}
    for k, p in enumerate(fitted.parameters):
        low, high = cut_interval(float(mean[k]), float(sd[k]), p.bounds)
        value = float(solution.values[k])
        found[p.name] = Interval(p, value, min(low, value), max(high, value), float(min(sd[k] / p.deviation, 1.0)))
    return found


def cut_interval(mean: float, sd: float, bounds: tuple[float, float]) -> tuple[float, float]:
    """Return the 90 % interval of a normal distribution that is cut off at bounds.

    Parameters
    ----------
    mean, sd : float
    bounds : tuple of float

    Returns
    -------
    low, high : float
        From the bound, where the density is highest there.
    """
    low, high = ((b - mean) / sd for b in bounds)
    if low > 0.0 or high < 0.0:  # highest at a bound: one-sided
        tail = (0.0, 2 * TAIL) if low > 0.0 else (2 * TAIL, 0.0)
    else:
        tail = (TAIL, TAIL)
    cut = stats.truncnorm(low, high, loc=mean, scale=sd)
    ends = float(cut.ppf(tail[0])), float(cut.isf(tail[1]))
    return float(np.clip(ends[0], *bounds)), float(np.clip(ends[1], *bounds))
