"""Findings and page of the estimator study: refined estimator beside reference segmentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from evanesce.report.charts import Chart, Panel, Series
from evanesce.report.html import Page, Table
from evanesce.rig import Scene
from evanesce.studies import page as report
from evanesce.studies.estimator.study import FORCES, VOLTAGES, EstimatorStudy, Row, run_study
from evanesce.studies.ledger import Ledger
from evanesce.studies.registry import Findings, Progress, Study
from evanesce.studies.scenes import Finger, check_studied

QUICK_VOLTAGES = (8.5, 12.0)  # [V]
GOALS = {"smooth": 0.5, "ridged": 2.0}
"""Greatest error wanted of the refined estimator [%]."""


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
    check_studied(scene)
    fingers = [Finger(scene.finger.material, ridged, scattering=False).on(scene) for ridged in (False, True)]
    ledger = Ledger(out / "estimator.jsonl", {"scene": scene.as_dict(), "seed": seed, "quick": quick})
    found = run_study(
        *fingers, voltages=QUICK_VOLTAGES if quick else VOLTAGES, forces=FORCES[:1] if quick else FORCES, seed=seed,
        keep=ledger.row, tick=partial(progress, "estimator: frames"),
    )  # fmt: skip
    return findings(found)


def findings(found: EstimatorStudy) -> Findings:
    """Return table, chart and verdict.

    Parameters
    ----------
    found : EstimatorStudy

    Returns
    -------
    Findings
    """
    worst = found.worst()
    held = [w for w in worst if abs(w["refined_worst_percent"]) <= _goal(w["finger"])]
    refined = max(worst, key=lambda w: abs(w["refined_worst_percent"]))
    reference = max(worst, key=lambda w: abs(w["reference_worst_percent"]))
    return Findings(
        verdict=[
            f"The refined estimator errs by at most {abs(refined['refined_worst_percent']):.2f} % ({refined['finger']},"
            f" {refined['place']}), the reference segmentation at a threshold of {found.threshold:g} by up to"
            f" {abs(reference['reference_worst_percent']):.0f} % ({reference['finger']}, {reference['place']}).",
            f"The goal (0.5 % smooth, 2 % ridged, every frame) is met in {len(held)} of {len(worst)} classes.",
        ],
        charts=[_chart(found.rows)],
        tables=[_table(worst)],
        data={"rows": [r for r in found.as_dict().get("rows", [])], "worst": worst},
    )


def _goal(finger: str) -> float:
    return GOALS["ridged" if "ridged" in finger else "smooth"]


def _table(worst: Sequence[Mapping[str, Any]]) -> Table:
    return Table(
        columns=("finger", "place", "frames", "refined RMS [%]", "refined worst [%]", "goal [%]", "reference RMS [%]",
                 "reference worst [%]"),
        rows=[
            (
                w["finger"], w["place"], str(w["frames"]), f"{w['refined_rms_percent']:.2f}",
                f"{w['refined_worst_percent']:+.2f}", f"{_goal(w['finger']):g}", f"{w['reference_rms_percent']:.1f}",
                f"{w['reference_worst_percent']:+.1f}",
            )
            for w in worst
        ],
        caption="Area error over voltages and forces. Cards without error of print and height, corners with their usual"
        " scatter: what is left is the boundary's error; the budget study draws the cards' errors as well.",
    )  # fmt: skip


def _chart(rows: Sequence[Row]) -> Chart:
    panels = []
    for place in dict.fromkeys(row.place for row in rows):
        series = []
        for finger in dict.fromkeys(row.finger for row in rows):
            some = [r for r in rows if (r.place, r.finger) == (place, finger)]
            volts = sorted({r.voltage_V for r in some})
            for who in ("refined", "reference"):
                errors = [[abs(getattr(r, f"{who}_percent")) for r in some if r.voltage_V == v] for v in volts]
                series.append(
                    Series(label=f"{finger}, {who}", x=volts, y=[max(max(e), 1e-3) for e in errors], group=finger)
                )
        panels.append(
            Panel(title=place, x_label="LED voltage [V]", y_label="worst area error over forces [%]", series=series,
                  log_y=True)
        )  # fmt: skip
    return Chart(
        panels=panels, caption="Solid the refined estimator, dashed the reference segmentation on the same frames."
    )


def page(study: EstimatorStudy) -> Page:
    """Return the report of ``evanesce study estimator``.

    Parameters
    ----------
    study : EstimatorStudy

    Returns
    -------
    Page
    """
    found = findings(study)
    lead = (
        "Area errors of both; neither sees the truth, only frames and a calibration. Subsurface scattering is the "
        "renderer's own model, whose inverse the refined estimator uses; on a real finger that part will be less exact."
    )
    frames = Table(
        columns=("finger", "place", "force [N]", "voltage [V]", "true [mm²]", "reference [%]", "refined [%]",
                 "saturated [1]"),
        rows=[
            (
                r.finger, r.place, f"{r.force_N:g}", f"{r.voltage_V:g}", f"{r.true_mm2:.3f}",
                f"{r.reference_percent:+.2f}", f"{r.refined_percent:+.2f}", f"{r.saturated_share:.2f}",
            )
            for r in study.rows
        ],
        caption="Area error of every frame.",
    )  # fmt: skip
    found = replace(found, tables=[*found.tables, frames])
    title = "The refined estimator beside the reference segmentation"
    return report.page(title, [(STUDY, found)], study.provenance, lead=lead)


STUDY = Study("estimator", "A refined estimator beside the reference segmentation", 20, run)
