"""Which causes there are, with which probability: the joint fit as a sum of single effects.

Each taken cause has a place of its own. What its place is filled by is judged on the data less the prediction without
that cause, with all that else is fitted, and the discrepancy, marginalised: the cause itself, any cause that was not
taken, something unknown, or nothing. One more place asks for a further cause. So whatever else is said of the causes
(verdict, sets, groups) is read off these probabilities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.rng import generator
from evanesce.criticism.parameters import Parameter
from evanesce.inference.causes import Cause
from evanesce.inference.discrepancy import Discrepancy
from evanesce.inference.joint import Fitter, JointFit
from evanesce.inference.shapes import FormBank
from evanesce.inference.single_effects import NONE, UNKNOWN, Place, Shapes, null_statistics, p_value, place_of
from evanesce.inference.small_space import SmallSpace
from evanesce.inference.unknown import unknown_rows

Array = NDArray[Any]


@dataclass(frozen=True)
class Posterior:
    """Probabilities of the causes.

    Attributes
    ----------
    places : mapping of str to Place
        Of each taken cause.
    further : Place
        One more.
    further_p : float
        p-value of the evidence for a further cause, against noise.
    """

    places: Mapping[str, Place]
    further: Place
    further_p: float

    @property
    def inclusion(self) -> dict[str, float]:
        """Probability of each cause to be in the rig, the most probable first."""
        out: dict[str, float] = {}
        for place in (*self.places.values(), self.further):
            for name, probability in place.probability.items():
                if name != NONE:
                    out[name] = out.get(name, 1.0) * (1.0 - probability)
        return dict(sorted(((n, 1.0 - left) for n, left in out.items()), key=lambda pair: -pair[1]))

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""
        return {
            "inclusion": self.inclusion,
            "places": {
                name: {"credible_set": list(p.credible_set), "probability": _largest(p)} for name, p in self.places.items()
            },
            "further": {
                "credible_set": list(self.further.credible_set), "probability": _largest(self.further),
                "p_value": self.further_p,
            },
        }  # fmt: skip


def _largest(place: Place) -> dict[str, float]:
    ordered = sorted(place.probability.items(), key=lambda pair: -pair[1])
    return {name: value for name, value in ordered if value >= 0.001}


def posterior_of(
    fitter: Fitter, fitted: JointFit, causes: Sequence[Cause], bank: FormBank, discrepancy: Discrepancy
) -> Posterior:
    """Return the probabilities of all causes at a joint fit.

    Parameters
    ----------
    fitter : Fitter
        Anchored at the fit.
    fitted : JointFit
    causes : sequence of Cause
    bank : FormBank
    discrepancy : Discrepancy
    """
    data, model = fitter.data, fitter.model
    whole = model.vector(fitted.point)
    secants = {t.id: whole - model.vector(fitted.without(t.id)) for t in fitted.taken}
    blocks: dict[str, Array] = {"nuisances": np.concatenate([fitted.metric.rows, _scaled(fitted, "@")])}
    for taken in fitted.taken:
        blocks[f"fitted {taken.id}"] = _scaled(fitted, f"{taken.id}:")
    blocks["discrepancy"] = discrepancy.rows(fitted)
    for forms in bank.of(causes):
        rows = forms.rows(data)
        if forms.id in secants:
            # What was relinearised is one more form of it, as likely as each of those drawn.
            rows = np.concatenate([rows, secants[forms.id][None].astype(np.float32)])
        blocks[forms.id] = rows
    blocks[UNKNOWN] = unknown_rows(data, bank.nominal)
    lefts = np.array([fitted.residual + secant for secant in secants.values()] + [fitted.residual])
    space = SmallSpace(blocks, lefts)
    known = [c.id for c in causes if c.id in blocks] + [UNKNOWN]
    places = {}
    for number, name in enumerate(secants):
        others = [n for n in secants if n != name]
        marginal = ["nuisances", "discrepancy", *(f"fitted {n}" for n in others)]
        places[name], _ = _judged(space, marginal, [n for n in known if n not in others], number)
    marginal = ["nuisances", "discrepancy", *(f"fitted {n}" for n in secants)]
    rest = [n for n in known if n not in secants]
    further, p = _judged(space, marginal, rest, len(secants), with_p=True)
    return Posterior(places, further, p)


def _judged(
    space: SmallSpace, marginal: Sequence[str], candidates: Sequence[str], vector: int, *, with_p: bool = False
) -> tuple[Place, float]:
    gram, along = space.marginalised(marginal, candidates, vector)
    shapes, products, start, cuts = [], {}, 0, []
    for name in candidates:
        part = space.places[name]
        cut = slice(start, start + part.stop - part.start)
        cuts.append(cut)
        shapes.append(Shapes.of(name, gram[cut, cut]))
        products[name] = along[cut]
        start = cut.stop
    place = place_of(shapes, products)
    if not with_p:
        return place, 0.0
    return place, p_value(place, null_statistics(shapes, gram, generator(0, "null statistics")))


def _scaled(fitted: JointFit, prefix: str) -> Array:
    """Return the derivatives (n, bins) by parameters of a prefix, times their prior standard deviations."""
    chosen = [k for k, p in enumerate(fitted.parameters) if p.name.startswith(prefix)]
    deviations = np.array([_deviation(fitted.parameters[k]) for k in chosen])
    return np.asarray(fitted.solution.rows[chosen] * deviations[:, None], np.float32)


def _deviation(parameter: Parameter) -> float:
    return float(parameter.deviation)
