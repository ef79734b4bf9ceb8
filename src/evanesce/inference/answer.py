"""The answer: causes with intervals and consequences, what is explained, the gain, the extended scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.consequence import NINETY, AreaReader, Consequence, nearest
from evanesce.inference.constants import LEAST_AREA, LEAST_PROBABLE, SUBSTITUTE
from evanesce.inference.gain import Interval
from evanesce.inference.gate import VERSION, Gate
from evanesce.inference.groups import group_of
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.model import Model
from evanesce.inference.naming import told_of
from evanesce.inference.posterior import Posterior
from evanesce.inference.search import Search
from evanesce.inference.single_effects import UNKNOWN, Place
from evanesce.inference.unknown import told_fields
from evanesce.prediction.fine import in_pixels
from evanesce.prediction.linear import CovarianceRows, Metric
from evanesce.prediction.parameters import value_of
from evanesce.prediction.point import natural, scene_with
from evanesce.rig import Scene, dump_scene

Array = NDArray[Any]


class Unexplained(Protocol):
    """What an extended model leaves of the data."""

    @property
    def found(self) -> bool:
        """Whether it is more than noise."""

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""

    def sentence(self) -> str:
        """Return what it looks like."""


class Gain(Protocol):
    """Gain on held-out data."""

    @property
    def worse(self) -> bool:
        """Whether the extension makes the area worse."""

    @property
    def area_percent(self) -> tuple[float, float]:
        """Mean absolute error of the area before and after [%]."""

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""


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


def extended_scene(model: Model, fitted: JointFit) -> Scene:
    """Return the nominal scene with the causes at their fitted values, lengths in pixels of the real camera."""
    point = {name: value for name, value in fitted.point.items() if ":" in name}
    return scene_with(model.observation.believed, in_pixels(point, model.factor), model.fixed)


def verdict_of(posterior: Posterior, left_found: bool) -> str:
    """Return the verdict: ``none``, ``causes``, ``causes and unknown`` or ``unknown``.

    The rule, on the probabilities and nothing else: a place of the sum that is more probably filled than empty holds
    what is likelier of causes of the library, all together, and something unknown. There is something unknown, too, if
    what is left of the views together is more than noise. The place of a further cause counts where noise alone would
    hardly give as much evidence for one.

    Parameters
    ----------
    posterior : Posterior
    left_found : bool
        See :attr:`evanesce.inference.left.Left.found`.
    """
    places = [*posterior.places.values(), *([posterior.further] if posterior.asks else [])]
    filled = [(p.present, p.probability.get(UNKNOWN, 0.0)) for p in places if p.present > 0.5]
    causes = any(present - unknown >= unknown for present, unknown in filled)
    unknown = left_found or any(present - unknown < unknown for present, unknown in filled)
    return {(0, 0): "none", (1, 0): "causes", (1, 1): "causes and unknown", (0, 1): "unknown"}[causes, unknown]


def answer(
    model: Model,
    search: Search,
    gate: Gate,
    fitted: JointFit,
    posterior: Posterior,
    named: list[Named],
    left: Unexplained,
    gain: Gain | None,
    advice: dict[str, Any] | None,
    left_out: Mapping[str, str],
    seconds: float,
    *,
    replicates: bool,
    notes: Sequence[str] = (),
) -> tuple[dict[str, Any], str]:
    """Return the result, and the extended scene as TOML.

    Parameters
    ----------
    model, search, gate, fitted, posterior, named, left, gain, advice, left_out, seconds
        What came out.
    replicates : bool
        Whether the data themselves say how much they scatter.
    notes : sequence of str
        To be read before the probabilities are believed.

    Returns
    -------
    result : dict
        See docs/reference/criticism-json.md.
    scene : str
    """
    noise = float(fitted.residual.size)
    explained = 1.0 - search.share(max(fitted.misfit - search.floor, 0.0))
    verdict = verdict_of(posterior, left.found)
    not_judged = {**left_out, **search.not_taken}
    result = {
        "version": VERSION,
        "method": "joint",
        "verdict": verdict,
        "first_line": first_line(
            verdict, named, explained, left, gain, told_fields(search.unknown), notes,
            posterior.further if posterior.asks else None, search.idle,
        ),
        "warnings": [*notes, *warnings_of(verdict, bool(named), replicates=replicates)],
        "gate": [line.as_dict() for line in gate.lines],
        "causes": [n.as_dict() for n in named],
        "posterior": posterior.as_dict(),
        "unknown": left.as_dict()
        | {"fields": sorted(search.unknown), "nearest": nearest_to_unknown(posterior) if "unknown" in verdict else ""},
        "misfit": {
            "before": search.first, "after": fitted.misfit, "bins": noise, "removed_share": explained,
            "left_share": 1.0 - explained,
        },
        "held_out": None if gain is None else gain.as_dict(),
        "next_measurement": advice,
        "nuisances": {name: value for name, value in fitted.point.items() if name.startswith("@")},
        "moves": [vars(step) for step in search.steps],
        "not_judged": [{"id": name, "why": not_judged[name]} for name in not_judged if name not in fitted.ids],
        "extended_scene": None,
        "seconds": seconds,
    }  # fmt: skip
    return result, dump_scene(extended_scene(model, fitted))


def nearest_to_unknown(posterior: Posterior) -> str:
    """Return the cause of the library, of those not named, that comes nearest to something unknown; empty for none."""
    place = posterior.places.get(UNKNOWN, posterior.further)
    weighed = {name: value for name, value in place.log_bayes.items() if name != UNKNOWN}
    return max(weighed, key=lambda name: weighed[name], default="")


def warnings_of(verdict: str, named: bool, *, replicates: bool) -> list[str]:
    """Return what a reader has to know before believing the probabilities.

    Parameters
    ----------
    verdict : str
        See :func:`verdict_of`.
    named : bool
        Whether any cause is.
    replicates : bool
        Whether frames of a held state say how much the data scatter.
    """
    found = []
    if not replicates:
        found.append("no replicate frames: noise is the camera model's, so that false alarms are not controlled")
    if named and "unknown" in verdict:
        found.append("probabilities are among the library's causes: those named may stand in for what is unknown")
    return found


def first_line(
    verdict: str,
    named: list[Named],
    explained: float,
    left: Unexplained,
    gain: Gain | None,
    fields: str,
    notes: Sequence[str] = (),
    further: Place | None = None,
    idle: Sequence[str] = (),
) -> str:
    """Return the sentence that a reader needs if they read no other.

    Parameters
    ----------
    verdict, named, explained, left, gain
        As in :func:`answer`.
    fields : str
        What was taken as unknown, in words.
    notes : sequence of str
        What makes it doubtful.
    further : Place, optional
        Of one more cause: what is said where none could be fitted.
    idle : sequence of str
        Causes that were given up for doing nothing to the area: what is left may be theirs.
    """
    told = left.sentence() if left.found else fields
    if idle and "unknown" in verdict:
        told += f"; or it is {' or '.join(idle)}, without effect on the area"
    warning = "".join(f"CAUTION: {note}. " for note in notes)
    if verdict == "none":
        return f"{warning}The data are what the scene predicts, as far as their scatter lets anything be seen."
    if not named:
        return f"{warning}There is {told if 'unknown' in verdict else unfitted(further)}."
    if gain is not None and gain.worse:
        before, after = gain.area_percent
        warning += f"CAUTION: the extension makes the held-out area worse ({before:.2f} to {after:.2f} %). "
    own = [cause for k, cause in enumerate(named) if cause.partner not in [other.id for other in named[:k]]]
    words = [_told(cause) for cause in own if cause.moved.largest >= LEAST_AREA]
    without = ", ".join(_names(cause) for cause in own if cause.moved.largest < LEAST_AREA)
    beside = ("; without" if words else "; none has an") + f" effect on the area: {without}" if without else ""
    likely = "" if further is None else max(further.probability, key=lambda name: further.probability[name])
    beside_them = told if "unknown" in verdict else f"{likely}, without effect on the area" if likely in idle else ""
    more = f". Beside them there is {beside_them}" if beside_them else ""
    count = f"{len(named)} cause{'s' if len(named) > 1 else ''} explain{'' if len(named) > 1 else 's'}"
    return (
        f"{warning}{count} {100 * explained:.1f} % of the misfit{': ' if words else ''}{', '.join(words)}{beside}{more}"
    )


def unfitted(further: Place | None) -> str:
    """Return what there is where the place of a further cause is filled and none of the causes could be fitted."""
    likely = [] if further is None else [n for n in further.credible_set if further.probability[n] >= LEAST_PROBABLE]
    told = ", ".join(f"{name} ({100 * further.probability[name]:.0f} %)" for name in likely) if further else ""
    return "a cause that could not be fitted" + (f", most probably {told}" if told else "")


def _names(cause: Named) -> str:
    """Return a cause, with what makes up for it."""
    return f"{cause.told} and {cause.partner}, which make up for each other" if cause.partner else cause.told


def _told(cause: Named) -> str:
    """Return a cause with what it does to the area where it does most."""
    c = cause.moved
    k = int(np.argmax(np.abs(np.nan_to_num(c.change_percent))))
    return f"{_names(cause)} ({c.change_mm2[k]:+.2f} mm^2, {c.change_percent[k]:+.1f} % at {c.forces_N[k]:g} N)"
