"""Probabilities of none, each effect, pairs and the unknown, from evidences and frozen priors over their number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp

from evanesce.prediction.frozen import FROZEN

NONE, UNKNOWN = "none", "unknown"


@dataclass(frozen=True)
class Posterior:
    """Over all models that were weighed.

    Attributes
    ----------
    models : mapping of tuple of str to float
        Probability by the effects in the model; ``("unknown",)`` and ``(effect, "unknown")`` hold a flexible term.
    """

    models: Mapping[tuple[str, ...], float]

    def marginal(self) -> dict[str, float]:
        """Return the probability of ``none``, of the unknown, and of each effect alone or with another."""
        found = {NONE: self.models.get((), 0.0), UNKNOWN: 0.0}
        for effects, probability in self.models.items():
            for name in effects:
                found[name] = found.get(name, 0.0) + probability
        # Sums of what normalised to one may exceed it by rounding.
        return {name: min(value, 1.0) for name, value in found.items()}

    @property
    def best(self) -> tuple[str, ...]:
        """Effects of the most probable model."""
        return max(self.models, key=lambda k: self.models[k])


def posterior(log_bayes: Mapping[tuple[str, ...], float], library: int) -> Posterior:
    """Return probabilities from log Bayes factors against no effect.

    Parameters
    ----------
    log_bayes : mapping of tuple of str to float
        By the effects in the model; the empty one is 0 by definition and need not be there.
    library : int
        How many effects could have been named: each has an equal share of the prior for one cause.
    """
    known = FROZEN.priors
    pairs = max(library * (library - 1) / 2, 1)
    log_prior = {
        0: np.log(known["none"]),
        1: np.log(known["one"] / max(library, 1)),
        2: np.log(known["two"] / pairs),
    }
    weights: dict[tuple[str, ...], float] = {(): float(log_prior[0])}
    for effects, value in log_bayes.items():
        named = [e for e in effects if e != UNKNOWN]
        if not effects:
            continue
        if UNKNOWN in effects:
            prior = np.log(known["unknown"]) + (np.log(1.0 / max(library, 1)) * len(named))
        else:
            prior = log_prior[min(len(named), 2)] + max(len(named) - 2, 0) * np.log(known["two"] / max(library, 1))
        weights[effects] = float(prior + value)
    total = float(logsumexp(list(weights.values())))
    return Posterior({effects: float(np.exp(w - total)) for effects, w in weights.items()})


def with_mimics(found: Posterior) -> Posterior:
    """Return probabilities once something unknown may draw what each named cause draws, as well as it does.

    Evidence cannot tell a cause from another one of the same picture, however loud it is. How often that happens is not
    in the data either: the odds are those by which loud names were wrong before (``mimic``), for each cause of each
    model, however many they are.
    """
    odds = FROZEN.priors["mimic"]
    models = dict(found.models)
    for effects, probability in found.models.items():
        named = tuple(e for e in effects if e != UNKNOWN)
        for cause in named:
            others = (*(e for e in named if e != cause), UNKNOWN)
            models[others] = models.get(others, 0.0) + odds * probability
    total = sum(models.values())
    return Posterior({effects: value / total for effects, value in models.items()})


def tempering(p: float, log_bayes: Sequence[float]) -> float:
    """Return the power, at most 1, by which evidence for single causes agrees with the probability of their best score.

    Whatever the alternative, a test of probability ``p`` bears out odds of at most 1 / (-e p ln p). Evidence that says
    more rests on a likelihood with thinner tails than the noise that was drawn, as that of a codec has.

    Parameters
    ----------
    p : float
        That noise makes any cause score as well.
    log_bayes : sequence of float
        Of all causes, each alone against none [nats].

    References
    ----------
    Sellke, Bayarri and Berger, "Calibration of p values for testing precise null hypotheses", The American
    Statistician 55 (2001) 62.
    """
    if not len(log_bayes) or p <= 0.0:
        return 1.0
    most = -float(np.log(-np.e * p * np.log(p))) if p < 1.0 / np.e else 0.0
    values = np.asarray(log_bayes, float)

    def surplus(power: float) -> float:
        return float(logsumexp(power * values) - np.log(values.size)) - most

    return 1.0 if surplus(1.0) <= 0.0 else float(brentq(surplus, 0.0, 1.0)) if surplus(0.0) < 0.0 else 0.0


def log_bayes_of_p(p: float) -> float:
    """Return the log Bayes factor that a p-value stands for, p being Beta(0.2, 1) under the alternative.

    At 0.01 a factor of 8, as large as any unimodal alternative's; at 0.5 one of 0.35, against it.

    References
    ----------
    Sellke, Bayarri and Berger, "Calibration of p values for testing precise null hypotheses", The American
    Statistician 55 (2001) 62.
    """
    shape = FROZEN.priors["p_shape"]
    return float(np.log(shape) + (shape - 1.0) * np.log(p))
