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
    from evanesce.rig import Scene
    from evanesce.studies.budget.study import BudgetStudy

COLOUR_TERM = "green response"


def register(group: typer.Typer) -> None:
    """Add the command to the group of studies."""
    group.command()(handles_errors(budget))


def budget(
    smooth: Annotated[str, typer.Argument(help="Scene with a smooth finger.")] = "thesis",
    ridged: Annotated[
        str | None,
        typer.Argument(
            help="Scene with a ridged finger on the same rig; left out: thesis_ridged, or both fingers on the first "
            "scene's rig where it has a colour camera."
        ),
    ] = None,
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
    from evanesce.studies.budget.page import page
    from evanesce.studies.budget.study import run_study
    from evanesce.studies.estimator.study import fingers_of
    from evanesce.studies.ledger import Ledger

    scenes = _scenes(smooth, ridged)
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


def _scenes(smooth: str, ridged: str | None) -> tuple[Scene, Scene]:
    """Return the rig with a smooth and with a ridged finger."""
    from evanesce.evaluation.camera_model import camera_model
    from evanesce.rig import load_scene
    from evanesce.studies.scenes import Finger, check_studied

    first = load_scene(smooth)
    if ridged is None and first.camera.colour is not None:
        check_studied(first)
        camera_model(first)  # refuses a camera whose colours depend on the whole frame
        own = (Finger(first.finger.material, kind, scattering=False).on(first) for kind in (False, True))
        return next(own), next(own)
    second = load_scene(ridged or "thesis_ridged")
    if (first.camera.colour is None) != (second.camera.colour is None):
        raise InputError("one camera is in colour, the other is not", key="camera.colour", allowed="the same rig")
    for scene in (first, second):
        if scene.camera.colour is not None:
            camera_model(scene)
    return first, second


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
    if any(COLOUR_TERM in c.contributions_percent for c in found.classes):
        console.print(_parts(found))


def _parts(found: BudgetStudy) -> Table:
    """Return what a colour frame's area owes its uncertainty to."""
    table = Table(title="Standard uncertainty of the refined area from each component, median [%]")
    for heading in ("component", *(f"{c.finger}, {c.place}" for c in found.classes)):
        table.add_column(heading, justify="left" if heading == "component" else "right")
    for name in dict.fromkeys(name for c in found.classes for name in c.contributions_percent):
        table.add_row(name, *(f"{c.contributions_percent.get(name, 0.0):.3f}" for c in found.classes))
    return table
