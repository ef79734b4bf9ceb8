"""``evanesce criticise``: from a measurement bundle to what the simulation gets wrong about it."""

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
from evanesce.inference.naming import label_of

PICTURES = (".png", ".pdf", ".svg")


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    @handles_errors
    def criticise(
        folder: Annotated[Path, typer.Argument(help="The bundle, see docs/reference/bundle.md.", metavar="BUNDLE")],
        json_file: JsonOption = None,
        report: Annotated[Path | None, typer.Option("--report", help="Write an HTML page to this file.")] = None,
        scene: Annotated[
            Path | None, typer.Option("--scene", help="Write the extended scene here (default: beside the JSON).")
        ] = None,
        seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the draws of noise.")] = 0,
        shapes: Annotated[
            Path | None, typer.Option("--shapes", help="Write a picture of what every cause may look like, and stop.")
        ] = None,
    ) -> None:
        """Find what a nominal model gets wrong about measured data: name causes, extend the scene, measure gain."""
        from evanesce.bundle import read_bundle

        for target in (json_file, report, scene, shapes):
            check_json_target(target)
        if shapes is not None and shapes.suffix.lower() not in PICTURES:
            raise InputError(f"cannot write {shapes.suffix!r}", key="--shapes", allowed=", ".join(PICTURES))
        bundle = read_bundle(folder)
        warn(bundle.doubts)
        if shapes is not None:
            _draw_shapes(bundle, shapes)
            return
        _run(bundle, json_file, report, scene, seed)


def _run(bundle: Any, json_file: Path | None, report: Path | None, scene: Path | None, seed: int) -> None:
    """Find causes, tell the progress on standard error, write and show its answer."""
    from evanesce.core.provenance import record
    from evanesce.inference.critic import Criticism, criticise_frames
    from evanesce.inference.gate import GrossDifference
    from evanesce.inference.page import page
    from evanesce.inference.series.critic import SeriesCriticism, criticise_series
    from evanesce.report.html import write
    from evanesce.rig import dump_scene

    try:

        def tell(line: str) -> None:
            messages.print(escape(line))

        found: Criticism | SeriesCriticism
        if bundle.has_frames:
            found = criticise_frames(bundle, seed=seed, tell=tell, workers=len(os.sched_getaffinity(0)))
        else:
            found = criticise_series(bundle, seed=seed, tell=tell)
    except GrossDifference as error:
        write_json(json_file, error.as_dict())
        raise
    target = scene or _beside(json_file or report)
    if target is not None:
        write_text(target, found.scene)
        found.result["extended_scene"] = str(target)
    write_json(json_file, found.result)
    if report is not None:
        scenes = (dump_scene(bundle.scene), found.scene)
        write(report, page(found.result, found.pictures, bundle.path.name, scenes, record(seed=seed)))
    _show(found.result)


def _draw_shapes(bundle: Any, target: Path) -> None:
    """Write a picture of the forms of all causes."""
    from evanesce.inference.critic import shapes_of
    from evanesce.inference.shape_picture import shape_figure

    forms, data = shapes_of(bundle, tell=lambda line: messages.print(escape(line)))
    figure = shape_figure(forms, data)
    figure.savefig(target, dpi=110)
    console.print(f"forms of {len(forms)} causes: {escape(str(target))}")


def _show(result: dict[str, Any]) -> None:
    console.print(escape(result["first_line"]))
    for warning in result["warnings"]:
        messages.print(escape(f"warning: {warning}"))
    table = Table(title="Fitted, with 90 % intervals", box=box.SIMPLE_HEAD)
    moved = ("area, mm^2", "area, %", "held-out nats", "probability")
    for heading in ("cause", "parameter", "value", "from", "to", "unit", *moved):
        table.add_column(heading, justify="left" if heading in ("cause", "parameter", "unit") else "right")
    for cause in result["causes"]:
        area = (cause["together"] or cause)["area"]
        largest = max(range(len(area["percent"])), key=lambda k: abs(area["percent"][k]), default=None)
        own_area = ["", ""] if largest is None else [f"{area['mm2'][largest]:+.2f}", f"{area['percent'][largest]:+.1f}"]
        for number, (name, p) in enumerate(cause["parameters"].items()):
            score = "" if cause["held_out_nats"] is None else f"{cause['held_out_nats'][0]:+.0f}"
            own = [*own_area, score, f"{cause['probability']:.2f}"] if number == 0 else [""] * 4
            values = [f"{p[key]:.4g}" for key in ("value", "lo", "hi")]
            table.add_row(escape(label_of(cause)) if number == 0 else "", name, *values, p["unit"], *own)
    if result["causes"]:
        console.print(table)
    console.print(f"Not explained: {100 * result['misfit']['left_share']:.3g} % of the misfit.")
    advice = result["next_measurement"]
    if advice is not None and advice["what"] is not None:
        between = " or ".join(advice["between"])
        console.print(escape(f"Next: {advice['what']}, to tell whether it is {between}."))
    gain = result["held_out"]
    if gain is not None:
        unit, what = ("DN", "views") if "rms_DN" in gain else ("standard deviations", "rows")
        rms, rms_after = gain["rms_DN" if unit == "DN" else "rms_sd"]
        area = [f"{a:.2f}" for a in gain["area_error_percent"] if a is not None]
        more = f", error of the predicted area {' to '.join(area)} %" if area else ""
        console.print(f"Held out ({gain['views']} {what}): residual {rms:.2f} to {rms_after:.2f} {unit} RMS{more}")


def _beside(target: Path | None) -> Path | None:
    """Return where the extended scene goes: beside the answer."""
    if target is None:
        return None
    if target.suffix == ".toml":
        raise InputError("is a scene's suffix", file=target, key="--json", allowed="a file that ends in .json")
    return target.with_name(target.stem + "_scene.toml")
