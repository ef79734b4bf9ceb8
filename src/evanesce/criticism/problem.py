"""The data beside the prediction: which bins count, how much each, and models fitted to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.prediction.linear import Metric
from evanesce.prediction.noise import Noise
from evanesce.prediction.parameters import Parameter, derivative, moved, value_of
from evanesce.prediction.predict import Point, Predictor
from evanesce.prediction.recoded import Recoded
from evanesce.prediction.views import View

Array = NDArray[Any]

SATURATED_DN = 254.0
SETTLED = 0.05
"""A fit has settled where no parameter moves by more than this many posterior standard deviations."""
LEAST_STEP = 0.5
"""Steps shorter than this many posterior standard deviations teach nothing of derivatives: they show rounding."""
FAR_MM = 0.03
"""Derivatives at the edge of contact hold this far."""


@dataclass(frozen=True)
class Problem:
    """Data, noise and predictor.

    Attributes
    ----------
    predictor : Predictor
    data : ndarray (views, rows, cols)
        Bins [DN].
    noise : Noise
    numerics : ndarray (views, rows, cols)
        Variance of what the prediction's own resolution leaves [DN^2].
    views : tuple of int
        That fits may use.
    sd : ndarray (views, rows, cols)
        Standard deviation of each bin [DN].
    valid : ndarray of bool (views, rows, cols)
    coded : Recoded, optional
        What a codec makes of the frames: noise is drawn from it, not from the replicates.
    """

    predictor: Predictor
    data: Array
    noise: Noise
    numerics: Array
    views: tuple[int, ...]
    sd: Array
    valid: NDArray[np.bool_]
    coded: Recoded | None = None

    @classmethod
    def of(
        cls, predictor: Predictor, data: Array, noise: Noise, numerics: Array, views: Sequence[int], level: Array
    ) -> Problem:
        """Return the problem with each bin weighted by the noise at a predicted level (views, rows, cols) [DN]."""
        frames = np.array([v.frames for v in predictor.views])[:, None, None]
        sd = np.sqrt(noise.variance(level, frames) + numerics)
        return cls(predictor, data, noise, numerics, tuple(int(v) for v in views), sd, level < SATURATED_DN)

    def louder(self, excess: Array, shared: Array) -> Problem:
        """Return the problem with the variance of each view (views,) multiplied.

        Parameters
        ----------
        excess : ndarray (views,)
            Of real noise over what was believed: what is drawn through a codec is as much louder.
        shared : ndarray (views,)
            Of views that share their noise over as many that do not: draws through a codec share it already.
        """
        wider = replace(self, sd=self.sd * np.sqrt(excess * shared)[:, None, None])
        if self.coded is None:
            return wider
        by = excess[:, None, None]
        return replace(wider, coded=self.coded.louder(by), numerics=self.numerics * by)

    def recoded(self, coded: Recoded, numerics: Array) -> Problem:
        """Return the problem with noise as it comes out of a codec, and what else there is beside it [DN^2]."""
        return replace(self, coded=coded, numerics=numerics, sd=np.sqrt(coded.variance + numerics))

    def whitened(self, cube: Array, views: Sequence[int] | None = None) -> Array:
        """Return the valid bins of some views (the fit's own by default) over their standard deviation, in a row."""
        chosen = list(self.views if views is None else views)
        return np.asarray((cube[chosen] / self.sd[chosen])[self.valid[chosen]])

    def unwhitened(self, row: Array, views: Sequence[int] | None = None) -> Array:
        """Return a whitened row as a cube (chosen views, rows, cols) of whitened values; 0 where not valid."""
        chosen = list(self.views if views is None else views)
        cube = np.zeros((len(chosen), *self.data.shape[1:]), row.dtype)
        cube[self.valid[chosen]] = row
        return cube

    def residual(self, predicted: Array, views: Sequence[int] | None = None) -> Array:
        """Return the whitened data less a prediction."""
        return self.whitened(self.data - predicted, views)

    @property
    def kinds(self) -> tuple[View, ...]:
        """Views that the fit uses."""
        return tuple(self.predictor.views[v] for v in self.views)


@dataclass(frozen=True)
class Fit:
    """A model fitted by its most probable parameters.

    Attributes
    ----------
    point : mapping
        All parameters, nuisances included.
    parameters : tuple of Parameter
        Effects first, then nuisances.
    rows : ndarray (parameters, bins)
        Whitened derivatives, in the same order.
    predicted : ndarray (views, rows, cols)
        Without the linear parameters' part; NaN in views that the fit did not use [DN].
    residual : ndarray (bins,)
        Whitened data less prediction.
    misfit : float
        Squared residual plus the priors' squares.
    """

    point: Mapping[str, float]
    parameters: tuple[Parameter, ...]
    rows: Array
    predicted: Array
    residual: Array
    misfit: float

    def covariance(self, inflation: float = 1.0) -> Array:
        """Return the posterior covariance of the parameters."""
        deviations = np.array([p.deviation for p in self.parameters])
        info = self.rows @ self.rows.T / inflation
        return np.asarray(np.linalg.inv(info + np.diag(1.0 / deviations**2)))

    def metric(self, parameters: Sequence[Parameter]) -> Metric:
        """Return the metric with some of the parameters marginalised."""
        names = [p.name for p in parameters]
        chosen = [k for k, p in enumerate(self.parameters) if p.name in names]
        return Metric.of(self.rows[chosen], np.array([self.parameters[k].deviation for k in chosen]))


def prior_square(point: Point, parameters: Sequence[Parameter]) -> float:
    """Return the sum of squares of parameters over their priors."""
    return float(sum(((value_of(point, p) - p.null) / p.deviation) ** 2 for p in parameters))


def derivatives(problem: Problem, point: Point, parameters: Sequence[Parameter], base: Array | None = None) -> Array:
    """Return whitened derivatives (parameters, bins)."""
    at = predicted_part(point, parameters)
    return np.array(
        [
            problem.whitened(derivative(problem.predictor, at, p, problem.views, base)).astype(np.float32)
            for p in parameters
        ]
    )


def fit(
    problem: Problem,
    parameters: Sequence[Parameter],
    start: Point,
    *,
    rows: Array | None = None,
    predicted: Array | None = None,
    rounds: int = 6,
    secant: bool = False,
) -> Fit:
    """Fit a model by Gauss and Newton with priors, bounds and halved steps.

    Parameters
    ----------
    problem : Problem
    parameters : sequence of Parameter
    start : mapping
    rows : ndarray (parameters, bins), optional
        Whitened derivatives where known; they are made anew only where the contact has moved too far for them.
    predicted : ndarray, optional
        At ``start``.
    rounds : int
        At most so many predictions.
    secant : bool
        Whether to correct the derivatives by what each step really did (Broyden's rank-one update): for parameters
        that the prediction is not linear in.
    """
    parameters = tuple(parameters)
    point = dict(start)
    predictor = problem.predictor
    cube = predictor.cube(predicted_part(point, parameters), problem.views) if predicted is None else predicted
    jacobian = derivatives(problem, point, parameters, cube) if rows is None else np.array(rows)
    linear = np.array([p.linear for p in parameters], bool)

    def left_by(at: Point, predicted: Array) -> Array:
        values = np.array([value_of(at, p) for p in parameters])
        return problem.residual(predicted) - values[linear] @ jacobian[linear]

    residual = left_by(point, cube)
    misfit = float(residual @ residual) + prior_square(point, parameters)
    deviations = np.array([p.deviation for p in parameters])
    since = dict(point)
    for _ in range(rounds):
        step, posterior = _step(jacobian, residual, point, parameters, deviations)
        better = None
        for _ in range(4):
            trial, taken = _within(point, parameters, step)
            if not np.any(taken):
                break
            new = predictor.cube(predicted_part(trial, parameters), problem.views)
            left = left_by(trial, new)
            value = float(left @ left) + prior_square(trial, parameters)
            if value <= misfit:
                better = (trial, new, left, value)
                break
            if secant:
                change = residual - left - jacobian[linear].T @ taken[linear]
                jacobian = _broyden(jacobian, np.where(linear, 0.0, taken), change, posterior)
            step = step / 3
        if better is None:
            break
        if secant:
            change = residual - better[2] - jacobian[linear].T @ taken[linear]
            jacobian = _broyden(jacobian, np.where(linear, 0.0, taken), change, posterior)
        gained = misfit - better[3]
        point, cube, residual, misfit = better
        if _far(point, since, parameters):
            jacobian, since = _renewed(problem, point, parameters, jacobian, cube), dict(point)
        elif gained < SETTLED or np.all(np.abs(taken) < SETTLED * posterior):
            break
    return Fit(point, parameters, jacobian, cube, residual, misfit)


def stepped(problem: Problem, parameters: Sequence[Parameter], start: Point, rows: Array, predicted: Array) -> Fit:
    """Return the most probable parameters of a prediction that follows its derivatives from a point on.

    Parameters
    ----------
    problem : Problem
    parameters : sequence of Parameter
    start : mapping
    rows : ndarray (parameters, bins)
        Whitened derivatives.
    predicted : ndarray (views, rows, cols)
        At ``start``, without the linear parameters' part [DN].
    """
    parameters = tuple(parameters)
    deviations = np.array([p.deviation for p in parameters])
    linear = np.array([p.linear for p in parameters], bool)
    values = np.array([value_of(start, p) for p in parameters])
    residual = problem.residual(predicted) - values[linear] @ rows[linear]
    point, taken = _within(start, parameters, _step(rows, residual, start, parameters, deviations)[0])
    residual = residual - taken @ rows
    cube = predicted.copy()
    views = list(problem.views)
    # Where bins are not valid nothing is compared.
    cube[views] += problem.unwhitened(taken[~linear] @ rows[~linear]) * problem.sd[views]
    misfit = float(residual @ residual) + prior_square(point, parameters)
    return Fit(point, parameters, np.array(rows), cube, residual, misfit)


def predicted_part(point: Point, parameters: Sequence[Parameter]) -> dict[str, float]:
    """Return a point without the parameters whose derivative says all."""
    linear = {p.name for p in parameters if p.linear}
    return {name: value for name, value in point.items() if name not in linear}


def _step(
    jacobian: Array, residual: Array, point: Point, parameters: Sequence[Parameter], deviations: Array
) -> tuple[Array, Array]:
    """Return Gauss and Newton's step, and the posterior standard deviations."""
    away = np.array([value_of(point, p) - p.null for p in parameters])
    precision = np.asarray(jacobian @ jacobian.T, float) + np.diag(1.0 / deviations**2)
    gradient = jacobian @ residual - away / deviations**2
    covariance = np.linalg.inv(precision)
    return covariance @ gradient, np.sqrt(np.diag(covariance))


def _within(point: Point, parameters: Sequence[Parameter], step: Array) -> tuple[dict[str, float], Array]:
    """Return the point after a step that stays in bounds, and the step taken."""
    at = np.array([value_of(point, p) for p in parameters])
    low, high = (np.array([p.bounds[k] for p in parameters]) for k in (0, 1))
    new = np.clip(at + step, low, high)
    return moved(point, {p.name: float(v) for p, v in zip(parameters, new, strict=True)}), new - at


def _broyden(jacobian: Array, taken: Array, change: Array, posterior: Array) -> Array:
    """Return derivatives that reproduce the change of prediction over a step, changed as little as may be."""
    scaled = taken / posterior**2
    size = float(taken @ scaled)
    if size < LEAST_STEP**2:
        return jacobian
    missing = change - jacobian.T @ taken
    return np.asarray(jacobian + np.outer(scaled / size, missing))


def _far(point: Point, since: Point, parameters: Sequence[Parameter]) -> bool:
    poses = [p.name for p in parameters if p.name.startswith("@pose")]
    return any(abs(point.get(n, 0.0) - since.get(n, 0.0)) > FAR_MM for n in poses)


def _renewed(problem: Problem, point: Point, parameters: Sequence[Parameter], jacobian: Array, cube: Array) -> Array:
    """Return new derivatives of what moves with the contact; smooth ones stay."""
    found = np.array(jacobian)
    local = [k for k, p in enumerate(parameters) if p.name.startswith(("@pose", "@force", "@turn"))]
    at = predicted_part(point, parameters)
    found[local] = derivatives(problem, at, [parameters[k] for k in local], cube)
    return found
