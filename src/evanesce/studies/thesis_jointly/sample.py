"""Evidence and posterior of one set of mechanisms by importance sampling about its joint fit.

Laplace's approximation alone misjudges parameters that data push against a bound (nothing scatters: share and length
both at 0, where each hides the other). Points are therefore drawn about the fit, from Student's distribution of the
posterior's covariance, and from the prior for what a bound holds; each weighs by prior times likelihood over the
density it was drawn from. Mean and covariance follow the draws in some rounds; all draws weigh by the mean density
of all rounds (Cornuet, Marin, Mira and Robert 2012, Scand. J. Stat. 39, 798).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from evanesce.inference.joint_fit import JointFit
from evanesce.studies.thesis_jointly.predict import Predictor

Array = NDArray[Any]

DRAWS, FREEDOM, WIDER = 500, 5.0, 1.1
"""Points of a round; degrees of freedom; by how much their spread exceeds the posterior's."""
ROUNDS, MOST_ROUNDS, EFFECTIVE, ENOUGH = 5, 16, 100.0, 8
"""Rounds in which mean and covariance follow the draws before, at least and, until weights are worth so many draws, at
most; draws that their weights have to be worth, over the
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
    proposals: list[_Proposal] = [_Proposal.about(fit, problem)]
    values, like = np.zeros((0, fit.solution.values.size)), np.zeros(0)
    predicted = np.zeros((0, sd.size))
    for number in range(MOST_ROUNDS):
        more = proposals[-1].draw(count, rng)
        own, rows = problem.log_posterior(more)
        values, like = np.concatenate([values, more]), np.concatenate([like, own])
        predicted = np.concatenate([predicted, rows])
        density = special.logsumexp([one.log_density(values) for one in proposals], axis=0) - np.log(len(proposals))
        found = Draws(problem.names, problem.inside(values), predicted, like - density)
        if number + 1 >= ROUNDS and found.effective > EFFECTIVE:
            break
        proposals.append(_Proposal(*_moments(found), problem))
    return found


@dataclass(frozen=True)
class _Proposal:
    """Student's distribution of some parameters; the others come from the prior."""

    centre: Array
    spread: Array
    problem: _Problem
    free: NDArray[np.bool_] | None = None

    @classmethod
    def about(cls, fit: JointFit, problem: _Problem) -> _Proposal:
        """Return that of a joint fit, what a bound holds being drawn from the prior."""
        free = ~fit.solution.held
        covariance = np.linalg.inv(fit.solution.precision[np.ix_(free, free)])
        return cls(fit.solution.values[free], covariance, problem, free)

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Return draws (count, parameters)."""
        factor = np.linalg.cholesky(self.spread) * WIDER
        turned = rng.standard_normal((count, self.centre.size)) / np.sqrt(
            rng.chisquare(FREEDOM, size=(count, 1)) / FREEDOM
        )
        own = np.asarray(self.centre + turned @ factor.T)
        if self.free is None:
            return own
        values = self.problem.prior.rvs(size=(count, self.free.size), random_state=rng)
        values[:, self.free] = own
        return np.asarray(values)

    def log_density(self, values: Array) -> Array:
        """Return the log density (draws,) at draws (draws, parameters)."""
        own, rest = values, 0.0
        if self.free is not None:
            own = values[:, self.free]
            rest = self.problem.prior.logpdf(values)[:, ~self.free].sum(axis=1)
        factor, size = np.linalg.cholesky(self.spread) * WIDER, self.centre.size
        square = np.square(np.linalg.solve(factor, (own - self.centre).T)).sum(axis=0) if size else np.zeros(len(own))
        units = special.gammaln(0.5 * (FREEDOM + size)) - special.gammaln(0.5 * FREEDOM)
        units -= 0.5 * size * np.log(FREEDOM * np.pi) + np.log(np.diag(factor)).sum()
        return np.asarray(units - 0.5 * (FREEDOM + size) * np.log1p(square / FREEDOM) + rest)


class _Problem:
    """Prior and likelihood of a set's points."""

    def __init__(self, fit: JointFit, predictor: Predictor, data: Array, sd: Array) -> None:
        null, deviation = (np.array([getattr(p, key) for p in fit.parameters]) for key in ("null", "deviation"))
        self.low, self.high = (np.array([p.bounds[end] for p in fit.parameters]) for end in (0, 1))
        ends = ((self.low - null) / deviation, (self.high - null) / deviation)
        self.prior = stats.truncnorm(*ends, loc=null, scale=deviation)
        self.names = tuple(p.name for p in fit.parameters)
        self.predictor, self.data, self.sd = predictor, data, sd

    def inside(self, values: Array) -> Array:
        """Return draws moved within the bounds."""
        return np.asarray(np.clip(values, self.low, self.high))

    def log_posterior(self, values: Array) -> tuple[Array, Array]:
        """Return log prior times likelihood (draws,), minus infinity beyond bounds, and predictions (draws, rows)."""
        kept = self.inside(values)
        predicted = self.predictor(dict(zip(self.names, kept.T, strict=True)))
        units = np.log(self.sd).sum() + 0.5 * self.sd.size * np.log(2.0 * np.pi)
        like = -0.5 * np.square((self.data - predicted) / self.sd).sum(axis=1) - units
        found = like + self.prior.logpdf(kept).sum(axis=1)
        return np.where((kept == values).all(axis=1), found, -np.inf), predicted


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
