"""Score tests of all candidates at once, calibrated on the noise that was measured.

The statistic of one candidate is that of a matched filter: the squared projection of the residual on what the candidate
would change, nuisances taken off. Its law under the null is not believed but drawn: correlated noise widens it, and
the smallest of many probabilities is compared with the smallest of each draw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from evanesce.criticism.problem import Fit, Problem
from evanesce.criticism.signatures import Signature, visible
from evanesce.prediction.frozen import FROZEN
from evanesce.prediction.linear import Metric, Score, score
from evanesce.prediction.noise import SHIFT_BINS
from evanesce.prediction.parameters import value_of
from evanesce.prediction.recoded import Recoded

Array = NDArray[Any]

SHIFTS = 24
"""Places at which each view's noise is laid over the signatures."""


@dataclass(frozen=True)
class Scored:
    """Score test of one candidate.

    Attributes
    ----------
    signature : Signature
    result : Score
        Of the best start where there are several.
    start : int
        Number of that start; -1 where there are none.
    inflation : float
        Variance of the score under drawn noise over that under white noise, at least 1.
    p : float
        By the tempered chi-square law, times the number of starts.
    information : ndarray (k, k)
        Metric inner products of the signature's rows.
    """

    signature: Signature
    result: Score
    start: int
    inflation: float
    p: float
    information: Array

    @property
    def id(self) -> str:
        """Of the effect."""
        return self.signature.id


@dataclass(frozen=True)
class ScoreTest:
    """Of all candidates.

    Attributes
    ----------
    scored : tuple of Scored
        Smallest p first.
    p : float
        That noise makes any candidate score as well, (1 + #) / (1 + B).
    draws : int
        B.
    """

    scored: tuple[Scored, ...]
    p: float
    draws: int

    def of(self, effect: str) -> Scored | None:
        """Return a candidate's, None where it could not be judged."""
        return next((s for s in self.scored if s.id == effect), None)


def score_test(
    problem: Problem, base: Fit, signatures: Sequence[Signature], *, draws: int, rng: np.random.Generator
) -> ScoreTest:
    """Test all candidates against a fitted base model.

    Parameters
    ----------
    problem : Problem
    base : Fit
        Its parameters are nuisances here, an effect among them that was accepted before included.
    signatures : sequence of Signature
    draws : int
        Of noise.
    rng : numpy.random.Generator
    """
    seen = [s for s in signatures if not s.note and visible(s)]
    if not seen:
        return ScoreTest((), 1.0, 0)
    metric = base.metric(base.parameters)
    rows = np.concatenate([s.rows for s in seen])
    projected = metric.project(rows)
    parts = np.split(np.arange(len(rows)), np.cumsum([len(s.rows) for s in seen])[:-1])
    gradients = projected @ from_belief(base)
    null = null_scores(problem, projected, draws, rng)
    found, of_draws = [], np.ones(draws)
    for signature, part in zip(seen, parts, strict=True):
        information = projected[part] @ rows[part].T
        one, p_null = _one(signature, information, gradients[part], null[:, part])
        found.append(one)
        of_draws = np.minimum(of_draws, p_null)
    found.sort(key=lambda s: s.p)
    p = float((1 + (of_draws <= found[0].p).sum()) / (1 + draws))
    return ScoreTest(tuple(found), p, draws)


def _one(signature: Signature, information: Array, gradient: Array, null: Array) -> tuple[Scored, Array]:
    """Return a candidate's score, and its p in each draw."""
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    if signature.joint:
        inflation = inflation_of(information, null)
        result = score(information, gradient, signature.deviations, inflation)
        statistic = whitened_power(information, null) / inflation
        p_null = stats.chi2.sf(statistic, max(result.degrees, 1))
        p = float(stats.chi2.sf(result.statistic, max(result.degrees, 1)))
        return Scored(signature, result, -1, inflation, p, information), p_null
    # Rival starts: amplitudes along each, the best one counts and pays for its choice.
    inflation = max(1.0, float(np.mean((null / size) ** 2)))
    along, along_null = gradient / size / np.sqrt(inflation), null / size / np.sqrt(inflation)
    start = int(np.argmax(along))
    result = score(
        information[start : start + 1, start : start + 1], gradient[start : start + 1], np.ones(1), inflation
    )
    if signature.candidate.penalty:
        return _chosen(signature, result, start, inflation, information), np.ones(len(null))
    count = effective_number(information)
    p = min(1.0, count * float(stats.norm.sf(along[start])))
    p_null = np.minimum(1.0, count * stats.norm.sf(along_null.max(axis=1)))
    return Scored(signature, result, start, inflation, p, information), p_null


def _chosen(signature: Signature, result: Score, start: int, inflation: float, information: Array) -> Scored:
    """Return the score of a candidate whose places were chosen by the data.

    Drawn noise was not searched for places, so its probability is bounded by Markov's inequality: under the null a
    Bayes factor exceeds k with a probability of at most 1/k.
    """
    paid = replace(result, log_bayes=result.log_bayes - signature.candidate.penalty)
    return Scored(signature, paid, start, inflation, float(np.exp(-max(paid.log_bayes, 0.0))), information)


def whitened_power(information: Array, gradients: Array) -> Array:
    """Return g' F^-1 g of gradients (n, k), along directions that can be seen."""
    values, vectors = np.linalg.eigh(information)
    good = values > 1e-9 * max(values.max(), 1e-300)
    return np.asarray(((gradients @ vectors[:, good]) ** 2 / values[good]).sum(axis=1))


def inflation_of(information: Array, gradients: Array) -> float:
    """Return the variance of gradients (n, k) under noise over what white noise would give, at least 1."""
    values = np.linalg.eigvalsh(information)
    degrees = int((values > 1e-9 * max(values.max(), 1e-300)).sum())
    return max(1.0, float(whitened_power(information, gradients).mean()) / max(degrees, 1))


def inflation_along(problem: Problem, base: Fit, change: Array) -> float:
    """Return the variance of drawn noise along a whitened change (bins,) over what white noise would give, at least 1.

    Two causes that draw the same picture have the same one, whatever else either could draw: by the mean over
    all that each may draw, one of six parameters had a third more evidence for the very same change than one of two.
    The draws are the same for all.
    """
    projected = metric_of(base).project(change[None])
    size = float(projected[0] @ change)
    if size <= 0.0:
        return 1.0
    null = null_scores(problem, projected, int(FROZEN.levels["draws_score"]), np.random.default_rng(0))
    return max(1.0, float(np.mean(null**2)) / size)


def effective_number(information: Array) -> float:
    """Return how many independent tests rows of these inner products amount to (Nyholt 2004, from eigenvalues)."""
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values = np.linalg.eigvalsh(information / np.outer(size, size))
    count = len(values)
    return float(1 + (count - 1) * (1 - np.var(values, ddof=1) / count)) if count > 1 else 1.0


def null_scores(problem: Problem, projected: Array, draws: int, rng: np.random.Generator) -> Array:
    """Return scores (draws, k) of projected rows (k, bins) with drawn noise.

    Each view's noise is a random mixture of the measured fields at a random shift, so all inner products of rows and
    shifted fields are made once and mixed.
    """
    if problem.coded is not None:
        return _coded_scores(problem, problem.coded, projected, draws, rng)
    noise = problem.noise
    kept = noise.fields.shape[0]
    fields = (noise.fields / np.sqrt(kept)).astype(np.float32)
    rows, cols = fields.shape[1:]
    found = np.zeros((draws, len(projected)))
    place = 0
    for view in problem.views:
        valid = problem.valid[view]
        count = int(valid.sum())
        part = projected[:, place : place + count].astype(np.float32)
        place += count
        table = np.empty((SHIFTS, len(projected), kept), np.float32)
        for k in range(SHIFTS):
            down, right = (int(rng.integers(0, n // SHIFT_BINS)) * SHIFT_BINS for n in (rows, cols))
            table[k] = part @ np.roll(fields, (down, right), axis=(1, 2))[:, valid].T
        weights = rng.standard_normal((draws, kept))
        shift = rng.integers(0, SHIFTS, draws)
        for k in range(SHIFTS):
            mine = shift == k
            found[mine] += weights[mine] @ table[k].T
    return found


def _coded_scores(problem: Problem, coded: Recoded, projected: Array, draws: int, rng: np.random.Generator) -> Array:
    """Return scores (draws, k) with noise that went through a codec, and what numerics leave beside it."""
    fields = np.array([problem.whitened(field) for field in coded.every])
    found = coded.drawn(draws, rng) @ (fields @ projected.T)
    beside = problem.whitened(np.sqrt(problem.numerics)) ** 2
    values, turn = np.linalg.eigh((projected * beside) @ projected.T)
    more = rng.standard_normal((draws, len(values))) * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(found + more @ turn.T)


def from_belief(base: Fit) -> Array:
    """Return the whitened residual (bins,) against the nuisances' prior means, by the fit's derivatives.

    At the most probable nuisances its inner products in the metric are those of the fit's own residual. A fit that
    stops a hundredth of a deviation before them leaves a residual along them that a candidate of their shape, all but
    a hundredth of which they take, would claim; these inner products know of no such rest.
    """
    away = np.array([value_of(base.point, p) - p.null for p in base.parameters])
    return np.asarray(base.residual + away @ base.rows)


def metric_of(base: Fit) -> Metric:
    """Return the metric with all parameters of a fit marginalised."""
    return base.metric(base.parameters)
