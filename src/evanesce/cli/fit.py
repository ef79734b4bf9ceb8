"""``evanesce fit``: calibrate a scene by a measurement bundle."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.markup import escape
from rich.table import Table

from evanesce.cli.common import (
    JsonOption,
    check_json_target,
    console,
    handles_errors,
    messages,
    warn,
    write_json,
    write_text,
)
from evanesce.core.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    @handles_errors
    def fit(
        folder: Annotated[Path, typer.Argument(help="The bundle, see docs/reference/bundle.md.", metavar="BUNDLE")],
        scene: Annotated[
            Path | None, typer.Option("--scene", help="Write the calibrated scene to this TOML file.")
        ] = None,
        json_file: JsonOption = None,
        report: Annotated[Path | None, typer.Option("--report", help="Write an HTML page to this file.")] = None,
        exclude: Annotated[
            list[str] | None, typer.Option("--exclude", help="Effect that is not fitted (repeatable).")
        ] = None,
        seed: Annotated[int, typer.Option("--seed", min=0, help="Of the bootstrap of the gain.")] = 0,
    ) -> None:
        """Calibrate a bundle's scene: the figures that it determines, with intervals, judged by held-out frames.

        Exit code 0 also where the scene is not good enough to stand for the rig: the first line and --json say so.
        """
        from evanesce.bundle import read_bundle
        from evanesce.inference.calibration.figures import FIGURES

        for option, target, suffix in (("--scene", scene, ".toml"), ("--report", report, ".html")):
            if target is not None and target.suffix.lower() != suffix:
                raise InputError(
                    f"ends in {target.suffix!r}", file=target, key=option, allowed=f"a file ending in {suffix}"
                )
        for target in (json_file, report, scene):
            check_json_target(target)
        unknown = [name for name in exclude or [] if name not in FIGURES]
        if unknown:
            raise InputError(f"'{unknown[0]}' is not fitted", key="--exclude", allowed=", ".join(FIGURES))
        bundle = read_bundle(folder)
        warn(bundle.doubts)
        _run(bundle, scene, json_file, report, tuple(exclude or ()), seed)


def _run(
    bundle: Any, scene: Path | None, json_file: Path | None, report: Path | None, exclude: tuple[str, ...], seed: int
) -> None:
    """Fit, tell the progress on standard error, write and show the answer."""
    from evanesce.core.provenance import record
    from evanesce.inference.calibration.answer import calibrated_scene, heading_of, result_of
    from evanesce.inference.calibration.fit import fit_rig
    from evanesce.inference.calibration.page import page
    from evanesce.inference.gate import GrossDifference
    from evanesce.report.html import write
    from evanesce.rig import copy_scene_files
    from evanesce.rig.commented import commented

    try:
        cores = len(os.sched_getaffinity(0))
        found = fit_rig(
            bundle, seed=seed, exclude=exclude, tell=lambda line: messages.print(escape(line)), workers=cores
        )
    except GrossDifference as error:
        write_json(json_file, error.as_dict())
        raise
    result = result_of(found)
    calibrated = calibrated_scene(found)
    if scene is not None:
        copy_scene_files(calibrated, scene.parent)
        write_text(scene, commented(calibrated, heading_of(found, bundle.path.name, result)))
        result["scene"] = str(scene)
    write_json(json_file, result)
    if report is not None:
        write(report, page(result, found, bundle.path.name, record(seed=seed, config=calibrated.as_dict())))
    _show(result)


def _show(result: dict[str, Any]) -> None:
    console.print(escape(result["first_line"]))
    for reason in result["reasons"]:
        messages.print(escape(f"not good enough: {reason}"), style="yellow")
    for remark in result["remarks"]:
        messages.print(escape(f"left: {remark}"))
    warn(result["warnings"])
    table = Table(title="Figures that the bundle determines, with 90 % intervals", box=box.SIMPLE_HEAD)
    for heading in ("figure", "value", "from", "to", "unit", "nominal", "what"):
        table.add_column(heading, justify="left" if heading in ("figure", "unit", "what") else "right")
    for row in (*result["figures"], *result["nuisances"]):
        if row["told"]:
            values = [f"{row[key]:.4g}" for key in ("value", "lo", "hi")]
            table.add_row(escape(row["key"]), *values, row["unit"], f"{row['nominal']:.4g}", row["what"])
    console.print(table)
    not_told = [row["key"].removeprefix("effects.") for row in result["figures"] if not row["told"]]
    if not_told:
        console.print(escape(f"Not determined: {', '.join(not_told)}."), highlight=False)
    areas = Table(
        title="Area by the reference segmentation against force; last, the calibrated scene's contact itself",
        box=box.SIMPLE_HEAD,
    )
    for heading in ("force, N", "measured, mm^2", "nominal, mm^2", "calibrated, mm^2", "held out", "contact, mm^2"):
        areas.add_column(heading, justify="right")
    for row in result["areas"]:
        values = [f"{row[key]:.2f}" for key in ("measured_mm2", "nominal_mm2", "calibrated_mm2")]
        contact = "" if row["contact_mm2"] is None else f"{row['contact_mm2']:.2f}"
        areas.add_row(f"{row['force_N']:g}", *values, "yes" if row["held_out"] else "", contact)
    console.print(areas)
