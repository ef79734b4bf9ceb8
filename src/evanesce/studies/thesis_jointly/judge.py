"""Judge every set of mechanisms on all outcomes: evidences, probabilities, what is unexplained, what is foretold.

The joint fit is that of the critic (:class:`evanesce.inference.joint.Fitter`), begun at an optimum by SciPy:
interpolated predictions have kinks at which steps of Gauss and Newton stall. Its evidence is refined by sampling
(:mod:`evanesce.studies.thesis_jointly.sample`). All sets are fitted, so that nothing depends on a path of search. Where
the text leaves two readings of a figure the evidence is their mean.

What no set explains is found one group of outcomes at a time: a group of which a broad distribution
(:data:`~evanesce.studies.thesis_jointly.data.UNKNOWN_SD`) gives more evidence than its prediction from all others
is set aside as unexplained, the worst first, and all is judged anew.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from evanesce.core.rng import generator
from evanesce.inference.joint import Fitter, JointFit, Taken
from evanesce.prediction.linear import Metric
from evanesce.prediction.parameters import Parameter
from evanesce.studies.thesis_jointly.data import Outcomes, Row
from evanesce.studies.thesis_jointly.mechanisms import NUISANCES, MechanismSet
from evanesce.studies.thesis_jointly.predict import Predictor
from evanesce.studies.thesis_jointly.sample import Draws, drawn

Array = NDArray[Any]
Tell = Callable[[str], None]

START: Mapping[str, float] = {"share": 0.3, "length_mm": 0.7}
"""Where fits begin, by the end of a parameter's name, unless at its null: scattering has no derivative at nothing."""
EVALUATIONS, EDGE = 60, 1e-4
"""Predictions of a fit at most; distance from a bound, in prior deviations, that counts as being there."""
MOST = 25
"""Sets that are fitted again where outcomes are left out: the likeliest, with those outcomes and without them."""
POINTS = 200
"""Posterior draws that are kept of each set."""
OUTSIDE = 0.05
"""Prior probability that something outside the model made a group of outcomes."""
WORST = 0.5
"""Probability of being unexplained above which a group is set aside."""


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


@dataclass(frozen=True)
class Judged:
    """One set of mechanisms on some data.

    Attributes
    ----------
    chosen : MechanismSet
    fit : JointFit
        Of the likelier reading.
    log_evidence : float
        Over all readings, in the rows' own units [nats].
    data : ndarray (rows,)
        The reading that the fit is of.
    points : mapping of str to ndarray (points,)
        Posterior draws of its parameters, over all readings.
    """

    chosen: MechanismSet
    fit: JointFit
    log_evidence: float
    data: Array
    points: Mapping[str, Array]

    @property
    def log_weight(self) -> float:
        """Logarithm of prior times evidence."""
        return self.log_evidence + self.chosen.log_prior

    def predicted(self, rows: Sequence[Row]) -> Array:
        """Return what the posterior draws predict of some rows, as rows count (points, rows)."""
        return Predictor(rows, self.chosen)(self.points)


@dataclass(frozen=True)
class Verdict:
    """All sets on some data.

    Attributes
    ----------
    outcomes : Outcomes
    unknown : tuple of str
        Groups that are set aside as unexplained.
    sets : tuple of Judged
        Most probable first.
    """

    outcomes: Outcomes
    unknown: tuple[str, ...]
    sets: tuple[Judged, ...]

    @property
    def log_evidence(self) -> float:
        """Of the data, averaged over all sets [nats]."""
        return float(special.logsumexp([one.log_weight for one in self.sets]))

    @property
    def probability(self) -> Array:
        """Probability of each set (sets,)."""
        weights = np.array([one.log_weight for one in self.sets])
        return np.asarray(np.exp(weights - special.logsumexp(weights)))

    def inclusion(self, name: str) -> float:
        """Return the probability of a mechanism."""
        return float(sum(p for p, s in zip(self.probability, self.sets, strict=True) if name in s.chosen.ids))

    def best_with(self, name: str) -> Judged | None:
        """Return the most probable set that holds a mechanism."""
        return next((one for one in self.sets if name in one.chosen.ids), None)


def judge_set(
    outcomes: Outcomes,
    chosen: MechanismSet,
    unknown: Collection[str] = (),
    near: Mapping[str, float] | None = None,
    seed: int = 0,
) -> Judged:
    """Fit one set of mechanisms to all readings of the outcomes.

    Parameters
    ----------
    outcomes : Outcomes
    chosen : MechanismSet
    unknown : collection of str
        Groups that are set aside as unexplained.
    near : mapping, optional
        A point from where to begin; the usual start otherwise.
    seed : int
        Of the draws.

    Returns
    -------
    Judged
    """
    sd, start = outcomes.sd(unknown), start_of(chosen) if near is None else dict(near)
    found: list[tuple[float, JointFit, Array, Draws]] = []
    rng = generator(seed, "thesis jointly", *sorted(chosen.ids))
    for data in outcomes.readings():
        model = OutcomeModel(outcomes, chosen, data, sd)
        metric = Metric.of(np.zeros((0, data.size)), np.zeros(0))
        taken = [Taken(m, m.parameters) for m in chosen.mechanisms if m.parameters]
        start = _optimum(model, (*chosen.parameters, *NUISANCES), start)
        best = Fitter(model).fitted(taken, start, metric=metric, rounds=0)
        draws = drawn(best, model.predictor, data, sd, rng)
        found.append((draws.log_evidence, best, data, draws))
    logs = np.array([f[0] for f in found])
    share = np.exp(logs - special.logsumexp(logs))
    counts = np.maximum(np.round(POINTS * share).astype(int), 0)
    points = np.concatenate([f[3].equal(int(n), rng) for f, n in zip(found, counts, strict=True)])
    _, best, data, draws = max(found, key=lambda f: f[0])
    whole = float(special.logsumexp(logs) - np.log(len(found)))
    return Judged(chosen, best, whole, data, dict(zip(draws.names, points.T, strict=True)))


def _optimum(model: OutcomeModel, parameters: Sequence[Parameter], start: Mapping[str, float]) -> dict[str, float]:
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


def start_of(chosen: MechanismSet) -> dict[str, float]:
    """Return the point at which the fit of a set begins."""
    point = {p.name: p.null for p in (*chosen.parameters, *NUISANCES)}
    return point | {name: START[end] for name in point for end in (name.rpartition(":")[2],) if end in START}


def judge(
    outcomes: Outcomes, sets: Sequence[MechanismSet], unknown: Collection[str] = (), tell: Tell = lambda line: None
) -> Verdict:
    """Judge many sets.

    Parameters
    ----------
    outcomes : Outcomes
    sets : sequence of MechanismSet
    unknown : collection of str
    tell : callable

    Returns
    -------
    Verdict
    """
    found = []
    for number, chosen in enumerate(sets):
        if number % 100 == 0:
            tell(f"set {number} of {len(sets)}")
        found.append(judge_set(outcomes, chosen, unknown))
    return verdict_of(outcomes, unknown, found)


def verdict_of(outcomes: Outcomes, unknown: Collection[str], found: Sequence[Judged]) -> Verdict:
    """Return judged sets in the order of their probability."""
    return Verdict(outcomes, tuple(unknown), tuple(sorted(found, key=lambda one: -one.log_weight)))


def foretold(one: Judged, places: Array, wider: Array | float = 0.0) -> float:
    """Return the log density of some rows given all others, the set's model linear about its fit.

    ``wider`` is a further variance of each row, over that of its noise; densities are per whitened unit.

    With r their whitened residuals and H what the rows themselves did for the fit (leverage), the prediction from the
    others is off by (1 - H)^-1 r, of covariance (1 - H)^-1.
    """
    rows = one.fit.solution.rows[:, places]
    left = one.fit.residual[places]
    rest = np.eye(len(places)) - rows.T @ one.fit.solution.covariance @ rows
    rest = 0.5 * (rest + rest.T) + 1e-9 * np.eye(len(places))
    ahead = np.linalg.inv(rest)
    off, spread = ahead @ left, ahead + np.diag(np.zeros(len(places)) + wider)
    return float(-0.5 * off @ np.linalg.solve(spread, off) - 0.5 * np.linalg.slogdet(spread)[1])


def likely(verdict: Verdict, group: str, count: int = MOST) -> list[Judged]:
    """Return the sets that are likely, with a group of outcomes or without it by :func:`foretold`."""
    places = verdict.outcomes.of(group)
    without = sorted(verdict.sets, key=lambda one: foretold(one, places) - one.log_weight)
    return list({id(one): one for one in (*verdict.sets[:count], *without[:count])}.values())


def left_out(verdict: Verdict, group: str) -> Verdict:
    """Judge the likely sets without a group of outcomes.

    Parameters
    ----------
    verdict : Verdict
        On all outcomes.
    group : str

    Returns
    -------
    Verdict
    """
    outcomes = verdict.outcomes.without(group)
    found = [judge_set(outcomes, one.chosen, verdict.unknown, one.fit.point) for one in likely(verdict, group)]
    return verdict_of(outcomes, verdict.unknown, found)


def unexplained(verdict: Verdict, group: str) -> float:
    """Return the probability that something outside the model made a group, each set linear about its fit.

    Parameters
    ----------
    verdict : Verdict
    group : str
    """
    outcomes, places = verdict.outcomes, verdict.outcomes.of(group)
    wider = np.square(outcomes.sd([group])[places] / outcomes.sd()[places]) - 1.0
    logs = [(foretold(one, places), foretold(one, places, wider), one.log_weight) for one in verdict.sets]
    model, broad, weight = np.array(logs).T
    # Sets weigh by all other outcomes.
    odds = special.logsumexp(weight - model + broad) - special.logsumexp(weight)
    return float(special.expit(odds + np.log(OUTSIDE / (1.0 - OUTSIDE))))


def proved_odds(verdict: Verdict, group: str) -> float:
    """Return the log odds of :func:`unexplained` by fits of the likely sets, the group taken for unexplained."""
    chosen, unknown = likely(verdict, group), (*verdict.unknown, group)
    after = [judge_set(verdict.outcomes, one.chosen, unknown, one.fit.point) for one in chosen]
    odds = verdict_of(verdict.outcomes, unknown, after).log_evidence
    odds -= verdict_of(verdict.outcomes, verdict.unknown, chosen).log_evidence
    return float(odds + np.log(OUTSIDE / (1.0 - OUTSIDE)))


def settled(outcomes: Outcomes, sets: Sequence[MechanismSet], tell: Tell = lambda line: None) -> Verdict:
    """Judge all sets; set aside one group after the other that no set explains, the worst first.

    Parameters
    ----------
    outcomes : Outcomes
    sets : sequence of MechanismSet
    tell : callable

    Returns
    -------
    Verdict
    """
    verdict = judge(outcomes, sets, (), tell)
    while True:
        found = {}
        for group in outcomes.groups:
            # What is linear about a fit only accuses: sets without the group are fitted before it is set aside.
            if group not in verdict.unknown and unexplained(verdict, group) > WORST:
                tell(f"is {group} explained?")
                found[group] = proved_odds(verdict, group)
        worst = max(found, key=lambda g: found[g], default="")
        if not worst or found[worst] < special.logit(WORST):
            return verdict
        tell(f"{worst} is set aside as unexplained")
        verdict = judge(outcomes, sets, (*verdict.unknown, worst), tell)
