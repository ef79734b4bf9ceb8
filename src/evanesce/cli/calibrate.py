"""``evanesce calibrate``: camera matrix, distortion and area per pixel from pictures of the two printed cards."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    console,
    handles_errors,
    messages,
    named_options,
    out_dir,
    progress,
    write_json,
)
from evanesce.core.errors import InputError

if TYPE_CHECKING:
    from evanesce.measurement.calibration.board_images import BoardPictures
    from evanesce.measurement.calibration.fit import Calibrated
    from evanesce.measurement.calibration.model import Calibration

MAX_PICTURES = 1000

CheckerboardOption = Annotated[
    list[Path] | None,
    typer.Option("--checkerboard", metavar="FILES...", help="Pictures of the checkerboard, or a folder."),
]
MoreArgument = Annotated[
    list[Path] | None, typer.Argument(metavar="", help="Further pictures of the checkerboard.", hidden=True)
]
PointsOption = Annotated[Path | None, typer.Option("--points", help="Corners found elsewhere: CSV, or MATLAB's .mat.")]
ImageSizeOption = Annotated[
    str | None, typer.Option("--image-size", metavar="WxH", help="Size of the pictures of --points in pixels.")
]
SquareOption = Annotated[
    Path | None, typer.Option("--square", help="Picture of the square card, for the area of a pixel.")
]
SquareColourOption = Annotated[
    str, typer.Option("--square-colour", help="white or black: which of the two is the card's square.")
]
ModelOption = Annotated[
    str, typer.Option("--model", help="radial2 (the thesis's), radial3, or full (with tangential).")
]
FocalOption = Annotated[
    float | None, typer.Option("--expect-focal-px", help="Focal length by the rig's drawing, in pixels.")
]
DistanceOption = Annotated[
    float | None, typer.Option("--expect-distance-mm", help="Distance of the board by the drawing, in mm.")
]


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(handles_errors(calibrate))


def calibrate(
    checkerboard: CheckerboardOption = None,
    more: MoreArgument = None,
    square_mm: Annotated[float, typer.Option("--square-mm", help="Side of the printed squares in mm.")] = 1.0,
    points: PointsOption = None,
    image_size: ImageSizeOption = None,
    square: SquareOption = None,
    side_mm: Annotated[float, typer.Option("--side-mm", help="Side of the square card in mm.")] = 15.0,
    square_colour: SquareColourOption = "white",
    model: ModelOption = "radial2",
    expect_focal_px: FocalOption = None,
    expect_distance_mm: DistanceOption = None,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Calibrate the camera from pictures of a checkerboard, or from corners found elsewhere.

    --json saves the calibration for `evanesce measure`; --out adds pictures of corners, residuals and scale.
    """
    check_json_target(json_file)
    files = _checkerboards(checkerboard or [], more or [])
    size = None if image_size is None else _size(image_size)
    _check_choices(files, points, size, model, square_colour)
    for key, value in (
        ("--square-mm", square_mm),
        ("--side-mm", side_mm),
        ("--expect-focal-px", expect_focal_px),
        ("--expect-distance-mm", expect_distance_mm),
    ):
        if value is not None and not 1e-6 < value < 1e6:
            raise InputError(f"{value:g}", key=key, allowed="a number from 1e-6 to 1e6")
    from evanesce.api.calibrate import fit_calibration
    from evanesce.measurement.calibration.points import read_points

    pictures = _find(files, square_mm, size) if files else None
    if pictures is None:
        assert points is not None
        assert size is not None
        views = read_points(points)
    else:
        views, size = pictures.views, pictures.image_size
    with named_options({"square": "--square"}):
        fit = fit_calibration(
            views, size, pictures=pictures, square=square, square_side_mm=side_mm,
            square_colour="white" if square_colour == "white" else "black", model=model,
            expect_focal_px=expect_focal_px, expect_distance_mm=expect_distance_mm,
        )  # fmt: skip
    folder = None if out is None else out_dir(out, "calibrate")
    if folder is not None:
        _draw(folder, fit.boards, pictures)
        fit.calibration.save(folder / "calibration.json")
    from evanesce.measurement.calibration.model import as_plain

    write_json(json_file, as_plain(fit.calibration))
    _show(fit.calibration, saved_to=json_file or folder)


def _checkerboards(given: list[Path], more: list[Path]) -> list[Path]:
    """Return the pictures: several after one option, the option repeated, and folders opened."""
    from evanesce.measurement.io.frames import natural_key
    from evanesce.measurement.io.images import IMAGE_SUFFIXES

    if more and not given:
        raise InputError(f"'{more[0]}' belongs to no option", allowed="--checkerboard FILES... or --points FILE")
    files: list[Path] = []
    for path in [*given, *more]:
        if path.is_dir():
            inside = [p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")]
            if not inside:
                raise InputError("the folder holds no images", file=path, key="--checkerboard")
            files += sorted(inside, key=lambda p: natural_key(p.name))
        elif path.is_file():
            files.append(path)
        else:
            raise InputError("no such file", file=path, key="--checkerboard", allowed="an image or a folder of images")
    if len(files) > MAX_PICTURES:
        raise InputError(f"{len(files)} pictures", key="--checkerboard", allowed=f"at most {MAX_PICTURES}")
    return files


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"\s*([0-9]{1,6})\s*[xX×]\s*([0-9]{1,6})\s*", text)
    cols, rows = (int(n) for n in found.groups()) if found else (0, 0)
    if not (2 <= cols <= 100_000 and 2 <= rows <= 100_000):
        raise InputError(f"'{text}'", key="--image-size", allowed="columns x rows, e.g. 1024x768, 2 to 100000 each")
    return cols, rows


def _check_choices(
    files: list[Path], points: Path | None, size: tuple[int, int] | None, model: str, square_colour: str
) -> None:
    if bool(files) == (points is not None):
        given = "both are given" if files else "neither is given"
        raise InputError(given, key="--checkerboard, --points", allowed="one of them")
    if points is not None and size is None:
        raise InputError("is missing", key="--image-size", allowed="WxH, as --points says nothing of the frame")
    if model not in ("radial2", "radial3", "full"):
        raise InputError(f"'{model}'", key="--model", allowed="radial2, radial3, full")
    if square_colour not in ("white", "black"):
        raise InputError(f"'{square_colour}'", key="--square-colour", allowed="white, black")


def _find(files: list[Path], square_mm: float, size: tuple[int, int] | None) -> BoardPictures:
    from evanesce.measurement.calibration.board_images import find_boards
    from evanesce.measurement.warnings import Warning

    with progress() as bar:
        task = bar.add_task("corners", total=len(files))
        pictures = find_boards(files, square_mm, done=lambda: bar.advance(task))
    if size is not None and size != pictures.image_size:
        text = (
            f"--image-size says {size[0]} x {size[1]}, the pictures are {pictures.image_size[0]} x "
            f"{pictures.image_size[1]} pixels: the pictures' own size is used"
        )
        pictures.warnings.append(Warning("changed_resolution", text))
    return pictures


def _draw(folder: Path, result: Calibrated, pictures: BoardPictures | None) -> None:
    from evanesce.measurement.calibration import plots
    from evanesce.measurement.plots import save_figure

    picture = pictures.first if pictures is not None and result.distinct[0].name == pictures.first_name else None
    save_figure(plots.corners_figure(result, picture), folder / "corners.png")
    save_figure(plots.residual_figure(result), folder / "residuals.png")
    save_figure(plots.scale_figure(result.scale, result, "local scale of the picture"), folder / "scale.png")
    undistorted = plots.scale_figure(result.scale_undistorted, result, "local scale after undistortion")
    save_figure(undistorted, folder / "scale_undistorted.png")


def _show(calibration: Calibration, saved_to: Path | None) -> None:
    from rich.table import Table
    from rich.text import Text

    details, matrix, k = calibration.details, calibration.camera_matrix, calibration.distortion
    errors = details["standard_errors"]

    def value(number: float, name: str, digits: int) -> str:
        error = errors.get(name)
        assumed = " (assumed)" if name in ("fx", "fy") and error is None else ""
        return f"{number:.{digits}f}" + (assumed if error is None else f" ± {error:.{digits}f}")

    raw, straight = details["scale_px_per_mm2"], details["scale_undistorted_px_per_mm2"]
    table = Table(title="Calibration", show_header=False)
    rows = [
        ("views, of which distinct", f"{len(details['views'])}, {len(details['distinct_views'])}"),
        ("corners", f"{len(details['corners'])}"),
        ("fx, fy [px]", f"{value(matrix[0, 0], 'fx', 1)}, {value(matrix[1, 1], 'fy', 1)}"),
        ("cx, cy [px]", f"{value(matrix[0, 2], 'cx', 1)}, {value(matrix[1, 2], 'cy', 1)}"),
        *((n, value(k[i], n, 4)) for i, n in enumerate(("k1", "k2", "p1", "p2", "k3")) if n in errors),
        ("grid RMS on corners left out [px]", f"{details['grid_rms_px']:.3f}"),
        ("the same after undistortion [px]", f"{details['grid_rms_undistorted_px']:.3f}"),
        ("local scale, median (min to max) [px/mm²]", _range(raw)),
        ("the same after undistortion [px/mm²]", _range(straight)),
    ]
    if calibration.mm2_per_px is not None:
        rows.append(("area of a pixel [mm²]", f"{calibration.mm2_per_px:.7f}"))
    for row in rows:
        table.add_row(*map(Text, row))
    console.print(table)
    for warning in details["warnings"]:
        messages.print(f"warning: {warning['code']}: {warning['text']}", highlight=False, markup=False, soft_wrap=True)
    if saved_to is None:
        messages.print("not saved: give --json FILE or --out DIR to save the calibration", soft_wrap=True)


def _range(scale: dict[str, float]) -> str:
    if math.isnan(scale["median"]):
        return "no complete cell"
    return f"{scale['median']:.1f} ({scale['min']:.1f} to {scale['max']:.1f})"
