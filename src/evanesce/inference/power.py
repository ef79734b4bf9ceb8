"""Expected power: how often a cause of given strength would be detected, named and covered, from noiseless signals.

A form of a cause is left out of what the critic knows of it, scaled to a strength, and seen through many draws of noise
in the small space of all forms. No case is drawn and no rig is fitted, so that a change of the critic is judged in
seconds; a form that is left out is still of the same making as those kept, so that these rates are a ceiling.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.constants import CREDIBLE, DETECTED
from evanesce.inference.single_effects import (
    LEAST_EIGENVALUE,
    UNKNOWN,
    Shapes,
    cause_of,
    merged,
    null_statistics,
    statistic_of,
)
from evanesce.inference.small_space import SmallSpace

Array = NDArray[Any]


@dataclass(frozen=True)
class Power:
    """Rates of one cause at one strength, means over its forms.

    Attributes
    ----------
    id : str
    strength : float
        Norm of the signal once nuisances took what they could [standard deviations].
    detected : float
        With a p-value below DETECTED.
    first : float
        Detected, and the most probable cause.
    covered, size : float
        Share of detected cases whose credible set holds the cause, and the mean size of the set; NaN if none.
    """

    id: str
    strength: float
    detected: float
    first: float
    covered: float
    size: float


def expected_power(
    space: SmallSpace,
    marginal: Mapping[str, float | Array],
    strengths: Sequence[float],
    rng: np.random.Generator,
    draws: int = 60,
    left_out: Sequence[str] = (),
) -> list[Power]:
    """Return the power for every cause and strength.

    Parameters
    ----------
    space : SmallSpace
        Blocks of forms by cause, of the unknown, and of what is marginalised; no vectors needed.
    marginal : mapping of str to float
        See :meth:`SmallSpace.marginalised`.
    strengths : sequence of float
    rng : numpy.random.Generator
    draws : int
        Of noise, for each form.
    left_out : sequence of str
        Blocks that are neither causes nor marginalised.
    """
    causes = [name for name in space.places if name not in marginal and name not in left_out]
    gram, _ = space.marginalised(marginal, causes, None)
    cuts, start = {}, 0
    for name in causes:
        cuts[name] = np.arange(start, start + len(space.places[name]))
        start += len(cuts[name])
    values, axes = np.linalg.eigh(gram)
    kept = values > LEAST_EIGENVALUE * values[-1]
    root = axes[:, kept] * np.sqrt(values[kept])
    whole = {name: Shapes.of(name, gram[np.ix_(cut, cut)]) for name, cut in cuts.items()}
    null = null_statistics(list(whole.values()), gram, rng)
    threshold = float(np.quantile(null, 1.0 - DETECTED))
    found = []
    for name in causes:
        if cause_of(name) == UNKNOWN or len(cuts[name]) < 2:
            continue
        rates: dict[float, list[Array]] = {s: [] for s in strengths}
        for place in cuts[name]:
            norm = np.sqrt(max(gram[place, place], 0.0))
            others = cuts[name][cuts[name] != place]
            own = Shapes.of(name, gram[np.ix_(others, others)])
            if norm <= 0 or not own.eigenvalues.size:
                continue
            for s in strengths:
                along = s * gram[place] / norm + rng.standard_normal((draws, int(kept.sum()))) @ root.T
                bayes = [(own if n == name else whole[n], others if n == name else cut) for n, cut in cuts.items()]
                every = merged({c.id: c.log_bayes(c.coordinates(along[:, cut])) for c, cut in bayes})
                rates[s].append(_judged(np.array(list(every.values())), list(every).index(name), threshold))
        found += [_power(name, s, np.concatenate(rows, axis=1)) for s, rows in rates.items() if rows]
    return found


def _judged(every: Array, truth: int, threshold: float) -> Array:
    """Return detected, first, covered and size of the set (4, draws) for log Bayes factors (causes, draws)."""
    detected = statistic_of(every) > threshold
    order = np.argsort(-every, axis=0)
    share = np.exp(every - np.logaddexp.reduce(every, axis=0))
    held = np.cumsum(np.take_along_axis(share, order, axis=0), axis=0)
    size = (held < CREDIBLE).sum(axis=0) + 1
    rank = np.argmax(order == truth, axis=0)
    return np.array([detected, detected & (order[0] == truth), rank < size, size], float)


def _power(name: str, strength: float, rows: Array) -> Power:
    detected = rows[0] > 0
    covered, size = (float(rows[k][detected].mean()) if detected.any() else float("nan") for k in (2, 3))
    return Power(name, strength, float(rows[0].mean()), float(rows[1].mean()), covered, size)
