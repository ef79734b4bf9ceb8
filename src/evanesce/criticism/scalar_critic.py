"""The critic for bundles without frames: the steps of :mod:`evanesce.criticism.critic` on scalar series."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from evanesce.bundle.bundle import Bundle
from evanesce.bundle.layout import Series
from evanesce.chain.simulate import solve_contact
from evanesce.core.errors import InputError
from evanesce.criticism.evidence import Evidence, Ranked
from evanesce.criticism.posterior import UNKNOWN, log_bayes_of_p, posterior, with_mimics
from evanesce.criticism.scalar import (
    ASSUMED_SIGMA,
    SeriesFit,
    SeriesPredictor,
    Table,
    alike,
    chi_square_p,
    fit_series,
    gain_of,
    pairs_of,
)
from evanesce.effects import Effect, Stage
from evanesce.prediction.candidates import Candidate, candidates_of
from evanesce.prediction.frozen import FROZEN
from evanesce.prediction.parameters import Parameter
from evanesce.prediction.predict import Point, scene_with
from evanesce.rig import Scene, dump_scene

Array = NDArray[Any]
Tick = Callable[[str], None]

LEAST_RESPONSE = 0.1
"""A candidate that moves no point by this share of its standard deviation at its usual size is not heard."""

MOST_PAIRED = 5
MOST_PARAMETERS = 2
Z90 = 1.645


@dataclass(frozen=True)
class Heard:
    """A candidate that the series feel.

    Attributes
    ----------
    candidate : Candidate
    parameters : tuple of Parameter
        Those that the series feel most.
    start : mapping
    kind : str
        As of :func:`kind_of`.
    """

    candidate: Candidate
    parameters: tuple[Parameter, ...]
    start: Point
    kind: str


def criticise_series(
    bundle: Bundle, *, seed: int = 0, tick: Tick = lambda step: None
) -> tuple[dict[str, Any], Evidence]:
    """Find what a simulation of the believed rig gets wrong about scalar series.

    Parameters
    ----------
    bundle : Bundle
        With series; frames in it are not looked at.
    seed : int
        Stated in the result; nothing here is random.
    tick : callable
        Told each step when it begins.

    Returns
    -------
    result : dict
        As of :func:`evanesce.criticism.critic.criticise`.
    evidence : Evidence
    """
    if not bundle.series:
        raise InputError("holds neither frames nor series", file=bundle.path, allowed="press frames or series/*.csv")
    table = Table.of(list(bundle.series.values()))
    predict = SeriesPredictor(bundle.scene, table.series)
    tick("what the believed rig predicts")
    table = table.widened(predict.refine(bundle.scene))
    base = fit_series(predict, table, (), (), {})
    heard, deaf = hear(predict, table, base, candidates_of(bundle.scene, bundle.testable), bundle.scene)
    fits: list[SeriesFit] = []
    p = chi_square_p(base, table)
    if p < FROZEN.levels["false_alarm"]:
        for one in heard:
            tick(f"fit of {one.candidate.id}")
            fits.append(fit_series(predict, table, (one.candidate.id,), one.parameters, one.start))
        for a, b in rival_pairs(fits, {h.candidate.id: h.kind for h in heard}):
            tick(f"fit of {a.ids[0]} and {b.ids[0]}")
            fits.append(fit_series(predict, table, a.ids + b.ids, a.parameters + b.parameters, {**a.point, **b.point}))
    tick("what would tell them apart")
    return _answer(bundle, predict, table, base, fits, heard, deaf, p, seed)


def rival_pairs(fits: Sequence[SeriesFit], kinds: Mapping[str, str]) -> list[tuple[SeriesFit, SeriesFit]]:
    """Return pairs of the best single causes, and of the best of each kind: light and mechanics get the same chance."""
    found = pairs_of(fits, MOST_PAIRED)
    for kind in sorted(set(kinds.values())):
        found += pairs_of([f for f in fits if kinds[f.ids[0]] == kind], MOST_PAIRED - 1)
    return list({a.ids + b.ids: (a, b) for a, b in found}.values())


def hear(
    predict: SeriesPredictor, table: Table, base: SeriesFit, candidates: Sequence[Candidate], scene: Scene
) -> tuple[list[Heard], dict[str, str]]:
    """Return the candidates that the series feel, and why the others are not heard."""
    heard, deaf = [], {}
    for candidate in candidates:
        if candidate.missing:
            deaf[candidate.id] = "needs " + ", ".join(candidate.missing)
            continue
        responses: list[tuple[float, Parameter, Point]] = []
        try:
            for p in candidate.parameters:
                for start in _tries(candidate, p):
                    moved = (predict(start) - base.predicted) / table.sigma
                    responses.append((float(np.abs(moved).max()), p, start))
        except InputError as error:
            deaf[candidate.id] = str(error.what)
            continue
        responses.sort(key=lambda r: -r[0])
        if not responses or responses[0][0] < LEAST_RESPONSE:
            deaf[candidate.id] = "these series do not feel it"
            continue
        chosen: dict[str, Parameter] = {}
        for size, p, _ in responses:
            if size >= LEAST_RESPONSE and len(chosen) < MOST_PARAMETERS:
                chosen.setdefault(p.name, p)
        if predict.changes_plate_light(responses[0][2]):
            amplitudes = {f"{candidate.id}:{name}" for name in candidate.effect.amplitudes}
            entry, scaled = next((s, q) for _, q, s in responses if q.name in amplitudes and q.name in s)
            predict.scale(scaled, entry)
            chosen = {scaled.name: scaled}
        heard.append(
            Heard(candidate, tuple(chosen.values()), responses[0][2], kind_of(candidate.effect, scene, responses[0][2]))
        )
    return heard, deaf


def _tries(candidate: Candidate, p: Parameter) -> list[dict[str, float]]:
    """Return points at which a parameter of a candidate is felt if it ever is."""
    if candidate.starts:
        return [dict(candidate.starts[0])]
    low, high = p.bounds
    return [{p.name: float(np.clip(p.null + side * p.deviation, low, high))} for side in (1.0, -1.0)]


def kind_of(effect: Effect, scene: Scene, point: Point) -> str:
    """Return what an effect changes: ``calibration``, ``mechanical`` or ``optical``.

    Of frames, only the square's shot tells of a calibration. What acts on load or contact, or changes the true contact
    area, is mechanics; the rest is light.
    """
    if "square" in effect.needs:
        return "calibration"
    if effect.stage in (Stage.LOAD, Stage.CONTACT):
        return "mechanical"
    believed, changed = (solve_contact(s, 1.3, seed=0, time_s=30.0)[1] for s in (scene, scene_with(scene, point)))
    assert believed is not None
    assert changed is not None
    same = abs(changed.nominal_contact_area / believed.nominal_contact_area - 1.0) < 1e-6
    return "optical" if same else "mechanical"


MENU: Mapping[str, tuple[str, str, Mapping[str, float], Array]] = {
    "force against displacement, 0.1 to 1.2 mm": ("displacement", "force", {}, np.linspace(0.1, 1.2, 8)),
    "area against LED voltage at 3 N, 8 to 12 V": ("voltage", "area", {"force_N": 3.0}, np.linspace(8.0, 12.0, 6)),
    "area against time over 2 minutes at 3 N": (
        "time", "area", {"force_N": 3.0}, np.array([1.0, 4.0, 12.0, 30.0, 60.0, 120.0]),
    ),
    "the same areas read at threshold 0.35": ("force", "area", {"threshold": 0.35}, np.linspace(0.5, 5.0, 6)),
    "areas below 0.3 N": ("force", "area", {}, np.geomspace(0.03, 0.3, 5)),
}  # fmt: skip
"""Further series that a lab could take in an hour: abscissa, ordinate, what is held, values."""


def next_series(predict: SeriesPredictor, group: Sequence[SeriesFit], base: SeriesFit) -> dict[str, Any] | None:
    """Return the series of the menu that pulls a group of causes farthest apart, each at the points fitted."""
    members = [*group] if len(group) > 1 else [*group, base]
    best: tuple[float, str] = (0.0, "")
    told: dict[str, float] = {}
    for what, (x_name, y_name, held, x) in MENU.items():
        units = {"force": "N", "displacement": "mm", "voltage": "V", "time": "s", "area": "mm2"}
        series = Series(
            name="next", x_name=x_name, x_unit=units[x_name], y_name=y_name, y_unit=units[y_name],
            x=np.asarray(x, float), y=np.ones(len(x)), held=held,
        )  # fmt: skip
        try:
            logs = [np.log(predict.values(series, m.point)) for m in members]
        except InputError:
            continue
        distances = [float((((a - b) / ASSUMED_SIGMA) ** 2).sum()) for k, a in enumerate(logs) for b in logs[k + 1 :]]
        told[what] = min(distances, default=0.0)
        best = max(best, (told[what], what))
    if not best[1]:
        return None
    return {
        "what": best[1],
        "separates": sorted({name for m in members for name in (m.ids or ("none",))}),
        "least_squared_distance": told,
    }


def _answer(
    bundle: Bundle,
    predict: SeriesPredictor,
    table: Table,
    base: SeriesFit,
    fits: Sequence[SeriesFit],
    heard: Sequence[Heard],
    deaf: Mapping[str, str],
    p: float,
    seed: int,
) -> tuple[dict[str, Any], Evidence]:
    kinds = {h.candidate.id: h.kind for h in heard}
    log_bayes = {f.ids: f.log_evidence - base.log_evidence for f in fits}
    weights = posterior(log_bayes, len(heard))
    accepted = sorted((f for f in fits if _accept(f, base)), key=lambda f: -weights.models[f.ids])
    best = accepted[0] if accepted else None
    # Of the unknown only what is left tells: of the believed rig, or of the best extension.
    ids = () if best is None else best.ids
    left = log_bayes_of_p(p if best is None else chi_square_p(best, table))
    weights = posterior({**log_bayes, (*ids, UNKNOWN): log_bayes.get(ids, 0.0) + left}, len(heard))
    weights = weights if best is None else with_mimics(weights)
    # More on top of the best explains as much, of course: a rival does without some of it.
    group = (
        [] if best is None else [f for f in accepted[1:] if not set(f.ids) > set(best.ids) and _as_good(f, best, table)]
    )
    other = [] if best is None or group else _of_another_kind(accepted, best, kinds)
    verdict = "none"
    if p < FROZEN.levels["false_alarm"]:
        verdict = "unknown" if best is None else ("ambiguous" if group else "named")
    result: dict[str, Any] = {
        "global_p": p,
        "verdict": verdict,
        "probabilities": dict(sorted(weights.marginal().items(), key=lambda i: -i[1])),
        "effects": [] if best is None else _effects(best),
        "ambiguous_with": sorted({n for f in group for n in f.ids} - set(best.ids)) if best else [],
        "alternatives": [list(f.ids) for f in group],
        "absorbed": [],
        "not_judged": [{"id": name, "why": why} for name, why in deaf.items()],
        "kinds": kinds,
        "next_measurement": next_series(predict, [best, *group, *other], base) if best else None,
        "rival_of_another_kind": [list(f.ids) for f in other],
        "unknown": None if verdict != "unknown" else _unknown(table, base),
        "gain": None,
        "extended_scene": None,
        "false_alarm_control": not table.assumed,
        "notes": _notes(table),
        "frozen_sha256": FROZEN.digest,
        "seed": seed,
    }
    after = bundle.scene if best is None else scene_with(bundle.scene, best.point)
    evidence = Evidence(
        ranking=[_ranked(f, base, kinds, weights.models) for f in sorted(fits, key=lambda f: -f.log_evidence)],
        scene_before=dump_scene(bundle.scene),
        scene_after=dump_scene(after),
        notes=tuple(_notes(table)),
    )
    return result, evidence


def _accept(fit: SeriesFit, base: SeriesFit) -> bool:
    gain, error = gain_of(fit, base)
    return gain > FROZEN.levels["accept_gain_se"] * error and fit.within_bounds


def _of_another_kind(accepted: Sequence[SeriesFit], best: SeriesFit, kinds: Mapping[str, str]) -> list[SeriesFit]:
    """Return the likeliest explanation by the other kind of cause alone, light or mechanics, if there is one."""
    own = {kinds[name] for name in best.ids} | {"calibration"}
    return [f for f in accepted if not {kinds[name] for name in f.ids} & own][:1]


def _as_good(fit: SeriesFit, best: SeriesFit, table: Table) -> bool:
    """Whether a cause could be mistaken for the best: alike in its prediction, or as good at points left out."""
    gain, error = gain_of(best, fit)
    return alike(fit, best, table, FROZEN.levels["ambiguous_lambda"]) or gain < FROZEN.levels["accept_gain_se"] * error


def _effects(fit: SeriesFit) -> list[dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for k, p in enumerate(fit.parameters):
        effect, _, name = p.name.partition(":")
        value, spread = float(fit.point[p.name]), Z90 * float(np.sqrt(fit.covariance[k, k]))
        found.setdefault(effect, {})[name] = {
            "value": value,
            "lo": max(value - spread, p.bounds[0]),
            "hi": min(value + spread, p.bounds[1]),
            "unit": p.unit,
        }
    return [{"id": name, "parameters": parameters} for name, parameters in found.items()]


def _ranked(
    fit: SeriesFit, base: SeriesFit, kinds: Mapping[str, str], models: Mapping[tuple[str, ...], float]
) -> Ranked:
    gain, error = gain_of(fit, base)
    notes = [" + ".join(kinds.get(i, "") for i in fit.ids), f"chi-square {fit.chi_square:.1f}"]
    if not fit.within_bounds:
        notes.append("a parameter is at its bound")
    return Ranked(fit.ids, gain, error, models.get(fit.ids, 0.0), "; ".join(notes))


def _unknown(table: Table, base: SeriesFit) -> dict[str, Any]:
    """Describe how the data depart from the believed rig along each series: factor and slope in log-log."""
    left = table.log_y - base.predicted
    silent = ("contrast", "symmetry", "moving", "nearest", "nearest_share", "explained")
    found: dict[str, Any] = {"where": "in the series", **dict.fromkeys(silent)}
    start, words = 0, {}
    for one in table.series:
        part = left[start : start + len(one)]
        start += len(one)
        slope = stats.linregress(np.log(np.maximum(one.x, 1e-9)), part).slope if len(one) > 2 else float("nan")
        words[one.name] = {"factor": float(np.exp(part.mean())), f"exponent_of_{one.x_name}": float(slope)}
    return found | {"scaling": words}


def _notes(table: Table) -> list[str]:
    notes = ["There are no frames: nothing about the light's place can be told, only what moves these figures."]
    if table.assumed:
        notes.append(
            f"A series states no standard deviation: {100 * ASSUMED_SIGMA:g} % of each value is assumed, independent "
            "from point to point; probabilities hang on it."
        )
    return notes
