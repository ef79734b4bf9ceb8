"""Judge every set of mechanisms on all outcomes: evidences, probabilities, what is unexplained, what is foretold.

Fits and evidences are those of the critic (:class:`evanesce.inference.joint.Fitter`, Laplace's approximation). All
sets are fitted, so that nothing depends on a path of search. A prior that ends at a bound is normalised over what lies
inside. Where the text leaves two readings of a figure the evidence is their mean.

What no set explains is found one group of outcomes at a time: a group of which a broad distribution
(:data:`~evanesce.studies.thesis_jointly.data.UNKNOWN_SD`) gives more evidence than its prediction from all others
is set aside as unexplained, the worst first, and all is judged anew.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from evanesce.inference.joint import Fitter, JointFit, Taken
from evanesce.prediction.linear import Metric
from evanesce.prediction.parameters import Parameter
from evanesce.studies.thesis_jointly.data import Outcomes
from evanesce.studies.thesis_jointly.mechanisms import NUISANCES, MechanismSet
from evanesce.studies.thesis_jointly.predict import Predictor

Array = NDArray[Any]
Tell = Callable[[str], None]

STARTS: tuple[Mapping[str, float], ...] = (
    {"share": 0.5, "length_mm": 0.7, "bone:share": 0.25},
    {"share": 0.2, "length_mm": 1.2, "bone:share": 0.55},
)
"""Where fits begin, by parameter or by the end of its name: scattering has no derivative at nothing."""
ROUNDS, RENEWALS, SETTLES = 30, 6, 0.05
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
        Best of all starts and readings.
    log_evidence : float
        Over all readings, in the rows' own units [nats].
    data : ndarray (rows,)
        The reading that the fit is of.
    """

    chosen: MechanismSet
    fit: JointFit
    log_evidence: float
    data: Array

    @property
    def log_weight(self) -> float:
        """Logarithm of prior times evidence."""
        return self.log_evidence + self.chosen.log_prior


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
    _index: dict[frozenset[str], int] = field(default_factory=dict)

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


def judge_set(outcomes: Outcomes, chosen: MechanismSet, unknown: Collection[str] = ()) -> Judged:
    """Fit one set of mechanisms to all readings of the outcomes.

    Parameters
    ----------
    outcomes : Outcomes
    chosen : MechanismSet
    unknown : collection of str
        Groups that are set aside as unexplained.

    Returns
    -------
    Judged
    """
    sd, found = outcomes.sd(unknown), []
    for data in outcomes.readings():
        fitter = Fitter(OutcomeModel(outcomes, chosen, data, sd))
        metric = Metric.of(np.zeros((0, data.size)), np.zeros(0))
        taken = [Taken(m, m.parameters) for m in chosen.mechanisms if m.parameters]
        fits = [
            fitter.fitted(taken, start, metric=metric, rounds=ROUNDS, renewals=RENEWALS, settles=SETTLES)
            for start in starts_of(chosen)
        ]
        best = min(fits, key=lambda one: one.misfit)
        units = float(np.log(sd).sum()) + 0.5 * sd.size * np.log(2.0 * np.pi)
        found.append((best.log_evidence - units - log_inside(best.parameters), best, data))
    whole = float(special.logsumexp([f[0] for f in found]) - np.log(len(found)))
    _, best, data = max(found, key=lambda f: f[0])
    return Judged(chosen, best, whole, data)


def starts_of(chosen: MechanismSet) -> list[dict[str, float]]:
    """Return the points at which fits of a set begin; one where it has nothing that needs several."""
    found: list[dict[str, float]] = []
    for start in STARTS:
        point = {p.name: p.null for p in (*chosen.parameters, *NUISANCES)}
        point |= {name: start[end] for name in point for end in (name, name.rpartition(":")[2]) if end in start}
        if point not in found:
            found.append(point)
    return found


def log_inside(parameters: Sequence[Parameter]) -> float:
    """Return the logarithm of the prior mass within the bounds of all parameters."""
    total = 0.0
    for p in parameters:
        ends = [(bound - p.null) / p.deviation for bound in p.bounds]
        total += float(np.log(special.ndtr(ends[1]) - special.ndtr(ends[0])))
    return total


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
        if number % 200 == 0:
            tell(f"set {number} of {len(sets)}")
        found.append(judge_set(outcomes, chosen, unknown))
    found.sort(key=lambda one: -one.log_weight)
    return Verdict(outcomes, tuple(unknown), tuple(found))
