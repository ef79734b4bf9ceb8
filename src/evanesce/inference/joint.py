"""The joint fit: all parameters of all causes taken so far and the nuisances, at the fine model's optimum."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.inference.causes import Entry
from evanesce.inference.constants import FAR
from evanesce.inference.exact_slopes import exact_slopes
from evanesce.inference.gauss_newton import ROUNDS, Slopes, fit
from evanesce.inference.joint_fit import JointFit, Taken, prior_of
from evanesce.inference.model import Model
from evanesce.inference.slow import Linear, beyond, is_near, left_line, slow_rows, with_rows
from evanesce.prediction.linear import Metric
from evanesce.prediction.parameters import STEP_SHARE, Parameter, value_of

Array = NDArray[Any]

ANCHORS = 3
"""Fine evaluations of one fit at most."""
STAYED = 0.01
"""A fit has stayed where it was anchored if the misfit fell by less than this share since."""


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
            predict, jacobian, self.observed, prior_of(parameters), values, metric=metric, slopes=slopes, rounds=rounds,
            renewals=renewals,
        )  # fmt: skip
        residual = self.observed - solution.predicted
        taken = tuple(replace(t, slow={name: linear.rows[name] for name in t.slow}) for t in taken)
        return JointFit(taken, parameters, point_of(solution.values), solution, metric, residual, len(self.fields))

    def slopes_about(self, found: JointFit) -> Slopes:
        """Return the derivatives of a fit's parameters where it ended, as exactly as its intervals ask for.

        Parameters
        ----------
        found : JointFit
        """
        deviations = np.sqrt(np.diag(np.linalg.inv(found.solution.precision)))
        linear = Linear(found.taken, self._evaluated_at)
        widths = {p: float(w) for p, w in zip(found.parameters, deviations, strict=True) if p.name not in linear.rows}
        rows = linear.rows | exact_slopes(self.model, {**found.point, **linear.point}, widths)
        made = np.array([rows[p.name] for p in found.parameters], float)
        return Slopes(made, made)

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
                if p.name in linear.rows and beyond(point[p.name], linear.point[p.name], p.null, float(w))
            ]
            linear.point |= {name: point[name] for name in anew}
            parameters = [_over(p, STEP_SHARE * float(w)) for p, w in zip(parameters, width, strict=True)]
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
                self._evaluated_at = {name: point[name] if left_line(found, name, at) else at for name, at in lines}
                there = {**point, **self._evaluated_at}
                self.model.anchor(there)
            elif anchored:
                there = {**point, **Linear(taken, self._evaluated_at).point}
            else:
                there = self.stand(taken, point)
            taken = [self._secants(t, there) for t in taken]
            slopes = None if slopes is None else with_rows(slopes, taken, slow_rows(taken))
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
        known = {name: self._evaluated_at.get(name, np.nan) for name in slow_rows(taken)}
        near = {name: is_near(point[name], at, nulls[name]) for name, at in known.items()}
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
            and not (p.name in known and is_near(there[p.name], known[p.name], p.null))
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


def _over(parameter: Parameter, width: float) -> Parameter:
    """Return a parameter that is differentiated over no more than a posterior deviation, to one side."""
    return replace(parameter, step=width, one_sided=True) if width < parameter.step else parameter


def _misfit(found: JointFit) -> str:
    return f"misfit {found.misfit:.6g} of {found.residual.size} bins and rows"


def taken_from(entry: Entry) -> Taken:
    """Return a cause as it stands in a joint fit; of a costly one the first amplitude alone is free."""
    cause = entry.cause
    if not cause.costly:
        return Taken(cause, cause.parameters)
    grown = next(p for p in cause.parameters if p.name in cause.amplitudes and p.name in entry.start)
    return Taken(cause, (grown,), {grown.name: entry.rows[0] / (entry.start[grown.name] - grown.null)})


def _bounded(parameter: Parameter) -> Parameter:
    """Return a nuisance that stays within what its prior allows, so that a wrong model cannot drive it astray."""
    reach = FAR * parameter.deviation
    return replace(parameter, bounds=(parameter.null - reach, parameter.null + reach))
