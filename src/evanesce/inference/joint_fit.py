"""What a joint fit is made of and what it found: causes, parameters, the most probable point, evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.gauss_newton import HELD, Prior, Solution
from evanesce.prediction.linear import Metric
from evanesce.prediction.parameters import Parameter

Array = NDArray[Any]


class Term(Protocol):
    """What the joint fit asks of a cause, be it an effect of the library or a mechanism of another list."""

    @property
    def id(self) -> str:
        """Its name."""

    @property
    def costly(self) -> bool:
        """Whether each evaluation takes seconds."""


@dataclass(frozen=True)
class Taken:
    """A cause in the joint fit.

    Attributes
    ----------
    cause : Term
    parameters : tuple of Parameter
        Free ones.
    slow : mapping of str to ndarray (bins,)
        Whitened derivatives of parameters whose evaluation takes seconds: between anchors they act linearly.
    """

    cause: Term
    parameters: tuple[Parameter, ...]
    slow: Mapping[str, Array] = field(default_factory=dict)

    @property
    def id(self) -> str:
        """Of the effect."""
        return self.cause.id


@dataclass(frozen=True)
class JointFit:
    """Causes and nuisances at their most probable values.

    Attributes
    ----------
    taken : tuple of Taken
    parameters : tuple of Parameter
        Of the causes, in order, then nuisances.
    point : mapping of str to float
    solution : Solution
    metric : Metric
        With the jitter of single views marginalised, and what was taken as unknown.
    residual : ndarray (d,)
        Whitened data less the prediction.
    fields : int
        How many of the metric's rows, the last ones, are those of something unknown.
    """

    taken: tuple[Taken, ...]
    parameters: tuple[Parameter, ...]
    point: Mapping[str, float]
    solution: Solution
    metric: Metric
    residual: Array
    fields: int = 0

    @property
    def nuisance_rows(self) -> Array:
        """The metric's rows (q, d) without those of something unknown."""
        return self.metric.rows[: len(self.metric.rows) - self.fields]

    def known_alone(self) -> JointFit:
        """Return the same fit where nothing unknown is marginalised, so that its misfit holds what is not explained."""
        if not self.fields:
            return self
        metric = Metric.of(self.nuisance_rows, np.ones(len(self.nuisance_rows)))
        grown = float(
            metric.project(self.residual) @ self.residual - self.metric.project(self.residual) @ self.residual
        )
        return replace(self, metric=metric, solution=replace(self.solution, misfit=self.misfit + grown), fields=0)

    def in_metric(self, metric: Metric) -> JointFit:
        """Return the same fit weighed in another metric.

        What a straight line promises to a better fit there does not count: one that is far off promises much.

        Parameters
        ----------
        metric : Metric
        """
        solution = self.solution.in_metric(metric, self.residual, prior_of(self.parameters))
        return replace(self, metric=metric, solution=solution)

    @property
    def misfit(self) -> float:
        """Squared residual in the metric, and the priors' squares."""
        return self.solution.misfit

    @property
    def ids(self) -> tuple[str, ...]:
        """Of the causes."""
        return tuple(t.id for t in self.taken)

    def without(self, *causes: str) -> dict[str, float]:
        """Return the point with some causes at their null."""
        return {name: value for name, value in self.point.items() if name.partition(":")[0] not in causes}

    def departures(self) -> Array:
        """Return the parameters' distances (n,) from their priors' means."""
        return self.solution.values - np.array([p.null for p in self.parameters])

    @property
    def log_evidence(self) -> float:
        """Log evidence by Laplace's approximation, up to what all fits of the same data share [nats].

        ``-(misfit + log det (D H D)) / 2`` with H the posterior's precision, D the prior standard deviations: the
        misfit holds the priors' squares already (MacKay, Information Theory, Inference, and Learning Algorithms, 2003,
        ch. 27).
        """
        return self.by_prior(np.array([p.deviation for p in self.parameters]))[0]

    def by_prior(self, deviation: Array) -> tuple[float, Array]:
        """Return the log evidence [nats] and the covariance (n, n) by other prior standard deviations, linear about it.

        Parameters
        ----------
        deviation : ndarray (n,)
            Of the parameters; what a bound holds stays.
        """
        free = np.flatnonzero(~self.solution.held)
        own = np.array([p.deviation for p in self.parameters])
        more = 1.0 / deviation**2 - 1.0 / own**2
        away = self.departures()
        precision = self.solution.precision + np.diag(more)
        inner, pull = precision[np.ix_(free, free)], (more * away)[free]
        misfit = self.misfit + float(more @ away**2) - float(pull @ np.linalg.solve(inner, pull))
        scaled = inner * np.outer(deviation[free], deviation[free])
        stiff = np.where(self.solution.held, HELD * np.diag(precision), 0.0)
        return -0.5 * (misfit + float(np.linalg.slogdet(scaled)[1])), np.linalg.inv(precision + np.diag(stiff))

    def of_cause(self, *causes: str) -> NDArray[np.int_]:
        """Return the places of some causes' parameters."""
        return np.flatnonzero([p.name.partition(":")[0] in causes for p in self.parameters])


def prior_of(parameters: Sequence[Parameter]) -> Prior:
    """Return the prior and the bounds of some parameters."""
    mean, deviation, low, high = (
        np.array(column)
        for column in zip(*((p.null, p.deviation, p.bounds[0], p.bounds[1]) for p in parameters), strict=True)
    )
    return Prior(mean, deviation, low, high)
