"""Findings of the time study: charts, tables and verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.report.charts import Chart, Panel, Series
from evanesce.report.html import Table
from evanesce.rig import Scene
from evanesce.studies.registry import Findings, Progress, Study
from evanesce.studies.time.area import (
    ASSUMED_HZ,
    DROPPED,
    EXPOSED_SPEED,
    FINE_HZ,
    JITTER_S,
    LEVELS,
    MERGED,
    OFF_MM,
    TRUE_HZ,
    onsets,
    reading_errors,
    stamped,
)
from evanesce.studies.time.study import compute

Floats = NDArray[np.float64]

CAMERAS: tuple[tuple[str, dict[str, float]], ...] = (
    ("150 Hz", {"rate": FINE_HZ, "clock": FINE_HZ}),
    ("30 Hz", {"rate": TRUE_HZ, "clock": TRUE_HZ}),
    ("25 Hz", {"rate": ASSUMED_HZ, "clock": ASSUMED_HZ}),
    ("30 Hz read as 25", {"rate": TRUE_HZ, "clock": ASSUMED_HZ}),
    (f"30 Hz, stamps jitter by {1e3 * JITTER_S:g} ms", {"rate": TRUE_HZ, "clock": TRUE_HZ, "jitter_s": JITTER_S}),
    (f"30 Hz, {DROPPED:.0%} of frames lost unnoticed", {"rate": TRUE_HZ, "clock": TRUE_HZ, "dropped": DROPPED}),
)
"""Cameras and clocks."""

SEEN = {
    **{name: f"30 Hz, {name} of exposure" for name in MERGED if name != "6 ms"},
    "rows": "30 Hz, rolling rows",
    "rows, above": f"30 Hz, rolling rows, {OFF_MM:g} mm higher in the frame",
    "rows, below": f"30 Hz, rolling rows, {OFF_MM:g} mm lower in the frame",
}
"""Exposures and ways of reading rows, beside an exposure of 6 ms with all rows at once."""

RIGHT, SHORT = "30 Hz", "30 Hz, 6 ms of exposure"


def findings(rows: Mapping[str, Mapping[str, Any]], speeds: Sequence[float], seed: int = 1) -> Findings:
    """Return tables, charts and verdict.

    Parameters
    ----------
    rows, speeds
        Of :func:`evanesce.studies.time.study.compute`.
    seed : int
        Of jitter and lost frames.

    Returns
    -------
    Findings
    """
    read, slips = read_areas(rows["press"], seed), slip_onsets(rows, speeds, seed)
    smear, skews = rows["smear"], [row for key, row in rows.items() if key.startswith("rows ")]
    at_rest = np.array(smear["area_mm2"][0])
    change = 100 * (np.array(smear["area_mm2"]) / at_rest - 1)
    worst = {(one["camera"], one["speed_mm_per_s"]): float(np.abs(one["error_ms"]).max()) for one in slips}
    by_name = {one["camera"]: one for one in read}
    verdict = [
        f"A clock of {ASSUMED_HZ:g} for {TRUE_HZ:g} Hz makes every time {TRUE_HZ / ASSUMED_HZ:.2f} times too long and"
        f" every rate {1 - ASSUMED_HZ / TRUE_HZ:.0%} too small; no area changes, but the area that the film gives for"
        f" a time of the press is wrong by up to {_greatest(by_name['30 Hz read as 25']):.1f} mm².",
        f"With the right clock a camera of {TRUE_HZ:g} Hz finds the onset of slip to"
        f" {', '.join(f'{worst[RIGHT, v]:.0f} ms at {v:g} mm/s' for v in speeds)} at worst.",
        f"25 mm/s and 6 ms of exposure change the area by {change[2][1]:+.2f} % at a threshold of {LEVELS[1]:g}"
        f" and {change[2][2]:+.2f} % at {LEVELS[2]:g}; 33 ms by {change[4][1]:+.1f} and {change[4][2]:+.1f} %.",
        _onset_sentence(slips),
        f"Rows read one by one change the area by {100 * skews[1]['change']:+.2f} % at 25 mm/s down the image, and"
        f" {100 * skews[0]['change']:+.2f} % across.",
    ]
    return Findings(
        verdict=verdict,
        charts=[_chart(rows, speeds), _area_chart(rows)],
        tables=[_onset_table(slips), _read_table(read), _smear_table(smear, change), _rows_table(skews)],
        data={"onset": slips, "area_read": read, "smear": dict(smear), "rows": [dict(s) for s in skews]},
    )


def _greatest(read: Mapping[str, Any]) -> float:
    return float(max(np.abs(read["error_mm2"])))


def _onset_sentence(slips: Sequence[Mapping[str, Any]]) -> str:
    usual = next(np.mean(s["error_ms"]) for s in slips if s["camera"] == SHORT)
    moved = {s["camera"]: float(np.mean(s["error_ms"]) - usual) for s in slips}
    exposed, rolling, above, below = (moved[SEEN[key]] for key in ("33 ms", "rows", "rows, above", "rows, below"))
    return (
        f"The onset of slip at {EXPOSED_SPEED:g} mm/s moves by {exposed:+.1f} ms with 33 ms of exposure for 6 (stamps"
        f" mid-exposure), by {rolling:+.1f} ms with rolling rows, and by {above:+.1f} and {below:+.1f} ms if the patch"
        f" lies {OFF_MM:g} mm higher and lower in the frame."
    )


def slip_onsets(rows: Mapping[str, Mapping[str, Any]], speeds: Sequence[float], seed: int) -> list[dict[str, Any]]:
    """Return true and detected onset of slip of each slide, by every camera, clock, exposure and way of reading.

    Parameters
    ----------
    rows, speeds, seed
        As for :func:`findings`.

    Returns
    -------
    list of dict
        Units in the keys.
    """
    cases = [(speed, name, rows[f"slide {speed:g}"], how) for speed in speeds for name, how in CAMERAS]
    exposed, plain = rows["exposed"], dict(CAMERAS)[RIGHT]
    for key, name in (("6 ms", SHORT), *SEEN.items()):
        row: Mapping[str, Any] = {**exposed, "x_mm": exposed["seen"][key]["x_mm"]}
        cases.append((EXPOSED_SPEED, name, row, plain))
    found = []
    for speed, name, row, how in cases:
        truth = row["true_onset_s"] - row["slide_starts_s"]
        seen = np.array(onsets(row, how["rate"], how["clock"], jitter_s=how.get("jitter_s", 0.0),
                               dropped=how.get("dropped", 0.0), seed=seed))  # fmt: skip
        found.append({"speed_mm_per_s": speed, "camera": name, "true_onset_s": truth, "onset_s": seen.tolist(),
                      "error_ms": (1e3 * (seen - truth)).tolist()})  # fmt: skip
    return found


def read_areas(press: Mapping[str, Any], seed: int) -> list[dict[str, Any]]:
    """Return the error of the area at a stated time of the press, and its growth, by camera and way of reading.

    Parameters
    ----------
    press : mapping
        Of :func:`evanesce.studies.time.area.film_row`.
    seed : int

    Returns
    -------
    list of dict
        Units in the keys.
    """
    cases = [(name, "6 ms", how) for name, how in CAMERAS]
    cases += [(name, key, dict(CAMERAS)[RIGHT]) for key, name in SEEN.items()]
    found = []
    for name, seen, how in cases:
        error, growth = reading_errors(press, seen, seed=seed, rate=how["rate"], clock=how["clock"],
                                       jitter_s=how.get("jitter_s", 0.0), dropped=how.get("dropped", 0.0))  # fmt: skip
        found.append({"camera": name, "error_mm2": [float(error.min()), float(error.max())],
                      "rms_mm2": float(np.sqrt((error**2).mean())),
                      "growth": [float(growth.min()), float(growth.max())]})  # fmt: skip
    return found


def _area_chart(rows: Mapping[str, Mapping[str, Any]]) -> Chart:
    press, slide = rows["press"], rows["exposed"]
    time, area = np.array(press["time_s"]), np.array(press["seen"]["6 ms"]["area_mm2"])
    step = round(FINE_HZ / TRUE_HZ)
    lost, late = stamped(time[::step], TRUE_HZ, np.random.default_rng(3), dropped=0.2)
    left = [
        Series(label="true", x=time.tolist(), y=press["true_area_mm2"]),
        Series(label="30 Hz", x=time[::step].tolist(), y=area[::step].tolist(), points=True),
        Series(label="30 Hz read as 25", x=(time[::step] * TRUE_HZ / ASSUMED_HZ).tolist(), y=area[::step].tolist(),
               points=True),
        Series(label="30 Hz, a fifth of the frames lost unnoticed", x=late.tolist(), y=area[::step][lost].tolist(),
               points=True),
    ]  # fmt: skip
    since = (np.array(slide["time_s"]) - slide["slide_starts_s"]).tolist()
    onset = slide["true_onset_s"] - slide["slide_starts_s"]
    right = [Series(label="true", x=since, y=slide["true_area_mm2"])]
    right += [Series(label=f"{name} of exposure", x=since, y=slide["seen"][name]["area_mm2"]) for name in MERGED]
    right.append(
        Series(label="rolling rows", x=since[::step], y=slide["seen"]["rows"]["area_mm2"][::step], points=True)
    )
    ends = [a for s in right for a in s.y if a is not None]
    right.append(Series(label="true onset of slip", x=[onset, onset], y=[min(ends), max(ends)]))
    return Chart(
        panels=[
            Panel(title="press to 1 N", x_label="time since the press began, as read [s]", y_label="contact area [mm²]",
                  series=left),
            Panel(title=f"slide at {EXPOSED_SPEED:g} mm/s", x_label="time since the slide began [s]",
                  y_label="contact area [mm²]", series=right),
        ],
        caption="A slow clock stretches the press, and frames lost unnoticed squeeze it: at a stated time the area is"
        " another one. A long exposure leaves the area alone until the patch slips; then it smears, and the slip looks"
        " like a growing contact. Rolling rows along the slide change nothing.",
    )  # fmt: skip


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
                y_label="displacement of the patch [mm]",
                series=[
                    Series(label="150 Hz", x=time, y=way),
                    Series(label="30 Hz", x=time[::step], y=way[::step], points=True),
                    Series(
                        label="30 Hz read as 25",
                        x=[t * TRUE_HZ / ASSUMED_HZ for t in time[::step]],
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


def _span(values: Sequence[float], form: str) -> str:
    return f"{min(values):{form}} to {max(values):{form}}"


def _onset_table(slips: Sequence[Mapping[str, Any]]) -> Table:
    return Table(
        columns=(
            "speed [mm/s]",
            "camera",
            "true onset [ms]",
            "detected, mean [ms]",
            "error [ms]",
            "mean error as displacement [mm]",
        ),
        rows=[
            (
                f"{s['speed_mm_per_s']:g}", s["camera"], f"{1e3 * s['true_onset_s']:.0f}",
                f"{1e3 * np.mean(s['onset_s']):.0f}", _span(s["error_ms"], "+.0f"),
                f"{1e-3 * s['speed_mm_per_s'] * np.mean(s['error_ms']):+.2f}",
            )
            for s in slips
        ],
        caption="Onset of slip as a whole since the slide began, from the patch's centroid (chain at 0.15) by a line"
        " with one knee. The error spans the camera's phases against the slide, and draws of stamps where these vary."
        " Stamps are mid-exposure and those of the frame's middle row: stamped at its beginning, an exposure makes"
        " everything half its length earlier.",
    )  # fmt: skip


def _read_table(read: Sequence[Mapping[str, Any]]) -> Table:
    return Table(
        columns=("camera", "error of the area at its stated time [mm²]", "RMS [mm²]", "growth as read over true [1]"),
        rows=[
            (r["camera"], _span(r["error_mm2"], "+.2f"), f"{r['rms_mm2']:.2f}", _span(r["growth"], ".3f")) for r in read
        ],
        caption="Press to 1 N in half a second: area as read at a stated time, less what a short exposure and a right"
        " clock give for it (beyond the press its last area); growth is the slope of area over time by least squares.",
    )


def _smear_table(smear: Mapping[str, Any], change: Floats) -> Table:
    return Table(
        columns=("displacement during the exposure [mm]", *(f"area change at {t:g} [%]" for t in LEVELS)),
        rows=[
            (f"{way:g}", *(f"{c:+.2f}" for c in line))
            for way, line in zip(smear["way_mm"], change.tolist(), strict=True)
        ],
        caption="Smear along the slide with the light per frame unchanged; 25 mm/s for 6 ms is 0.15 mm.",
    )


def _rows_table(skews: Sequence[Mapping[str, Any]]) -> Table:
    return Table(
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


def run(scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> Findings:
    """Compute the study and return its findings.

    Parameters
    ----------
    scene, out, progress, quick, seed
        As for :meth:`evanesce.studies.registry.Study.run`.

    Returns
    -------
    Findings
    """
    return findings(*compute(scene, out, progress, quick=quick, seed=seed), seed)


STUDY = Study("time", "Clock, exposure, rows and the onset of slip", 50, run)
