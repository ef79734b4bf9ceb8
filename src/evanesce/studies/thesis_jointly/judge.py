"""Judge every set of mechanisms on all outcomes: evidences, probabilities, what is unexplained, left-out predictions.

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
from scipy import special

from evanesce.core.rng import generator
from evanesce.inference.joint import Fitter
from evanesce.inference.joint_fit import JointFit, Taken
from evanesce.prediction.linear import Metric
from evanesce.studies.thesis_jointly.data import Outcomes, Row
from evanesce.studies.thesis_jointly.mechanisms import NUISANCES, MechanismSet
from evanesce.studies.thesis_jointly.model import OutcomeModel, optimum
from evanesce.studies.thesis_jointly.predict import Predictor
from evanesce.studies.thesis_jointly.sample import Draws, drawn

Array = NDArray[Any]
Tell = Callable[[str], None]

START: Mapping[str, float] = {"share": 0.3, "length_mm": 0.7}
"""Where fits begin, by the end of a parameter's name, unless at its null: scattering has no derivative at nothing."""
FAR_NATS = 10.0
"""Sets further behind the best keep Laplace's evidence, which is within 2 nats of the sampled one near it."""
MOST = 25
"""Sets that are fitted again where outcomes are left out: the likeliest, with those outcomes and without them."""
POINTS = 200
"""Posterior draws that are kept of each set."""
OUTSIDE = 0.05
"""Prior probability that something outside the model made a group of outcomes."""
WORST = 0.5
"""Probability of being unexplained above which a group is set aside."""


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
    *,
    sampled: bool = True,
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
    sampled : bool
        Whether its evidence is sampled; else it is Laplace's, and there are no posterior draws.
    seed : int
        Of the draws.

    Returns
    -------
    Judged
    """
    sd, start = outcomes.sd(unknown), start_of(chosen) if near is None else dict(near)
    fits: list[tuple[JointFit, Array]] = []
    draws: list[Draws] = []
    rng = generator(seed, "thesis jointly", *sorted(chosen.ids))
    for data in outcomes.readings():
        model = OutcomeModel(outcomes, chosen, data, sd)
        metric = Metric.of(np.zeros((0, data.size)), np.zeros(0))
        taken = [Taken(m, m.parameters) for m in chosen.mechanisms if m.parameters]
        start = optimum(model, (*chosen.parameters, *NUISANCES), start)
        fits.append((Fitter(model).fitted(taken, start, metric=metric, rounds=0), data))
        if sampled:
            draws.append(drawn(fits[-1][0], model.predictor, data, sd, rng))
    logs = np.array([d.log_evidence for d in draws] if sampled else [_by_laplace(fit, sd) for fit, _ in fits])
    best, data = fits[int(np.argmax(logs))]
    points: Mapping[str, Array] = {}
    if sampled:
        counts = np.round(POINTS * np.exp(logs - special.logsumexp(logs))).astype(int)
        every = np.concatenate([d.equal(int(n), rng) for d, n in zip(draws, counts, strict=True)])
        points = dict(zip(draws[0].names, every.T, strict=True))
    return Judged(chosen, best, float(special.logsumexp(logs) - np.log(len(fits))), data, points)


def _by_laplace(fit: JointFit, sd: Array) -> float:
    """Return Laplace's log evidence in the rows' own units, priors normalised over what lies inside bounds [nats]."""
    total = fit.log_evidence - float(np.log(sd).sum()) - 0.5 * sd.size * np.log(2.0 * np.pi)
    for p in fit.parameters:
        low, high = ((bound - p.null) / p.deviation for bound in p.bounds)
        total -= float(np.log(special.ndtr(high) - special.ndtr(low)))
    return total


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
        found.append(judge_set(outcomes, chosen, unknown, sampled=False))
    least = max(one.log_weight for one in found) - FAR_NATS
    near = [one for one in found if one.log_weight > least]
    tell(f"evidence of {len(near)} of {len(found)} sets")
    sampled = {one.chosen.ids: judge_set(outcomes, one.chosen, unknown, one.fit.point) for one in near}
    return verdict_of(outcomes, unknown, [sampled.get(one.chosen.ids, one) for one in found])


def verdict_of(outcomes: Outcomes, unknown: Collection[str], found: Sequence[Judged]) -> Verdict:
    """Return judged sets in the order of their probability."""
    return Verdict(outcomes, tuple(unknown), tuple(sorted(found, key=lambda one: -one.log_weight)))


def log_predictive(one: Judged, places: Array, wider: Array | float = 0.0) -> float:
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
    """Return the sets that are likely, with a group of outcomes or without it by :func:`log_predictive`."""
    places = verdict.outcomes.of(group)
    without = sorted(verdict.sets, key=lambda one: log_predictive(one, places) - one.log_weight)
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
    logs = [(log_predictive(one, places), log_predictive(one, places, wider), one.log_weight) for one in verdict.sets]
    model, broad, weight = np.array(logs).T
    # Sets weigh by all other outcomes.
    odds = special.logsumexp(weight - model + broad) - special.logsumexp(weight)
    return float(special.expit(odds + np.log(OUTSIDE / (1.0 - OUTSIDE))))


def refitted_odds(verdict: Verdict, group: str) -> float:
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
            # The linear estimate screens: sets without the group are fitted before it is set aside.
            if group not in verdict.unknown and unexplained(verdict, group) > WORST:
                tell(f"is {group} explained?")
                found[group] = refitted_odds(verdict, group)
        worst = max(found, key=lambda g: found[g], default="")
        if not worst or found[worst] < special.logit(WORST):
            return verdict
        tell(f"{worst} is set aside as unexplained")
        verdict = judge(outcomes, sets, (*verdict.unknown, worst), tell)
