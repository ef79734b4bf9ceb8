"""Select the winners of a search and assess them; results are kept step by step in JSON files."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.core.errors import WorkError
from evanesce.design import sensitivity, winner
from evanesce.design.evaluate import evaluate
from evanesce.design.parts import cost
from evanesce.design.processes import Call, done_by
from evanesce.design.search import Plan, Trial, pareto
from evanesce.design.secondary import OBJECTIVES
from evanesce.design.verify import verified

BASE = "base"
BETWEEN = "between the objectives, on the Pareto front"
LARGEST = 3
"""Number of effects, those that change one measurement most, each of which is left out of the draws once."""


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """What is computed of the winners.

    Attributes
    ----------
    designs : int
        Number of winners, the base not counted.
    rigs : int
        Drawn anew for the errors of each by load and position.
    trajectories : int
        Of Morris' plan about the best; 0: no sensitivity.
    renderings : int
        Of each verified case by the path tracer; 0: none.
    samples_per_pixel : int
        Of each rendering.
    """

    designs: int = 3
    rigs: int = 48
    trajectories: int = 4
    renderings: int = 2
    samples_per_pixel: int = 16


@dataclass(frozen=True, kw_only=True)
class Chosen:
    """A design that is assessed: the base or a winner.

    Attributes
    ----------
    name, why : str
    values : mapping
        Key -> value; empty for the base.
    trial : Trial or None
        None for the base as its scene has it.
    """

    name: str
    why: str
    values: Mapping[str, float]
    trial: Trial | None = None


def _in_turn(calls: Sequence[Call]) -> Iterator[tuple[int, Any]]:
    for number, (function, given, options) in enumerate(calls):
        yield number, function(*given, **options)


def choose(plan: Plan, trials: Sequence[Trial], count: int) -> list[Chosen]:
    """Return the base and up to ``count`` winners: smallest error, smallest error within the base's cost, the rest.

    The rest are those of the Pareto front nearest to the best of every objective, by rank.
    """
    front = pareto(trials, plan.objectives)
    found = [Chosen(name=BASE, why="the scene as it was given", values={})]
    wanted: list[tuple[str, Trial | None]] = []
    able = [t for t in trials if t.feasible]
    if able:
        wanted.append(("smallest predicted area error", min(able, key=_error)))
    if plan.parts is not None:
        most = cost(plan.parts, plan.base)
        equal = [t for t in able if t.figures["cost"] <= most * (1 + 1e-9)]
        text = f"smallest predicted area error at no more than the base's cost, {most:.2f} {plan.parts.currency}"
        wanted.append((text, min(equal, key=_error) if equal else None))
    wanted += [(BETWEEN, t) for t in _between(front, plan.objectives)]
    reasons: dict[int, list[str]] = {}
    by_number = {trial.number: trial for _, trial in wanted if trial is not None}
    for why, trial in wanted:
        if trial is None or (trial.number not in reasons and len(reasons) == count):
            continue
        reasons.setdefault(trial.number, [])
        if not (reasons[trial.number] and why == BETWEEN):
            reasons[trial.number].append(why)
    for number, why_all in reasons.items():
        trial = by_number[number]
        found.append(Chosen(name=f"trial-{number}", why="; ".join(why_all), values=trial.values, trial=trial))
    return found


def _error(trial: Trial) -> float:
    return trial.figures["area_error"]


def _between(front: Sequence[Trial], objectives: Sequence[str]) -> list[Trial]:
    """Return a front from its middle outwards: by the sum over objectives of each trial's rank."""
    if not front:
        return []
    ranks = np.zeros(len(front))
    for name in objectives:
        sign = 1.0 if OBJECTIVES[name].direction == "minimize" else -1.0
        order = np.argsort([sign * t.figures[name] for t in front], kind="stable")
        ranks[order] += np.arange(len(front)) ** 2
    return [front[k] for k in np.argsort(ranks, kind="stable")]


def study(
    plan: Plan, chosen: Sequence[Chosen], folder: Path, settings: Assessment, client: Any = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, dict[str, Any]]:  # fmt: skip
    """Assess designs; steps whose file exists are read from it.

    Returns
    -------
    dict
        Name -> ``assessed``, ``tolerances``, ``sensitivity``, ``without``, ``verified``; the last four not for all.
    """
    store = _ResultStore(plan, folder)
    submitted = _in_turn if client is None else partial(done_by, client)
    best = _best(chosen)
    steps = [call for c in chosen for call in _first_steps(plan, c, settings, sensitive=c is best)]
    total = len(steps) + (LARGEST if best else 0)
    done = 0

    def work(calls: list[_Step]) -> None:
        nonlocal done
        left = [s for s in calls if store.get(s.file) is None]
        done += len(calls) - len(left)
        on_progress(done, total)
        for number, result in submitted([s.call for s in left]):
            store.put(left[number].file, result)
            done += 1
            on_progress(done, total)

    work(steps)
    if best is not None:
        rows = store.get(f"{best.name}/tolerances")["rows"]
        effects = list(dict.fromkeys(row["name"].split(".")[0] for row in ranked(rows) if "." in row["name"]))
        new = {d.effect for d in store.new_fields}
        work(
            [
                _Step(
                    f"{best.name}/without-{effect}-{settings.rigs}",
                    winner.without,
                    (plan.job, best.values, effect, settings.rigs),
                    {},
                )
                for effect in [e for e in effects if e not in new][:LARGEST]
            ]
        )
    return {c.name: _gathered(store, plan, c, settings, sensitive=c is best) for c in chosen}


def ranked(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return rows of tolerances by the size of their change, largest first; infeasible ones left out."""
    return sorted((r for r in rows if "reason" not in r), key=lambda r: -change(r))


def change(row: Mapping[str, Any]) -> float:
    """Return the larger change of the area error by one standard deviation [% of the area]."""
    return max(abs(row["low_percent"]), abs(row["high_percent"]))


@dataclass(frozen=True)
class _Step:
    file: str
    function: Callable[..., Any]
    given: tuple[Any, ...]
    options: dict[str, Any]

    @property
    def call(self) -> Call:
        return self.function, self.given, self.options


def _best(chosen: Sequence[Chosen]) -> Chosen | None:
    return next((c for c in chosen if c.trial is not None), None)


def _first_steps(plan: Plan, chosen: Chosen, settings: Assessment, *, sensitive: bool) -> list[_Step]:
    job, values, name = plan.job, dict(chosen.values), chosen.name
    steps = [_Step(f"{name}/assessed-{settings.rigs}", winner.assessed, (job, values, settings.rigs), {})]
    if settings.renderings:
        for k in _verified_cases(plan):
            options = {
                "case": k,
                "count": settings.renderings,
                "samples": settings.samples_per_pixel,
                "seed": plan.question.seed + 1000,
            }
            steps.append(
                _Step(
                    f"{name}/verified-{k}-{settings.renderings}-{settings.samples_per_pixel}",
                    verified,
                    (job, values),
                    options,
                )
            )
    if chosen.trial is None:
        return [*steps, _Step(f"{name}/searched", evaluate, (job, values), {})]
    steps.append(_Step(f"{name}/tolerances", winner.tolerances, (job, values), {}))
    if settings.trajectories and sensitive:
        for k, row in enumerate(sensitivity.sample(plan.variables, values, settings.trajectories, plan.question.seed)):
            moved = dict(zip((v.key for v in plan.variables), map(float, row), strict=True))
            steps.append(_Step(f"{name}/morris-{settings.trajectories}-{k}", evaluate, (job, moved), {}))
    return steps


def _verified_cases(plan: Plan) -> list[int]:
    """Return the numbers of the cases that the path tracer verifies: that of the tolerances."""
    return [len(plan.question.cases) // 2]


def _gathered(
    store: _ResultStore, plan: Plan, chosen: Chosen, settings: Assessment, *, sensitive: bool
) -> dict[str, Any]:
    name = chosen.name
    found: dict[str, Any] = {"why": chosen.why, "values": dict(chosen.values)}
    found["assessed"] = store.get(f"{name}/assessed-{settings.rigs}")
    if settings.renderings:
        files = [
            f"{name}/verified-{k}-{settings.renderings}-{settings.samples_per_pixel}" for k in _verified_cases(plan)
        ]
        found["verified"] = [store.get(file) for file in files]
    if chosen.trial is None:
        return found | {"searched": store.get(f"{name}/searched")}
    found["tolerances"] = store.get(f"{name}/tolerances")
    kept = sorted((store.folder / name).glob(f"without-*-{settings.rigs}.json"))
    found["without"] = [own for p in kept if (own := store.get(f"{name}/{p.stem}")) is not None]
    if settings.trajectories and sensitive:
        designs = sensitivity.sample(plan.variables, chosen.values, settings.trajectories, plan.question.seed)
        tried = [store.get(f"{name}/morris-{settings.trajectories}-{k}") for k in range(len(designs))]
        errors = np.array([t["figures"]["area_error"] if "figures" in t else math.nan for t in tried])
        if np.isfinite(errors).all():
            found["sensitivity"] = sensitivity.indices(
                plan.variables, chosen.values, designs, errors, plan.question.seed
            )
        else:
            found["sensitivity_reason"] = next(t["reason"] for t in tried if "reason" in t)
    return found


class _ResultStore:
    """Results of steps as JSON files, each with the digest of its search."""

    def __init__(self, plan: Plan, folder: Path) -> None:
        from evanesce.design.uncertainty import uncertainty_of

        self.folder, self.key = folder, plan.signature
        self.new_fields = uncertainty_of(plan.base.scene, plan.question.standard_deviations).new_fields
        self._known: dict[str, Any] = {}

    def get(self, file: str) -> Any:
        if file not in self._known:
            path = self.folder / f"{file}.json"
            try:
                data = json.loads(path.read_text(encoding="utf-8"))
            except (OSError, ValueError):
                return None
            if not isinstance(data, dict) or data.get("search") != self.key or "result" not in data:
                return None
            self._known[file] = data["result"]
        return self._known[file]

    def put(self, file: str, result: Any) -> None:
        path = self.folder / f"{file}.json"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_name(f".{path.name}.part")
            part.write_text(json.dumps({"search": self.key, "result": result}, indent=1), encoding="utf-8")
            part.replace(path)
        except OSError as error:
            raise WorkError(f"{path}: cannot write: {error.strerror}") from None
        self._known[file] = result
