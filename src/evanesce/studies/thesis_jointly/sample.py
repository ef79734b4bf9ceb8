"""Evidence and posterior of one set of mechanisms by importance sampling about its joint fit.

Laplace's approximation alone misjudges parameters that data push against a bound (nothing scatters: share and length
both at 0, where each hides the other). Points are therefore drawn about the fit, from Student's distribution of the
posterior's covariance, and from the prior for what a bound holds; each weighs by prior times likelihood over the
density it was drawn from. Mean and covariance follow the draws in some rounds (Cappe, Guillin, Marin and Robert 2004,
J. Comput. Graph. Stat. 13, 907).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from evanesce.inference.joint import JointFit
from evanesce.studies.thesis_jointly.predict import Predictor

Array = NDArray[Any]

DRAWS, FREEDOM, WIDER = 1000, 8.0, 1.1
"""Points of a round; degrees of freedom; by how much their spread exceeds the posterior's."""
ROUNDS, ENOUGH = 3, 8
"""Rounds in which mean and covariance follow the draws before; draws that their weights have to be worth, over the
number of parameters, or else weights are tempered."""


@dataclass(frozen=True)
class Draws:
    """Weighted points of one set of mechanisms.

    Attributes
    ----------
    names : tuple of str
        Of the parameters.
    values : ndarray (draws, parameters)
    predicted : ndarray (draws, rows)
        As rows count.
    log_weight : ndarray (draws,)
        Of prior times likelihood over the density of the draw.
    """

    names: tuple[str, ...]
    values: Array
    predicted: Array
    log_weight: Array

    @property
    def log_evidence(self) -> float:
        """Of the data, in the rows' own units [nats]."""
        return float(special.logsumexp(self.log_weight) - np.log(len(self.log_weight)))

    @property
    def effective(self) -> float:
        """Number of independent draws that the weights are worth (Kish)."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return float(weight.sum() ** 2 / np.square(weight).sum())

    def equal(self, count: int, rng: np.random.Generator) -> Array:
        """Return points (count, parameters) of equal weight."""
        weight = np.exp(self.log_weight - special.logsumexp(self.log_weight))
        return np.asarray(self.values[rng.choice(len(weight), count, p=weight / weight.sum())])


def drawn(
    fit: JointFit, predictor: Predictor, data: Array, sd: Array, rng: np.random.Generator, count: int = DRAWS
) -> Draws:
    """Draw points about a joint fit and weigh them.

    Parameters
    ----------
    fit : JointFit
    predictor : Predictor
    data, sd : ndarray (rows,)
        As rows count.
    rng : numpy.random.Generator
    count : int

    Returns
    -------
    Draws
    """
    problem = _Problem(fit, predictor, data, sd)
    free, at = ~fit.solution.held, fit.solution.values
    first = problem.prior.rvs(size=(count, at.size), random_state=rng)
    density = problem.prior.logpdf(first)[:, ~free].sum(axis=1)
    if free.any():
        first[:, free], own = _student(at[free], _covariance(fit)[np.ix_(free, free)] * WIDER**2, count, rng)
        density = density + own
    found = problem.weighed(first, density)
    for _ in range(ROUNDS):
        centre, spread = _moments(found)
        values, density = _student(centre, spread * WIDER**2, count, rng)
        found = problem.weighed(values, density)
    return found


class _Problem:
    """Prior and likelihood of a set's points."""

    def __init__(self, fit: JointFit, predictor: Predictor, data: Array, sd: Array) -> None:
        null, deviation = (np.array([getattr(p, key) for p in fit.parameters]) for key in ("null", "deviation"))
        self.low, self.high = (np.array([p.bounds[end] for p in fit.parameters]) for end in (0, 1))
        ends = ((self.low - null) / deviation, (self.high - null) / deviation)
        self.prior = stats.truncnorm(*ends, loc=null, scale=deviation)
        self.names = tuple(p.name for p in fit.parameters)
        self.predictor, self.data, self.sd = predictor, data, sd

    def weighed(self, values: Array, density: Array) -> Draws:
        """Return draws (draws, parameters) of some log density (draws,) with their weights."""
        inside = ((values >= self.low) & (values <= self.high)).all(axis=1)
        kept = np.clip(values, self.low, self.high)
        predicted = self.predictor(dict(zip(self.names, kept.T, strict=True)))
        units = np.log(self.sd).sum() + 0.5 * self.sd.size * np.log(2.0 * np.pi)
        like = -0.5 * np.square((self.data - predicted) / self.sd).sum(axis=1) - units
        weight = np.where(inside, like + self.prior.logpdf(kept).sum(axis=1) - density, -np.inf)
        return Draws(self.names, kept, predicted, weight)


def _student(centre: Array, spread: Array, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return draws (count, n) of Student's distribution and their log densities (count,)."""
    factor, size = np.linalg.cholesky(spread), centre.size
    normal = rng.standard_normal((count, size))
    turned = normal / np.sqrt(rng.chisquare(FREEDOM, size=(count, 1)) / FREEDOM)
    square = np.square(turned).sum(axis=1)
    units = special.gammaln(0.5 * (FREEDOM + size)) - special.gammaln(0.5 * FREEDOM)
    units -= 0.5 * size * np.log(FREEDOM * np.pi) + np.log(np.diag(factor)).sum()
    return centre + turned @ factor.T, units - 0.5 * (FREEDOM + size) * np.log1p(square / FREEDOM)


def _moments(found: Draws) -> tuple[Array, Array]:
    """Return mean and covariance of weighted draws, weights tempered until they are worth enough draws."""
    log = found.log_weight - found.log_weight.max()
    power = 1.0
    while power > 0.05:
        weight = np.exp(power * log)
        weight /= weight.sum()
        if 1.0 / np.square(weight).sum() > ENOUGH * found.values.shape[1]:
            break
        power *= 0.8
    centre = weight @ found.values
    off = found.values - centre
    spread = (weight[:, None] * off).T @ off
    return centre, spread + np.diag(1e-6 * np.diag(spread) + 1e-12)


def _covariance(fit: JointFit) -> Array:
    """Return the posterior covariance with what is held left out of the inverse."""
    free = ~fit.solution.held
    found = np.zeros_like(fit.solution.precision)
    found[np.ix_(free, free)] = np.linalg.inv(fit.solution.precision[np.ix_(free, free)])
    return found
