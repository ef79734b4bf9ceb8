"""The joint fit: all parameters of all causes taken so far and the nuisances, at the fine model's optimum."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.inference.causes import Entry
from evanesce.inference.constants import FAR
from evanesce.inference.gauss_newton import HELD, ROUNDS, Prior, Slopes, Solution, fit
from evanesce.inference.model import Model
from evanesce.prediction.linear import Metric
from evanesce.prediction.parameters import Parameter, value_of

Array = NDArray[Any]

ANCHORS = 3
"""Fine evaluations of one fit at most."""
STAYED = 0.01
"""A fit has stayed where it was anchored if the misfit fell by less than this share since."""


LINEAR, LINEAR_SHARE = 0.5, 0.1
"""Over so many posterior standard deviations, or over that share of its distance from null, a parameter whose
evaluation takes seconds acts linearly (assumed: forms of other light hardly depend on how much there is of it)."""


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
        """Return the fit that has least misfit in another metric, linear about this one.

        Parameters
        ----------
        metric : Metric
        """
        step, solution = self.solution.in_metric(metric, self.residual, _prior(self.parameters))
        point = {**self.point, **{p.name: float(v) for p, v in zip(self.parameters, solution.values, strict=True)}}
        residual = self.residual - step @ self.solution.rows
        return replace(self, metric=metric, solution=solution, point=point, residual=residual)

    @property
    def misfit(self) -> float:
        """Squared residual in the metric, and the priors' squares."""
        return self.solution.misfit

    @property
    def ids(self) -> tuple[str, ...]:
        """Of the causes."""
        return tuple(t.id for t in self.taken)

    def without(self, cause: str) -> dict[str, float]:
        """Return the point with one cause at its null."""
        return {name: value for name, value in self.point.items() if not name.startswith(f"{cause}:")}

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

    def of_cause(self, cause: str) -> NDArray[np.int_]:
        """Return the places of a cause's parameters."""
        return np.flatnonzero([p.name.startswith(f"{cause}:") for p in self.parameters])


class Linear:
    """Parameters whose evaluation takes seconds, linear about where they were evaluated last.

    Parameters
    ----------
    taken : sequence of Taken
        Causes with whitened derivatives (d,) by such parameters.
    evaluated : mapping of str to float
        Where, of these parameters and others; what was evaluated nowhere yet is at its null.
    """

    def __init__(self, taken: Sequence[Taken], evaluated: Mapping[str, float]) -> None:
        self.rows = _slow(taken)
        nulls = {p.name: p.null for t in taken for p in t.parameters}
        self.point = {name: evaluated.get(name, nulls[name]) for name in self.rows}

    def predicted(self, model: Model, point: Mapping[str, float]) -> Array:
        """Return the whitened prediction (d,) at a point."""
        found = model.vector({**point, **self.point})
        for name, row in self.rows.items():
            found = found + (point[name] - self.point[name]) * row
        return np.asarray(found)


class Fitter:
    """Fits causes jointly.

    Parameters
    ----------
    model : Model
    """

    fields: Array = np.zeros((0, 0), np.float32)
    """Rows (k, d) of what was taken as unknown, each of unit prior standard deviation: marginalised in every fit."""
    noise: Array = np.zeros((0, 0), np.float32)
    """Rows (k, d) of noise that hangs together, each of unit standard deviation, beside that of the data."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.observed = model.observed
        every = model.nuisances()
        self.nuisances = tuple(_bounded(p) for p in every if not p.linear)
        self.jitter = tuple(p for p in every if p.linear)
        self._evaluated_at: dict[str, float] = {}
        self._differentiated_at: dict[str, float] = {}

    def fitted(
        self,
        taken: Sequence[Taken],
        start: Mapping[str, float],
        *,
        metric: Metric,
        slopes: Slopes | None = None,
        rounds: int = ROUNDS,
        renewals: int = 1,
    ) -> JointFit:
        """Return the joint fit about the present anchor.

        Parameters
        ----------
        taken : sequence of Taken
        start : mapping
        metric : Metric
        slopes, rounds, renewals
            See :func:`evanesce.inference.gauss_newton.fit`.
        """
        parameters = (*(p for t in taken for p in t.parameters), *self.nuisances)
        linear = Linear(taken, self._evaluated_at)

        def point_of(values: Array) -> dict[str, float]:
            return {**start, **{p.name: float(v) for p, v in zip(parameters, values, strict=True)}}

        def predict(values: Array) -> Array:
            return linear.predicted(self.model, point_of(values))

        def jacobian(values: Array, predicted: Array, width: Array | None) -> tuple[Array, Array]:
            rows = self._jacobian(parameters, point_of(values), linear, width)
            return rows, predict(values) if width is not None and linear.rows else predicted

        values = np.array([value_of(start, p) for p in parameters])
        solution = fit(
            predict, jacobian, self.observed, _prior(parameters), values, metric=metric, slopes=slopes, rounds=rounds,
            renewals=renewals,
        )  # fmt: skip
        residual = self.observed - solution.predicted
        taken = tuple(replace(t, slow={name: linear.rows[name] for name in t.slow}) for t in taken)
        return JointFit(taken, parameters, point_of(solution.values), solution, metric, residual, len(self.fields))

    def slopes_about(self, found: JointFit) -> Slopes:
        """Return the derivatives of a fit's parameters where it ended, over steps that their priors allow.

        The slope at a point says little of how far a parameter may be whose law bends within its posterior: adhesion
        goes by a root, and is never as well determined as its slope near nothing promises.

        Parameters
        ----------
        found : JointFit
        """
        rows = self._jacobian(found.parameters, found.point, Linear(found.taken, self._evaluated_at), None)
        return Slopes(rows, rows)

    def _jacobian(
        self, parameters: Sequence[Parameter], point: Mapping[str, float], linear: Linear, width: Array | None
    ) -> Array:
        """Return whitened derivatives (n, d), with a width (n,) over no more than that.

        Those by what takes seconds are made anew where, by that width, their straight line does not reach.
        """
        anew: list[str] = []
        if width is not None:
            anew = [
                p.name
                for p, w in zip(parameters, width, strict=True)
                if p.name in linear.rows and _beyond(point[p.name], linear.point[p.name], p.null, float(w))
            ]
            linear.point |= {name: point[name] for name in anew}
            parameters = [_over(p, float(w)) for p, w in zip(parameters, width, strict=True)]
        asked = [p for p in parameters if p.name not in linear.rows or p.name in anew]
        # What takes longest first: processes that share the work end together.
        made = self._derivatives({**point, **linear.point}, sorted(asked, key=lambda p: p.name not in anew))
        linear.rows |= {name: made[name] for name in anew}
        for places in (self._evaluated_at, self._differentiated_at):
            places |= {name: point[name] for name in anew}
        return np.array([linear.rows[p.name] if p.name in linear.rows else made[p.name] for p in parameters], float)

    def predicted(self, point: Mapping[str, float], taken: Sequence[Taken]) -> Array:
        """Return the whitened prediction (bins,) with some causes; those whose evaluation takes seconds act linearly.

        Raises
        ------
        InputError
            If the rig cannot have these values.
        """
        return Linear(taken, self._evaluated_at).predicted(self.model, point)

    def relinearised(
        self,
        taken: Sequence[Taken],
        start: Mapping[str, float],
        known: Mapping[str, Array] | Slopes | None = None,
        tell: Callable[[str], None] = lambda line: None,
        anchors: int = ANCHORS,
        rounds: int = ROUNDS,
        renewals: int = 1,
        anchored: bool = False,
    ) -> JointFit:
        """Return the joint fit at the fine model's optimum: anchored and differentiated anew until it stays.

        Parameters
        ----------
        taken : sequence of Taken
        start : mapping
        known : mapping of str to ndarray (bins,), or Slopes, optional
            Whitened derivatives at the start, by parameter: a step is tried by them before any is made anew.
        tell : callable
            Told how far it is, with the time left.
        anchors : int
            Fine evaluations at most.
        rounds, renewals : int
            After each, see :func:`evanesce.inference.gauss_newton.fit`.
        anchored : bool
            Begin about the present anchor: good enough for a fit that will go far from its start.

        Raises
        ------
        InputError
            If the rig cannot have the values of the start.
        """
        point = dict(start)
        slopes = known if isinstance(known, Slopes) else None
        found: JointFit | None = None
        began = time.monotonic()
        for number in range(anchors):
            if found is not None:
                left = (anchors - number) * (time.monotonic() - began) / number
                tell(f"{_misfit(found)} after pass {number} of {anchors} at most; some {left:.0f} s left")
                lines = Linear(taken, self._evaluated_at).point.items()
                self._evaluated_at = {name: point[name] if _left(found, name, at) else at for name, at in lines}
                there = {**point, **self._evaluated_at}
                self.model.anchor(there)
            elif anchored:
                there = {**point, **Linear(taken, self._evaluated_at).point}
            else:
                there = self.stand(taken, point)
            taken = [self._secants(t, there) for t in taken]
            slopes = None if slopes is None else _with_rows(slopes, taken, _slow(taken))
            metric = self.jitter_metric(there)
            metric = metric.with_rows(self.fields) if len(self.fields) else metric
            if slopes is None and known is not None and not isinstance(known, Slopes):
                parameters = (*(p for t in taken for p in t.parameters), *self.nuisances)
                made = self._derivatives(there, [p for p in parameters if p.name not in known])
                rows = [known[p.name] if p.name in known else made[p.name] for p in parameters]
                slopes = Slopes(np.array(rows, float))
            # An anchor moves the prediction, not its derivatives: those of the last serve until they gain no more.
            found = self.fitted(taken, point, metric=metric, slopes=slopes, rounds=rounds, renewals=renewals)
            slopes, taken = found.solution.slopes, found.taken
            self.model.unexplained = float(np.sqrt(max(found.misfit - self.observed.size, 0.0)))
            before = self.observed - self.predicted(point, taken)
            first = float(metric.project(before) @ before)
            point = dict(found.point)
            if first - found.misfit < max(STAYED * (found.misfit - self.observed.size), 1.0):
                break
        assert found is not None  # there is more than no anchor
        tell(_misfit(found))
        return found

    def stand(self, taken: Sequence[Taken], point: Mapping[str, float]) -> dict[str, float]:
        """Anchor the model at some causes' point, and return where it was evaluated.

        What takes seconds stays where it was evaluated before, as far as a straight line reaches.
        """
        nulls = {p.name: p.null for t in taken for p in t.parameters}
        known = {name: self._evaluated_at.get(name, np.nan) for name in _slow(taken)}
        near = {name: _near(point[name], at, nulls[name]) for name, at in known.items()}
        self._evaluated_at = {name: at if near[name] else point[name] for name, at in known.items()}
        there = {**point, **self._evaluated_at}
        self.model.anchor(there)
        return there

    def _secants(self, taken: Taken, there: Mapping[str, float]) -> Taken:
        """Return a cause whose parameters that take seconds act along the line from null to where they were evaluated.

        Beside other causes that line is another one than about the nominal rig. A derivative that was made there stays.
        """
        known = self._differentiated_at
        nulls = {
            p.name: p.null
            for p in taken.parameters
            if p.name in taken.slow
            and there[p.name] != p.null
            and not (p.name in known and _near(there[p.name], known[p.name], p.null))
        }
        if not nulls:
            return taken
        here = self.model.vector(there)
        rows = {
            name: np.asarray((here - self.model.vector({**there, name: null})) / (there[name] - null), np.float32)
            for name, null in nulls.items()
        }
        return replace(taken, slow={**taken.slow, **rows})

    def derivatives(self, point: Mapping[str, float], parameters: Sequence[Parameter]) -> list[Array]:
        """Return whitened derivatives (bins,) at a point, in the order of some parameters.

        Raises
        ------
        InputError
            If the rig cannot have one.
        """
        return list(self._derivatives(point, parameters).values())

    def _derivatives(self, point: Mapping[str, float], parameters: Sequence[Parameter]) -> dict[str, Array]:
        """Return whitened derivatives (bins,) at a point, by parameter."""
        found: dict[str, Array] = {}
        for parameter, row in zip(parameters, self.model.derivatives([(point, p) for p in parameters]), strict=True):
            if isinstance(row, InputError):
                raise row
            found[parameter.name] = row
        return found

    def jitter_metric(self, point: Mapping[str, float]) -> Metric:
        """Return the inner product with the light and load of single views, and noise that hangs together."""
        rows = np.array(list(self._derivatives(point, self.jitter).values())).reshape(-1, self.observed.size)
        metric = Metric.of(rows, np.array([p.deviation for p in self.jitter]))
        return metric.with_rows(self.noise) if len(self.noise) else metric


def _with_rows(slopes: Slopes, taken: Sequence[Taken], rows: Mapping[str, Array]) -> Slopes:
    """Return derivatives of causes' parameters, then of nuisances, with some rows replaced."""
    names = [p.name for t in taken for p in t.parameters]
    if not any(name in rows for name in names):
        return slopes
    found = slopes.rows.copy()
    for name, row in rows.items():
        found[names.index(name)] = row
    return replace(slopes, rows=found, made=found if slopes.fresh else slopes.made)


def _over(parameter: Parameter, width: float) -> Parameter:
    """Return a parameter that is differentiated over no more than a posterior deviation, to one side."""
    return replace(parameter, step=width, one_sided=True) if width < parameter.step else parameter


def _left(fitted: JointFit, name: str, evaluated: float) -> bool:
    """Return whether a fit has moved a parameter from where it was evaluated by more than its line reaches."""
    place = [p.name for p in fitted.parameters].index(name)
    sd = float(np.sqrt(fitted.solution.covariance[place, place]))
    return _beyond(fitted.point[name], evaluated, fitted.parameters[place].null, sd)


def _beyond(value: float, evaluated: float, null: float, width: float) -> bool:
    """Return whether a value is farther from where a parameter was evaluated than a straight line reaches."""
    return abs(value - evaluated) > LINEAR * width and not _near(value, evaluated, null)


def _near(value: float, evaluated: float, null: float) -> bool:
    """Return whether a value is as near where a parameter was evaluated as a straight line reaches."""
    return bool(abs(value - evaluated) <= LINEAR_SHARE * abs(evaluated - null))


def _misfit(found: JointFit) -> str:
    return f"misfit {found.misfit:.6g} of {found.residual.size} bins and rows"


def _slow(taken: Sequence[Taken]) -> dict[str, Array]:
    """Return the derivatives (bins,) of parameters whose evaluation takes seconds, by name."""
    return {name: row for t in taken for name, row in t.slow.items()}


def taken_from(entry: Entry) -> Taken:
    """Return a cause as it stands in a joint fit; of a costly one the first amplitude alone is free."""
    cause = entry.cause
    if not cause.costly:
        return Taken(cause, cause.parameters)
    grown = next(p for p in cause.parameters if p.name in cause.amplitudes and p.name in entry.start)
    return Taken(cause, (grown,), {grown.name: entry.rows[0] / (entry.start[grown.name] - grown.null)})


def _prior(parameters: Sequence[Parameter]) -> Prior:
    mean, deviation, low, high = (
        np.array(column)
        for column in zip(*((p.null, p.deviation, p.bounds[0], p.bounds[1]) for p in parameters), strict=True)
    )
    return Prior(mean, deviation, low, high)


def _bounded(parameter: Parameter) -> Parameter:
    """Return a nuisance that stays within what its prior allows, so that a wrong model cannot drive it astray."""
    reach = FAR * parameter.deviation
    return replace(parameter, bounds=(parameter.null - reach, parameter.null + reach))
