"""Effect of a wrong clock, a long exposure, a rolling shutter and few frames on areas and on the onset of slip.

The finger of the scene is pressed to 1 N and slid until it slips as a whole; frames are taken five times as often as
the camera takes them, so that the camera's own phase against the slide can be moved.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.chain.fast import FastCamera
from evanesce.chain.simulate import expose, simulate, solve_contact
from evanesce.contact.solve import contact_sequence
from evanesce.core import rng
from evanesce.core.states import PlateLight
from evanesce.evaluation.perfect_view import PerfectView
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene
from evanesce.studies.ledger import Ledger
from evanesce.studies.registry import Progress
from evanesce.studies.scenes import check_studied
from evanesce.studies.time.area import EXPOSED_SPEED, FINE_HZ, LEVELS, READOUT_S, TRUE_HZ, film_row

Floats = NDArray[np.float64]

FORCE = 1.0  # [N]
SPEEDS = (5.0, 25.0)  # [mm/s]
QUICK_SPEEDS = (25.0,)  # [mm/s]
DISTANCE = 10.0  # [mm]
CHAIN = Chain(threshold=0.15)
SMEARS_MM = (0.0, 0.03, 0.15, 0.5, 0.825)
"""Displacement during an exposure: 5 mm/s for 6 ms, 25 for 6, 25 for 20, 25 for 33 ms."""

VELOCITIES = ((25.0, 0.0), (0.0, 25.0), (0.0, -25.0), (0.0, 5.0))  # [mm/s], image's right and down
HALF_MM = 7.5
PRESS_S, HOLD_S = 0.5, 0.1


def sliding(scene: Scene, speed: float) -> Scene:
    """Return a scene that presses to 1 N and slides at a speed [mm/s], sampled finely in time.

    Parameters
    ----------
    scene : Scene
    speed : float
        [mm/s].

    Returns
    -------
    Scene
    """
    x, y = scene.finger.position_mm
    data = scene.as_dict() | {
        "press": {"forces_N": [FORCE], "frame_rate_hz": FINE_HZ},
        "slide": {
            "speed_mm_per_s": speed, "distance_mm": DISTANCE, "friction_coefficient": 0.67,
            "press_time_s": PRESS_S, "hold_time_s": HOLD_S,
        },
        "assumptions": {}, "sources": {},
    }  # fmt: skip
    data["finger"] = {k: v for k, v in data["finger"].items() if k != "ridges"} | {"position_mm": [x - 1.5, y]}
    return Scene.model_validate_json(json.dumps(data))


def smeared(light: PlateLight, way_px: float) -> PlateLight:
    """Return light displaced along the rows during the exposure, its mean position unchanged.

    Parameters
    ----------
    light : PlateLight
    way_px : float
        Displacement during the exposure [px].

    Returns
    -------
    PlateLight
    """
    if way_px <= 0:
        return light
    reach = int(np.ceil(way_px / 2 + 0.5))
    taps = np.arange(-reach, reach + 1)
    # the share of the displacement over each pixel
    box = np.clip(np.minimum(taps + 0.5, way_px / 2) - np.maximum(taps - 0.5, -way_px / 2), 0.0, None)
    kernel = (box / box.sum()).astype(np.float32)
    still = np.array([1.0], np.float32)
    spread = cv2.sepFilter2D(
        np.asarray(light.radiance, np.float32), cv2.CV_32F, kernel, still, borderType=cv2.BORDER_CONSTANT
    )
    return replace(light, radiance=spread)


def compute(
    scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1
) -> tuple[dict[str, dict[str, Any]], tuple[float, ...]]:
    """Measure slides, a press, smeared frames and frames with a rolling shutter.

    Parameters
    ----------
    scene, out, progress, quick, seed
        See :meth:`evanesce.studies.registry.Study.run`.

    Returns
    -------
    rows : dict
        Results by what was measured: ``slide 25``, ``press``, ``exposed``, ``smear``, ``rows 25 0`` ...
    speeds : tuple of float
        Of the slides [mm/s].
    """
    check_studied(scene)
    speeds = QUICK_SPEEDS if quick else SPEEDS
    ledger = Ledger(out / "time.jsonl", {"scene": scene.as_dict(), "seed": seed})
    view = PerfectView.of(scene)
    smooth = scene.model_copy(update={"finger": scene.finger.model_copy(update={"ridges": None})})
    jobs: list[tuple[str, Any]] = [(f"slide {v:g}", partial(_slide_row, view, smooth, v, seed)) for v in speeds]
    jobs += [("press", partial(_press_row, view, smooth, seed)), ("exposed", partial(_exposed_row, view, smooth, seed))]
    jobs += [("smear", partial(_smear_row, view, smooth, seed))]
    jobs += [(f"rows {x:g} {y:g}", partial(_rows_row, view, smooth, (x, y), seed)) for x, y in VELOCITIES]
    rows: dict[str, dict[str, Any]] = {}
    for done, (key, make) in enumerate(jobs):
        progress("time: slides", done, len(jobs))
        rows[key] = ledger.row(key, make)
    progress("time: slides", len(jobs), len(jobs))
    return rows, speeds


def _slide_row(view: PerfectView, scene: Scene, speed: float, seed: int) -> dict[str, Any]:
    """Return time, place and area of the patch as measured, and when it truly begins to slip as a whole."""
    moving = sliding(scene, speed)
    states, camera = contact_sequence(moving), FastCamera(moving)
    crop = view.window(HALF_MM)
    start = int((PRESS_S + HOLD_S) * FINE_HZ) + 1
    onset = _true_onset(moving, start)
    found: dict[str, list[float]] = {"time_s": [], "x_mm": [], "area_mm2": [], "true_area_mm2": []}
    # the finger bends for most of the slide; a frame before the slip is like the next
    first = max(start, int((onset - 8 / TRUE_HZ) * FINE_HZ)) if np.isfinite(onset) else start
    for i in range(first, len(states)):
        state = states[i]
        image = view.straight(camera.frame(state, seed=seed, index=i, time_s=state.time).data)
        result = segment(image, replace(CHAIN, crop=crop))
        columns = np.flatnonzero(result.mask.any(axis=0))
        weights = result.mask.sum(axis=0)[columns] if columns.size else np.ones(1)
        place = float((columns * weights).sum() / weights.sum()) if columns.size else float("nan")
        found["time_s"].append(float(state.time))
        found["x_mm"].append(place * view.mm2_per_px**0.5)
        found["area_mm2"].append(result.pixels * view.mm2_per_px)
        found["true_area_mm2"].append(state.nominal_contact_area)
    return found | {"true_onset_s": onset, "slide_starts_s": PRESS_S + HOLD_S}


def _true_onset(moving: Scene, start: int) -> float:
    """Return the middle between the last frame in which some of the contact sticks and the next [s]; NaN without."""
    # when it slips does not depend on the grid on which it is looked at
    coarse = moving.model_copy(update={"grid": moving.grid.model_copy(update={"samples": 64})})
    states = contact_sequence(coarse)
    for i in range(start, len(states)):
        if float(states[i].parameters["stick_ratio"]) <= 0.0:
            return float(states[i].time) - 0.5 / FINE_HZ if i > start else float("nan")
    return float("nan")


def _press_row(view: PerfectView, scene: Scene, seed: int) -> dict[str, Any]:
    """Return the area over time of the press to 1 N, by each exposure and way of reading rows."""
    moving = sliding(scene, EXPOSED_SPEED)
    states = contact_sequence(moving)[: int(PRESS_S * FINE_HZ) + 1]
    return film_row(view, moving, states, CHAIN, HALF_MM, seed)


def _exposed_row(view: PerfectView, scene: Scene, seed: int) -> dict[str, Any]:
    """Return the same of a slide, from its start to its end."""
    moving = sliding(scene, EXPOSED_SPEED)
    start = int((PRESS_S + HOLD_S) * FINE_HZ) + 1
    found = film_row(view, moving, contact_sequence(moving)[start - 2 :], CHAIN, HALF_MM, seed)
    return found | {"slide_starts_s": PRESS_S + HOLD_S, "true_onset_s": _true_onset(moving, start)}


def _smear_row(view: PerfectView, scene: Scene, seed: int) -> dict[str, Any]:
    """Return the area by displacement during the exposure and threshold, at unchanged light [mm^2]."""
    rig, state = solve_contact(scene, FORCE, seed=seed)
    assert state is not None  # a force was given
    light = render_fast(rig, state, seed=rng.integer_seed(seed, "render", 0))
    crop, areas = view.window(HALF_MM), []
    for way in SMEARS_MM:
        moved = smeared(light, way / view.mm2_per_px**0.5)
        image = view.straight(expose(rig, moved, seed=seed)[1].data)
        areas.append([segment(image, Chain(threshold=t, crop=crop)).pixels * view.mm2_per_px for t in LEVELS])
    return {"way_mm": SMEARS_MM, "area_mm2": areas, "true_area_mm2": state.nominal_contact_area}


def _rows_row(view: PerfectView, scene: Scene, velocity: tuple[float, float], seed: int) -> dict[str, Any]:
    """Return the area of a patch that moves while its rows are read, over that of one at rest."""
    areas = []
    for x, y in ((0.0, 0.0), velocity):
        effect = {"rolling_skew": {"velocity_x_mm_per_s": x, "velocity_y_mm_per_s": y}}
        moving = scene.model_copy(update={"effects": effect})
        image = view.straight(simulate(moving, FORCE, seed=seed, render=render_fast).frame.data)
        areas.append(segment(image, replace(CHAIN, crop=view.window(HALF_MM))).pixels * view.mm2_per_px)
    height = scene.camera.resolution_px[1] * view.mm2_per_px**0.5
    return {
        "velocity_mm_per_s": velocity,
        "change": areas[1] / areas[0] - 1.0,
        # rows are read at height/readout; a patch that runs with them is seen for longer
        "expected": 1.0 / (1.0 - velocity[1] * READOUT_S / height) - 1.0,
    }
