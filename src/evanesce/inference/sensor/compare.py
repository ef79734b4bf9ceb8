"""Evidence and held-out log score of sensor models: which terms the data ask for, and what each predicts."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from evanesce.inference.sensor.law import Kind, Term, VarianceLaw, VarianceSeries, terms_of
from evanesce.rig.camera import Pixel

Array = NDArray[np.float64]

ENTERED = 3.0
"""Gain of log evidence for which a term is entered [nats]: odds of 20."""
FOLDS = 5
"""Stretches of each series of which each is held out in turn."""
STEPS = 40
"""Of Gauss and Newton at the most."""
TIED_MOST = 0.95
"""Correlation of neighbouring levels that is believed: one would leave a series of a single level."""
LEAST_SCATTER = 1e-3
"""Relative scatter that is never undercut [1]: that of a variance over a million pixels."""


@dataclass(frozen=True)
class Fitted:
    """A model fitted to rows of variance.

    Attributes
    ----------
    law : VarianceLaw
    values : ndarray (k,)
        Most probable, logarithm over the prior's median.
    covariance : ndarray (k, k)
    scatter, tied : float
        Standard deviation of a row's log variance about the law, and its correlation with the next row [1].
    log_evidence : float
        By Laplace's approximation, scatter and correlation at their estimates [nats].
    """

    law: VarianceLaw
    values: Array
    covariance: Array
    scatter: float
    tied: float
    log_evidence: float

    @property
    def terms(self) -> frozenset[str]:
        """Names of the terms."""
        return frozenset(term.id for term in self.law.terms)


def fit(
    series: Sequence[VarianceSeries], kind: Kind, pixel: Pixel, terms: Collection[str],
    deviations: Mapping[str, float] | None = None,
) -> Fitted:  # fmt: skip
    """Fit a set of terms, rows correlated along each series as a first-order autoregression.

    Parameters
    ----------
    series : sequence of VarianceSeries
    kind : {"transfer", "dark"}
    pixel : Pixel
        Nominal.
    terms : collection of str
    deviations : mapping of str to float, optional
        Prior standard deviations in place of those of :func:`~evanesce.inference.sensor.law.terms_of`.

    Returns
    -------
    Fitted
    """
    law = VarianceLaw(series, kind, pixel, terms)
    given = deviations or {}
    law.deviation = np.array([given.get(term.id, term.deviation) for term, _ in law.owners])
    observed = np.concatenate([np.log(s.variance_DN2) for s in series])
    lengths = [s.x.size for s in series]
    values, scatter, tied = np.zeros(len(law.owners)), 0.1, 0.0
    for _ in range(8):
        values, slopes = _most_probable(law, observed, lengths, values, scatter, tied)
        before = (scatter, tied)
        scatter, tied = _noise(observed - law.log_variance(values), lengths, len(values))
        if abs(np.log(scatter / before[0])) < 1e-3 and abs(tied - before[1]) < 1e-3:
            break
    white = _whiten(slopes, lengths, tied) / scatter
    precision = white.T @ white + np.diag(law.deviation**-2.0)
    covariance = np.asarray(np.linalg.inv(precision), np.float64)
    left = _whiten(observed - law.log_variance(values), lengths, tied) / scatter
    noise = -0.5 * left @ left - _log_norm(lengths, scatter, tied)
    prior = -0.5 * float(np.sum((values / law.deviation) ** 2)) - float(np.sum(np.log(law.deviation)))
    evidence = float(noise) + prior - 0.5 * float(np.linalg.slogdet(precision)[1])
    return Fitted(law, values, covariance, scatter, tied, evidence)


def _most_probable(
    law: VarianceLaw, observed: Array, lengths: Sequence[int], start: Array, scatter: float, tied: float
) -> tuple[Array, Array]:
    """Return the most probable values by damped Gauss-Newton steps, and the slopes there (rows, k)."""

    def cost(values: Array) -> float:
        left = _whiten(observed - law.log_variance(values), lengths, tied) / scatter
        return float(left @ left + np.sum((values / law.deviation) ** 2))

    values, damping = start.copy(), 1e-3
    slopes = law.slopes(values)
    if values.size == 0:
        return values, slopes
    now = cost(values)
    for _ in range(STEPS):
        white = _whiten(slopes, lengths, tied) / scatter
        left = _whiten(observed - law.log_variance(values), lengths, tied) / scatter
        normal = white.T @ white + np.diag(law.deviation**-2.0)
        gradient = white.T @ left - values * law.deviation**-2.0
        while damping < 1e8:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
            tried = np.clip(values + step, -8.0 * law.deviation, 8.0 * law.deviation)
            there = cost(tried)
            if there <= now:
                break
            damping *= 4.0
        else:
            break
        gained, values, now = now - there, tried, there
        damping = max(damping / 4.0, 1e-9)
        slopes = law.slopes(values)
        if gained < 1e-6 * max(now, 1.0):
            break
    return values, slopes


def _whiten(values: Array, lengths: Sequence[int], tied: float) -> Array:
    """Return rows made independent of unit scatter, along each series of a first-order autoregression."""
    result, first = np.array(values, float), 0
    for length in lengths:
        part = values[first : first + length]
        result[first + 1 : first + length] = (part[1:] - tied * part[:-1]) / np.sqrt(1.0 - tied**2)
        first += length
    return result


def _log_norm(lengths: Sequence[int], scatter: float, tied: float) -> float:
    """Return the logarithm of the normalising constant of such rows."""
    rows = sum(lengths)
    pairs = rows - sum(length > 0 for length in lengths)
    return rows * (0.5 * np.log(2.0 * np.pi) + np.log(scatter)) + 0.5 * pairs * float(np.log(1.0 - tied**2))


def _noise(left: Array, lengths: Sequence[int], values: int) -> tuple[float, float]:
    """Return scatter and correlation from row to row of what is left."""
    first, product, square = 0, 0.0, 0.0
    for length in lengths:
        part = left[first : first + length]
        product += float(part[1:] @ part[:-1])
        square += 0.5 * float(part[1:] @ part[1:] + part[:-1] @ part[:-1])
        first += length
    tied = float(np.clip(product / max(square, 1e-30), 0.0, TIED_MOST))
    free = max(left.size - values, 0.3 * left.size)
    white = _whiten(left, lengths, tied)
    return max(float(np.sqrt(white @ white / free)), LEAST_SCATTER), tied


def search(series: Sequence[VarianceSeries], kind: Kind, pixel: Pixel) -> Fitted:
    """Enter the term of most evidence until none is worth :data:`ENTERED`; drop what no longer is.

    Parameters
    ----------
    series : sequence of VarianceSeries
    kind : {"transfer", "dark"}
    pixel : Pixel
        Nominal.

    Returns
    -------
    Fitted
    """
    every = terms_of(pixel, kind)
    best = fit(series, kind, pixel, ())
    while True:
        tried = [fit(series, kind, pixel, {*best.terms, t.id}) for t in every if _may_enter(t, best.terms)]
        now = max(tried, key=lambda one: one.log_evidence, default=best)
        if now.log_evidence < best.log_evidence + ENTERED:
            break
        best = now
    for term in sorted(best.terms):
        if not _needed(term, best.terms, every):
            without = fit(series, kind, pixel, best.terms - {term})
            if without.log_evidence > best.log_evidence - ENTERED:
                best = without
    return best


def _may_enter(term: Term, there: Collection[str]) -> bool:
    return term.id not in there and (not term.needs or any(name in there for name in term.needs))


def _without(term: str, there: Collection[str], every: Sequence[Term]) -> frozenset[str]:
    """Return the terms without one, and without those that cannot be there without it."""
    rest = set(there) - {term}
    while lost := {t.id for t in every if t.id in rest and t.needs and not set(t.needs) & rest}:
        rest -= lost
    return frozenset(rest)


def _needed(term: str, there: Collection[str], every: Sequence[Term]) -> bool:
    """Whether a term is the only one of those that another term needs."""
    return any(t.id in there and term in t.needs and not (set(t.needs) - {term}) & set(there) for t in every)


def held_out_score(fitted: Fitted, series: Sequence[VarianceSeries]) -> Array:
    """Return the log predictive density of each of other series of variances [nats].

    Rows of a series are predicted together: with the covariance of the fitted values and the rows' own scatter. They
    are not conditioned on the neighbours that were fitted.

    Parameters
    ----------
    fitted : Fitted
    series : sequence of VarianceSeries
        Of names and pixels that were fitted.

    Returns
    -------
    ndarray (series,)
    """
    scores = []
    for one in series:
        law = fitted.law.of_series(one)
        slopes = law.slopes(fitted.values)
        lag = np.abs(np.subtract.outer(np.arange(one.x.size), np.arange(one.x.size)))
        spread = fitted.scatter**2 * fitted.tied**lag + slopes @ fitted.covariance @ slopes.T
        off = np.log(one.variance_DN2) - law.log_variance(fitted.values)
        scores.append(stats.multivariate_normal.logpdf(off, cov=spread, allow_singular=True))
    return np.array(scores)


def predicted(fitted: Fitted, one: VarianceSeries, share: float = 0.9) -> tuple[Array, Array, Array]:
    """Return the predicted variances of a series with the interval that holds a share of single rows [DN^2].

    A new series (another light) must have been in the fit without rows, for its own terms to have their priors; another
    temperature or exposure of pixels that were fitted needs nothing.

    Parameters
    ----------
    fitted : Fitted
    one : VarianceSeries
        Its variances are not looked at.
    share : float
        Probability [1].

    Returns
    -------
    tuple of ndarray (n,)
        Median, low, high.
    """
    law = fitted.law.of_series(one)
    centre, slopes = law.log_variance(fitted.values), law.slopes(fitted.values)
    spread = np.sqrt(fitted.scatter**2 + np.einsum("nk,kl,nl->n", slopes, fitted.covariance, slopes))
    reach = float(stats.norm.ppf(0.5 + 0.5 * share)) * spread
    return np.exp(centre), np.exp(centre - reach), np.exp(centre + reach)


@dataclass(frozen=True)
class Comparison:
    """What the rows say of the nominal sensor model.

    Attributes
    ----------
    kind : str
    nominal, best : Fitted
        To all rows.
    evidence : mapping of str to float
        Log evidence that each term of the best model, and what needs it, adds to the others [nats].
    chosen : mapping of str to int
        Number of folds, of :data:`FOLDS`, whose rows alone ask for the term.
    gain : tuple of float
        Held-out log score of the found over the nominal model, and its 95 % interval [nats].
    gain_of : mapping of str to tuple of float
        The same of the best model over that without the term and what needs it.
    rms : tuple of float
        Root mean square of held-out log variances about nominal and found model [1].
    rows : int
    """

    kind: str
    nominal: Fitted
    best: Fitted
    evidence: Mapping[str, float]
    chosen: Mapping[str, int]
    gain: tuple[float, float, float]
    gain_of: Mapping[str, tuple[float, float, float]]
    rms: tuple[float, float]
    rows: int

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        terms = [
            {
                "term": term.id, "words": term.words, "key": term.key or None,
                "values": dict(self.best.law.found(self.best.values)[term.id]), "log_evidence": self.evidence[term.id],
                "chosen_in_folds": self.chosen.get(term.id, 0), "held_out_gain": list(self.gain_of[term.id]),
            }
            for term in self.best.law.terms
        ]  # fmt: skip
        return {
            "rows_of": self.kind, "rows": self.rows, "folds": FOLDS, "terms": terms,
            "held_out_gain": list(self.gain), "held_out_rms": list(self.rms), "scatter": self.best.scatter,
            "correlation": self.best.tied, "log_evidence": self.best.log_evidence - self.nominal.log_evidence,
        }  # fmt: skip


def compare(
    series: Sequence[VarianceSeries], kind: Kind, pixel: Pixel, seen: Callable[[int, int], None] = lambda done, of: None
) -> Comparison:
    """Find what a nominal sensor model lacks; every fold chooses its own terms, from its own rows alone.

    Parameters
    ----------
    series : sequence of VarianceSeries
    kind : {"transfer", "dark"}
    pixel : Pixel
        Nominal.
    seen : callable
        Called with the searches done, and all.

    Returns
    -------
    Comparison
    """
    nominal, best = fit(series, kind, pixel, ()), search(series, kind, pixel)
    seen(1, FOLDS + 1)
    lesser = {term: _without(term, best.terms, terms_of(pixel, kind)) for term in sorted(best.terms)}
    evidence = {t: best.log_evidence - fit(series, kind, pixel, rest).log_evidence for t, rest in lesser.items()}
    chosen: dict[str, int] = {}
    gains: list[Array] = []
    each: dict[str, list[Array]] = {term: [] for term in best.terms}
    square = np.zeros(2)
    for fold in range(FOLDS):
        kept, held = _split(series, fold)
        models = [fit(kept, kind, pixel, ()), search(kept, kind, pixel)]
        for term in models[1].terms:
            chosen[term] = chosen.get(term, 0) + 1
        gains.append(held_out_score(models[1], held) - held_out_score(models[0], held))
        whole = held_out_score(fit(kept, kind, pixel, best.terms), held)
        for term, rest in lesser.items():
            each[term].append(whole - held_out_score(fit(kept, kind, pixel, rest), held))
        square += [_square(model, held) for model in models]
        seen(fold + 2, FOLDS + 1)
    rows = sum(one.x.size for one in series)
    low, high = (float(r) for r in np.sqrt(square / rows))
    return Comparison(
        kind, nominal, best, evidence, chosen, _interval(gains),
        {term: _interval(found) for term, found in each.items()}, (low, high), rows,
    )  # fmt: skip


def _square(fitted: Fitted, held: Sequence[VarianceSeries]) -> float:
    """Return the sum of squared log ratios of measured over predicted variance."""
    off = [np.log(h.variance_DN2) - fitted.law.of_series(h).log_variance(fitted.values) for h in held]
    return float(np.sum(np.concatenate(off) ** 2))


def _split(series: Sequence[VarianceSeries], fold: int) -> tuple[list[VarianceSeries], list[VarianceSeries]]:
    """Return the series without one stretch of each, and those stretches."""
    kept: list[VarianceSeries] = []
    held: list[VarianceSeries] = []
    for one in series:
        out = np.arange(one.x.size) * FOLDS // one.x.size == fold
        for rows, into in ((~out, kept), (out, held)):
            into.append(
                VarianceSeries(
                    one.name, one.pixels, one.x[rows], one.variance_DN2[rows], one.analogue_gain, one.temperature_C
                )
            )
    return kept, held


def _interval(gains: Sequence[Array]) -> tuple[float, float, float]:
    """Return the whole gain and its 95 % interval by the series' scatter; by the folds' where there is one series."""
    table = np.array(gains)
    parts = table.sum(axis=0) if table.shape[1] > 1 else table[:, 0]
    whole = float(parts.sum())
    reach = float(stats.t.ppf(0.975, parts.size - 1) * parts.std(ddof=1) * np.sqrt(parts.size))
    return whole, whole - reach, whole + reach
