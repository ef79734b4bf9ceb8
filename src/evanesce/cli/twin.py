"""``evanesce twin``: simulate a photographed checkerboard, or a contact frame, and put both side by side."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    console,
    handles_errors,
    messages,
    out_dir,
    progress,
    working,
    write_json,
    write_text,
)
from evanesce.core.errors import InputError

if TYPE_CHECKING:
    from evanesce.studies.twin.residuals import TwinResiduals
    from evanesce.studies.twin.study import Twin

CURVES = ("libcamera", "bt709", "srgb", "linear")


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    @handles_errors
    def twin(
        photo: Annotated[
            Path,
            typer.Argument(metavar="PICTURE", help="Photograph of a checkerboard of 1 mm squares, or a contact frame."),
        ],
        scene: Annotated[
            str | None,
            typer.Option("--scene", help="Rig as believed (default: thesis; thesis_ridged_red for a contact frame)."),
        ] = None,
        contact: Annotated[
            bool, typer.Option("--contact", help="The picture is a colour frame of a finger on the plate.")
        ] = False,
        curve: Annotated[str, typer.Option("--curve", help=f"Tone curve of the photograph: {', '.join(CURVES)}.")] = (
            "libcamera"
        ),
        seed: Annotated[int, typer.Option("--seed", min=0, help="Of the twin's sensor noise.")] = 1,
        json_file: JsonOption = None,
        out: OutOption = None,
    ) -> None:
        """Fit the simulation to half of a picture, evaluate it on the other half, write a report.

        A board has to fill most of the frame, lying on the glass: about a minute for a megapixel. A contact frame has
        to be in colour, with one contact and the lit finger around it: a minute or two, at any size.
        """
        check_json_target(json_file)
        if contact:
            _contact(photo, scene or "thesis_ridged_red", seed, json_file, out)
            return
        if curve not in CURVES:
            raise InputError(f"'{curve}'", key="--curve", allowed=", ".join(CURVES))
        from evanesce.core import provenance
        from evanesce.measurement.io.images import read_image
        from evanesce.rig import load_scene
        from evanesce.studies.twin.residuals import twin_residuals
        from evanesce.studies.twin.study import make_twin

        loaded, base = read_image(photo), load_scene(scene or "thesis")
        folder = out_dir(out, "twin")
        with working("corners, geometry, light and blur: about a minute for a megapixel"):
            made = make_twin(loaded.data, base, seed=seed, curve=curve)  # type: ignore[arg-type]
            residuals = twin_residuals(made)
        origin = provenance.record(seed=seed, config=base.as_dict(), photograph=photo.name, tone_curve=curve)
        _write(folder, made, residuals, photo.name, origin)
        write_json(json_file, {**_record(made, residuals), "provenance": origin})
        _show(residuals, folder)


def _contact(photo: Path, scene: str, seed: int, json_file: Path | None, out: Path | None) -> None:
    """Run the twin of a contact frame."""
    from evanesce.core import provenance
    from evanesce.measurement.io.images import read_image
    from evanesce.report import html
    from evanesce.rig import dump_scene, load_scene
    from evanesce.sensor.codec import replacing
    from evanesce.studies.contact_twin import page as contact_page
    from evanesce.studies.contact_twin.record import calibrated_scene, record
    from evanesce.studies.contact_twin.study import contact_twin

    loaded, base = read_image(photo), load_scene(scene)
    folder = out_dir(out, "twin")
    with progress() as bar:
        task = bar.add_task("fits", total=None)
        made = contact_twin(
            loaded.data, base, str(photo),
            lambda step, done, of: bar.update(task, description=step, completed=done, total=of),
        )  # fmt: skip
    origin = provenance.record(seed=seed, config=base.as_dict(), frame=photo.name)
    with replacing(folder / "side_by_side.png") as path:
        path.write_bytes(html.figure_png(contact_page.side_by_side(made)))
    html.write(folder / "report.html", contact_page.page(made, photo.name, origin))
    write_text(folder / "twin_scene.toml", dump_scene(calibrated_scene(made)))
    found = record(made)
    write_json(folder / "twin.json", {**found, "provenance": origin})
    write_json(json_file, {**found, "provenance": origin})
    _show_contact(found, folder)


def _show_contact(found: dict[str, Any], folder: Path) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(title="Residual on blocks that no fit has seen")
    for column in ("model", "red [DN]", "green [DN]", "blue [DN]", "gain [nat]"):
        table.add_column(Text(column), justify="left" if column == "model" else "right")
    rows = [("believed rig", found["added"][0])]
    rows += [(f"without {row['cause']}", row) for row in found["without"]]
    rows.append(("final", found["final"]))
    for name, row in rows:
        rms = [f"{value:.1f}" for value in row["rms_DN"]]
        table.add_row(name, *rms, f"{row['gain_nat']:+.0f} ± {row['gain_error_nat']:.0f}")
    console.print(table)
    figures = Table(title="What the frame gives (90 %)")
    for column in ("figure", "estimate", "interval", "unit", "meaning"):
        figures.add_column(Text(column))
    for one in found["figures"]:
        ends = "held" if one["low"] is None else f"{one['low']:.3g} to {one['high']:.3g}"
        figures.add_row(one["name"], f"{one['value']:.3g}", ends, one["unit"], one["meaning"])
    console.print(figures)
    if found["automatic_level"]:
        levels = ", ".join(f"{level:.1f} ({metering})" for metering, level in found["automatic_level"].items())
        console.print(f"libcamera's automatic exposure would settle on a contact level of {levels}", soft_wrap=True)
    for note in found["notes"]:
        messages.print(f"note: {note}", soft_wrap=True, highlight=False, markup=False)
    console.print(f"report: {folder / 'report.html'}", soft_wrap=True, highlight=False, markup=False)


def _write(folder: Path, made: Twin, residuals: TwinResiduals, name: str, origin: Any) -> None:
    import numpy as np

    from evanesce.report import html
    from evanesce.rig import copy_scene_files, dump_scene
    from evanesce.sensor.codec import replacing, write_png
    from evanesce.studies.twin import page as twin_page

    write_png(folder / "photo_grey.png", np.clip(np.rint(made.photo), 0, 255).astype(np.uint8))
    write_png(folder / "twin.png", made.simulated)
    with replacing(folder / "difference.png") as path:
        path.write_bytes(twin_page.difference_png(made))
    copy_scene_files(made.scene, folder)
    write_text(folder / "twin_scene.toml", dump_scene(made.scene))
    html.write(folder / "report.html", twin_page.page(made, residuals, name, origin))


def _record(made: Twin, residuals: TwinResiduals) -> dict[str, Any]:
    camera, board = made.rig.camera, made.rig.board
    figures = dataclasses.asdict(residuals)
    return {
        "corners": len(made.grid),
        "corners_held_out": int(made.corners_held_out.sum()),
        "geometric_rms_px": residuals.corner_rms_px,
        "grey_rms_DN": residuals.grey_rms,
        **{key: figures[key] for key in ("corner_median_px", "corner_rms_fitted_px", "zones", "causes")},
        "grey_median_abs_DN": residuals.grey_median_abs,
        "grey_rms_fitted_DN": residuals.grey_rms_fitted,
        "photo_deviation_DN": residuals.photo_deviation,
        "print": {
            "narrow_squares_um": residuals.spacing_narrow_um,
            "wide_squares_um": residuals.spacing_wide_um,
            "ink_um": 1e3 * board.ink_mm,
            "stretch": board.stretch,
            "shear": board.shear,
        },
        "camera": camera.model_dump(mode="json"),
    }


def _show(residuals: TwinResiduals, folder: Path) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(title="Twin, on the half that no fit has seen")
    for column in ("zone [px]", "corner RMS [px]", "edge, photo [px]", "edge, twin [px]", "grey RMS [DN]"):
        table.add_column(Text(column), justify="right")
    for z in residuals.zones:
        table.add_row(
            f"{z.inner_px:.0f} to {z.outer_px:.0f}",
            f"{z.corner_rms_px:.3f}",
            f"{z.edge_photo_px:.2f}",
            f"{z.edge_twin_px:.2f}",
            f"{z.grey_rms:.2f}",
        )
    table.add_row("all", f"{residuals.corner_rms_px:.3f}", "", "", f"{residuals.grey_rms:.2f}", end_section=True)
    console.print(table)
    console.print(f"report: {folder / 'report.html'}", soft_wrap=True, highlight=False, markup=False)
