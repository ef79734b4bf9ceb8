"""By how much a calibrated model's light is off in ways that no figure stands for, learned from what is left.

A real rig is lit as no model is to a hundredth of the noise. Where noise alone weighs what is left, figures of geometry
and mechanics give way to errors of the light. Here smooth errors of the light and of the level, alike in all views or
each view's own, have strengths of their own, and those that explain what is left best (the evidence's maximum) are
marginalised in the next fit. A model that leaves only noise gets none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.constants import WAVES
from evanesce.inference.discrepancy import cosines
from evanesce.inference.joint import JointFit
from evanesce.inference.model import AnchoredModel
from evanesce.inference.search import everything_marginalised
from evanesce.inference.small_space import products
from evanesce.prediction.parameters import Parameter, derivative

Array = NDArray[Any]

OWN_WAVES = 2
"""Cosines along each side of the frame, of errors that each view has by itself."""
STRENGTHS: Mapping[str, Array] = {
    "light, alike in all views": np.array([0.0, 0.003, 0.01, 0.03, 0.1, 0.3]),
    "light, each view's own": np.array([0.0, 0.003, 0.01, 0.03, 0.1, 0.3]),
    "level, each view's own": np.array([0.0, 0.1, 0.3, 1.0, 3.0, 10.0]),
}
"""Standard deviations that are tried: shares of the light, and DN."""
ROUNDS = 3
"""In which each strength is chosen given the others; they settle in two."""
WORTH = 10.0
"""Log evidence [nats] that an error must bring to be taken: a grid of strengths is searched for each."""


@dataclass(frozen=True)
class OwnError:
    """Errors of the light and of the level.

    Attributes
    ----------
    strengths : mapping of str to float
        Standard deviation of each kind: share of the light, or DN; 0 where the data ask for none.
    rows : ndarray (k, d)
        Whitened, each of unit prior standard deviation.
    """

    strengths: Mapping[str, float]
    rows: Array


def told_error(name: str, size: float) -> str:
    """Return an error in words.

    Parameters
    ----------
    name : str
        Of :data:`STRENGTHS`.
    size : float
    """
    return f"{name}: {100 * size:g} %" if name.startswith("light") else f"{name}: {size:g} DN"


def own_error(model: AnchoredModel, fitted: JointFit) -> OwnError:
    """Return the errors of light and level that explain best what a fit leaves.

    Parameters
    ----------
    model : AnchoredModel
        Anchored about the fit.
    fitted : JointFit

    Returns
    -------
    OwnError
    """
    blocks = _blocks(model, fitted)
    rows = np.concatenate(list(blocks.values()))
    metric, believed = everything_marginalised(fitted)
    seen = np.asarray(metric.project(rows), np.float32)
    gram, along = products(seen, rows), np.asarray(seen @ believed, float)
    names, counts = list(blocks), [len(block) for block in blocks.values()]
    chosen = dict.fromkeys(names, 0.0)

    def evidence(strengths: Mapping[str, float]) -> float:
        size = np.repeat([strengths[name] for name in names], counts)
        kept = size > 0
        inner = np.eye(int(kept.sum())) + size[kept, None] * gram[np.ix_(kept, kept)] * size[kept]
        data = size[kept] * along[kept]
        return float(0.5 * data @ np.linalg.solve(inner, data) - 0.5 * np.linalg.slogdet(inner)[1])

    for _ in range(ROUNDS):
        for name in names:
            tried = {float(s): evidence({**chosen, name: float(s)}) for s in STRENGTHS[name]}
            best = max(tried, key=lambda s: tried[s])
            chosen[name] = best if tried[best] > tried[0.0] + WORTH else 0.0
    taken = [chosen[name] * blocks[name] for name in names if chosen[name] > 0]
    return OwnError(chosen, np.concatenate([rows[:0], *taken]).astype(np.float32))


def _blocks(model: AnchoredModel, fitted: JointFit) -> dict[str, Array]:
    """Return the whitened rows of each kind of error, for a strength of 1 over all of its waves together."""
    data = model.data
    lit = [k for k in data.open if data.views[k].touches]
    power = Parameter(name="@light", deviation=1.0, step=0.01)
    light = np.nan_to_num(derivative(model.coarse, fitted.point, power, lit))
    alike, own = cosines(light.shape[1:], WAVES), cosines(light.shape[1:], OWN_WAVES)
    everywhere = np.zeros_like(light)
    everywhere[lit] = light[lit]

    def single(values: Array, views: list[int]) -> Array:
        rows = []
        for k in views:
            for wave in own:
                only = np.zeros_like(light)
                only[k] = values[k] * wave
                rows.append(data.whitened(only))
        return np.array(rows).reshape(-1, data.whitened(light).size) / np.sqrt(len(own))

    names = list(STRENGTHS)
    return {
        names[0]: np.array([data.whitened(everywhere * wave) for wave in alike]) / np.sqrt(len(alike)),
        names[1]: single(light, lit),
        names[2]: single(np.ones_like(light), list(data.open)),
    }
