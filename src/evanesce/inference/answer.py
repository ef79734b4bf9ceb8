"""The answer: causes with intervals and consequences, what is explained, the gain, the extended scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.constants import LEAST_AREA, LEAST_PROBABLE
from evanesce.inference.gate import VERSION, Gate
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.model import Model
from evanesce.inference.named import Named
from evanesce.inference.posterior import Posterior
from evanesce.inference.search import Search
from evanesce.inference.single_effects import UNKNOWN, Place
from evanesce.inference.unknown import told_fields
from evanesce.prediction.fine import in_pixels
from evanesce.prediction.point import scene_with
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
