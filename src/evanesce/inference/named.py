"""Causes of an answer: intervals, consequences, what makes up for them, and their order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.consequence import NINETY, AreaReader, Consequence, nearest
from evanesce.inference.constants import LEAST_AREA, SUBSTITUTE
from evanesce.inference.gain import Interval
from evanesce.inference.groups import group_of
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.naming import told_of
from evanesce.inference.posterior import Posterior
from evanesce.inference.search import Search
from evanesce.prediction.fine import in_pixels
from evanesce.prediction.linear import CovarianceRows, Metric
from evanesce.prediction.parameters import value_of
from evanesce.prediction.point import natural

Array = NDArray[Any]


@dataclass(frozen=True)
class Named:
    """A cause of the answer.

    Attributes
    ----------
    id : str
    removed : float
        Share of the misfit that was there which comes back without the cause, all else refitted.
    consequence : Consequence
    parameters : mapping of str to mapping
        By name: value, ``lo`` and ``hi`` of the 90 % interval, unit.
    probability : float
        That it is there.
    credible_set : tuple of str
        Causes among which it is to 95 %; itself alone where nothing stands in for it.
    listed : bool
        Whether it moves the area by too little to be named first.
    held_out : tuple of float, optional
        What it adds to the log score of held-out conditions, and its 95 % interval [nats].
    partner : str
        Cause that makes up for it: the data hardly tell the two apart, and both together move the area by less than
        half of what one of them does.
    together : Consequence, optional
        Of both.
    """

    id: str
    removed: float
    consequence: Consequence
    parameters: Mapping[str, Mapping[str, Any]]
    probability: float
    credible_set: tuple[str, ...]
    listed: bool
    held_out: Interval | None = None
    partner: str = ""
    together: Consequence | None = None

    @property
    def told(self) -> str:
        """The cause, with those that stand in for it; those alone where what was fitted is none of them."""
        return told_of(self.id, self.credible_set)

    @property
    def moved(self) -> Consequence:
        """What it does to the area, together with what makes up for it."""
        return self.consequence if self.together is None else self.together

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""
        return {
            "id": self.id, "told": self.told, "group": group_of(self.credible_set),
            "parameters": {k: dict(v) for k, v in self.parameters.items()},
            "probability": self.probability, "credible_set": list(self.credible_set),
            "misfit_share": self.removed, "area": self.consequence.as_dict(), "below_least_area": self.listed,
            "held_out_nats": None if self.held_out is None else list(self.held_out),
            "together": None if self.together is None else {"with": self.partner, "area": self.together.as_dict()},
        }  # fmt: skip


def widened_covariance(fitted: JointFit, tied: CovarianceRows) -> Array:
    """Return the parameters' covariance (n, n) with the discrepancy in the noise, which widens every interval.

    Parameters
    ----------
    fitted : JointFit
    tied : CovarianceRows
        Of the discrepancy.

    Notes
    -----
    The fit weights by noise alone. With weights P, derivatives J and the discrepancy's covariance T'T its estimate has
    the covariance A + A J P T'T P J' A, A = (J P J' + priors)^-1 (the sandwich of misspecified models, Huber 1967).
    """
    rows = fitted.solution.rows
    own = fitted.solution.covariance
    spread = own @ tied.products(fitted.metric.project(rows))
    return np.asarray(own + spread @ spread.T)


def lacking_each(search: Search, fitted: JointFit) -> dict[str, JointFit]:
    """Return a fit without each of its causes, where the rig can lack it."""
    found = {name: search.lacking(fitted, name) for name in fitted.ids}
    return {name: one for name, one in found.items() if one is not None}


def scaled(metric: Metric, residual: Array) -> float:
    """Return the mean squared residual (at least 1): by so much noise was taken for less than what is left."""
    return max(1.0, float(metric.project(residual) @ residual) / residual.size)


def named_causes(
    search: Search,
    areas: AreaReader,
    fitted: JointFit,
    tied: CovarianceRows,
    posterior: Posterior,
    held_out: Mapping[str, Interval],
) -> list[Named]:
    """Return the causes, by consequence; those that move the area too little to be named, by held-out score.

    Parameters
    ----------
    search : Search
    areas : AreaReader
    fitted : JointFit
    tied : CovarianceRows
    posterior : Posterior
    held_out : mapping of str to tuple of float
        What causes add to the log score of held-out conditions, with intervals [nats].
    """
    covariance = widened_covariance(fitted, tied) * scaled(fitted.metric, fitted.residual)
    deviation = np.sqrt(np.diag(covariance))
    factor = search.fitter.model.factor
    found = []
    for taken in fitted.taken:
        parameters = {}
        for k in fitted.of_cause(taken.id):
            p = fitted.parameters[k]
            low, high = p.bounds
            value = value_of(fitted.point, p)
            ends = (max(value - NINETY * deviation[k], low), min(value + NINETY * deviation[k], high))
            real = [in_pixels({p.name: p.coordinate.value(float(v))}, factor)[p.name] for v in (value, *ends)]
            name = p.name.partition(":")[2]
            parameters[name] = {"value": real[0], "lo": real[1], "hi": real[2], "unit": p.unit}
        for name, value in fitted.point.items():
            effect, _, own = name.partition(":")
            if effect == taken.id and own and own not in parameters:
                value = natural(name, value)
                parameters[own] = {"value": value, "lo": value, "hi": value, "unit": ""}
        consequence = areas.of_causes(fitted, covariance, taken.id)
        removed = search.share(search.lost(fitted, taken.id))
        place = posterior.places[taken.id]
        found.append(
            Named(
                taken.id, removed, consequence, parameters, place.probability[taken.id], place.credible_set,
                consequence.largest < LEAST_AREA, held_out.get(taken.id),
            )
        )  # fmt: skip
    return _paired(found, lambda name: nearest(fitted, covariance, name), partial(areas.of_causes, fitted, covariance))


def _paired(found: Sequence[Named], near: Callable[[str], str], areas: Callable[..., Consequence]) -> list[Named]:
    """Return causes, by consequence, with those that make up for them: one without the other is a rig nobody has.

    Parameters
    ----------
    found : sequence of Named
    near : callable
        ``near(name)``: the cause from which the data hardly tell it; empty if there is none.
    areas : callable
        ``areas(name, other)``: what both do to the area.
    """
    known = {n.id: n for n in found}
    for n in sorted(found, key=lambda n: -n.consequence.largest):
        other = near(n.id) if not n.listed and known[n.id].together is None else ""
        if not other or known[other].together is not None:
            continue
        together = areas(n.id, other)
        if together.change_mm2 and together.largest < SUBSTITUTE * n.consequence.largest:
            for one, partner in ((n.id, other), (other, n.id)):
                known[one] = replace(known[one], partner=partner, together=together)
    return sorted(known.values(), key=_rank)


def _rank(cause: Named) -> tuple[float, float, bool, float]:
    """Return what causes are ordered by: what they do to the area, if that is enough to be named, then held-out score.

    Of two that make up for each other one stands behind the other.
    """
    moved = cause.moved.largest
    score = cause.held_out[0] if cause.held_out is not None else cause.removed
    named = moved >= LEAST_AREA
    return -moved if named else 0.0, 0.0 if named else -score, cause.partner < cause.id, -cause.removed
