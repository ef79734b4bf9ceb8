"""The uncertainty budget's coverage as a part of ``evanesce study all``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evanesce.rig import Scene
from evanesce.studies.budget.study import run_study
from evanesce.studies.registry import Chart, Findings, Ledger, Listing, Panel, Part, Progress, Series
from evanesce.studies.scenes import Finger, check_studied

MEASUREMENTS, QUICK_MEASUREMENTS = 1000, 100
WANTED = (0.93, 0.97)
"""Share of measurements whose 95 % interval should hold the truth."""


def run(scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> Findings:
    """Do the study; see :class:`evanesce.studies.registry.Study`."""
    check_studied(scene)
    count = QUICK_MEASUREMENTS if quick else MEASUREMENTS
    ledger = Ledger(out / "budget.jsonl", {"scene": scene.as_dict(), "seed": seed, "measurements": count})
    fingers = [Finger(scene.finger.material, ridged, glowing=False).on(scene) for ridged in (False, True)]

    def tick(what: str, done: int, total: int) -> None:
        progress(f"budget: {what}", done, total)

    found = run_study(*fingers, measurements=count, seed=seed, tick=tick, keep=ledger.row)
    return findings(found.as_dict()["classes"])


def findings(classes: Sequence[Mapping[str, Any]]) -> Findings:
    """Return table, chart and verdict."""
    inside = [c for c in classes if WANTED[0] <= c["refined_covered"] <= WANTED[1]]
    covered = [100 * c["refined_covered"] for c in classes]
    author = [100 * c["reference_covered"] for c in classes]
    return Findings(
        verdict=[
            f"The refined estimator's 95 % intervals hold the truth in {min(covered):.1f} to {max(covered):.1f} % of"
            f" {classes[0]['measurements']} measurements a class; {len(inside)} of {len(classes)} classes lie within"
            f" {100 * WANTED[0]:g} to {100 * WANTED[1]:g} %. The reference segmentation: {min(author):.1f} to"
            f" {max(author):.1f} %.",
            "3407 px/mm² says how finely the frame is divided; the interval says how well the area is known:"
            f" ±{min(c['refined_half_width_percent'] for c in classes):.2f} to"
            f" ±{max(c['refined_half_width_percent'] for c in classes):.2f} %.",
        ],
        charts=[_chart(classes)],
        tables=[
            _coverage_table(classes),
            _parts_table(classes, "contributions_percent", "refined area"),
            _parts_table(classes, "reference_contributions_percent", "area of the reference segmentation"),
        ],
        data={"classes": list(classes)},
    )


def _coverage_table(classes: Sequence[Mapping[str, Any]]) -> Listing:
    return Listing(
        columns=("finger", "place", "measurements", "refined holds [%]", "linear [%]", "half-width [%]", "bias [%]",
                 "author holds [%]", "half-width [%]", "bias [%]"),
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


def _parts_table(classes: Sequence[Mapping[str, Any]], key: str, what: str) -> Listing:
    names = list(dict.fromkeys(name for c in classes for name in c[key]))
    return Listing(
        columns=("component", *(f"{c['finger']}, {c['place']} [%]" for c in classes)),
        rows=[(name, *(f"{c[key].get(name, 0.0):.3f}" for c in classes)) for name in names],
        caption=f"Standard uncertainty of the {what} from each component, median.",
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


STUDY = Part("budget", "How well is an area known?", 30, run)
