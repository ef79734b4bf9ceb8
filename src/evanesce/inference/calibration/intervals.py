"""Intervals of fitted figures: the joint posterior with the discrepancy in its noise, within the figures' bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from evanesce.inference.joint_fit import JointFit
from evanesce.inference.named import scaled
from evanesce.prediction.linear import CovarianceRows
from evanesce.prediction.parameters import Parameter

Array = NDArray[Any]

TOLD = 0.5
"""Posterior over prior standard deviation below which the data determine a figure: three quarters of the prior's
variance are theirs then."""
HELD_SHARE = 0.9
"""Probability of an interval."""
LEAST_FREE = 1e-6
"""Of a held parameter's variance: less is what rounding leaves."""


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


def intervals(fitted: JointFit, tied: CovarianceRows) -> dict[str, Interval]:
    """Return the intervals of all parameters of a joint fit, by name.

    Parameters
    ----------
    fitted : JointFit
    tied : CovarianceRows
        Of the discrepancy.

    Notes
    -----
    Covariance of the estimate as in :func:`evanesce.inference.answer.widened_covariance` (Huber 1967). What a bound
    holds against a slope g of the log posterior has a density that falls off from there as exp(-g t): to the other
    parameters that is a deviation of 1/g; its own is the normal, about a mean beyond the bound, that the bound cuts.
    """
    solution = fitted.solution
    held = solution.held
    inflation = scaled(fitted.metric, fitted.residual)
    projected = fitted.metric.project(fitted.residual)
    deviation = np.array([p.deviation for p in fitted.parameters])
    slope = np.asarray(solution.rows @ projected, float) - fitted.departures() / deviation**2
    bound_precision = np.where(held, slope**2 / inflation, 0.0)
    own = np.linalg.inv(solution.precision + np.diag(bound_precision))
    # The metric on the side of the fewer rows.
    cross = tied.products(fitted.metric.project(solution.rows))
    found = {}
    for k, p in enumerate(fitted.parameters):
        # Of what a bound holds, as if it did not; the bounds of the others stay.
        row = own[k] / max(1.0 - bound_precision[k] * own[k, k], LEAST_FREE)
        mean = float(solution.values[k] + (slope[k] * row[k] if held[k] else 0.0))
        sd = float(np.sqrt((row[k] + np.square(row @ cross).sum()) * inflation))
        low, high = cut_interval(mean, sd, p.bounds)
        value = float(solution.values[k])
        found[p.name] = Interval(p, value, min(low, value), max(high, value), min(sd / p.deviation, 1.0))
    return found


def cut_interval(mean: float, sd: float, bounds: tuple[float, float]) -> tuple[float, float]:
    """Return the 90 % interval of highest density of a normal distribution that is cut off at bounds.

    One of equal tails would never reach a bound, where most effects are absent.

    Parameters
    ----------
    mean, sd : float
    bounds : tuple of float

    Returns
    -------
    low, high : float
    """
    low, high = ((b - mean) / sd for b in bounds)
    cut = stats.truncnorm(low, high, loc=mean, scale=sd)
    # Even about the mean, unless that reaches beyond a bound: then from there.
    inside = stats.norm.cdf(high) - stats.norm.cdf(low)
    half = float(stats.norm.isf(0.5 * (1.0 - HELD_SHARE * inside)))
    if low > -half and low + high > 0.0:
        ends = (bounds[0], float(cut.ppf(HELD_SHARE)))
    elif high < half:
        ends = (float(cut.isf(HELD_SHARE)), bounds[1])
    else:
        ends = (mean - half * sd, mean + half * sd)
    return float(np.clip(ends[0], *bounds)), float(np.clip(ends[1], *bounds))
