"""The answer: causes with intervals and consequences, what is explained, the gain, the extended scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.criticism.fine import in_pixels
from evanesce.criticism.linear import Metric
from evanesce.criticism.parameters import value_of
from evanesce.criticism.predict import scene_with
from evanesce.inference.consequence import NINETY, AreaReader, Consequence
from evanesce.inference.constants import LEAST_AREA
from evanesce.inference.gain import HeldOut
from evanesce.inference.gate import Gate
from evanesce.inference.joint import JointFit
from evanesce.inference.model import AnchoredModel
from evanesce.inference.posterior import Posterior
from evanesce.inference.search import Search, loss_of
from evanesce.rig import Scene, dump_scene

Array = NDArray[Any]

VERSION = 1
"""Of the answer's form."""


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
    """

    id: str
    removed: float
    consequence: Consequence
    parameters: Mapping[str, Mapping[str, Any]]
    probability: float
    credible_set: tuple[str, ...]
    listed: bool

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""
        return {
            "id": self.id, "parameters": {k: dict(v) for k, v in self.parameters.items()},
            "probability": self.probability, "credible_set": list(self.credible_set), "misfit_share": self.removed, "area": self.consequence.as_dict(), "below_least_area": self.listed,
        }  # fmt: skip


def widened_covariance(fitted: JointFit, tied: Array) -> Array:
    """Return the parameters' covariance (n, n) with the discrepancy in the noise, which widens every interval.

    Parameters
    ----------
    fitted : JointFit
    tied : ndarray (k, bins)
        Rows of the discrepancy.

    Notes
    -----
    The fit weights by noise alone. With weights P, derivatives J and the discrepancy's covariance T'T its estimate has
    the covariance A + A J P T'T P J' A, A = (J P J' + priors)^-1 (the sandwich of misspecified models, Huber 1967).
    """
    rows = fitted.solution.rows
    own = fitted.solution.covariance
    cross = rows @ np.asarray(fitted.metric.project(tied.astype(float))).T
    spread = own @ cross
    return np.asarray(own + spread @ spread.T)


def scaled(metric: Metric, residual: Array) -> float:
    """Return the mean squared residual (at least 1): by so much noise was taken for less than what is left."""
    return max(1.0, float(metric.project(residual) @ residual) / residual.size)


def named_causes(
    search: Search, areas: AreaReader, fitted: JointFit, tied: Array, posterior: Posterior
) -> list[Named]:
    """Return the causes, by consequence.

    Parameters
    ----------
    search : Search
    areas : AreaReader
    fitted : JointFit
    tied : ndarray (k, bins)
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
            real = [in_pixels({p.name: float(v)}, factor)[p.name] for v in (value, *ends)]
            name = p.name.partition(":")[2]
            parameters[name] = {"value": real[0], "lo": real[1], "hi": real[2], "unit": p.unit}
        for name, value in fitted.point.items():
            effect, _, own = name.partition(":")
            if effect == taken.id and own and own not in parameters:
                parameters[own] = {"value": value, "lo": value, "hi": value, "unit": ""}
        consequence = areas.of_cause(fitted, taken.id, covariance)
        removed = search.share(loss_of(fitted, taken.id))
        place = posterior.places[taken.id]
        found.append(
            Named(
                taken.id, removed, consequence, parameters, place.probability[taken.id], place.credible_set,
                consequence.largest < LEAST_AREA,
            )
        )  # fmt: skip
    return sorted(found, key=lambda n: (-n.consequence.largest, -n.removed))


def extended_scene(model: AnchoredModel, fitted: JointFit) -> Scene:
    """Return the nominal scene with the causes at their fitted values, lengths in pixels of the real camera."""
    point = {name: value for name, value in fitted.point.items() if ":" in name}
    return scene_with(model.observation.believed, in_pixels(point, model.factor))


def answer(
    model: AnchoredModel,
    search: Search,
    gate: Gate,
    fitted: JointFit,
    posterior: Posterior,
    named: list[Named],
    gain: HeldOut | None,
    left_out: Mapping[str, str],
    seconds: float,
) -> tuple[dict[str, Any], str]:
    """Return the result, and the extended scene as TOML.

    Returns
    -------
    result : dict
        See docs/criticism/joint.md.
    scene : str
    """
    noise = float(fitted.residual.size)
    explained = 1.0 - max(fitted.misfit - noise, 0.0) / max(search.first - noise, 1.0)
    result = {
        "version": VERSION,
        "method": "joint",
        "first_line": first_line(named, explained, gain),
        "gate": [line.as_dict() for line in gate.lines],
        "causes": [n.as_dict() for n in named],
        "posterior": posterior.as_dict(),
        "misfit": {
            "before": search.first, "after": fitted.misfit, "bins": noise, "removed_share": explained,
            "left_share": 1.0 - explained,
        },
        "held_out": None if gain is None else gain.as_dict(),
        "nuisances": {name: value for name, value in fitted.point.items() if name.startswith("@")},
        "moves": [vars(step) for step in search.steps],
        "not_judged": [{"id": name, "why": why} for name, why in {**left_out, **search.refused}.items()],
        "extended_scene": None,
        "seconds": seconds,
    }  # fmt: skip
    return result, dump_scene(extended_scene(model, fitted))


def first_line(named: list[Named], explained: float, gain: HeldOut | None) -> str:
    """Return the sentence that a reader needs if they read no other."""
    warning = ""
    if gain is not None and gain.worse and named:
        before, after = gain.area_percent
        warning = f"CAUTION: the extension makes the held-out area worse ({before:.2f} to {after:.2f} %). "
    if not named:
        return "No cause of the library explains a part of what is left that matters."
    words = []
    for cause in (n for n in named if not n.listed):
        c = cause.consequence
        if not c.change_mm2:
            words.append(cause.id)
            continue
        k = int(np.argmax(np.abs(np.nan_to_num(c.change_percent))))
        words.append(f"{cause.id} ({c.change_mm2[k]:+.2f} mm^2, {c.change_percent[k]:+.1f} % at {c.forces_N[k]:g} N)")
    listed = ", ".join(n.id for n in named if n.listed)
    beside = f"; without effect on the area: {listed}" if listed else ""
    return f"{warning}{len(named)} causes explain {100 * explained:.1f} % of the misfit: {', '.join(words)}{beside}"
