"""Nested fits: each promising candidate fitted for good, its evidence, and what it predicts of conditions left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from evanesce.core.errors import InputError
from evanesce.criticism.blots import MOVES, STRIPED, left_of_spot
from evanesce.criticism.isolability import Cause
from evanesce.criticism.marks import BESIDE, left_at_places, left_beside
from evanesce.criticism.problem import Fit, Problem, derivatives, fit, predicted_part
from evanesce.criticism.score import Scored, from_belief, inflation_along, metric_of
from evanesce.effects import Context, Stage, active_effects, apply_stage
from evanesce.prediction.candidates import Candidate
from evanesce.prediction.frozen import FROZEN
from evanesce.prediction.observe import DWELL_FRAMES
from evanesce.prediction.parameters import Parameter, moved, value_of
from evanesce.prediction.predict import scene_with
from evanesce.prediction.scores import leave_one_out
from evanesce.rig import Scene

Array = NDArray[Any]

ROUNDS = 6
HOLD_PARTS = 3
"""In which a hold is left out."""
AMPLITUDES = (0.02, 5.0)
"""Of a start, within which a fit enters."""
MOST_STARTS, NEAR_START = 4, 0.3
"""Starts from which a fit is tried, and the share of the best one's statistic that they need."""
NEARER = 0.2
"""Share of the way from null to where a fit enters, for a second try."""
NEAR_BOUND, NEAR_BOUND_DEVIATIONS = 1e-3, 0.01
"""How near a bound a fit counts as ended there: of the bounds' width, and of the prior's standard deviation, whichever
is less. Bounds are set where nothing makes sense beyond, decades from what is plausible: a thousandth of the width of a
warm-up's time constant is 10 s."""


@dataclass(frozen=True)
class Extension:
    """A base model with one more candidate, fitted.

    Attributes
    ----------
    ids : tuple of str
        Effects beyond the believed rig.
    problem : Problem
        Whose predictor it was fitted by: that of all, or one put right where this very fit ended.
    fitted : Fit
    parameters : tuple of Parameter
        Of those effects.
    log_bayes : float
        Laplace evidence over the model without any of them.
    gain, gain_error : float
        Log predictive score of conditions left out over the base model, and its standard error.
    inflation : float
        Variance of drawn noise along the fitted change over what white noise would have there.
    cause : Cause
        Of the last candidate, for distances.
    at_places : mapping of str to float
        For places taken from the data: what is left there in each kind of shot, and about them [standard deviations].
    improved : float
        Log likelihood, priors of what was fitted included, over that of the base model: what it explains, whatever its
        own parameters cost.
    """

    ids: tuple[str, ...]
    problem: Problem
    fitted: Fit
    parameters: tuple[Parameter, ...]
    log_bayes: float
    gain: float
    gain_error: float
    inflation: float
    cause: Cause
    at_places: Mapping[str, float] = field(default_factory=dict)
    improved: float = 0.0

    @property
    def possible(self) -> bool:
        """Whether the fit is off its bounds and its marks go from shot to shot as such marks do."""
        return self.within_bounds and self.goes_as_its_marks_do

    @property
    def goes_as_its_marks_do(self) -> bool:
        """Whether nothing at the listed places or about them tells that they are other marks than named."""
        beside = [z for name, z in self.at_places.items() if name.startswith(BESIDE)]
        moves = [z for name, z in self.at_places.items() if name.startswith(MOVES)]
        striped = [z for name, z in self.at_places.items() if name == STRIPED]
        at = [z for name, z in self.at_places.items() if not name.startswith((BESIDE, STRIPED, MOVES))]
        # Of loud marks the form alone, which no library knows to a few per cent, leaves that much.
        form = FROZEN.levels["places_form"] * 2.0 * max(self.log_bayes, 0.0)

        # One spot of any size is a shape that much else has, where a list of places is its marks' own.
        least = FROZEN.levels["spot_p" if moves else "places_p"]

        def alike(values: Sequence[float]) -> bool:
            left = float(np.square(values).sum())
            return left < form or float(stats.chi2.sf(left, max(len(values), 1))) > least

        within = [(FROZEN.levels["beside_left"], beside), (FROZEN.levels["spot_striped"], striped)]
        still = all(abs(z) < max(most, np.sqrt(form)) for most, values in within for z in values)
        return alike(at) and alike(moves) and still

    @property
    def within_bounds(self) -> bool:
        """Whether no parameter lies at a bound that is not its null."""
        return not any(at_bound(p, value_of(self.fitted.point, p)) for p in self.parameters)


def at_bound(parameter: Parameter, value: float) -> bool:
    """Tell whether a value lies at a bound that is not the parameter's null."""
    low, high = parameter.bounds
    margin = min(NEAR_BOUND * (high - low), NEAR_BOUND_DEVIATIONS * parameter.deviation)
    return min(value - low, high - value) < margin and abs(value - parameter.null) > margin


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
    own_parameters, start, rows = _entry(problem, base, scored)
    kept = [k for k, p in enumerate(base.parameters) if p.name not in candidate.names]
    whole = np.concatenate([rows, base.rows[kept]])
    every = (*own_parameters, *nuisances)
    fitted = fit(problem, every, start, rows=whole, rounds=ROUNDS, secant=True)
    if fitted.misfit > base.misfit:
        # Worse than nothing: a straight line has put it where it bends too much to find back.
        near = _nearer(candidate, scored, own_parameters, start)
        again = fit(problem, every, moved(start, near), rows=whole, rounds=ROUNDS, secant=True)
        fitted = min(fitted, again, key=lambda f: f.misfit)
    if any(not p.linear and not np.any(row) for p, row in zip(own_parameters, rows, strict=True)):
        freed = _with_shapes(problem, fitted, len(own_parameters))
        # What they cannot say within their bounds is left unsaid.
        if not any(at_bound(p, value_of(freed.point, p)) for p in own_parameters):
            fitted = freed
    return _judged(problem, base, known, scored, fitted, len(own_parameters))


def _nearer(
    candidate: Candidate, scored: Scored, own_parameters: Sequence[Parameter], start: Mapping[str, float]
) -> dict[str, float]:
    """Return a candidate's values at a share of the way from null to where a fit entered.

    Of one with starts the amplitudes alone: its rows are those of the start's own place and shape.
    """
    names = {f"{candidate.id}:{name}" for name in candidate.effect.amplitudes}
    return {
        p.name: p.null + NEARER * (value_of(start, p) - p.null)
        for p in own_parameters
        if scored.start < 0 or p.name in names
    }


def _with_shapes(problem: Problem, fitted: Fit, count: int) -> Fit:
    """Return a fit with those of its first parameters freed of which nothing could be said: shapes of what is nothing.

    Only where the amplitude has been fitted do they change anything. It goes with some of them, so that its own
    derivative has to be as exact as theirs.
    """
    rows, at = np.array(fitted.rows), predicted_part(fitted.point, fitted.parameters)
    rows[:count] = derivatives(problem, at, fitted.parameters[:count], fitted.predicted)
    return fit(
        problem, fitted.parameters, fitted.point, rows=rows, predicted=fitted.predicted, rounds=ROUNDS, secant=True
    )


def extend_again(problem: Problem, base: Fit, known: Extension | None, scored: Scored, found: Extension) -> Extension:
    """Fit an extension again from where it ended, by another predictor of the same data."""
    fitted = fit(
        problem, found.fitted.parameters, found.fitted.point, rows=found.fitted.rows, rounds=ROUNDS, secant=True
    )
    return _judged(problem, base, known, scored, fitted, len(found.cause.deviations))


def _judged(problem: Problem, base: Fit, known: Extension | None, scored: Scored, fitted: Fit, count: int) -> Extension:
    """Return what a fit says of a candidate, whose ``count`` parameters are its first."""
    candidate = scored.signature.candidate
    own_parameters, nuisances = fitted.parameters[:count], fitted.parameters[count:]
    deviations = np.array([p.deviation for p in own_parameters])
    own = fitted.rows[:count]
    metric = fitted.metric(nuisances)
    signal = _signal(problem, fitted, own_parameters)
    inflation = inflation_along(problem, base, signal)
    information = metric.gram(own) / inflation
    occam = -0.5 * float(np.linalg.slogdet(np.eye(count) + information * np.outer(deviations, deviations))[1])
    if scored.start >= 0:
        occam -= float(np.log(len(candidate.starts))) + candidate.penalty
    improved = 0.5 * (base.misfit - fitted.misfit) / inflation
    gain, error = held_out_gain(problem, base, fitted, count, inflation)
    at_places: dict[str, float] = {}
    effect, left = candidate.effect, fitted.residual / np.sqrt(inflation)
    if effect.marks is not None or effect.line is not None or effect.blot is not None:
        at_places = left_at_places(problem, signal, left)
    if effect.marks is not None or effect.line is not None:
        at_places |= left_beside(problem, signal, left)
    if effect.blot is not None:
        at_places |= left_of_spot(problem, metric_of(fitted), signal, left)
    return Extension(
        ids=(*(known.ids if known else ()), candidate.id),
        problem=problem,
        fitted=fitted,
        parameters=tuple(p for p in fitted.parameters if not p.name.startswith("@")),
        log_bayes=(known.log_bayes if known else 0.0) + improved + occam,
        gain=gain,
        gain_error=error,
        inflation=inflation,
        cause=Cause(candidate.id, signal, own, deviations),
        at_places=at_places,
        improved=improved,
    )


def _signal(problem: Problem, fitted: Fit, own: Sequence[Parameter]) -> Array:
    """Return the whitened change that a fitted candidate makes."""
    values = np.array([value_of(fitted.point, p) - p.null for p in own])
    if all(p.linear for p in own):
        return np.asarray(values @ fitted.rows[: len(own)])
    without = moved(predicted_part(fitted.point, fitted.parameters), {p.name: p.null for p in own})
    return problem.whitened(fitted.predicted - problem.predictor.cube(without, problem.views))


def _entry(problem: Problem, base: Fit, scored: Scored) -> tuple[tuple[Parameter, ...], dict[str, float], Array]:
    """Return a candidate's parameters, where a fit enters it, and the derivatives there.

    One that changes the plate's own light costs seconds for each prediction, so it is scaled along its signature.
    """
    candidate = scored.signature.candidate
    costly = changes_plate_light(problem, candidate)
    if scored.start < 0:
        parameters = tuple(replace(p, linear=True) if costly else p for p in candidate.parameters)
        values = {
            p.name: float(np.clip(p.null + e, *p.bounds))
            for p, e in zip(candidate.parameters, scored.result.estimate, strict=True)
        }
        return parameters, moved(base.point, values), scored.signature.rows
    names = {f"{candidate.id}:{n}" for n in candidate.effect.amplitudes}
    first = candidate.starts[scored.start]
    grown = next(p for p in candidate.parameters if p.name in names and p.name in first)

    def entered(number: int, share: float) -> dict[str, float]:
        start = candidate.starts[number]
        value = float(np.clip(grown.null + share * (start[grown.name] - grown.null), *grown.bounds))
        return moved(base.point, {**start, grown.name: value})

    amplitude = float(np.clip(scored.result.estimate[0], *AMPLITUDES))
    if costly:
        rows = scored.signature.rows[[scored.start]] / (first[grown.name] - grown.null)
        return (replace(grown, linear=True),), entered(scored.start, amplitude), rows
    # What begins beyond a threshold is silent where a straight line would have it.
    points = [
        entered(number, share)
        for number, along in _promising_starts(base, scored).items()
        for share in (along, 0.5 * (along + 1.0), 1.0)
    ]
    point = _least_left(problem, base, points)
    at = predicted_part(point, base.parameters)
    return candidate.parameters, point, derivatives(problem, at, candidate.parameters)


def _promising_starts(base: Fit, scored: Scored) -> dict[int, float]:
    """Return the starts whose straight line says nearly as much as the best one's, with their amplitudes."""
    size = np.maximum(np.diag(scored.information), 1e-300)
    gradient = metric_of(base).project(scored.signature.rows) @ from_belief(base)
    told = np.maximum(gradient, 0.0) ** 2 / size
    amplitude = np.clip(gradient / (size + 1.0), *AMPLITUDES)
    ranked = np.argsort(-told)[:MOST_STARTS]
    return {int(k): float(amplitude[k]) for k in ranked if told[k] >= NEAR_START * told.max()}


def _least_left(problem: Problem, base: Fit, points: Sequence[dict[str, float]]) -> dict[str, float]:
    """Return the point that leaves least once the base model's nuisances have taken what they may."""
    metric = metric_of(base)
    left = []
    for point in points:
        cube = problem.predictor.cube(predicted_part(point, base.parameters), problem.views)
        residual = base.residual - problem.whitened(cube - base.predicted)
        left.append(float(metric.project(residual) @ residual))
    return points[int(np.argmin(left))]


def changes_plate_light(problem: Problem, candidate: Candidate) -> bool:
    """Tell whether a candidate changes what the guided light depends on beside the LEDs' powers."""
    if candidate.effect.stage is not Stage.RIG:
        return False
    scene = problem.predictor.scene
    point = dict(candidate.starts[0]) if candidate.starts else {p.name: p.null + p.step for p in candidate.parameters}
    changed = scene_with(scene, point)
    try:
        rig = apply_stage(Stage.RIG, changed, active_effects(changed), Context(changed, 0))
    except InputError:
        return False

    def guide(of: Scene) -> tuple[object, ...]:
        finger = of.finger.refractive_index, of.finger.diffuse_reflectance
        return repr(of.plate), of.leds.air_gap_share, of.leds.emitting_width_mm, of.leds.emitting_height_mm, finger

    return guide(rig) != guide(scene)


def held_out_gain(problem: Problem, base: Fit, extended: Fit, own: int, inflation: float) -> tuple[float, float]:
    """Return the log predictive gain of conditions left out one by one, and the error that noise alone gives it.

    The difference of two squared residuals is linear in the noise, with the distance of the two predictions as its
    standard deviation. A scatter over conditions would call a gain uncertain because it is larger in some of them.

    What is known of the nuisances beforehand is data as well, and counts with what either model leaves of it: a black
    level of eight deviations predicts the frames left out as well as the effect would that it stands in for.

    Parameters
    ----------
    problem : Problem
    base, extended : Fit
    own : int
        How many of the extended fit's parameters, its first, are the candidate's.
    inflation : float
    """
    groups = condition_of_bins(problem)
    # What a fit learnt of the nuisances' derivatives on its way is no gain: the same serve both.
    shared = extended.rows[own:] if len(extended.rows) - own == len(base.rows) else base.rows
    scores = []
    for one, rows in ((extended, extended.rows), (base, shared)):
        deviations = np.array([p.deviation for p in one.parameters])
        away = np.array([value_of(one.point, p) - p.null for p in one.parameters])
        scores.append(leave_one_out(rows, one.residual, deviations, away, groups))
    apart = float(np.sum((extended.residual - base.residual) ** 2, dtype=float))
    known = [_of_priors(one, extended.parameters[own:]) for one in (base, extended)]
    gain = float((scores[0] - scores[1]).sum()) / inflation + 0.5 * float((known[0] ** 2 - known[1] ** 2).sum())
    return gain, float(np.sqrt(apart / inflation + ((known[0] - known[1]) ** 2).sum()))


def _of_priors(fitted: Fit, nuisances: Sequence[Parameter]) -> Array:
    """Return how far a fit's nuisances are from their prior means (k,) [deviations]."""
    return np.array([(value_of(fitted.point, p) - p.null) / p.deviation for p in nuisances])


def condition_of_bins(problem: Problem) -> NDArray[np.int_]:
    """Return the number of each whitened bin's condition; auxiliary shots are conditions of their own.

    A long hold is all that tells of time: it is left out in thirds, frame by frame in turn, so that what has been seen
    of it speaks of the rest.
    """
    press = [view.condition for view in problem.kinds if view.kind in ("press", "replicate")]
    labels: dict[tuple[object, ...], int] = {}
    numbers, seen = [], Counter[int]()
    for view in problem.kinds:
        key: tuple[object, ...] = (view.kind,)
        if view.kind in ("press", "replicate"):
            hold = press.count(view.condition) >= 2 * DWELL_FRAMES
            key = ("press", view.condition, seen[view.condition] % HOLD_PARTS if hold else 0)
            seen[view.condition] += 1
        numbers.append(labels.setdefault(key, len(labels)))
    counts = problem.valid[list(problem.views)].sum(axis=(1, 2))
    return np.repeat(numbers, counts)


def intervals(extension: Extension, level: float = 0.90) -> dict[str, dict[str, object]]:
    """Return each effect parameter's value with its interval, by its name."""
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
