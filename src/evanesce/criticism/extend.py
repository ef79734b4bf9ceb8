"""Nested fits: each promising candidate fitted for good, its evidence, and what it predicts of conditions left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.criticism.gain import leave_one_out
from evanesce.criticism.isolability import Cause
from evanesce.criticism.parameters import Parameter, moved, value_of
from evanesce.criticism.problem import Fit, Problem, fit, predicted_part
from evanesce.criticism.score import Scored, metric_of

Array = NDArray[Any]

ROUNDS = 4
NEAR_BOUND = 1e-3
"""Of the bounds' width."""


@dataclass(frozen=True)
class Extension:
    """A base model with one more candidate, fitted.

    Attributes
    ----------
    ids : tuple of str
        Effects beyond the believed rig.
    fitted : Fit
    parameters : tuple of Parameter
        Of those effects.
    log_bayes : float
        Laplace evidence over the model without any of them.
    gain, gain_error : float
        Log predictive score of conditions left out over the base model, and its standard error.
    inflation : float
        Of the candidates' scores under drawn noise.
    cause : Cause
        Of the last candidate, for distances.
    """

    ids: tuple[str, ...]
    fitted: Fit
    parameters: tuple[Parameter, ...]
    log_bayes: float
    gain: float
    gain_error: float
    inflation: float
    cause: Cause

    @property
    def within_bounds(self) -> bool:
        """Whether no parameter lies at a bound that is not its null."""
        for p in self.parameters:
            value, (low, high) = value_of(self.fitted.point, p), p.bounds
            margin = NEAR_BOUND * (high - low)
            if min(value - low, high - value) < margin and abs(value - p.null) > margin:
                return False
        return True


def extend(problem: Problem, base: Fit, known: Extension | None, scored: Scored) -> Extension:
    """Fit one candidate on top of a base model.

    Parameters
    ----------
    problem : Problem
    base : Fit
    known : Extension, optional
        What the base model already has beyond the believed rig.
    scored : Scored
        The candidate's score test against that base.
    """
    candidate = scored.signature.candidate
    nuisances = tuple(p for p in base.parameters if p.name not in candidate.names)
    start, rows = _entry(problem, base, scored)
    parameters = (*candidate.parameters, *nuisances)
    kept = [k for k, p in enumerate(base.parameters) if p.name not in candidate.names]
    fitted = fit(
        problem,
        parameters,
        start,
        rows=np.concatenate([rows, base.rows[kept]]),
        rounds=ROUNDS,
        secant=True,
    )
    of_effects = tuple(p for p in parameters if not p.name.startswith("@"))
    deviations = np.array([p.deviation for p in candidate.parameters])
    own = fitted.rows[: len(candidate.parameters)]
    metric = fitted.metric(nuisances)
    information = metric.gram(own) / scored.inflation
    occam = -0.5 * float(np.linalg.slogdet(np.eye(len(deviations)) + information * np.outer(deviations, deviations))[1])
    improved = 0.5 * (base.misfit - fitted.misfit) / scored.inflation
    gain, error = held_out_gain(problem, base, fitted)
    without = {p.name: p.null for p in candidate.parameters}
    cube = problem.predictor.cube(predicted_part(moved(fitted.point, without), parameters), problem.views)
    signal = problem.whitened(fitted.predicted - cube)
    return Extension(
        ids=(*(known.ids if known else ()), candidate.id),
        fitted=fitted,
        parameters=of_effects,
        log_bayes=(known.log_bayes if known else 0.0) + improved + occam,
        gain=gain,
        gain_error=error,
        inflation=scored.inflation,
        cause=Cause(candidate.id, signal, own, deviations),
    )


def _entry(problem: Problem, base: Fit, scored: Scored) -> tuple[dict[str, float], Array]:
    """Return where a fit enters a candidate, and the derivatives by its parameters there (or secants to there)."""
    candidate = scored.signature.candidate
    if scored.start < 0:
        values = {
            p.name: float(np.clip(p.null + e, *p.bounds))
            for p, e in zip(candidate.parameters, scored.result.estimate, strict=True)
        }
        return moved(base.point, values), scored.signature.rows
    start = dict(candidate.starts[scored.start])
    amplitude = float(np.clip(scored.result.estimate[0], 0.02, 5.0))
    names = {f"{candidate.id}:{n}" for n in candidate.effect.amplitudes}
    grown = [p for p in candidate.parameters if p.name in names and p.name in start]
    for p in grown[:1]:
        start[p.name] = float(np.clip(p.null + amplitude * (start[p.name] - p.null), *p.bounds))
    point = moved(base.point, start)
    from evanesce.criticism.problem import derivatives

    return point, derivatives(problem, point, candidate.parameters)


def held_out_gain(problem: Problem, base: Fit, extended: Fit) -> tuple[float, float]:
    """Return the log predictive gain of conditions left out one by one, and its standard error over conditions."""
    groups = condition_of_bins(problem)
    scores = []
    for one in (extended, base):
        deviations = np.array([p.deviation for p in one.parameters])
        away = np.array([value_of(one.point, p) - p.null for p in one.parameters])
        scores.append(leave_one_out(one.rows, one.residual, deviations, away, groups))
    difference = scores[0] - scores[1]
    count = difference.size
    error = float(np.sqrt(count) * difference.std(ddof=1)) if count > 1 else float("inf")
    return float(difference.sum()), error


def condition_of_bins(problem: Problem) -> NDArray[np.int_]:
    """Return the number of each whitened bin's condition; auxiliary shots are conditions of their own."""
    labels: dict[tuple[object, ...], int] = {}
    numbers = []
    for view in problem.kinds:
        key = ("press", view.condition) if view.kind in ("press", "replicate") else (view.kind,)
        numbers.append(labels.setdefault(key, len(labels)))
    counts = problem.valid[list(problem.views)].sum(axis=(1, 2))
    return np.repeat(numbers, counts)


def intervals(extension: Extension, level: float = 0.90) -> dict[str, dict[str, object]]:
    """Return each effect parameter's value with its interval, by its name."""
    from scipy import stats

    sd = np.sqrt(np.diag(extension.fitted.covariance(extension.inflation)))
    names = [p.name for p in extension.fitted.parameters]
    reach = float(stats.norm.ppf(0.5 + level / 2))
    found: dict[str, dict[str, object]] = {}
    for p in extension.parameters:
        value, half = value_of(extension.fitted.point, p), reach * float(sd[names.index(p.name)])
        found[p.name] = {
            "value": value,
            "lo": max(value - half, p.bounds[0]),
            "hi": min(value + half, p.bounds[1]),
            "unit": p.unit,
        }
    return found


def causes(extensions: Sequence[Extension]) -> list[Cause]:
    """Return the last candidates of extensions."""
    return [e.cause for e in extensions]


__all__ = ["Extension", "causes", "condition_of_bins", "extend", "held_out_gain", "intervals", "metric_of"]
