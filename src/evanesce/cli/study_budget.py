"""``evanesce study budget``: coverage of the stated intervals of an area."""

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
from evanesce.cli.study_estimator import parse_volts
from evanesce.core.errors import InputError

if TYPE_CHECKING:
    from evanesce.studies.budget.study import BudgetStudy


def register(group: typer.Typer) -> None:
    """Add the command to the group of studies."""
    group.command()(handles_errors(budget))


def budget(
    smooth: Annotated[str, typer.Argument(help="Scene with a smooth finger.")] = "thesis",
    ridged: Annotated[str, typer.Argument(help="Scene with a ridged finger on the same rig.")] = "thesis_ridged",
    measurements: Annotated[int, typer.Option("--measurements", help="Simulated measurements per class.")] = 1000,
    volts: Annotated[
        str, typer.Option("--volts", help="LED voltages of the frames [V], separated by commas.")
    ] = "8.4,9.7",
    fingers: Annotated[
        str,
        typer.Option("--fingers", help="Names, separated by semicolons: smooth; ridged; smooth, scattering ..."),
    ] = "smooth; ridged",
    threshold: Annotated[float, typer.Option("--threshold", help="Of the reference segmentation, 0 to 1.")] = 0.15,
    seed: Annotated[int, typer.Option("--seed", min=0)] = 1,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Uncertainty of an area, and coverage of its intervals over simulated measurements.

    An interrupted run resumes from its output folder.
    """
    check_json_target(json_file)
    if not 10 <= measurements <= 1_000_000:
        raise InputError(f"{measurements}", key="--measurements", allowed="10 to 1000000")
    if not 0 < threshold < 1:
        raise InputError(f"{threshold:g}", key="--threshold", allowed="above 0, below 1")
    voltages = parse_volts(volts)
    from evanesce.report.html import write
    from evanesce.rig import load_scene
    from evanesce.studies.budget.page import page
    from evanesce.studies.budget.study import run_study
    from evanesce.studies.estimator.study import fingers_of
    from evanesce.studies.ledger import Ledger

    scenes = load_scene(smooth), load_scene(ridged)
    if any(scene.camera.colour is not None for scene in scenes):
        raise InputError(
            "a colour camera", key="camera.colour",
            allowed="none: the budget's estimator reads grey frames; docs/background/red-light.md has colour's terms",
        )  # fmt: skip
    known = fingers_of(*scenes)
    names = [" ".join(name.split()) for name in fingers.split(";")]
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"{unknown[0]!r}", key="--fingers", allowed="; ".join(known))
    folder = out_dir(out, "study-budget")
    settings = [[scene.as_dict() for scene in scenes], measurements, threshold, seed, voltages, names]
    ledger = Ledger(folder / "budget.jsonl", settings)
    with progress() as bar:
        found = run_study(
            *scenes, measurements=measurements, voltages=voltages, fingers=names, threshold=threshold, seed=seed,
            tick=bar.report, keep=ledger.row,
        )  # fmt: skip
    report = write(folder / "report.html", page(found))
    write_json(folder / "result.json", found.as_dict())
    write_json(json_file, found.as_dict())
    _show(found, measurements)
    console.print(f"Report: {report}", highlight=False, soft_wrap=True)


def _show(found: BudgetStudy, measurements: int) -> None:
    table = Table(title=f"Share of {measurements} measurements whose 95 % interval covers the true area")
    columns = ("finger", "position", "refined [%]", "half-width [%]", "reference [%]", "half-width [%]")
    for heading in columns:
        table.add_column(heading, justify="left" if heading in ("finger", "position") else "right")
    for c in found.classes:
        table.add_row(
            c.finger, c.place, f"{100 * c.refined_covered:.1f}", f"{c.refined_half_width_percent:.2f}",
            f"{100 * c.reference_covered:.1f}", f"{c.reference_half_width_percent:.2f}",
        )  # fmt: skip
    console.print(table)
