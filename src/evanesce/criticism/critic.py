"""The critic on one page: noise, split, fit of what is believed, tests, candidates, extension, unknown, gain.

The open part of the data decides everything; the locked part is looked at once, at the end, for the gain.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.read import Bundle
from evanesce.criticism.answer import Findings, answer, verdict
from evanesce.criticism.battery import BatteryResult, run_battery
from evanesce.criticism.battery_data import Residuals
from evanesce.criticism.candidates import Candidate, candidates_of
from evanesce.criticism.codec import codec_parameters, codec_variance, noise_by_bins
from evanesce.criticism.evidence import Evidence
from evanesce.criticism.extend import Extension, extend
from evanesce.criticism.fine import fine_cube
from evanesce.criticism.frozen import FROZEN
from evanesce.criticism.isolability import absorbed, confusion, group_of
from evanesce.criticism.locked import locked_gain
from evanesce.criticism.next_shot import next_measurement
from evanesce.criticism.noise import noise_of
from evanesce.criticism.noise_scale import noise_scale_of
from evanesce.criticism.nuisance import nuisance_parameters
from evanesce.criticism.numerics import edge_template, leftover_variance, numerics_parameters, quick_variance
from evanesce.criticism.observe import Observation, model_factor, observe
from evanesce.criticism.parameters import Parameter, derivative
from evanesce.criticism.posterior import UNKNOWN, Posterior, log_bayes_of_p, posterior
from evanesce.criticism.predict import Predictor
from evanesce.criticism.problem import Fit, Problem, fit, predicted_part
from evanesce.criticism.residuals import noise_draws, residuals_of
from evanesce.criticism.score import Scored, ScoreTest, metric_of, score_test
from evanesce.criticism.signatures import Signature, signatures_of
from evanesce.criticism.tone import expected_tone
from evanesce.criticism.unknown import Flexible, describe_unknown, fit_flexible
from evanesce.errors import InputError
from evanesce.rng import generator

Array = NDArray[Any]
Tick = Callable[[str], None]


ROUNDS = 20
"""Of the believed rig's fits: where the light is far off, the tone curve's bend leaves only short steps."""

PLACES = 2
"""The fine prediction is made at so many points at most."""

FAR: Mapping[str, float] = {"@pose": 0.01, "@light": 0.01, "@card_light": 0.01, "@black": 0.2, "@turn": 0.05}
"""Steps of the nuisances by which what finer pixels change stays what it is [their units]."""


@dataclass
class Case:
    """One bundle on its way through the critic."""

    observation: Observation
    problem: Problem
    base: Fit
    candidates: tuple[Candidate, ...]
    seed: int
    codec: bool = False
    notes: list[str] = field(default_factory=list)

    def rng(self, name: str, number: int = 0) -> np.random.Generator:
        """Return a random stream of its own for each step."""
        return generator(self.seed, "criticism", name, number)


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
        See docs/criticism.md.
    evidence : Evidence
        What a report shows of it.
    """
    tick("frames and noise")
    case = prepare(observe(bundle), seed, exclude)
    tick("signatures of all candidates")
    signatures = signatures_of(case.problem, case.base, case.candidates, lambda name: tick(f"signature of {name}"))
    tick("score tests")
    first = test(case, signatures, case.base, 0)
    tick("battery")
    battery, left = ring(case, case.base, 0)
    global_p = joint_p(first.p, battery.global_p, codec=case.codec)
    level = FROZEN.levels["false_alarm_codec" if case.codec else "false_alarm"]
    findings = Findings(global_p=global_p, first=first, battery=battery, level=level)
    if global_p < level:
        tick("nested fits")
        search(case, signatures, findings)
    weigh(case, findings, left, signatures)
    tick("what can be told from what")
    isolate(case, signatures, findings)
    tick("locked part")
    flexible = findings.flexible if verdict(findings) == "unknown" else None
    findings.gain = locked_gain(case.observation, case.problem, case.base, findings.best, flexible)
    return answer(case, signatures, findings)


def prepare(observation: Observation, seed: int, exclude: Collection[str] = ()) -> Case:
    """Measure the noise and fit the believed rig with its nuisances."""
    size = noise_scale_of(observation.believed.camera, observation.scatter)
    predictor = Predictor(observation.scene, observation.views, noise_scale=size.value)
    known = FROZEN.noise
    data = observation.cube
    noise = noise_of(
        observation.held,
        expected_tone(observation.scene.camera, size.value),
        data.shape[1:],
        floor_DN=known["floor_DN"],
        flicker=known["flicker"],
    )
    views = [int(v) for v in observation.open]
    parameters = [
        p
        for p in nuisance_parameters(observation.views, noise.flicker, size.deviation)
        if p.views is None or set(p.views) & set(views)
    ]
    base = predictor.cube({})
    problem = Problem.of(predictor, data, noise, quick_variance(base), views, base)
    start = {"@black": size.black_DN} if size.black_DN else {}
    seen = None if start else base
    own = predicted_part(fit(problem, parameters, start, predicted=seen, rounds=ROUNDS).point, parameters)
    for _ in range(PLACES):
        at, point = at_place(observation, problem, own, size.codec), own
        fitted_problem, every = at[0], [*parameters, *at[1]]
        fitted = fit(fitted_problem, every, point, rounds=ROUNDS)
        own = predicted_part(fitted.point, every)
        if not displaced(own, point):
            break
    if size.codec:
        # A codec hands noise from frame to frame, so that replicates show too little of it; single bins tell.
        fitted_problem = fitted_problem.louder(noise_by_bins(fitted_problem, fitted))
        fitted = fit(fitted_problem, every, own, rounds=ROUNDS)
    candidates = candidates_of(observation.scene, observation.available, exclude)
    case = Case(observation, fitted_problem, fitted, candidates, seed, size.codec)
    if not noise.measured:
        case.notes.append("no replicates: the noise is the camera's own model, false alarms are not controlled")
    if observation.series:
        case.notes.append(
            "scalar series take no part beside frames (" + ", ".join(sorted(observation.series)) + "): a bundle of them"
            " alone is judged by them"
        )
    if size.codec:
        case.notes.append("noise was smoothed after the tone curve (a codec?): faint departures are not sought")
    return case


def displaced(point: Mapping[str, float], since: Mapping[str, float]) -> bool:
    """Tell whether a fit has moved so far that the fine prediction is to be made anew."""
    return any(
        abs(point.get(name, 0.0) - since.get(name, 0.0)) > far
        for stem, far in FAR.items()
        for name in point
        if name.startswith(stem)
    )


def at_place(
    observation: Observation, problem: Problem, point: Mapping[str, float], codec: bool = False
) -> tuple[Problem, tuple[Parameter, ...]]:
    """Return the problem about the fitted place of the finger, and the nuisances of computation there.

    From now on predictions carry the plate's light at that very place, as fine pixels gather it, and weights follow
    the level there.
    """
    predictor = problem.predictor
    predictor.correction = None
    quick = predictor.cube(point)
    factor, scale = model_factor(observation.believed), predictor.noise_scale
    fine = fine_cube(observation.believed, predictor.views, factor, point, noise_scale=scale)
    predictor.correction = np.nan_to_num(fine - quick, nan=0.0)
    lit = [k for k, view in enumerate(predictor.views) if view.touches]
    change = np.zeros_like(fine)
    change[lit] = fine[lit] - quick[lit]
    left_over = leftover_variance(change)
    if codec:
        left_over = left_over + codec_variance(fine)
    renewed = Problem.of(predictor, problem.data, problem.noise, left_over, problem.views, fine)
    every = nuisance_parameters(predictor.views, 0.0)
    force = {p.views[0]: p for p in every if p.name.startswith("@force") and p.views}
    by_force = [
        derivative(predictor, point, force[k], [k])[k] if k in force else None for k in range(len(predictor.views))
    ]
    edge = edge_template(predictor.scene, predictor.views, by_force)
    found = numerics_parameters(predictor.views, change, edge)
    return renewed, (*found, *codec_parameters(predictor.views, fine)) if codec else found


def test(case: Case, signatures: Sequence[Signature], base: Fit, number: int) -> ScoreTest:
    """Score all candidates against a fitted model."""
    draws = int(FROZEN.levels["draws_score"])
    return score_test(case.problem, base, signatures, draws=draws, rng=case.rng("score", number))


def ring(case: Case, fitted: Fit, number: int) -> tuple[BatteryResult, Residuals]:
    """Run the battery on what a fitted model leaves."""
    left = residuals_of(case.problem, fitted)
    draws = int(FROZEN.levels["draws_battery"])
    return run_battery(left, noise_draws(case.problem, fitted, draws, case.rng("battery", number))), left


def joint_p(score_p: float, battery_p: float, *, codec: bool = False) -> float:
    """Return the probability of either test ringing, its level shared between them (Bonferroni, weighted).

    What a codec makes of a frame has structure of any kind, so that the battery says nothing there.
    """
    if codec:
        return score_p
    share = FROZEN.levels["score_share"]
    return min(1.0, score_p / share, battery_p / (1 - share))


def search(case: Case, signatures: Sequence[Signature], findings: Findings) -> None:
    """Extend the model step by step, each step by the best of the candidates that were fitted for good."""
    base, known, scores = case.base, None, findings.first
    for number in range(int(FROZEN.search["rounds"])):
        tried = [s for s in scores.scored if known is None or s.id not in known.ids]
        tried = promising(tried)
        extensions = fitted_for_good(case, base, known, tried)
        findings.rounds.append(extensions)
        better = max(extensions, key=lambda e: e.log_bayes, default=None)
        if better is None or not acceptable(better, known, len(scores.scored)):
            break
        known, base = better, better.fitted
        findings.best = known
        left_scores = test(case, [s for s in signatures if s.id not in known.ids], base, number + 1)
        battery, left = ring(case, base, number + 1)
        findings.after, findings.left = battery, left
        findings.left_p = joint_p(left_scores.p, battery.global_p, codec=case.codec)
        if left_scores.p >= findings.level:
            break
        scores = left_scores


def fitted_for_good(case: Case, base: Fit, known: Extension | None, tried: Sequence[Scored]) -> list[Extension]:
    """Return the fits of candidates; one whose fit leaves what its effect allows is left out, with a note."""
    found = []
    for scored in tried:
        try:
            found.append(extend(case.problem, base, known, scored))
        except InputError as error:
            case.notes.append(f"{scored.id} could not be fitted: {error}")
    return found


def promising(scored: Sequence[Scored]) -> list[Scored]:
    """Return the candidates that are worth a fit: the best few, and all that come near the best."""
    ranked = sorted(scored, key=lambda s: -s.result.log_bayes)
    few, most = int(FROZEN.search["always"]), int(FROZEN.search["refine"])
    near = [s for s in ranked if s.result.log_bayes > ranked[0].result.log_bayes - FROZEN.search["near_nats"]]
    return ranked[:few] if len(near) < few else near[:most]


def acceptable(extension: Extension, known: Extension | None, library: int) -> bool:
    """Tell whether an extension may be built upon: it predicts the unseen, is worth its prior, and is off its bounds.

    A further cause has to bring a share of what the first ones did (``second_share``).

    Parameters
    ----------
    extension : Extension
    known : Extension, optional
        What it was built upon; None for the believed rig.
    library : int
        How many effects could have been named.
    """
    gained = extension.gain > FROZEN.levels["accept_gain_se"] * extension.gain_error
    before = {} if known is None else {known.ids: known.log_bayes}
    models = {**before, extension.ids: extension.log_bayes}
    odds = log_odds(posterior(models, library), extension.ids, tuple(before)[-1:])
    # What a cause named already leaves is first of all its own form, which no library knows to a few per cent.
    over = 0.0 if known is None else FROZEN.levels["second_share"] * known.log_bayes
    worth = extension.log_bayes - (0.0 if known is None else known.log_bayes) > over
    return gained and worth and odds > FROZEN.levels["accept_nats"] and extension.within_bounds


def log_odds(found: Posterior, ids: tuple[str, ...], against: tuple[tuple[str, ...], ...]) -> float:
    """Return the logarithm of the odds of a model against another one, the believed rig by default."""
    other = against[0] if against else ()
    return float(np.log(max(found.models[ids], 1e-300)) - np.log(max(found.models[other], 1e-300)))


def weigh(case: Case, findings: Findings, left: Residuals, signatures: Sequence[Signature]) -> None:
    """Give each model its probability, the unknown among them."""
    library = len([s for s in signatures if not s.note])
    log_bayes: dict[tuple[str, ...], float] = {}
    for scored in findings.first.scored:
        log_bayes[(scored.id,)] = scored.result.log_bayes
    for extensions in findings.rounds:
        for extension in extensions:
            log_bayes[tuple(sorted(extension.ids))] = extension.log_bayes
    fitted = case.base if findings.best is None else findings.best.fitted
    remains, battery = (left, findings.battery) if findings.left is None else (findings.left, findings.after)
    sd = case.problem.sd[list(case.problem.views)]
    findings.flexible = fit_flexible(remains, sd, _projection(case, fitted))
    rings = battery is not None and not case.codec and battery.global_p < FROZEN.levels["false_alarm"]
    loud = log_bayes_of_p(battery.global_p) if battery is not None and not case.codec else 0.0
    extra = max(findings.flexible.evidence, loud) if rings else loud
    ids = () if findings.best is None else tuple(sorted(findings.best.ids))
    log_bayes[(*ids, UNKNOWN)] = (log_bayes[ids] if ids else 0.0) + extra
    findings.posterior = posterior(log_bayes, library)
    findings.rings = rings
    if rings:
        findings.left_evidence = extra
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
        return
    group: dict[str, Extension] = {}
    for number in range(len(findings.best.ids)):
        for rival in rivals(findings.rounds[number], findings.best.ids[: number + 1], metric):
            if rival.cause.id not in findings.best.ids:
                group.setdefault(rival.cause.id, rival)
    findings.group = list(group.values())
    if group:
        findings.next_shot = next_measurement(case.observation, case.problem, findings.best, findings.group)


def rivals(fitted: Sequence[Extension], ids: tuple[str, ...], metric: Any) -> list[Extension]:
    """Return what a cause that was accepted could be mistaken for, of those that were fitted in the same step."""
    number = next(k for k, e in enumerate(fitted) if e.ids == ids)
    levels, best = FROZEN.levels, fitted[number].log_bayes
    near = set(group_of(number, confusion([e.cause for e in fitted], metric), levels["ambiguous_lambda"]))
    return [
        e
        for k, e in enumerate(fitted)
        if k != number
        and e.within_bounds
        and e.log_bayes > best - levels["ambiguous_nats" if k in near else "rival_nats"]
    ]


def rivals_without_best(findings: Findings) -> list[Extension]:
    """Return the causes that come nearest where none was worth its prior."""
    least = FROZEN.levels["least_nats"]
    fitted = [e for e in (findings.rounds[0] if findings.rounds else []) if e.within_bounds and e.log_bayes > least]
    best = max((e.log_bayes for e in fitted), default=0.0)
    return sorted((e for e in fitted if e.log_bayes > best - FROZEN.levels["rival_nats"]), key=lambda e: -e.log_bayes)


__all__ = ["Case", "Flexible", "Posterior", "criticise"]
