"""Joint fit of a nonlinear model by Gauss and Newton: Gaussian priors, bounds, nuisances marginalised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.prediction.linear import Metric

Array = NDArray[Any]
Model = Callable[[Array], Array]
Jacobian = Callable[[Array, Array, Array | None], tuple[Array, Array]]

RADIUS = 1.0
"""Prior deviations that a first step goes in any parameter: a model far off promises most by figures that nobody
believes, and a step that goes there leaves the place where its derivatives hold."""
WIDER, NARROWER = 2.5, 0.25
"""Factors of the radius after a step that kept most of what it promised, and of the step after one that failed."""
KEPT, LITTLE = 0.5, 0.2
"""Shares of what was promised above which the radius grows, and below which it is halved."""
ROUNDS = 20
"""Predictions at most: a radius grows from one deviation to hundreds in six."""
BISECTIONS = 16
"""Of the damping's logarithm over 24 decades: the step's size comes to a per cent or so."""
FAILURES, STALE_FAILURES = 5, 2
"""Steps that may fail in a row: by derivatives made where they start, and by those that steps have corrected since, if
they can be made anew."""
SETTLED, LEAST_GAIN = 1e-4, 1.0
"""A fit has settled where a step promises less than this share of the misfit above noise's, or less than half a nat."""
HELD = 1e9
"""By so much the precision of what a bound holds is raised: enough to stay, little enough to invert."""
LEAST_STEP = 0.5
"""Steps below so many posterior standard deviations show the model's rounding, not its derivatives."""


@dataclass(frozen=True)
class Prior:
    """Gaussian prior and bounds of n parameters.

    Attributes
    ----------
    mean, deviation, low, high : ndarray (n,)
    """

    mean: Array
    deviation: Array
    low: Array
    high: Array

    def square(self, values: Array) -> float:
        """Return the sum of squares of values (n,) over the prior."""
        return float(np.square((values - self.mean) / self.deviation).sum())


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of n parameters.

    Attributes
    ----------
    rows : ndarray (n, d)
        Whitened, corrected by the steps taken.
    made : ndarray (n, d), optional
        As differences made them last; None where they were made of each parameter elsewhere.
    """

    rows: Array
    made: Array | None = None

    @property
    def fresh(self) -> bool:
        """Whether no step has corrected them since."""
        return self.made is self.rows


@dataclass(frozen=True)
class Solution:
    """Most probable parameters.

    Attributes
    ----------
    values : ndarray (n,)
    predicted : ndarray (d,)
        Whitened prediction there.
    slopes : Slopes
        Derivatives there.
    misfit : float
        Squared residual in the metric, plus the prior's squares.
    precision : ndarray (n, n)
        Of the posterior, linear about the solution.
    held : ndarray of bool (n,)
        Parameters that a bound holds against the data: nothing can be had by moving them on, though their prior, which
        knows no bound, would let them.
    """

    values: Array
    predicted: Array
    slopes: Slopes
    misfit: float
    precision: Array
    held: NDArray[np.bool_]

    @property
    def rows(self) -> Array:
        """Whitened derivatives (n, d), renewed or corrected by the steps taken."""
        return self.slopes.rows

    @property
    def covariance(self) -> Array:
        """Posterior covariance (n, n); of what is held next to none."""
        stiff = np.where(self.held, HELD * np.diag(self.precision), 0.0)
        return np.asarray(np.linalg.inv(self.precision + np.diag(stiff)))

    def in_metric(self, metric: Metric, residual: Array, prior: Prior) -> Solution:
        """Return the same parameters, their misfit and precision in another metric.

        Parameters
        ----------
        metric : Metric
        residual : ndarray (d,)
            Whitened data less the prediction here.
        prior : Prior
        """
        precision, _ = _normal(self.rows, residual, self.values, prior, metric)
        misfit = float(metric.project(residual) @ residual) + prior.square(self.values)
        return replace(self, misfit=misfit, precision=precision)


def bounded_step(precision: Array, gradient: Array, low: Array, high: Array) -> Array:
    """Return the step that minimises step' precision step / 2 - gradient' step within low <= step <= high.

    Parameters
    ----------
    precision : ndarray (n, n)
        Positive definite.
    gradient, low, high : ndarray (n,)

    Notes
    -----
    Active sets: what violates a bound is put on it and the rest solved again; what a bound holds against the gradient's
    wish is let go again. At most 4 n changes, which for some twenty parameters was always enough.
    """
    size = len(gradient)
    step, held = np.zeros(size), np.zeros(size, bool)
    for _ in range(4 * size + 4):
        free = ~held
        wish = gradient[free] - precision[np.ix_(free, held)] @ step[held]
        step[free] = np.linalg.solve(precision[np.ix_(free, free)], wish) if free.any() else 0.0
        beyond = free & ((step < low) | (step > high))
        if beyond.any():
            step = np.clip(step, low, high)
            held |= beyond
            continue
        slope = gradient - precision @ step
        wrong = held & (((step <= low) & (slope > 1e-12)) | ((step >= high) & (slope < -1e-12))) & (low < high)
        if not wrong.any():
            break
        held[np.argmax(np.where(wrong, np.abs(slope), 0.0))] = False
    return np.clip(step, low, high)


def fit(
    model: Model,
    jacobian: Jacobian,
    data: Array,
    prior: Prior,
    start: Array,
    *,
    metric: Metric,
    slopes: Slopes | None = None,
    rounds: int = ROUNDS,
    renewals: int = 1,
) -> Solution:
    """Fit a model.

    Parameters
    ----------
    model : callable
        ``model(values) -> whitened prediction (d,)``; may raise :class:`~evanesce.core.errors.InputError` for values
        that the rig cannot have, which then count as a step that failed, as predictions do that are not finite.
    jacobian : callable
        ``jacobian(values, predicted, width) -> whitened derivatives (n, d), prediction (d,)``: to be made over no more
        than posterior standard deviations, ``width`` (n,), where those are known. The prediction changes where what it
        takes for linear is evaluated anew.
    data : ndarray (d,)
        Whitened.
    prior : Prior
    start : ndarray (n,)
    metric : Metric
        Inner product of the data space, nuisances marginalised.
    slopes : Slopes, optional
        Derivatives at the start, where they are known.
    rounds : int
        Predictions at most.
    renewals : int
        How often derivatives may be made anew where steps have stopped to gain; between, steps correct them (Broyden).

    Returns
    -------
    Solution
    """

    def predict(at: Array) -> Array:
        found = model(at)
        if not np.isfinite(found).all():
            raise InputError("the rig's frames cannot be computed at these figures: some pixels are not finite")
        return found

    values = np.clip(np.asarray(start, float), prior.low, prior.high)
    predicted = predict(values)

    def made(width: Array | None) -> tuple[Slopes, Array]:
        rows, there = jacobian(values, predicted, width)
        rows = np.array(rows, float)
        return Slopes(rows, rows), there

    if slopes is None:
        slopes, predicted = made(None)

    def misfit_of(at: Array, prediction: Array) -> float:
        left = data - prediction
        return float(metric.project(left) @ left) + prior.square(at)

    misfit, radius, failed = misfit_of(values, predicted), RADIUS, 0
    for _ in range(rounds):
        precision, gradient = _normal(slopes.rows, data - predicted, values, prior, metric)
        low, high = prior.low - values, prior.high - values
        free = bounded_step(precision, gradient, low, high)
        step = step_within(radius, prior.deviation, free, precision, gradient, low, high)
        settled = _promised(free, precision, gradient) < max(SETTLED * (misfit - data.size), LEAST_GAIN)
        # After steps that failed only what is within reach counts.
        settled |= failed > 0 and _promised(step, precision, gradient) < LEAST_GAIN
        stale = not slopes.fresh and renewals > 0
        if settled or failed >= (STALE_FAILURES if stale else FAILURES):
            if not stale:
                break
            (slopes, predicted), renewals = made(np.sqrt(np.diag(np.linalg.inv(precision)))), renewals - 1
            misfit = misfit_of(values, predicted)
            radius, failed = max(radius, RADIUS), 0
            continue
        trial = np.clip(values + step, prior.low, prior.high)
        size, promised = float(np.abs(step / prior.deviation).max()), _promised(step, precision, gradient)
        try:
            there = predict(trial)
        except InputError:
            radius, failed = size * NARROWER, failed + 1
            continue
        corrected = broyden(slopes.rows, trial - values, there - predicted, precision)
        slopes = slopes if corrected is slopes.rows else replace(slopes, rows=corrected)
        value = misfit_of(trial, there)
        gained = misfit - value
        if gained > 0.0:
            values, predicted, misfit, failed = trial, there, value, 0
            radius = radius * WIDER if gained > KEPT * promised else size / 2 if gained < LITTLE * promised else radius
        else:
            radius, failed = size * NARROWER, failed + 1
    precision, gradient = _normal(slopes.rows, data - predicted, values, prior, metric)
    # Where the last step, too short to be taken, would end: a fit settles a little before a bound.
    low, high = prior.low - values, prior.high - values
    step = bounded_step(precision, gradient, low, high)
    slope = gradient - precision @ step
    held = ((step <= low) & (slope < 0)) | ((step >= high) & (slope > 0))
    return Solution(values, predicted, slopes, misfit, precision, held)


def step_within(
    radius: float, deviation: Array, step: Array, precision: Array, gradient: Array, low: Array, high: Array
) -> Array:
    """Return the best step that goes no farther in any parameter than so many prior deviations.

    Levenberg's damping in units of the priors: what data determine well moves first, what they hardly tell stays.

    Parameters
    ----------
    radius : float
    deviation : ndarray (n,)
        Of the prior.
    step : ndarray (n,)
        That without a limit, which is returned where it is short enough.
    precision : ndarray (n, n)
    gradient : ndarray (n,)
    low, high : ndarray (n,)
        Bounds of the step.
    """
    if np.abs(step / deviation).max() <= radius:
        return step
    largest = np.log10(float((np.diag(precision) * deviation**2).max()))
    less, more = largest - 12.0, largest + 12.0
    for _ in range(BISECTIONS):
        middle = (less + more) / 2
        step = bounded_step(precision + np.diag(10.0**middle / deviation**2), gradient, low, high)
        less, more = (middle, more) if np.abs(step / deviation).max() > radius else (less, middle)
    return bounded_step(precision + np.diag(10.0**more / deviation**2), gradient, low, high)


def _promised(step: Array, precision: Array, gradient: Array) -> float:
    """Return by how much a step lowers the misfit of the linear model."""
    return 2.0 * float(step @ gradient) - float(step @ precision @ step)


def broyden(rows: Array, step: Array, change: Array, precision: Array) -> Array:
    """Return derivatives that reproduce the change (d,) of prediction over a step (n,), changed as little as may be.

    Least change in units of the posterior (Broyden's rank-one update, weighted by the posterior precision).
    """
    scaled = np.diag(precision) * step
    size = float(step @ scaled)
    if size < LEAST_STEP**2:
        return rows
    return np.asarray(rows + np.outer(scaled / size, change - step @ rows))


def _normal(rows: Array, left: Array, values: Array, prior: Prior, metric: Metric) -> tuple[Array, Array]:
    """Return the posterior precision (n, n) and the gradient (n,) of the log posterior."""
    projected = metric.project(rows)
    precision = np.asarray(projected @ rows.T) + np.diag(1.0 / prior.deviation**2)
    gradient = np.asarray(projected @ left) - (values - prior.mean) / prior.deviation**2
    return precision, gradient
