"""``evanesce calibrate``: camera matrix, distortion and area per pixel from pictures of the two printed cards."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
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
OnGlassOption = Annotated[
    str | None,
    typer.Option("--on-glass", metavar="NAME", help="Picture whose board lay on the glass, by its file name, or none."),
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
    on_glass: OnGlassOption = None,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Calibrate the camera from pictures of a checkerboard, or from corners found elsewhere.

    --json saves the calibration for `evanesce measure`; --out adds a page with the views, corners, residuals and scale.
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
    from evanesce.cli.calibrate_output import draw, show
    from evanesce.measurement.calibration.points import read_points

    pictures = _find(files, square_mm, size) if files else None
    if pictures is None:
        assert points is not None
        assert size is not None
        views = read_points(points)
    else:
        views, size = pictures.views, pictures.image_size
    with named_options({"square": "--square", "checker_side_mm": "--square-mm", "on_glass": "--on-glass"}):
        fit = fit_calibration(
            views, size, pictures=pictures, square=square, square_side_mm=side_mm,
            square_colour="white" if square_colour == "white" else "black", model=model,
            expect_focal_px=expect_focal_px, expect_distance_mm=expect_distance_mm, on_glass=on_glass,
        )  # fmt: skip
    folder = None if out is None else out_dir(out, "calibrate")
    if folder is not None:
        draw(folder, fit)
        fit.calibration.save(folder / "calibration.json")
    from evanesce.measurement.calibration.model import as_plain

    write_json(json_file, as_plain(fit.calibration))
    show(fit.calibration, saved_to=json_file or folder)


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

    begun = time.monotonic()
    with progress() as bar:
        task = bar.add_task("corners", total=len(files))
        pictures = find_boards(files, square_mm, done=lambda: bar.advance(task))
    messages.print(f"corners of {len(files)} pictures found in {time.monotonic() - begun:.1f} s", highlight=False)
    if size is not None and size != pictures.image_size:
        text = (
            f"--image-size says {size[0]} x {size[1]}, the pictures are {pictures.image_size[0]} x "
            f"{pictures.image_size[1]} pixels: the pictures' own size is used"
        )
        pictures.warnings.append(Warning("changed_resolution", text))
    return pictures
