"""Which picture to take next: simulated shots of a costed menu, by how far each would pull an ambiguous group apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.criticism.extend import Extension
from evanesce.criticism.problem import Problem, predicted_part
from evanesce.effects import Stage
from evanesce.prediction.linear import Metric
from evanesce.prediction.nuisance import nuisance_parameters
from evanesce.prediction.observe import Observation
from evanesce.prediction.parameters import derivative
from evanesce.prediction.predict import Predictor
from evanesce.prediction.views import View

Array = NDArray[Any]

FRAMES = 8
"""Of a suggested shot."""

LOAD_CELL_N = 0.01
"""What a checked load cell is good for [N]."""

ENOUGH = 9.0


@dataclass(frozen=True)
class Shot:
    """An entry of the menu.

    Attributes
    ----------
    what : str
    minutes : float
        What it costs a lab.
    view : View
    """

    what: str
    minutes: float
    view: View


def menu(observation: Observation) -> list[Shot]:
    """Return what could be measured beyond what was, cheapest first."""
    press = [v for v in observation.views if v.kind == "press"]
    have = {v.kind for v in observation.views}
    cheap = {"led_off": 0.5, "lens_cap": 1.0, "checkerboard": 3.0, "square": 3.0}
    found = [Shot(kind, cost, View(kind=kind, frames=FRAMES)) for kind, cost in cheap.items() if kind not in have]
    if press:
        last = max(press, key=lambda v: (v.force_N or 0.0, v.time_s))
        voltages = {v.voltage_V for v in press}
        for step in (-1.0, 1.0):
            voltage = (min(voltages) if step < 0 else max(voltages)) + step
            name = f"voltage step to {voltage:g} V"
            found.append(Shot(name, 1.0, replace(last, voltage_V=voltage, frames=FRAMES)))
        found.append(Shot("longer hold, 30 minutes", 30.0, replace(last, time_s=last.time_s + 1800.0, frames=FRAMES)))
        low = min(v.force_N or 0.0 for v in press)
        found.append(Shot(f"lighter press, {low / 3:.2g} N", 2.0, replace(last, force_N=low / 3, frames=FRAMES)))
    return sorted(found, key=lambda s: s.minutes)


def next_measurement(
    observation: Observation, problem: Problem, best: Extension, group: Sequence[Extension]
) -> dict[str, Any]:
    """Return the shot that tells the best answer from most of its group, with what it separates.

    Parameters
    ----------
    observation : Observation
    problem : Problem
    best : Extension
    group : sequence of Extension
        What it could be mistaken for.
    """
    options = [(shot, _distances(problem, shot.view, best, group)) for shot in menu(observation)]
    options.append((Shot("load cell checked against a weight", 10.0, View(kind="press")), _by_load_cell(best, group)))
    ranked = sorted(options, key=lambda o: (-sum(d >= ENOUGH for d in o[1]), -min(max(o[1]), 100.0), o[0].minutes))
    shot, distances = ranked[0]
    if max(distances) < ENOUGH:
        return {"what": "nothing on the menu tells these apart", "separates": [], "menu": _listed(options, group)}
    return {
        "what": shot.what,
        "separates": [e.cause.id for e, d in zip(group, distances, strict=True) if d >= ENOUGH],
        "lambda": [float(d) for d in distances],
        "minutes": shot.minutes,
        "menu": _listed(options, group),
    }


def _listed(options: Sequence[tuple[Shot, list[float]]], group: Sequence[Extension]) -> list[dict[str, Any]]:
    found = []
    for shot, distances in options:
        apart = {e.cause.id: float(d) for e, d in zip(group, distances, strict=True)}
        found.append({"what": shot.what, "minutes": shot.minutes, "lambda": apart})
    return found


def _distances(problem: Problem, view: View, best: Extension, group: Sequence[Extension]) -> list[float]:
    """Return squared whitened distances between what the best and each of the group predict of a view."""
    predictor = Predictor(problem.predictor.scene, [view], noise_scale=problem.predictor.noise_scale)
    predictor.fixed = problem.predictor.fixed
    nuisances = nuisance_parameters([view], problem.noise.flicker)
    # Light, black level and pose are known from the data; only what is new with this shot is free.
    new = [p for p in nuisances if p.linear or view.is_card]
    try:
        mine = predictor.cube(_shared(best))
        sd = np.sqrt(problem.noise.variance(mine, view.frames))
        rows = np.array([(derivative(predictor, _shared(best), p, [0], mine) / sd).ravel() for p in new])
        metric = Metric.of(rows.reshape(len(new), mine.size), np.array([p.deviation for p in new]))
        found = []
        for other in group:
            apart = ((mine - predictor.cube(_shared(other))) / sd).ravel()
            found.append(float(metric.project(apart) @ apart))
        return found
    except InputError:
        return [0.0] * len(group)


def _shared(extension: Extension) -> dict[str, float]:
    """Return a fit's point without what belongs to single views."""
    fitted = extension.fitted
    return {n: v for n, v in predicted_part(fitted.point, fitted.parameters).items() if "[checker" not in n}


def _by_load_cell(best: Extension, group: Sequence[Extension]) -> list[float]:
    """Return distances by a load cell that is known to be right: only effects on the load differ from the rest."""

    def load(extension: Extension) -> float:
        from evanesce.effects import all_effects

        changes = [
            abs(extension.fitted.point[p.name] - p.null) / LOAD_CELL_N
            for p in extension.parameters
            if all_effects()[p.name.partition(":")[0]].stage is Stage.LOAD
        ]
        return max(changes, default=0.0)

    return [(load(best) - load(other)) ** 2 for other in group]
