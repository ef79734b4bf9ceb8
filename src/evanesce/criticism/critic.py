"""The critic on one page: noise, split, fit of what is believed, tests, candidates, extension, unknown, gain.

The open part of the data decides everything; the locked part is looked at once, at the end, for the gain.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.bundle import Bundle
from evanesce.criticism.answer import Findings, answer, verdict
from evanesce.criticism.battery_data import Residuals
from evanesce.criticism.case import Case, prepare
from evanesce.criticism.evidence import Evidence
from evanesce.criticism.extend import Extension
from evanesce.criticism.isolability import absorbed
from evanesce.criticism.locked import locked_gain
from evanesce.criticism.next_shot import next_measurement
from evanesce.criticism.posterior import UNKNOWN, log_bayes_of_p, posterior, tempering, with_mimics
from evanesce.criticism.problem import Fit
from evanesce.criticism.score import metric_of
from evanesce.criticism.search import joint_p, ring, rivals, rivals_without_best, search, test
from evanesce.criticism.signatures import Signature, signatures_of
from evanesce.criticism.unknown import Flexible, describe_unknown, fit_flexible
from evanesce.prediction.frozen import FROZEN
from evanesce.prediction.observe import observe, require_monochrome

Array = NDArray[Any]
Tick = Callable[[str], None]


def criticise(
    bundle: Bundle, *, seed: int = 0, tick: Tick = lambda step: None, exclude: Collection[str] = ()
) -> tuple[dict[str, Any], Evidence]:
    """Find what a simulation of the believed rig gets wrong about measured data.

    Parameters
    ----------
    bundle : Bundle
    seed : int
        Of the draws of noise.
    tick : callable
        Told each step when it begins.
    exclude : collection of str
        Effects of the library that are not considered: what is known to be absent, or a test of what is left then.

    Returns
    -------
    result : dict
        See docs/criticism/index.md.
    evidence : Evidence
        What a report shows of it.
    """
    require_monochrome(bundle)
    tick("frames and noise")
    case = prepare(observe(bundle), seed, exclude)
    tick("signatures of all candidates")
    signatures = signatures_of(case.problem, case.base, case.candidates, lambda name: tick(f"signature of {name}"))
    tick("score tests")
    first = test(case, signatures, case.base, 0)
    tick("battery")
    battery, left = ring(case, case.base, 0)
    global_p = joint_p(first.p, battery.global_p, codec=case.codec)
    level = level_of(case)
    findings = Findings(global_p=global_p, first=first, battery=battery, level=level, unlike=case.unlike)
    if global_p < level and not case.unlike:
        tick("nested fits")
        search(case, signatures, findings)
    weigh(case, findings, left, signatures)
    tick("what can be told from what")
    isolate(case, signatures, findings)
    tick("locked part")
    findings.gain = locked_gain(case.observation, case.problem, case.base, findings.best, confirmed_term(findings))
    return answer(case, signatures, findings)


def confirmed_term(findings: Findings) -> Flexible | None:
    """Return the flexible term of something unknown, if the battery rings with it.

    None where only score tests or marks of another kind rang: nothing confirms the term's shape then, and through a
    codec, where the battery is not listened to, it would be the codec's.
    """
    return findings.flexible if findings.heard and verdict(findings) == "unknown" else None


def level_of(case: Case) -> float:
    """Return the level of false alarms: a stricter one where a codec left too little noise to be known well."""
    return float(FROZEN.levels["false_alarm" + ("_silent" if case.silent else "_codec" if case.codec else "")])


def weigh(case: Case, findings: Findings, left: Residuals, signatures: Sequence[Signature]) -> None:
    """Give each model its probability, the unknown among them."""
    library = len([s for s in signatures if not s.note])
    log_bayes: dict[tuple[str, ...], float] = {}
    for scored in findings.first.scored:
        log_bayes[(scored.id,)] = scored.result.log_bayes
    other_marks = 0.0
    for extensions in findings.rounds:
        for extension in extensions:
            log_bayes[tuple(sorted(extension.ids))] = extension.log_bayes
            if not extension.goes_as_its_marks_do:
                # Places there are, but of other marks: what their list explains is evidence of something unknown.
                other_marks = max(other_marks, extension.log_bayes)
                log_bayes[tuple(sorted(extension.ids))] = 0.0
    if findings.first.p > 1.5 / (findings.first.draws + 1):  # else it is as small as draws can tell
        # Under a codec the drawn law is too narrow by what its stricter level makes up for.
        p = findings.first.p * FROZEN.levels["false_alarm"] / findings.level
        power = tempering(p, [scored.result.log_bayes for scored in findings.first.scored])
        log_bayes = {ids: power * value for ids, value in log_bayes.items()}
    fitted = case.base if findings.best is None else findings.best.fitted
    remains, battery = (left, findings.battery) if findings.left is None else (findings.left, findings.after)
    sd = case.problem.sd[list(case.problem.views)]
    findings.flexible = fit_flexible(remains, sd, _projection(case, fitted))
    heard = battery is not None and not case.codec and battery.global_p < FROZEN.levels["false_alarm"]
    # Marks of a kind that the library lacks are structure, whether or not the battery may be listened to.
    rings = heard or (findings.best is None and other_marks > FROZEN.levels["accept_nats"])
    loud = log_bayes_of_p(battery.global_p) if battery is not None and not case.codec else 0.0
    extra = max(findings.flexible.evidence, loud) if rings else loud
    if findings.best is None:
        extra = max(extra, other_marks)
    ids = () if findings.best is None else tuple(sorted(findings.best.ids))
    explained = log_bayes[ids] if ids else 0.0
    log_bayes[(*ids, UNKNOWN)] = explained + extra
    if rings and battery is not None:
        findings.left_evidence = max(extra, log_bayes_of_p(battery.beyond_draws))
        if ids and findings.unexplained > FROZEN.levels["unknown_share"]:
            # A cause that leaves so much is one of the unknown's shapes: what it explains is the unknown's as well.
            alone = explained + findings.left_evidence
            log_bayes[(UNKNOWN,)] = max(log_bayes.get((UNKNOWN,), -np.inf), alone)
    if findings.unlike:
        # The library changes what is believed: where nothing of that shows, it has nothing to say.
        log_bayes = {(UNKNOWN,): case.likeness.evidence}
    found = posterior(log_bayes, library)
    findings.posterior = found if findings.best is None else with_mimics(found)
    findings.rings, findings.heard = rings, heard
    # What the score tests alone hear, and no fit confirms, has to be described as well: it may be called unknown.
    if rings or (findings.best is None and findings.global_p < findings.level):
        findings.unknown = describe_unknown(remains, _whitened_maps(case, signatures), findings.flexible)
    else:
        findings.flexible = None


def _projection(case: Case, fitted: Fit) -> Callable[[Array], Array]:
    """Return a function that takes from cubes (n, views, rows, cols) what the fit's parameters may take."""
    metric, mask = metric_of(fitted), case.problem.valid[list(case.problem.views)]

    def project(cubes: Array) -> Array:
        found = np.zeros_like(cubes)
        found[:, mask] = metric.project(cubes[:, mask])
        return found

    return project


def _whitened_maps(case: Case, signatures: Sequence[Signature]) -> dict[str, Array]:
    metric = metric_of(case.base)
    found = {}
    for signature in signatures:
        if len(signature.rows) and not signature.note:
            size = np.sqrt(np.einsum("kd,kd->k", signature.rows, signature.rows, dtype=float))
            rows = metric.project(signature.rows[size > 0])
            if len(rows):
                found[signature.id] = np.array([case.problem.unwhitened(r) for r in rows])
    return found


def isolate(case: Case, signatures: Sequence[Signature], findings: Findings) -> None:
    """Say what the answer could be mistaken for, what nuisances hide, and which shot would tell."""
    limit = FROZEN.levels["ambiguous_lambda"]
    metric = metric_of(case.base)
    plausible = {}
    for s in signatures:
        if s.joint and len(s.rows):
            sizes = np.einsum("kd,kd->k", s.rows, s.rows, dtype=float) * s.deviations**2
            k = int(np.argmax(sizes))
            plausible[s.id] = s.rows[k] * s.deviations[k]
    findings.absorbed = absorbed(plausible, metric, case.base.parameters, limit)
    if findings.best is None:
        findings.group = rivals_without_best(findings)
        if len(findings.group) > 1:
            first, *others = findings.group
            findings.next_shot = next_measurement(case.observation, case.problem, first, others)
        return
    group: dict[str, Extension] = {}
    for number in range(len(findings.best.ids)):
        for rival in rivals(findings.rounds[number], findings.best.ids[: number + 1], metric):
            if rival.cause.id not in findings.best.ids:
                group.setdefault(rival.cause.id, rival)
    findings.group = list(group.values())
    if group:
        findings.next_shot = next_measurement(case.observation, case.problem, findings.best, findings.group)
