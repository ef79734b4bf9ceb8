"""``evanesce study estimator``: the refined estimator beside the reference segmentation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    console,
    handles_errors,
    out_dir,
    progress,
    write_json,
)
from evanesce.cli.study_voltage import parse_forces
from evanesce.core.errors import InputError

if TYPE_CHECKING:
    from evanesce.studies.estimator.study import EstimatorStudy


def register(group: typer.Typer) -> None:
    """Add the command to the group of studies."""

    @group.command()
    @handles_errors
    def estimator(
        smooth: Annotated[str, typer.Argument(help="Scene with a smooth finger.")] = "thesis",
        ridged: Annotated[str, typer.Argument(help="Scene with a ridged finger on the same rig.")] = "thesis_ridged",
        volts: Annotated[str, typer.Option("--volts", help="LED voltages [V], separated by commas.")] = "8,9,10,12",
        forces: Annotated[str, typer.Option("--forces", help="Normal forces [N], separated by commas.")] = "1,3",
        threshold: Annotated[float, typer.Option("--threshold", help="Of the reference segmentation, 0 to 1.")] = 0.15,
        seed: Annotated[int, typer.Option("--seed", min=0)] = 1,
        json_file: JsonOption = None,
        out: OutOption = None,
    ) -> None:
        """Area error of both estimators by voltage: smooth and ridged, clear and scattering, centre and corner.

        An interrupted run resumes from the rows in its output folder.
        """
        check_json_target(json_file)
        voltages, loads = parse_volts(volts), parse_forces(forces)
        if not 0 < threshold < 1:
            raise InputError(f"{threshold:g}", key="--threshold", allowed="above 0, below 1")
        from evanesce.report.html import write
        from evanesce.rig import load_scene
        from evanesce.studies.estimator.page import page
        from evanesce.studies.estimator.study import run_study
        from evanesce.studies.ledger import Ledger

        scenes = load_scene(smooth), load_scene(ridged)
        folder = out_dir(out, "study-estimator")
        ledger = Ledger(folder / "rows.jsonl", [[s.as_dict() for s in scenes], voltages, loads, threshold, seed])
        with progress() as bar:
            task = bar.add_task("frames", total=None)
            found = run_study(
                *scenes, voltages=voltages, forces=loads, threshold=threshold, seed=seed, keep=ledger.row,
                tick=lambda done, total: bar.update(task, completed=done, total=total),
            )  # fmt: skip
        report = write(folder / "report.html", page(found))
        write_json(folder / "result.json", found.as_dict())
        write_json(json_file, found.as_dict())
        _show(found)
        console.print(f"Report: {report}", highlight=False, soft_wrap=True)


def parse_volts(text: str) -> tuple[float, ...]:
    """Read voltages [V], separated by commas."""
    allowed = "1 to 50 different voltages from 5 to 24 V, e.g. 8,9,12"
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"{text!r}", key="--volts", allowed=allowed) from None
    if len(set(found)) != len(found) or len(found) > 50 or not all(5 <= v <= 24 for v in found):
        raise InputError(f"{text!r}", key="--volts", allowed=allowed)
    return found


def _show(found: EstimatorStudy) -> None:
    table = Table(title=f"Area error [%] over voltages and forces; threshold of the reference {found.threshold:g}")
    for heading in ("finger", "position", "frames", "refined RMS", "refined worst", "reference RMS", "reference worst"):
        table.add_column(heading, justify="left" if heading in ("finger", "position") else "right")
    for w in found.worst():
        table.add_row(
            w["finger"], w["place"], str(w["frames"]), f"{w['refined_rms_percent']:.2f}",
            f"{w['refined_worst_percent']:+.2f}", f"{w['reference_rms_percent']:.1f}",
            f"{w['reference_worst_percent']:+.1f}",
        )  # fmt: skip
    console.print(table)
