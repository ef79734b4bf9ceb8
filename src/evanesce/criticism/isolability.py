"""What can be told from what: squared distances between causes, and which nuisance hides one.

Everything is measured in the metric of a fitted model, its nuisances refitted: a distance of 9 is three standard
deviations, below which two causes are one answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.prediction.linear import Metric, distance2
from evanesce.prediction.parameters import Parameter

Array = NDArray[Any]


@dataclass(frozen=True)
class Cause:
    """A candidate that was fitted.

    Attributes
    ----------
    id : str
    signal : ndarray (bins,)
        Whitened change that it makes at its fitted values.
    rows : ndarray (k, bins)
        Whitened derivatives there.
    deviations : ndarray (k,)
        Of the priors.
    """

    id: str
    signal: Array
    rows: Array
    deviations: Array


def confusion(causes: Sequence[Cause], metric: Metric) -> Array:
    """Return squared distances (n, n): of each signal from the nearest that another cause can make, nuisances free."""
    found = np.zeros((len(causes), len(causes)))
    for i, one in enumerate(causes):
        for j, other in enumerate(causes):
            if i != j:
                # Linear about the other's own fit, which already is the nearest point or close to it.
                found[i, j] = distance2(one.signal - other.signal, metric, other.rows)
    return found


def group_of(best: int, distances: Array, limit: float) -> tuple[int, ...]:
    """Return the numbers of causes that cannot be told from ``best``: near to it in either direction."""
    near = np.minimum(distances[best], distances[:, best]) < limit
    return tuple(int(k) for k in np.flatnonzero(near) if k != best)


def absorbed(
    signals: Mapping[str, Array], metric: Metric, nuisances: Sequence[Parameter], limit: float
) -> list[dict[str, str]]:
    """Return the causes whose plausible departure would be loud, were it not for a nuisance that takes it.

    Parameters
    ----------
    signals : mapping of str to ndarray (bins,)
        Whitened change by a departure of one prior standard deviation.
    metric : Metric
        Of the nuisances, its rows in their order.
    nuisances : sequence of Parameter
    limit : float
        Squared distance that counts as loud.

    Returns
    -------
    list of dict
        ``id`` and ``by``, the nuisance that takes most of it.
    """
    found = []
    for name, signal in signals.items():
        loud = float(signal @ signal)
        if loud < limit or distance2(signal, metric, np.zeros((0, signal.size))) >= limit:
            continue
        taken = [distance2(signal, Metric.of(row[None], np.ones(1)), np.zeros((0, signal.size))) for row in metric.rows]
        found.append({"id": name, "by": nuisance_words(nuisances[int(np.argmin(taken))].name)})
    return found


WORDS = {
    "@light": "the light's unknown level",
    "@black": "the black level's rounding",
    "@pose_x": "the finger's place (x)",
    "@pose_y": "the finger's place (y)",
    "@noise": "the noise's size before the tone curve",
    "@resolution": "what finer pixels change",
    "@edge": "the place of the edge of contact",
    "@codec_dark": "what the codec makes of the dark",
    "@codec_darkest": "what the codec makes of the dark",
    "@codec_soft": "the codec's softening",
    "@codec_share": "what the codec makes of the light",
    "@codec_bias": "what the codec, if it is the one that was found, changes",
    "@flicker": "the light's jitter",
    "@force": "the load cell's error",
    "@turn": "the card's turn",
    "@card_light": "the room's light on the card",
    "@card_slope_x": "the room's light on the card",
    "@card_slope_y": "the room's light on the card",
}


def nuisance_words(name: str) -> str:
    """Return a nuisance in words."""
    stem = name.partition("[")[0]
    return WORDS.get(stem, stem)
