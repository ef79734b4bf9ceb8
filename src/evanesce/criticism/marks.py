"""Effects whose places only the data know: specks, hot pixels, dust, a scratch. What stands out tells their places.

What one mark in each bin would change says how a mark's signal goes from view to view there. Along that each bin has an
amplitude of its own; bins whose amplitude is worth the choice of a place among all bins make the list, and a fit then
multiplies the list as a whole. Marks are told apart by how their bins go with voltage, contact and darkness. A line is
looked for among all places, directions and lengths in the same way (:mod:`evanesce.criticism.lines`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.criticism.blots import brightest_blot
from evanesce.criticism.features import smoothed
from evanesce.criticism.lines import brightest_line
from evanesce.criticism.problem import Fit, Problem, predicted_part
from evanesce.effects import Marks
from evanesce.optics.projection import Projection
from evanesce.prediction.candidates import Candidate
from evanesce.prediction.frozen import FROZEN
from evanesce.prediction.parameters import Parameter, moved
from evanesce.prediction.views import BIN_PX
from evanesce.rig import Scene

Array = NDArray[Any]

MOST = 300
"""Places in a list; the strongest."""

FOOTPRINT = 0.05
"""Share of a list's largest change from which on a bin is one of its places."""

BESIDE = "beside them, over"
"""Begins the names of what is left about places."""


@dataclass(frozen=True)
class Chosen:
    """Bins that stand out.

    Attributes
    ----------
    bins : ndarray of int (n,)
        Numbers among all bins, row by row.
    amounts : ndarray (n,)
        Of the template's unit.
    penalty : float
        What their choice costs [nats].
    """

    bins: NDArray[np.int_]
    amounts: Array
    penalty: float


def with_places(
    problem: Problem, base: Fit, candidates: Sequence[Candidate], *, codec: bool = False
) -> tuple[Candidate, ...]:
    """Return the candidates; those that list places have them from what a fitted model leaves.

    Their lists are handed to the predictor. What the believed rig has already is not looked for anew.

    Parameters
    ----------
    problem : Problem
    base : Fit
    candidates : sequence of Candidate
    codec : bool
        Whether the frames went through one.
    """
    believed = problem.predictor.scene.effects
    searched = [c for c in candidates if not c.missing and c.id not in believed]
    templates = {c.id: template_of(problem, base, c.id, c.effect.marks) for c in searched if c.effect.marks is not None}
    found = []
    for candidate in candidates:
        line, blot = candidate.effect.line, candidate.effect.blot
        if candidate.id in templates:
            found.append(_placed(problem, base, candidate, templates[candidate.id], codec))
        elif candidate in searched and line is not None and line.like in templates:
            found.append(_lined(problem, base, candidate, templates[line.like]))
        elif candidate in searched and blot is not None and blot.like in templates:
            found.append(_blotted(problem, base, candidate, templates[blot.like]))
        else:
            found.append(candidate)
    return tuple(found)


def without_places(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Return the candidates; those whose places only the data know cannot be judged.

    For frames whose codec has left next to no noise: the blots that it makes stay from frame to frame, and nothing is
    left by which a real one could be told from them.
    """
    why = "a codec left no noise by which real marks are told from those that it makes"
    return tuple(
        replace(c, unseen=why) if not c.missing and (c.effect.marks is not None or c.effect.line is not None) else c
        for c in candidates
    )


def template_of(problem: Problem, base: Fit, effect: str, marks: Marks) -> Array:
    """Return the whitened change (views, rows, cols) that one mark in the middle of each bin makes, per unit amount."""
    predictor = problem.predictor
    x, y, area = cells(predictor.scene, problem.data.shape[1:], marks.where)
    unit = marks.unit(predictor.scene, area)
    predictor.fixed[effect] = listing(marks, x, y, np.full(x.size, unit))
    at = moved(predicted_part(base.point, base.parameters), {f"{effect}:{marks.scale}": 1.0})
    change = predictor.cube(at, problem.views) - base.predicted
    del predictor.fixed[effect]
    return problem.unwhitened(problem.whitened(change)) / unit


def listing(marks: Marks, x: Array, y: Array, amounts: Array) -> dict[str, Any]:
    """Return the settings of an effect that list marks at x, y [mm] with amounts."""
    found = {marks.x: x, marks.y: y, marks.amount: amounts}
    return {key: [float(v) for v in values] for key, values in found.items()} | dict(marks.fixed)


def _placed(problem: Problem, base: Fit, candidate: Candidate, template: Array, codec: bool) -> Candidate:
    marks = candidate.effect.marks
    assert marks is not None
    predictor, name = problem.predictor, f"{candidate.id}:{marks.scale}"
    chosen = standing_out(problem.unwhitened(base.residual), template, codec=codec)
    if not chosen.bins.size:
        return replace(candidate, unseen="no place stands out")
    x, y, _ = cells(predictor.scene, problem.data.shape[1:], marks.where)
    predictor.fixed[candidate.id] = listing(marks, x[chosen.bins], y[chosen.bins], chosen.amounts)
    scale = Parameter(name=name, deviation=1.0, bounds=(0.0, 10.0), step=0.25)
    return replace(candidate, parameters=(scale,), starts=({name: 1.0},), penalty=chosen.penalty)


def _lined(problem: Problem, base: Fit, candidate: Candidate, template: Array) -> Candidate:
    line = candidate.effect.line
    assert line is not None
    scene = problem.predictor.scene
    found = brightest_line(problem.unwhitened(base.residual), template)
    if found is None:
        return replace(candidate, unseen="no line stands out")
    (u0, v0), (u1, v1) = found.ends
    middle = (BIN_PX - 1) / 2
    x, y = Projection.of(scene.camera, scene.plate).to_plate(
        np.array([u0, u1]) * BIN_PX + middle, np.array([v0, v1]) * BIN_PX + middle
    )
    length = float(np.hypot(x[1] - x[0], y[1] - y[0]))
    problem.predictor.fixed[candidate.id] = {
        line.middle: [float(x.mean()), float(y.mean())],
        line.direction: float(np.degrees(np.arctan2(y[1] - y[0], x[1] - x[0]))),
        line.length: length,
    }
    name = f"{candidate.id}:{line.amount}"
    own = next(p for p in candidate.parameters if p.name == name)
    amount = float(np.clip(found.amount / length / line.per_mm(1.0), *own.bounds))
    return replace(candidate, parameters=(own,), starts=({name: amount},), penalty=found.penalty)


def left_at_places(problem: Problem, row: Array, residual: Array) -> dict[str, float]:
    """Return what a fitted list of places leaves there in each kind or state of shots, over its standard deviation.

    A mark is told by how it goes from shot to shot: light of hot pixels, taken for specks, is still there where no LED
    is on, and a spot that grows with the load is no film. All shots count at all places, those too in which the named
    mark would not be seen.

    Parameters
    ----------
    problem : Problem
    row : ndarray (bins,)
        Whitened change that the list makes.
    residual : ndarray (bins,)
        Whitened, of the fit with it.
    """
    change, left = problem.unwhitened(row), problem.unwhitened(residual)
    weight = np.sqrt((change**2).sum(axis=0))
    weight = np.where(weight > FOOTPRINT * weight.max(), weight, 0.0)
    seen = problem.valid[list(problem.views)] * weight
    found = {}
    names = [f"press at {v.force_N:g} N, {v.voltage_V:g} V" if v.kind == "press" else v.kind for v in problem.kinds]
    for kind in dict.fromkeys(names):
        mine = [k for k, name in enumerate(names) if name == kind]
        size = float(np.sqrt((seen[mine] ** 2).sum()))
        if size > 0:
            found[kind] = float((seen[mine] * left[mine]).sum()) / size
    return found


def _blotted(problem: Problem, base: Fit, candidate: Candidate, template: Array) -> Candidate:
    blot, scene = candidate.effect.blot, problem.predictor.scene
    assert blot is not None
    found = brightest_blot(problem.unwhitened(base.residual), template)
    if found is None:
        return replace(candidate, unseen="no spot stands out")
    (u, v), middle = found.middle, (BIN_PX - 1) / 2
    x, y = Projection.of(scene.camera, scene.plate).to_plate(
        np.array([u * BIN_PX + middle]), np.array([v * BIN_PX + middle])
    )
    side = BIN_PX / scene.camera.scale_px_per_mm
    problem.predictor.fixed[candidate.id] = {
        blot.middle: [float(x[0]), float(y[0])],
        blot.radius: found.radius * side,
    }
    own = next(p for p in candidate.parameters if p.name == f"{candidate.id}:{blot.amount}")
    start = {own.name: float(np.clip(found.amount / side**2, *own.bounds))}
    return replace(candidate, parameters=(own,), starts=(start,), penalty=found.penalty)


BESIDE_BINS = (2.0, 4.0, 8.0)
"""How far about a list's places what it explains is looked for [bins, standard deviation]."""


def left_beside(problem: Problem, row: Array, residual: Array) -> dict[str, float]:
    """Return what a fitted list of places leaves about them, along its own change made wider, over its deviation.

    A mark is as small as the lens draws it. Of a larger bright spot the marks that stand out most are only the middle.

    Parameters
    ----------
    problem, row, residual
        As for :func:`left_at_places`.
    """
    change, left = (problem.unwhitened(part).astype(np.float32) for part in (row, residual))
    valid = problem.valid[list(problem.views)]
    found = {}
    for wide in BESIDE_BINS:
        wider = np.array([smoothed(np.ascontiguousarray(one), wide) for one in change]) * valid
        # What is alike at the places themselves is for the list's own amplitude.
        wider -= float((wider * change).sum()) / max(float((change**2).sum()), 1e-30) * change
        size = float(np.sqrt((wider**2).sum()))
        if size > 0:
            found[f"{BESIDE} {wide:g} bins"] = float((wider * left).sum()) / size
    return found


def cells(scene: Scene, shape: tuple[int, ...], where: str) -> tuple[Array, Array, float]:
    """Return the middles x, y (rows * cols) of the bins [mm] and the area of one [mm^2], on plate or sensor."""
    rows, cols = shape
    camera = scene.camera
    v, u = (((np.arange(n) + 0.5) * BIN_PX) for n in (rows, cols))
    row, col = (a.ravel() for a in np.meshgrid(v, u, indexing="ij"))
    if where == "sensor":
        pitch = camera.pixel.pitch_um * 1e-3
        return col * pitch, row * pitch, (BIN_PX * pitch) ** 2
    x, y = Projection.of(camera, scene.plate).to_plate(col - 0.5, row - 0.5)
    return np.asarray(x), np.asarray(y), (BIN_PX / camera.scale_px_per_mm) ** 2


def standing_out(residual: Array, template: Array, *, codec: bool = False) -> Chosen:
    """Return the bins that a mark explains better than nothing, its place and amount paid for.

    Parameters
    ----------
    residual, template : ndarray (views, rows, cols)
        Whitened.
    codec : bool
        Of frames from a codec, whose errors stand out to both sides: only bins beyond what stands out to the wrong
        side, of which no mark is capable.
    """
    product = np.einsum("vrc,vrc->rc", residual, template).ravel()
    information = np.einsum("vrc,vrc->rc", template, template).ravel()
    seen = information > 0
    significance = np.where(seen, product / np.sqrt(np.where(seen, information, 1.0)), 0.0)
    square = significance**2
    # A place among all bins, and an amount that may as well have been another one of its size.
    cost = np.log(max(int(seen.sum()), 1)) + 0.5 * np.log1p(square)
    least = beyond_the_other_side(significance[seen]) if codec else 0.0
    worth = np.where(significance > least, 0.5 * square - cost, 0.0)
    bins = np.flatnonzero(worth > 0)
    bins = bins[np.argsort(-worth[bins])][:MOST]
    return Chosen(bins, product[bins] / information[bins], float(cost[bins].sum()))


def beyond_the_other_side(significance: Array) -> float:
    """Return the least value that at most ``false_places`` as many values exceed to the other side as to this one."""
    up, down = np.sort(significance[significance > 0])[::-1], np.sort(-significance[significance < 0])[::-1]
    above = np.arange(1, up.size + 1)
    below = np.searchsorted(-down, -up, side="right")
    kept = np.flatnonzero(below <= FROZEN.levels["false_places"] * above)
    return float(up[kept[-1]]) * (1 - 1e-12) if kept.size else np.inf
