"""From defects in pixels to the settings of effects that list them, and how such effects show from view to view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.effects import Marks
from evanesce.inference.atoms import Atom, disc_offsets
from evanesce.inference.causes import Cause
from evanesce.inference.joint_fit import Taken
from evanesce.inference.model import AnchoredModel
from evanesce.optics.projection import Projection
from evanesce.prediction.parameters import Parameter
from evanesce.prediction.views import BIN_PX
from evanesce.rig import Scene

Array = NDArray[Any]

HALF_PX = 7
"""Of the image of a point."""
MOST_SCALE = 10.0
"""Bound of what multiplies a list, by the effects themselves."""


@dataclass(frozen=True)
class Mark:
    """A defect that was found.

    Attributes
    ----------
    cause : str
        Whose behaviour explains it best, or ``unknown``.
    atom : Atom
    row, col : float
        Of its middle; integer = a pixel's middle [px of the model camera].
    amount : float
        In the unit of the cause's list.
    z : float
        Over its standard deviation.
    log_bayes : mapping of str to float
        By cause and of something unknown, over nothing; the choice of a place is paid for [nats].
    """

    cause: str
    atom: Atom
    row: float
    col: float
    amount: float
    z: float
    log_bayes: Mapping[str, float]


def positions(scene: Scene, row: Array, col: Array, where: str) -> tuple[Array, Array]:
    """Return x, y [mm] of pixels (n,) of the model camera, on the plate or from the sensor's first corner."""
    if where == "sensor":
        pitch = scene.camera.pixel.pitch_um * 1e-3
        return (col + 0.5) * pitch, (row + 0.5) * pitch
    x, y = Projection.of(scene.camera, scene.plate).to_plate(col, row)
    return np.asarray(x), np.asarray(y)


def _list(marks: Marks, scene: Scene, row: Array, col: Array, amounts: Array) -> dict[str, Any]:
    x, y = positions(scene, row, col, marks.where)
    listed = {marks.x: x, marks.y: y, marks.amount: amounts}
    return {key: [float(v) for v in values] for key, values in listed.items()} | dict(marks.fixed)


def _changed(
    model: AnchoredModel, point: Mapping[str, float], cause: Cause, settings: Mapping[str, Any]
) -> dict[str, float]:
    """Hand a list to the quick prediction, and return the point at which it acts."""
    model.coarse.fixed = {**model.fixed, cause.id: settings}
    return {**point, f"{cause.id}:{_marks(cause).scale}": 1.0}


def _marks(cause: Cause) -> Marks:
    marks = cause.candidate.effect.marks
    assert marks is not None
    return marks


def behaviour_of(model: AnchoredModel, point: Mapping[str, float], cause: Cause) -> Array:
    """Return what a unit amount changes in sum over its pixels, at every pixel (open views, rows, cols) [DN].

    Parameters
    ----------
    model : AnchoredModel
    point : mapping
    cause : Cause
        Of an effect that lists defects.
    """
    scene, opened = model.observation.scene, list(model.data.open)
    rows, cols = model.data.cube.shape[1:]
    v, u = (a.ravel() for a in np.mgrid[:rows, :cols] * BIN_PX + (BIN_PX - 1) / 2)
    side_mm = BIN_PX / scene.camera.scale_px_per_mm
    marks = _marks(cause)
    area = side_mm**2 if marks.where == "plate" else (BIN_PX * scene.camera.pixel.pitch_um * 1e-3) ** 2
    unit = marks.unit(scene, area)
    before = {k: x for k, x in point.items() if not k.startswith(f"{cause.id}:")}
    base = model.coarse.cube(before, opened)[opened]
    try:
        at = _changed(model, before, cause, _list(marks, scene, v, u, np.full(v.size, unit)))
        change = model.coarse.cube(at, opened)[opened] - base
    finally:
        model.coarse.fixed = dict(model.fixed)
    height, width = model.observation.images.shape[1:]
    # One in each bin: what spreads to neighbours comes back from them.
    every = change * (BIN_PX**2 / unit)
    return np.array([enlarged(one, (height, width)) for one in every], np.float32)


def enlarged(bins: Array, shape: tuple[int, int]) -> Array:
    """Return bins (rows, cols) as pixels, interpolated."""
    whole = cv2.resize(bins.astype(np.float32), None, fx=BIN_PX, fy=BIN_PX, interpolation=cv2.INTER_LINEAR)
    missing = [(0, n - m) for n, m in zip(shape, whole.shape, strict=True)]
    return np.pad(whole, missing)


def point_spread(model: AnchoredModel, point: Mapping[str, float], cause: Cause, behaviour: Array) -> Array:
    """Return the image of one defect (rows, cols), odd sides, sum 1.

    Parameters
    ----------
    model : AnchoredModel
    point : mapping
    cause : Cause
    behaviour : ndarray (open views, rows, cols)
    """
    scene, marks = model.observation.scene, _marks(cause)
    inner = np.abs(behaviour)[:, HALF_PX:-HALF_PX, HALF_PX:-HALF_PX]
    place, row, col = np.unravel_index(int(np.argmax(inner)), inner.shape)
    row, col = row + HALF_PX, col + HALF_PX
    view = model.data.open[place]
    area = (
        1.0 / scene.camera.scale_px_per_mm**2 if marks.where == "plate" else (scene.camera.pixel.pitch_um * 1e-3) ** 2
    )
    unit = marks.unit(scene, area)
    before = {k: x for k, x in point.items() if not k.startswith(f"{cause.id}:")}
    base = model.coarse.image(before, view)
    try:
        settings = _list(marks, scene, np.array([float(row)]), np.array([float(col)]), np.array([unit]))
        change = model.coarse.image(_changed(model, before, cause, settings), view) - base
    finally:
        model.coarse.fixed = dict(model.fixed)
    patch = change[row - HALF_PX : row + HALF_PX + 1, col - HALF_PX : col + HALF_PX + 1]
    total = float(patch.sum())
    if abs(total) < 1e-12:
        return np.ones((1, 1))
    return np.asarray(np.maximum(patch / total, 0.0))


@dataclass(frozen=True)
class Listed:
    """A cause with the places that data showed, as it enters the joint fit.

    Attributes
    ----------
    taken : Taken
    settings : mapping
        Of its effect: the places.
    start : mapping of str to float
        Where its free parameter starts.
    """

    taken: Taken
    settings: Mapping[str, Any]
    start: Mapping[str, float]


def listed(cause: Cause, found: Sequence[Mark], scene: Scene) -> Listed:
    """Return a cause with the places of its defects.

    Parameters
    ----------
    cause : Cause
    found : sequence of Mark
        Of a line or a blob the first counts.
    scene : Scene
        Seen by the model camera.
    """
    effect = cause.candidate.effect
    if effect.marks is not None:
        settings = _listed(effect.marks, found, scene)
        own, start = (
            Parameter(name=f"{cause.id}:{effect.marks.scale}", deviation=1.0, bounds=(0.0, MOST_SCALE), step=0.25),
            1.0,
        )
    else:
        name, settings, start = (
            _line(cause, found[0], scene) if effect.line is not None else _blob(cause, found[0], scene)
        )
        own = next(p for p in cause.parameters if p.name == f"{cause.id}:{name}")
    return placed(cause, own, settings, start)


def placed(cause: Cause, own: Parameter, settings: Mapping[str, Any], start: float) -> Listed:
    """Return a cause with settings from data, one parameter of which is free."""
    point = {own.name: float(np.clip(start, *own.bounds))}
    there = Cause(replace(cause.candidate, parameters=(own,), starts=(point,)), cause.costly)
    return Listed(Taken(there, (own,)), settings, point)


def _listed(marks: Marks, found: Sequence[Mark], scene: Scene) -> dict[str, Any]:
    rows, cols, amounts = [], [], []
    for mark in found:
        offsets = disc_offsets(mark.atom.size_px)
        rows.append(np.clip(mark.row + offsets[:, 0], 0, scene.camera.resolution_px[1] - 1))
        cols.append(np.clip(mark.col + offsets[:, 1], 0, scene.camera.resolution_px[0] - 1))
        amounts.append(np.full(len(offsets), mark.amount / len(offsets)))
    return _list(marks, scene, *(np.concatenate(part) for part in (rows, cols, amounts)))


def _line(cause: Cause, mark: Mark, scene: Scene) -> tuple[str, dict[str, Any], float]:
    line = cause.candidate.effect.line
    assert line is not None
    half = 0.5 * mark.atom.size_px * np.array([-1.0, 1.0])
    x, y = positions(
        scene, mark.row + half * np.sin(mark.atom.angle), mark.col + half * np.cos(mark.atom.angle), "plate"
    )
    length = float(np.hypot(x[1] - x[0], y[1] - y[0]))
    settings = {
        line.middle: [float(x.mean()), float(y.mean())],
        line.direction: float(np.degrees(np.arctan2(y[1] - y[0], x[1] - x[0]))),
        line.length: length,
    }
    return line.amount, settings, mark.amount / length / line.per_mm(1.0)


def _blob(cause: Cause, mark: Mark, scene: Scene) -> tuple[str, dict[str, Any], float]:
    blot = cause.candidate.effect.blot
    assert blot is not None
    x, y = positions(scene, np.array([mark.row]), np.array([mark.col]), "plate")
    radius = mark.atom.size_px / scene.camera.scale_px_per_mm
    settings = {blot.middle: [float(x[0]), float(y[0])], blot.radius: radius}
    return blot.amount, settings, mark.amount / (2.0 * np.pi * radius**2)
