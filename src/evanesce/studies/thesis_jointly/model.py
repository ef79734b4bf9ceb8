"""The outcomes as data of the critic's joint fit, and where its fits begin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from evanesce.inference.model import one_by_one
from evanesce.prediction.parameters import Parameter
from evanesce.studies.thesis_jointly.data import Outcomes
from evanesce.studies.thesis_jointly.mechanisms import NUISANCES, MechanismSet
from evanesce.studies.thesis_jointly.predict import Predictor

Array = NDArray[Any]

EVALUATIONS, EDGE = 60, 1e-4
"""Predictions of a fit at most; distance from a bound, in prior deviations, that counts as being there."""


class OutcomeModel:
    """The outcomes as data of a joint fit (see :class:`evanesce.inference.model.Model`).

    Parameters
    ----------
    outcomes : Outcomes
    chosen : MechanismSet
    data : ndarray (rows,)
        As rows count.
    sd : ndarray (rows,)
    """

    observation: Any = None
    factor = 1
    unexplained = 0.0
    fixed: Mapping[str, Mapping[str, Any]] = {}

    def __init__(self, outcomes: Outcomes, chosen: MechanismSet, data: Array, sd: Array) -> None:
        self.data, self.sd = data, sd
        self.predictor = Predictor(outcomes.rows, chosen)
        self._parameters = (*chosen.parameters, *NUISANCES)
        self._slopes: tuple[tuple[float, ...], dict[str, Array]] = ((), {})

    @property
    def observed(self) -> Array:
        """Whitened data (rows,)."""
        return np.asarray(self.data / self.sd)

    def nuisances(self) -> tuple[Parameter, ...]:
        """Return what every fit varies."""
        return NUISANCES

    def anchor(self, point: Mapping[str, float]) -> Array:
        """Return the prediction (rows,); there is no finer model."""
        return np.asarray(self.vector(point) * self.sd)

    def vector(self, point: Mapping[str, float]) -> Array:
        """Return the whitened prediction (rows,)."""
        return np.asarray(self.predictor({k: np.array([v]) for k, v in point.items()})[0] / self.sd)

    def derivative(self, point: Mapping[str, float], parameter: Parameter) -> Array:
        """Return its derivative (rows,) by a parameter; those by all parameters are computed together."""
        key = tuple(point.values())
        if self._slopes[0] != key:
            self._slopes = (key, self._all_derivatives(point))
        return self._slopes[1][parameter.name]

    derivatives = one_by_one

    def _all_derivatives(self, point: Mapping[str, float]) -> dict[str, Array]:
        names = [p.name for p in self._parameters]
        at = np.array([point[name] for name in names])
        low, high = (np.array([p.bounds[end] for p in self._parameters]) for end in (0, 1))
        step = np.array([p.step for p in self._parameters])
        up, down = np.minimum(at + step, high), np.maximum(at - step, low)
        several = np.tile(at, (2 * len(at), 1))
        for k in range(len(at)):
            several[2 * k, k], several[2 * k + 1, k] = up[k], down[k]
        rows = self.predictor(dict(zip(names, several.T, strict=True))) / self.sd
        change = (rows[0::2] - rows[1::2]) / (up - down)[:, None]
        return dict(zip(names, change, strict=True))

    def further_rows(self) -> Array:
        """Return none: the noise of rows is what they state."""
        return np.zeros((0, self.data.size))


def optimum(model: OutcomeModel, parameters: Sequence[Parameter], start: Mapping[str, float]) -> dict[str, float]:
    """Return the most probable point by a trust region that keeps to the bounds (Branch, Coleman and Li 1999)."""
    null, deviation = np.array([p.null for p in parameters]), np.array([p.deviation for p in parameters])
    low, high = (np.array([p.bounds[end] for p in parameters]) for end in (0, 1))

    def point(values: Array) -> dict[str, float]:
        return {p.name: float(v) for p, v in zip(parameters, values, strict=True)}

    def misfit(values: Array) -> Array:
        return np.concatenate([model.vector(point(values)) - model.observed, (values - null) / deviation])

    def slopes(values: Array) -> Array:
        own = np.array([model.derivative(point(values), p) for p in parameters])
        return np.concatenate([own.T, np.diag(1.0 / deviation)])

    inside = np.clip([start[p.name] for p in parameters], low + EDGE * deviation, high - EDGE * deviation)
    found = optimize.least_squares(
        misfit, inside, slopes, bounds=(low, high), x_scale=deviation, max_nfev=EVALUATIONS, ftol=1e-5, xtol=1e-6
    )
    # Evidence takes a parameter that the data push against a bound for held there.
    near = np.clip(found.x, low, high)
    near = np.where(near - low < 2 * EDGE * deviation, low, np.where(high - near < 2 * EDGE * deviation, high, near))
    return point(near)
