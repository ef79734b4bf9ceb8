"""``evanesce twin``: simulate a photographed checkerboard and put both side by side."""

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
        photo: Annotated[Path, typer.Argument(metavar="PHOTO", help="Photograph of a checkerboard of 1 mm squares.")],
        scene: Annotated[
            str, typer.Option("--scene", help="Rig whose plate, focal length and readout hold.")
        ] = "thesis",
        curve: Annotated[str, typer.Option("--curve", help=f"Tone curve of the photograph: {', '.join(CURVES)}.")] = (
            "libcamera"
        ),
        seed: Annotated[int, typer.Option("--seed", min=0, help="Of the twin's sensor noise.")] = 1,
        json_file: JsonOption = None,
        out: OutOption = None,
    ) -> None:
        """Fit the simulation to half of a photograph of a checkerboard, evaluate it on the other half, write a report.

        Needs a board that fills most of the frame, lying on the glass. About a minute for a megapixel.
        """
        check_json_target(json_file)
        if curve not in CURVES:
            raise InputError(f"'{curve}'", key="--curve", allowed=", ".join(CURVES))
        from evanesce.core import provenance
        from evanesce.measurement.io.images import read_image
        from evanesce.rig import load_scene
        from evanesce.studies.twin.residuals import twin_residuals
        from evanesce.studies.twin.study import make_twin

        loaded, base = read_image(photo), load_scene(scene)
        folder = out_dir(out, "twin")
        with messages.status("corners, geometry, light and blur: about a minute for a megapixel"):
            made = make_twin(loaded.data, base, seed=seed, curve=curve)  # type: ignore[arg-type]
            residuals = twin_residuals(made)
        origin = provenance.record(seed=seed, config=base.as_dict(), photograph=photo.name, tone_curve=curve)
        _write(folder, made, residuals, photo.name, origin)
        write_json(json_file, {**_record(made, residuals), "provenance": origin})
        _show(residuals, folder)


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
