"""Findings and page of the budget study: coverage of the stated intervals, and their components."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evanesce.report.charts import Chart, Panel, Series
from evanesce.report.html import Page, Table
from evanesce.rig import Scene
from evanesce.studies import page as report
from evanesce.studies.budget.study import BudgetStudy, run_study
from evanesce.studies.ledger import Ledger
from evanesce.studies.registry import Findings, Progress, Study
from evanesce.studies.scenes import Finger, check_studied

MEASUREMENTS, QUICK_MEASUREMENTS = 1000, 100
WANTED = (0.93, 0.97)
"""Share of measurements whose 95 % interval should hold the truth."""

FACTOR_PARTS = (
    "card print", "card height", "lens distance", "scale fit", "threshold on the card", "scale over the view",
)  # fmt: skip
"""Components that the conversion factor owes its uncertainty to; the others are the contact's boundary."""


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
    count = QUICK_MEASUREMENTS if quick else MEASUREMENTS
    ledger = Ledger(out / "budget.jsonl", {"scene": scene.as_dict(), "seed": seed, "measurements": count})
    fingers = [Finger(scene.finger.material, ridged, scattering=False).on(scene) for ridged in (False, True)]

    def tick(what: str, done: int, total: int) -> None:
        progress(f"budget: {what}", done, total)

    found = run_study(*fingers, measurements=count, seed=seed, tick=tick, keep=ledger.row)
    return findings(found.as_dict()["classes"])


def findings(classes: Sequence[Mapping[str, Any]]) -> Findings:
    """Return table, chart and verdict.

    Parameters
    ----------
    classes : sequence of mapping
        Of :meth:`~evanesce.studies.budget.study.BudgetStudy.as_dict`.

    Returns
    -------
    Findings
    """
    inside = [c for c in classes if WANTED[0] <= c["refined_covered"] <= WANTED[1]]
    covered = [100 * c["refined_covered"] for c in classes]
    reference = [100 * c["reference_covered"] for c in classes]
    return Findings(
        verdict=[
            f"The refined estimator's 95 % intervals hold the truth in {min(covered):.1f} to {max(covered):.1f} % of"
            f" {classes[0]['measurements']} measurements a class; {len(inside)} of {len(classes)} classes lie within"
            f" {100 * WANTED[0]:g} to {100 * WANTED[1]:g} %. The reference segmentation: {min(reference):.1f} to"
            f" {max(reference):.1f} %.",
            "3407 px/mm² says how finely the frame is divided; the interval says how well the area is known:"
            f" ±{min(c['refined_half_width_percent'] for c in classes):.2f} to"
            f" ±{max(c['refined_half_width_percent'] for c in classes):.2f} %.",
        ],
        charts=[_chart(classes)],
        tables=[
            _coverage_table(classes),
            _parts_table(classes, "contributions_percent", "refined area"),
            _parts_table(classes, "reference_contributions_percent", "area of the reference segmentation"),
            _factor_table(classes),
        ],
        data={"classes": list(classes)},
    )


def _coverage_table(classes: Sequence[Mapping[str, Any]]) -> Table:
    return Table(
        columns=("finger", "place", "measurements", "refined covered [%]", "linear [%]", "half-width [%]", "bias [%]",
                 "reference covered [%]", "half-width [%]", "bias [%]"),
        rows=[
            (
                c["finger"], c["place"], str(c["measurements"]), f"{100 * c['refined_covered']:.1f}",
                f"{100 * c['refined_linear_covered']:.1f}", f"{c['refined_half_width_percent']:.2f}",
                f"{c['refined_bias_percent']:+.2f}", f"{100 * c['reference_covered']:.1f}",
                f"{c['reference_half_width_percent']:.2f}", f"{c['reference_bias_percent']:+.2f}",
            )
            for c in classes
        ],
        caption="Share of simulated measurements whose 95 % interval holds the truth: cards and corners drawn"
        " anew, from the distributions that the budget assumes, and one of a class's frames. Intervals by Monte Carlo"
        " (JCGM 101); the linear ones (GUM) beside them.",
    )  # fmt: skip


def _parts_table(classes: Sequence[Mapping[str, Any]], key: str, what: str) -> Table:
    names = list(dict.fromkeys(name for c in classes for name in c[key]))
    return Table(
        columns=("component", *(f"{c['finger']}, {c['place']} [%]" for c in classes)),
        rows=[(name, *(f"{c[key].get(name, 0.0):.3f}" for c in classes)) for name in names],
        caption=f"Standard uncertainty of the {what} from each component, median.",
    )


def _factor_table(classes: Sequence[Mapping[str, Any]]) -> Table:
    """Return the root sum of squares of the components that enter the conversion factor."""
    rows = []
    for what, key in (("refined", "contributions_percent"), ("reference", "reference_contributions_percent")):
        shares = [sum(c[key].get(name, 0.0) ** 2 for name in FACTOR_PARTS) ** 0.5 for c in classes]
        rows.append((what, *(f"{share:.3f}" for share in shares)))
    return Table(
        columns=("area", *(f"{c['finger']}, {c['place']} [%]" for c in classes)),
        rows=rows,
        caption=f"Standard uncertainty of the conversion factor (mm² per pixel): {', '.join(FACTOR_PARTS)}.",
    )


def _chart(classes: Sequence[Mapping[str, Any]]) -> Chart:
    panels = []
    for title, key in (
        ("refined", "contributions_percent"),
        ("reference segmentation", "reference_contributions_percent"),
    ):
        names = list(dict.fromkeys(name for c in classes for name in c[key]))
        series = [
            Series(
                # side by side, since most components are the same in every class
                label=f"{c['finger']}, {c['place']}",
                x=[1 + i + 0.12 * (k - (len(classes) - 1) / 2) for i in range(len(names))],
                y=[max(c[key].get(name, 0.0), 1e-4) for name in names], points=True,
            )
            for k, c in enumerate(classes)
        ]  # fmt: skip
        panels.append(
            Panel(title=title, x_label="", y_label="standard uncertainty of the area [%]", series=series, log_y=True,
                  x_names=names)
        )  # fmt: skip
    return Chart(
        panels=panels, caption="What an area's uncertainty is made of, median over the measurements of a class."
    )


def page(study: BudgetStudy) -> Page:
    """Return the report of ``evanesce study budget``.

    Parameters
    ----------
    study : BudgetStudy

    Returns
    -------
    Page
    """
    lead = (
        "Cards and corners are drawn anew for each measurement, and one of each class's "
        f"{study.classes[0].frames} frames; the interval must hold the truth. Print, height and edges of the cards are "
        "drawn from the distributions that the budget assumes: this tests the propagation and the estimators, not what "
        "is assumed of cards."
    )
    found = findings(study.as_dict()["classes"])
    return report.page("Uncertainty of an area", [(STUDY, found)], study.provenance, lead=lead)


STUDY = Study("budget", "How well is an area known?", 30, run)
