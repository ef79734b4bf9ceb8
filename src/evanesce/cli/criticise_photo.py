"""``evanesce criticise-photo``: what the nominal model of a photographed checkerboard lacks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.markup import escape
from rich.table import Table

from evanesce.cli.common import JsonOption, check_json_target, console, handles_errors, messages, working, write_json
from evanesce.core.errors import InputError

CURVES = ("libcamera", "bt709", "srgb", "linear")


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("criticise-photo")
    @handles_errors
    def criticise_photo(
        photo: Annotated[Path, typer.Argument(metavar="PHOTO", help="Photograph of a checkerboard of 1 mm squares.")],
        corners: Annotated[
            Path | None, typer.Option("--corners", help="Corners of a calibration's views (CSV): are they one picture?")
        ] = None,
        scene: Annotated[
            str, typer.Option("--scene", help="Scene with the nominal plate, focal length and readout.")
        ] = "thesis",
        curve: Annotated[str, typer.Option("--curve", help=f"Nominal tone curve: {', '.join(CURVES)}.")] = "libcamera",
        seed: Annotated[
            int, typer.Option("--seed", min=0, help="Noted in the provenance; nothing is drawn by it.")
        ] = 0,
        json_file: JsonOption = None,
        report: Annotated[Path | None, typer.Option("--report", help="Write an HTML page to this file.")] = None,
    ) -> None:
        """Find what the simulation lacks of one photographed board, by name, with half of its blocks held out."""
        for target in (json_file, report):
            check_json_target(target)
        if curve not in CURVES:
            raise InputError(f"'{curve}'", key="--curve", allowed=", ".join(CURVES))
        from evanesce.core.provenance import record
        from evanesce.inference.photograph.answer import answer
        from evanesce.inference.photograph.critic import criticise_photograph, judged_views
        from evanesce.inference.photograph.page import page
        from evanesce.inference.photograph.picture import read_photograph
        from evanesce.measurement.calibration.points import read_points
        from evanesce.measurement.io.images import read_image
        from evanesce.report import html
        from evanesce.rig import load_scene

        picture, base = read_image(photo), load_scene(scene)
        views = None if corners is None else read_points(corners)
        with working("corners and geometry") as step:
            photograph = read_photograph(picture.data, base, curve)  # type: ignore[arg-type]
            found = criticise_photograph(photograph, tell=step)
            step("held-out blocks")
            result = answer(found)
            if views is not None:
                step("views")
                result["views"] = judged_views(found.bench, views)
        origin = record(seed=seed, config=base.as_dict(), photograph=photo.name, tone_curve=curve)
        write_json(json_file, {**result, "provenance": origin})
        if report is not None:
            html.write(report, page(result, found, photo.name, origin))
        _show(result)


def _show(result: dict[str, Any]) -> None:
    from evanesce.inference.photograph.page import views_words

    console.print(escape(result["first_line"]))
    for warning in result["warnings"]:
        messages.print(escape(f"warning: {warning}"))
    table = Table(title="Held-out blocks: what is lost without each cause, 95 % intervals", box=box.SIMPLE_HEAD)
    for heading in ("without", "log score lost [nats]", "from", "to", "RMS [DN]"):
        table.add_column(heading, justify="left" if heading == "without" else "right")
    for name, one in result["held_out"]["without"].items():
        value, low, high = one["log_score_lost"]
        table.add_row(name, f"{value:.0f}", f"{low:.0f}", f"{high:.0f}", f"{one['rms_DN']:.2f}")
    if result["held_out"]["without"]:
        console.print(table)
    for shot in result["next_measurement"]:
        console.print(f"Next: {escape(shot['what'])} Separates: {', '.join(shot['separates'])}.")
    if "views" in result:
        console.print(escape(views_words(result["views"])))
