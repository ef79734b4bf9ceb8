"""Evidence of one cause whose form is a distribution: a sum of shapes with random weights, of unknown strength.

A cause adds ``s A' w`` to whitened data, ``A`` (k, bins) its shapes, ``w`` standard normal, ``s`` its strength, so that
its covariance is ``s^2 A'A``. Shapes are scaled so that a draw of strength 1 has a mean squared norm of 1 in the
metric: strength is then the number of standard deviations by which the cause shows, after the nuisances took what they
could. With ``K = A P A'`` (P the metric) and ``z = A P y`` the log Bayes factor over none is::

    (z' (K + s^-2)^-1 z - log det (1 + s^2 K)) / 2

which the eigenvectors of the small matrix K give for all strengths at once. Strengths are averaged over
:data:`STRENGTHS`, spaced evenly in their logarithm.

Many causes at once are a sum of such single effects (Wang, Sarkar, Carbonetto, Stephens 2020, J. R. Stat. Soc. B 82,
1273): each place of the sum holds one cause, and says with which probability which; causes that stand in for each other
share one place and form its credible set.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

from evanesce.inference.constants import CREDIBLE, NONE_PRIOR, STRENGTHS

Array = NDArray[Any]

LEAST_EIGENVALUE = 1e-9
"""Of the largest: what rounding leaves of directions that shapes do not have."""
LEAST_NORM = 0.1
"""Standard deviations; a plausible amount that moves the data by less cannot be seen."""

NULL_DRAWS = 20_000
"""Of noise, which place a p-value between 0.0025 and 0.01 to a tenth."""

NONE = "none"
UNKNOWN = "unknown"
"""Also the beginning of the names of its blocks: fields that go from view to view in one way each."""


def cause_of(block: str) -> str:
    """Return the cause that a block of rows belongs to; blocks of something unknown are one cause."""
    return UNKNOWN if block.partition(" ")[0] == UNKNOWN else block


def merged(log_bayes: Mapping[str, Array]) -> dict[str, Array]:
    """Return log Bayes factors by cause: that of something unknown is the mean over its blocks.

    Parameters
    ----------
    log_bayes : mapping of str to ndarray (...)
        By block [nats].
    """
    parts: dict[str, list[Array]] = {}
    for block, value in log_bayes.items():
        parts.setdefault(cause_of(block), []).append(np.asarray(value))
    return {name: np.logaddexp.reduce(every, axis=0) - np.log(len(every)) for name, every in parts.items()}


@dataclass(frozen=True)
class Shapes:
    """What one cause may look like, reduced to what evidences need.

    Attributes
    ----------
    id : str
        Of the cause.
    scale : ndarray (k,)
        By which its rows are multiplied, so that squared norms in the metric have a mean of 1 over draws; 0 for rows
        that do not show.
    eigenvalues : ndarray (m,)
        Of the scaled rows' inner products, the smallest left out; empty if nothing shows.
    axes : ndarray (k, m)
        Eigenvectors.
    strengths : ndarray (n,)
        At which it is weighed.
    one_sided : bool
        Whether the sum of its rows' weights is positive: of a cause that can only grow.
    """

    id: str
    scale: Array
    eigenvalues: Array
    axes: Array
    strengths: Array = field(default_factory=lambda: STRENGTHS)
    one_sided: bool = False

    @classmethod
    def of(cls, name: str, gram: Array, *, reach: float = np.inf, one_sided: bool = False) -> Shapes:
        """Return the shapes of rows with the given inner products (k, k) in the metric.

        Forms of a cause are as likely one as the other; rows of something unknown keep their proportions, by which it
        is smooth.

        Parameters
        ----------
        name : str
        gram : ndarray (k, k)
        reach : float
            Times the largest row's norm beyond which no strength is plausible.
        one_sided : bool
        """
        norms = np.sqrt(np.maximum(np.diag(gram), 0.0))
        seen = norms > LEAST_NORM
        even = np.full(len(norms), np.sqrt(np.mean(norms[seen] ** 2)) if seen.any() else 1.0)
        size = even if cause_of(name) == UNKNOWN else np.where(seen, norms, 1.0)
        scale = np.where(seen, 1.0 / (size * np.sqrt(max(seen.sum(), 1))), 0.0)
        if not seen.any():
            return cls(name, scale, np.zeros(0), np.zeros((len(norms), 0)))
        low, high = (min(float(end), reach * float(norms.max())) for end in STRENGTHS[[0, -1]])
        strengths = np.geomspace(low, high, len(STRENGTHS))
        values, axes = np.linalg.eigh(scale[:, None] * gram * scale)
        kept = values > LEAST_EIGENVALUE * values[-1]
        return cls(name, scale, values[kept], axes[:, kept], strengths, one_sided)

    @property
    def directions(self) -> Array:
        """Coefficients (k, m) of the rows for directions of unit norm in the metric."""
        return np.asarray(self.scale[:, None] * self.axes / np.sqrt(self.eigenvalues))

    def coordinates(self, along: Array) -> Array:
        """Return coordinates (..., m), of unit variance under noise, of the rows' products (..., k) with the data."""
        return np.asarray(along @ self.directions)

    def log_bayes(self, coordinates: Array) -> Array:
        """Return the log Bayes factor over none (...) for unit coordinates (..., m) [nats]."""
        if not self.eigenvalues.size:
            return np.full(np.shape(coordinates)[:-1], -np.inf)
        each = self._by_strength(np.asarray(coordinates))
        return np.asarray(np.logaddexp.reduce(each, axis=-1) - np.log(len(self.strengths)))

    def _by_strength(self, coordinates: Array) -> Array:
        """Return the log Bayes factor (..., n) at each strength for unit coordinates (..., m)."""
        size2 = np.square(self.strengths)[:, None] * self.eigenvalues
        each = 0.5 * (np.square(coordinates) @ (size2 / (1.0 + size2)).T - np.log1p(size2).sum(axis=-1))
        if not self.one_sided:
            return np.asarray(each)
        # Weights whose sum is positive had half the prior; the factor is what data make of that half.
        total = self.axes.T @ (self.scale > 0)
        mean = coordinates @ (np.sqrt(size2) / (1.0 + size2) * total).T
        hidden = max(float((self.scale > 0).sum() - total @ total), 0.0)
        spread = np.sqrt(hidden + (1.0 / (1.0 + size2)) @ np.square(total))
        return np.asarray(each + special.log_ndtr(mean / spread) + np.log(2.0))

    def strength(self, coordinates: Array) -> float:
        """Return the most probable strength for unit coordinates (m,) [1]."""
        return float(self.strengths[int(np.argmax(self._by_strength(np.asarray(coordinates))))])


@dataclass(frozen=True)
class Place:
    """One place of the sum: which cause fills it.

    Attributes
    ----------
    log_bayes : mapping of str to float
        Over none, by cause [nats].
    probability : mapping of str to float
        Posterior, ``none`` among them; they sum to 1.
    """

    log_bayes: Mapping[str, float]
    probability: Mapping[str, float]

    @classmethod
    def of(cls, log_bayes: Mapping[str, float]) -> Place:
        """Return the posterior of log Bayes factors: none has the prior NONE_PRIOR, causes share the rest evenly."""
        names = [NONE, *log_bayes]
        share = (1.0 - NONE_PRIOR) / max(len(log_bayes), 1)
        weights = np.array([np.log(NONE_PRIOR), *(np.log(share) + b for b in log_bayes.values())])
        posterior = np.exp(weights - np.logaddexp.reduce(weights))
        return cls(dict(log_bayes), dict(zip(names, map(float, posterior), strict=True)))

    def with_fits(self, own: str, behind: Mapping[str, float]) -> Place:
        """Return the place where causes that were fitted in it came out behind its own cause by so many nats.

        What a fit says stands in the place of what drawn forms say.
        """
        if own not in self.log_bayes:
            return self
        fitted = {name: self.log_bayes[own] - gap for name, gap in behind.items() if name in self.log_bayes}
        return Place.of({**self.log_bayes, **fitted})

    def beside(self, further: Place) -> Place:
        """Return the place where what shows beside its cause is no reason to take something unknown for that cause.

        Something unknown in the place explains both at once; the place's own cause leaves the other to a further one.

        Parameters
        ----------
        further : Place
            One more, beside the place's own cause.
        """
        if UNKNOWN not in self.log_bayes or not further.log_bayes:
            return self
        shows = max(float(statistic_of(np.array(list(further.log_bayes.values())))), 0.0)
        return Place.of({**self.log_bayes, UNKNOWN: self.log_bayes[UNKNOWN] - shows})

    def without_law(self, names: Iterable[str]) -> Place:
        """Return the place where the probability of some causes is that of something unknown.

        Parameters
        ----------
        names : iterable of str
        """
        gone = set(names) & set(self.log_bayes)
        if not gone:
            return self
        left = {name: value for name, value in self.probability.items() if name not in gone}
        moved = sum(self.probability[name] for name in gone)
        factors = {name: value for name, value in self.log_bayes.items() if name not in gone}
        return Place(factors, {**left, UNKNOWN: left.get(UNKNOWN, 0.0) + moved})

    def at_most(self, most: float) -> Place:
        """Return the place where nothing has more than a probability; what is above is none's.

        Parameters
        ----------
        most : float
            More than a half, so that what is more probable than not stays so.
        """
        told = {name: min(value, most) for name, value in self.probability.items() if name != NONE}
        return Place(self.log_bayes, {NONE: 1.0 - sum(told.values()), **told})

    @property
    def present(self) -> float:
        """Probability that anything fills the place."""
        return 1.0 - self.probability[NONE]

    @property
    def credible_set(self) -> tuple[str, ...]:
        """Smallest set of causes that holds CREDIBLE of the probability that is not none's, the most probable first."""
        causes = sorted((n for n in self.probability if n != NONE), key=lambda n: -self.probability[n])
        total, found, held = sum(self.probability[n] for n in causes), [], 0.0
        for name in causes:
            found.append(name)
            held += self.probability[name]
            if held >= CREDIBLE * total:
                break
        return tuple(found)


def place_of(candidates: Sequence[Shapes], along: Mapping[str, Array]) -> Place:
    """Return which cause fills one place.

    Parameters
    ----------
    candidates : sequence of Shapes
    along : mapping of str to ndarray (k,)
        Products, in the metric, of each candidate's rows with the data less the prediction without any cause there.
    """
    shown = [c for c in candidates if c.eigenvalues.size]
    found = merged({c.id: c.log_bayes(c.coordinates(along[c.id])) for c in shown})
    return Place.of({name: float(value) for name, value in found.items()})


def statistic_of(log_bayes: Array) -> Array:
    """Return the detection statistic (...): log of the mean Bayes factor over causes (causes, ...) [nats]."""
    return np.asarray(np.logaddexp.reduce(log_bayes, axis=0) - np.log(len(log_bayes)))


def null_statistics(
    candidates: Sequence[Shapes], gram: Array, rng: np.random.Generator, draws: int = NULL_DRAWS
) -> Array:
    """Return the sorted detection statistics (draws,) of pure noise.

    All shapes' coordinates are drawn together, with the covariance that their inner products say, so that causes that
    resemble each other count as one trial.

    Parameters
    ----------
    candidates : sequence of Shapes
    gram : ndarray (rows, rows)
        Inner products in the metric of all candidates' rows, one after the other.
    rng : numpy.random.Generator
    draws : int
    """
    directions = linalg.block_diag(*(c.directions for c in candidates))
    values, axes = np.linalg.eigh(directions.T @ gram @ directions)
    kept = values > LEAST_EIGENVALUE * values[-1]
    root = axes[:, kept] * np.sqrt(values[kept])
    drawn = rng.standard_normal((draws, int(kept.sum()))) @ root.T
    found, start = {}, 0
    for shapes in candidates:
        stop = start + shapes.eigenvalues.size
        if stop > start:
            found[shapes.id] = shapes.log_bayes(drawn[:, start:stop])
        start = stop
    return np.sort(statistic_of(np.array(list(merged(found).values()))))


def p_value(place: Place, null: Callable[[], Array]) -> float:
    """Return the p-value of a place's evidence, as small as :data:`NULL_DRAWS` can tell.

    A mean Bayes factor has mean 1 in noise, and exceeds ``x`` there with a probability of at most ``1 / x``: evidence
    that is beyond all draws needs none.

    Parameters
    ----------
    place : Place
    null : callable
        Returns sorted statistics of noise (:func:`null_statistics`).
    """
    statistic, least = float(statistic_of(np.array(list(place.log_bayes.values())))), 1.0 / (1 + NULL_DRAWS)
    if statistic > -np.log(least):
        return least
    drawn = null()
    return float((1 + len(drawn) - np.searchsorted(drawn, statistic)) / (1 + len(drawn)))
