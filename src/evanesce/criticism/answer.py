"""What was found, put into the stable answer that docs/criticism/index.md describes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.criticism.battery import BatteryResult
from evanesce.criticism.battery_data import Residuals
from evanesce.criticism.blots import MOVES, STRIPED
from evanesce.criticism.evidence import Evidence, Ranked, Shown
from evanesce.criticism.extend import Extension, intervals
from evanesce.criticism.locked import LockedGain
from evanesce.criticism.marks import BESIDE
from evanesce.criticism.posterior import Posterior
from evanesce.criticism.score import ScoreTest
from evanesce.criticism.signatures import Signature
from evanesce.criticism.unknown import Flexible
from evanesce.effects import all_effects
from evanesce.prediction.fine import in_pixels
from evanesce.prediction.frozen import FROZEN
from evanesce.prediction.observe import model_factor
from evanesce.prediction.predict import scene_with
from evanesce.prediction.views import View
from evanesce.rig import Scene, dump_scene

Array = NDArray[Any]


@dataclass
class Findings:
    """All that the critic learns about a case, step by step.

    Attributes
    ----------
    global_p : float
    first : ScoreTest
        Of all candidates against the believed rig.
    battery, after : BatteryResult
        On what the believed rig leaves, and on what the extended one leaves.
    left : Residuals, optional
        What the extended rig leaves.
    left_p : float
        Joint probability of the tests on it.
    rounds : list of list of Extension
        Of each step, all that were fitted.
    best : Extension, optional
        Accepted.
    group : list of Extension
        What it could be mistaken for.
    rings : bool
        Whether structure is left that no candidate explains.
    heard : bool
        Whether the battery rings with it, which is not listened to under a codec.
    unlike : bool
        Whether the frames do not show the believed contact at all.
    level : float
        Of false alarms, below which ``global_p`` counts.
    left_evidence : float
        Of that structure: of the flexible term, or of the loudest test where that says more [nats].
    """

    global_p: float
    first: ScoreTest
    battery: BatteryResult
    after: BatteryResult | None = None
    left: Residuals | None = None
    left_p: float = 1.0
    rounds: list[list[Extension]] = field(default_factory=list)
    best: Extension | None = None
    group: list[Extension] = field(default_factory=list)
    absorbed: list[dict[str, str]] = field(default_factory=list)
    next_shot: dict[str, Any] | None = None
    posterior: Posterior | None = None
    flexible: Flexible | None = None
    unknown: dict[str, Any] | None = None
    rings: bool = False
    heard: bool = False
    unlike: bool = False
    left_evidence: float = 0.0
    level: float = FROZEN.levels["false_alarm"]
    gain: LockedGain | None = None

    @property
    def unexplained(self) -> float:
        """Evidence of structure that is left over that of the causes accepted [1]."""
        return 0.0 if self.best is None else self.left_evidence / max(self.best.log_bayes, 1e-9)


def verdict(findings: Findings) -> str:
    """Return ``none``, ``named``, ``ambiguous`` or ``unknown``."""
    if findings.global_p >= findings.level:
        return "none"
    if findings.unlike:
        return "unknown"
    if findings.rings and (findings.best is None or findings.unexplained > FROZEN.levels["unknown_share"]):
        return "unknown"
    if findings.best is None:
        # Something rings. Causes that come near are the answer even where none is worth its prior.
        return "ambiguous" if findings.group else "unknown"
    return "ambiguous" if findings.group else "named"


def answer(case: Any, signatures: Sequence[Signature], findings: Findings) -> tuple[dict[str, Any], Evidence]:
    """Return the result and what a report shows of it."""
    said = verdict(findings)
    named = findings.best if said != "none" else None
    effects = (
        [] if named is None else _effects(named, case.problem.predictor.fixed, model_factor(case.observation.believed))
    )
    probabilities = findings.posterior.marginal() if findings.posterior else {}
    notes = (*case.notes, *warnings(findings))
    result: dict[str, Any] = {
        "global_p": findings.global_p,
        "verdict": said,
        "probabilities": {k: v for k, v in sorted(probabilities.items(), key=lambda i: -i[1])},
        "effects": effects,
        "ambiguous_with": [e.cause.id for e in findings.group] if said == "ambiguous" else [],
        "absorbed": findings.absorbed,
        "not_judged": [{"id": s.id, "why": s.note} for s in signatures if s.note],
        "next_measurement": findings.next_shot,
        "unknown": findings.unknown if said == "unknown" else None,
        "gain": None if findings.gain is None else findings.gain.as_dict(),
        "extended_scene": None,
        "false_alarm_control": case.problem.noise.measured,
        "notes": list(notes),
        "frozen_sha256": FROZEN.digest,
        "seed": case.seed,
    }
    believed = case.observation.believed
    after = believed if named is None else extended_scene(believed, named, case.problem.predictor.fixed)
    evidence = Evidence(
        shown=_shown(case, findings),
        outcomes=findings.battery.outcomes,
        ranking=_ranking(findings),
        scene_before=dump_scene(believed),
        scene_after=dump_scene(after),
        notes=notes,
        score_p=findings.first.p,
        battery_p=findings.battery.global_p,
        listened=not case.codec,
    )
    return result, evidence


def warnings(findings: Findings) -> tuple[str, ...]:
    """Return what speaks against a named cause though it was accepted: the locked part, which chose nothing."""
    named = verdict(findings) in ("named", "ambiguous") and findings.best is not None
    if not named or findings.gain is None or findings.gain.log_score[2] >= 0.0:
        return ()
    return ("what is named predicts the locked part worse than the believed rig does: something else may be at work",)


def extended_scene(believed: Scene, named: Extension, fixed: Mapping[str, Mapping[str, Any]] | None = None) -> Scene:
    """Return the believed scene with the named effects switched on at their fitted values and chosen places."""
    point = {name: value for name, value in named.fitted.point.items() if ":" in name}
    return scene_with(believed, in_pixels(point, model_factor(believed)), fixed)


def _effects(named: Extension, fixed: Mapping[str, Mapping[str, Any]], factor: int) -> list[dict[str, Any]]:
    """Return effects with their values, lengths in pixels as the real camera counts them."""
    found: dict[str, dict[str, Any]] = {}
    for name, entry in intervals(named).items():
        effect, _, parameter = name.partition(":")
        real = {k: in_pixels({name: v}, factor)[name] if isinstance(v, float) else v for k, v in entry.items()}
        found.setdefault(effect, {})[parameter] = real
    listed = {effect: _places(effect, fixed) for effect in named.ids}
    return [
        {"id": effect, "parameters": found[effect]} | ({"places": listed[effect]} if listed[effect] else {})
        for effect in named.ids
    ]


def _places(effect: str, fixed: Mapping[str, Mapping[str, Any]]) -> int:
    """Return how many places of an effect were taken from the data."""
    marks = all_effects()[effect].marks
    return 0 if marks is None else len(fixed.get(effect, {}).get(marks.x, ()))


def _ranking(findings: Findings) -> list[Ranked]:
    models = findings.posterior.models if findings.posterior else {}
    found = [
        Ranked(
            e.ids,
            e.gain,
            e.gain_error,
            models.get(tuple(sorted(e.ids)), 0.0),
            _set_aside(e),
        )
        for extensions in findings.rounds
        for e in extensions
    ]
    return sorted(found, key=lambda r: -r.probability)


def _set_aside(extension: Extension) -> str:
    """Return why an extension cannot be accepted; empty if it can."""
    if not extension.within_bounds:
        return "a parameter is at its bound"
    if not extension.goes_as_its_marks_do:
        kind, z = max(extension.at_places.items(), key=lambda item: abs(item[1]))
        if kind.startswith(BESIDE):
            return f"its places are the middle of something larger: {z:+.1f} standard deviations {kind}"
        if kind.startswith((MOVES, STRIPED)):
            return f"no film, but something {kind} ({z:+.1f} standard deviations)"
        return f"its places show other marks in the {kind.replace('_', ' ')} shots ({z:+.1f} standard deviations)"
    return ""


def _shown(case: Any, findings: Findings) -> list[Shown]:
    problem, base = case.problem, case.base
    before = problem.unwhitened(base.residual)
    after = before if findings.best is None else problem.unwhitened(findings.best.fitted.residual)
    found = []
    for k, view in enumerate(problem.kinds):
        valid = problem.valid[problem.views[k]]
        panels = [np.where(valid, cube[k], np.nan) for cube in (before, after)]
        found.append(Shown(view_words(view), problem.data[problem.views[k]], panels[0], panels[1], view.locked))
    return found


def view_words(view: View) -> str:
    """Return a view's kind and state with units."""
    kind = view.kind.replace("_", " ")
    return f"{kind}, {view.force_N:g} N, {view.voltage_V:g} V, {view.time_s:g} s" if view.force_N is not None else kind
