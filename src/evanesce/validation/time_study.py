"""What a wrong clock, a long exposure, rows read one by one and few frames do to areas and to the onset of slip.

The finger of the scene is pressed to 1 N and slid until it slips as a whole; frames are taken five times as often as
the camera takes them, so that the camera's own phase against the slide can be moved.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce import rng
from evanesce.contact.solve import contact_sequence
from evanesce.fast import FastCamera
from evanesce.measurement.segment import Chain, segment
from evanesce.render.transport import render_fast
from evanesce.rig import Scene
from evanesce.simulate import photograph, simulate, touch
from evanesce.states import PlateLight
from evanesce.validation.perfect import PerfectView
from evanesce.validation.studies import Chart, Findings, Ledger, Listing, Panel, Part, Progress, Series
from evanesce.validation.study_scenes import check_studied

Floats = NDArray[np.float64]

FORCE = 1.0  # [N]
SPEEDS = (5.0, 25.0)  # [mm/s]
QUICK_SPEEDS = (25.0,)  # [mm/s]
DISTANCE = 10.0  # [mm]
FINE_HZ = 150.0
TRUE_HZ, BELIEVED_HZ = 30.0, 25.0
"""The camera is said to run at 30 Hz; the published scripts divide by 25."""

CHAIN = Chain(threshold=0.15)
LEVELS = (0.05, 0.15, 0.35)
SMEARS_MM = (0.0, 0.03, 0.15, 0.5, 0.825)
"""Way during an exposure: 5 mm/s for 6 ms, 25 for 6, 25 for 20, 25 for 33 ms."""

VELOCITIES = ((25.0, 0.0), (0.0, 25.0), (0.0, -25.0), (0.0, 5.0))  # [mm/s], image's right and down
HALF_MM = 7.5
PRESS_S, HOLD_S = 0.5, 0.1


def sliding(scene: Scene, speed: float) -> Scene:
    """Return a scene that presses to 1 N and slides at a speed [mm/s], sampled finely in time."""
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


def broken_line(time: Floats, way: Floats) -> tuple[float, float]:
    """Return when a point at rest begins to move, and its speed then, by least squares.

    Parameters
    ----------
    time, way : ndarray (n,)
        [s], [mm].

    Returns
    -------
    onset, speed : float
        [s], [mm/s] of way = rest + speed max(0, time - onset); NaN where fewer than two frames move.
    """
    best = (np.inf, float("nan"), float("nan"))
    for onset in np.linspace(time[0], time[-2], 20 * len(time)):
        basis = np.stack([np.ones_like(time), np.maximum(0.0, time - onset)], axis=1)
        if np.count_nonzero(basis[:, 1]) < 2:
            break
        found, *_ = np.linalg.lstsq(basis, way, rcond=None)
        misfit = float(((way - basis @ found) ** 2).sum())
        if found[1] > 0 and misfit < best[0]:
            best = (misfit, float(onset), float(found[1]))
    return best[1], best[2]


def smeared(light: PlateLight, way_px: float) -> PlateLight:
    """Return light that moved along the rows by a way [px] during the exposure, with its mean place unchanged."""
    if way_px <= 0:
        return light
    reach = int(np.ceil(way_px / 2 + 0.5))
    taps = np.arange(-reach, reach + 1)
    # the share of the way spent over each pixel
    box = np.clip(np.minimum(taps + 0.5, way_px / 2) - np.maximum(taps - 0.5, -way_px / 2), 0.0, None)
    kernel = (box / box.sum()).astype(np.float32)
    still = np.array([1.0], np.float32)
    spread = cv2.sepFilter2D(
        np.asarray(light.radiance, np.float32), cv2.CV_32F, kernel, still, borderType=cv2.BORDER_CONSTANT
    )
    return replace(light, radiance=spread)


def run(scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> Findings:
    """Do the study; see :class:`evanesce.validation.studies.Study`."""
    check_studied(scene)
    speeds = QUICK_SPEEDS if quick else SPEEDS
    ledger = Ledger(out / "time.jsonl", {"scene": scene.as_dict(), "seed": seed})
    view = PerfectView.of(scene)
    smooth = scene.model_copy(update={"finger": scene.finger.model_copy(update={"ridges": None})})
    jobs: list[tuple[str, Any]] = [(f"slide {v:g}", partial(_slide_row, view, smooth, v, seed)) for v in speeds]
    jobs += [("smear", partial(_smear_row, view, smooth, seed))]
    jobs += [(f"rows {x:g} {y:g}", partial(_rows_row, view, smooth, (x, y), seed)) for x, y in VELOCITIES]
    rows = {}
    for done, (key, make) in enumerate(jobs):
        progress("time: slides", done, len(jobs))
        rows[key] = ledger.row(key, make)
    progress("time: slides", len(jobs), len(jobs))
    return findings(rows, speeds)


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


def _smear_row(view: PerfectView, scene: Scene, seed: int) -> dict[str, Any]:
    """Return the area at each way during the exposure and level, the exposure's light unchanged [mm^2]."""
    rig, state = touch(scene, FORCE, seed=seed)
    assert state is not None  # a force was given
    light = render_fast(rig, state, seed=rng.integer_seed(seed, "render", 0))
    crop, areas = view.window(HALF_MM), []
    for way in SMEARS_MM:
        moved = smeared(light, way / view.mm2_per_px**0.5)
        image = view.straight(photograph(rig, moved, seed=seed)[1].data)
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
    readout_s = 22.75e-3
    height = scene.camera.resolution_px[1] * view.mm2_per_px**0.5
    return {
        "velocity_mm_per_s": velocity,
        "change": areas[1] / areas[0] - 1.0,
        # rows are read at height/readout; a patch that runs with them is seen for longer
        "expected": 1.0 / (1.0 - velocity[1] * readout_s / height) - 1.0,
    }


def onsets(row: Mapping[str, Any], rate: float, clock: float) -> list[float]:
    """Return the detected onset of slip at each phase of a camera, by a clock that believes in another rate [s].

    Parameters
    ----------
    row : mapping
        Of one slide.
    rate, clock : float
        True and believed frame rate [Hz]; time counts from the start of the slide.
    """
    step = round(FINE_HZ / rate)
    time = np.array(row["time_s"]) - row["slide_starts_s"]
    way = np.array([np.nan if v is None else v for v in row["x_mm"]], float)
    found = []
    for phase in range(step):
        some = np.isfinite(way[phase::step])
        onset, _ = broken_line(time[phase::step][some], way[phase::step][some])
        found.append(onset * rate / clock)
    return found


def findings(rows: Mapping[str, Mapping[str, Any]], speeds: Sequence[float]) -> Findings:
    """Return tables, chart and verdict."""
    lines, data, worst = [], [], []
    for speed in speeds:
        row = rows[f"slide {speed:g}"]
        truth = row["true_onset_s"] - row["slide_starts_s"]
        for rate, clock in ((FINE_HZ, FINE_HZ), (TRUE_HZ, TRUE_HZ), (BELIEVED_HZ, BELIEVED_HZ), (TRUE_HZ, BELIEVED_HZ)):
            found = np.array(onsets(row, rate, clock))
            off = found - truth
            lines.append(
                (
                    f"{speed:g}", f"{rate:g}", f"{clock:g}", f"{1e3 * truth:.0f}", f"{1e3 * found.mean():.0f}",
                    f"{1e3 * off.min():+.0f} to {1e3 * off.max():+.0f}", f"{speed * off.mean():+.2f}",
                )
            )  # fmt: skip
            data.append({"speed_mm_per_s": speed, "rate_hz": rate, "clock_hz": clock, "onset_s": found.tolist(),
                         "true_onset_s": truth})  # fmt: skip
            if (rate, clock) == (TRUE_HZ, TRUE_HZ):
                worst.append(float(np.abs(off).max()))
    smear, skews = rows["smear"], [rows[f"rows {x:g} {y:g}"] for x, y in VELOCITIES]
    at_rest = np.array(smear["area_mm2"][0])
    change = 100 * (np.array(smear["area_mm2"]) / at_rest - 1)
    verdict = [
        f"A clock of {BELIEVED_HZ:g} for {TRUE_HZ:g} Hz makes every time {TRUE_HZ / BELIEVED_HZ:.2f} times too long and"
        f" every rate {1 - BELIEVED_HZ / TRUE_HZ:.0%} too small; areas do not feel it.",
        f"With the right clock a camera of {TRUE_HZ:g} Hz finds the onset of slip to"
        f" {', '.join(f'{1e3 * w:.0f} ms at {v:g} mm/s' for v, w in zip(speeds, worst, strict=True))} at worst.",
        f"25 mm/s and 6 ms of exposure change the area by {change[2][1]:+.2f} % at a threshold of {LEVELS[1]:g}"
        f" and {change[2][2]:+.2f} % at {LEVELS[2]:g}; 33 ms by {change[4][1]:+.1f} and {change[4][2]:+.1f} %.",
        f"Rows read one by one change it by {100 * skews[1]['change']:+.2f} % at 25 mm/s down the image, and"
        f" {100 * skews[0]['change']:+.2f} % across.",
    ]
    return Findings(
        verdict=verdict,
        charts=[_chart(rows, speeds)],
        tables=[_onset_table(lines), _smear_table(smear, change), _rows_table(skews)],
        data={"onset": data, "smear": dict(smear), "rows": [dict(s) for s in skews]},
    )


def _chart(rows: Mapping[str, Mapping[str, Any]], speeds: Sequence[float]) -> Chart:
    panels = []
    for speed in speeds:
        row = rows[f"slide {speed:g}"]
        time = (np.array(row["time_s"]) - row["slide_starts_s"]).tolist()
        way = np.array([np.nan if v is None else v for v in row["x_mm"]], float)
        way = (way - way[0]).tolist()
        step = round(FINE_HZ / TRUE_HZ)
        true = row["true_onset_s"] - row["slide_starts_s"]
        panels.append(
            Panel(
                title=f"slide at {speed:g} mm/s",
                x_label="time since the slide began [s]",
                y_label="way of the patch [mm]",
                series=[
                    Series(label="150 Hz", x=time, y=way),
                    Series(label="30 Hz", x=time[::step], y=way[::step], points=True),
                    Series(
                        label="30 Hz read as 25",
                        x=[t * TRUE_HZ / BELIEVED_HZ for t in time[::step]],
                        y=way[::step],
                        points=True,
                    ),
                    Series(label="true onset", x=[true, true], y=[min(way), max(way)]),
                ],
            )
        )
    return Chart(
        panels=panels,
        caption="While the finger bends the patch moves by the shear of the tip alone, then it runs with the finger;"
        " the knee is the onset that the measurement sees. The shear before it pulls the knee to earlier times.",
    )


def _onset_table(lines: Sequence[Sequence[str]]) -> Listing:
    return Listing(
        columns=(
            "speed [mm/s]",
            "frames [Hz]",
            "clock [Hz]",
            "true onset [ms]",
            "detected, mean [ms]",
            "error [ms]",
            "mean error as way [mm]",
        ),
        rows=lines,
        caption="Onset of slip as a whole since the slide began, from the patch's centroid (chain at 0.15) by a line"
        " with one knee. The error spans the camera's phases against the slide.",
    )


def _smear_table(smear: Mapping[str, Any], change: Floats) -> Listing:
    return Listing(
        columns=("way during the exposure [mm]", *(f"area change at {t:g} [%]" for t in LEVELS)),
        rows=[
            (f"{way:g}", *(f"{c:+.2f}" for c in line))
            for way, line in zip(smear["way_mm"], change.tolist(), strict=True)
        ],
        caption="Smear along the slide with the light per frame unchanged; 25 mm/s for 6 ms is 0.15 mm.",
    )


def _rows_table(skews: Sequence[Mapping[str, Any]]) -> Listing:
    return Listing(
        columns=("velocity right, down [mm/s]", "area change [%]", "1/(1 - v/v rows) - 1 [%]"),
        rows=[
            (
                "{:g}, {:g}".format(*s["velocity_mm_per_s"]),
                f"{100 * s['change']:+.2f}",
                f"{100 * s['expected']:+.2f}",
            )
            for s in skews
        ],
        caption="Readout of 22.75 ms from the first row to the last (IMX477, 2028 x 1520 mode). Across the rows the"
        " patch is sheared, which keeps its area.",
    )


STUDY = Part("time", "Clock, exposure, rows and the onset of slip", 50, run)
