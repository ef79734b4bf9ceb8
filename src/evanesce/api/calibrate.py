"""Calibrate a camera from frames of the two printed targets: a checkerboard, and a square of known side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.core.states import Frame
from evanesce.measurement.calibration.board_images import BoardPictures, boards_of
from evanesce.measurement.calibration.fit import Calibrated, report
from evanesce.measurement.calibration.fit import calibrate as fit_boards
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.calibration.rectify import rectification, rectify
from evanesce.measurement.calibration.scales import compare_scales, stated_view
from evanesce.measurement.io.images import Loaded, Unreadable, read_image
from evanesce.measurement.io.mosaics import MosaicFormat
from evanesce.measurement.reference.area import SquareScale, square_scale
from evanesce.measurement.refined.light import tone_table

Picture = NDArray[np.uint8] | str | Path
Model = Literal["radial2", "radial3", "full"]
Colour = Literal["white", "black"]


@dataclass(frozen=True, kw_only=True)
class CalibrationFit:
    """A calibration with what it was made from.

    Attributes
    ----------
    calibration : Calibration
    boards : Calibrated
        The fit to the checkerboard's corners.
    pictures : BoardPictures or None
        None where the corners were found elsewhere.
    square : SquareScale or None
    """

    calibration: Calibration
    boards: Calibrated
    pictures: BoardPictures | None
    square: SquareScale | None


def calibrate(
    checkerboards: Sequence[Picture],
    *,
    checker_side_mm: float = 1.0,
    square: Picture | None = None,
    square_side_mm: float = 15.0,
    square_colour: Colour = "white",
    model: Model = "radial2",
    tone_curve: str | Sequence[float] | None = None,
    expect_focal_px: float | None = None,
    expect_distance_mm: float | None = None,
    on_glass: str | None = None,
) -> Calibration:
    """Calibrate a camera from frames of a checkerboard and of a square.

    Parameters
    ----------
    checkerboards : sequence of ndarray of uint8 (rows, cols[, 3]), str or Path
        Frames of the checkerboard [DN], or image files. One flat on the glass gives distortion and scale; several,
        tilted by 10 to 20 degrees, the focal length as well.
    checker_side_mm : float
        Side of the checkerboard's squares [mm].
    square : ndarray, str or Path, optional
        Frame of the square flat on the glass; without it no area of a pixel is known.
    square_side_mm : float
        Its side [mm].
    square_colour : {"white", "black"}
        Which of the two is the square.
    model : {"radial2", "radial3", "full"}
        Distortion: two radial terms (as in the thesis), three, or three with the tangential ones.
    tone_curve : str or sequence of float, optional
        Tone curve of the frames for the refined estimator: ``linear``, ``bt709``, ``srgb``, or 256 values of linear
        light; ``bt709`` where none is given.
    expect_focal_px, expect_distance_mm : float, optional
        What the rig's drawing says, to compare with; the focal length is assumed where the boards do not determine it.
    on_glass : str, optional
        Name of the picture whose board lay on the glass ("picture 1" for an array), or "none"; the only one, or the
        one least tilted, if nothing is said.

    Returns
    -------
    Calibration
        Camera matrix [px], distortion, area of a pixel of the undistorted view [mm^2]; ``details`` holds corners,
        residuals, standard errors and warnings. ``save`` writes it, :func:`evanesce.load_calibration` reads it.

    Raises
    ------
    InputError
        If a picture cannot be read, a size is out of range, the square is not found, or its scale and that of the
        board on the glass contradict by more than 2 %.
    WorkError
        If there is no checkerboard in any picture.

    Examples
    --------
    >>> import evanesce as ev
    >>> scene = ev.load("thesis").with_(card__checkerboard_side_mm=2.0, card__checkerboard_squares=(20, 16))
    >>> camera = ev.Camera(ev.coarser(scene, 4))
    >>> board, square = camera.shoot_target("checkerboard"), camera.shoot_target("square")
    >>> calibration = ev.calibrate([board], checker_side_mm=2.0, square=square)
    >>> round(calibration.mm2_per_px / camera.scale_mm2_per_px, 2)
    0.99
    """
    pictures = boards_of(map(_named, range(len(checkerboards)), checkerboards), checker_side_mm)
    fit = fit_calibration(
        pictures.views, pictures.image_size, pictures=pictures, square=square, square_side_mm=square_side_mm,
        square_colour=square_colour, model=model, expect_focal_px=expect_focal_px,
        expect_distance_mm=expect_distance_mm, on_glass=on_glass,
    )  # fmt: skip
    if tone_curve is None:
        return fit.calibration
    tone_table(tone_curve)  # refuses what is none
    curve = tone_curve if isinstance(tone_curve, str) else [float(value) for value in tone_curve]
    return replace(fit.calibration, details={**fit.calibration.details, "tone_curve": curve})


def fit_calibration(
    views: Sequence[BoardView],
    image_size: tuple[int, int],
    *,
    pictures: BoardPictures | None = None,
    square: Picture | None = None,
    square_side_mm: float = 15.0,
    square_colour: Colour = "white",
    model: str = "radial2",
    expect_focal_px: float | None = None,
    expect_distance_mm: float | None = None,
    on_glass: str | None = None,
) -> CalibrationFit:
    """Calibrate a camera from corners of a checkerboard that have been found, and from a frame of the square.

    Parameters
    ----------
    views : sequence of BoardView
        Corners on the board [mm] and in the frame [px].
    image_size : tuple of int
        (cols, rows) [px].
    pictures : BoardPictures, optional
        The pictures in which they were found: their blur and warnings go into the calibration.
    square, square_side_mm, square_colour, model, expect_focal_px, expect_distance_mm, on_glass
        As for :func:`calibrate`.

    Returns
    -------
    CalibrationFit

    Raises
    ------
    InputError
        If the square is not found, is of another size than the pictures of the board, or contradicts their scale.
    """
    for key, value in (("square_side_mm", square_side_mm), ("expect_focal_px", expect_focal_px),
                       ("expect_distance_mm", expect_distance_mm)):  # fmt: skip
        if value is not None and not 1e-6 < value < 1e6:
            raise InputError(f"{value:g}", key=key, allowed="a number from 1e-6 to 1e6")
    flat = stated_view(views, on_glass)
    boards = fit_boards(
        views, image_size, model=model, expect_focal_px=expect_focal_px, expect_distance_mm=expect_distance_mm,
        on_glass=flat - 1 if flat else None,
    )  # fmt: skip
    card = None if square is None else _square(square, square_side_mm, square_colour, boards.calibration)
    calibration = _complete(boards, pictures, card, square_side_mm, flat)
    return CalibrationFit(calibration=calibration, boards=boards, pictures=pictures, square=card)


def _named(number: int, picture: Picture) -> tuple[str, Loaded]:
    """Return a picture's name for messages, and the picture."""
    if isinstance(picture, str | Path):
        return Path(picture).name, read_image(picture)
    return f"picture {number + 1}", Loaded(as_image(picture))


def as_image(picture: Picture) -> NDArray[np.uint8]:
    """Return an image of a file or an array.

    Parameters
    ----------
    picture : ndarray, str or Path

    Returns
    -------
    ndarray of uint8, (rows, cols) or (rows, cols, 3)

    Raises
    ------
    InputError
        If the file cannot be read, or the array is not an 8-bit image.
    """
    if isinstance(picture, str | Path):
        return read_image(picture).data
    image = np.asarray(picture)
    grey, colour = image.ndim == 2, image.ndim == 3 and image.shape[2] == 3
    if image.dtype != np.uint8 or not (grey or colour):
        raise InputError(
            f"an array of {image.dtype} of shape {image.shape}", key="frame",
            allowed="uint8 of shape (rows, cols) or (rows, cols, 3)",
        )  # fmt: skip
    return np.ascontiguousarray(image)


def mosaic_of(picture: Picture | Frame, form: MosaicFormat) -> Frame:
    """Return a frame with a raw mosaic, of a frame that holds one, an array or a file of 16 bits.

    Parameters
    ----------
    picture : Frame, ndarray of uint16 (rows, cols), str or Path
    form : MosaicFormat

    Returns
    -------
    Frame
        Its ``data`` is the mosaic in 8 bits where it has no other.

    Raises
    ------
    InputError
        If there is no mosaic of 16 bits, or it does not fit the format.
    """
    if isinstance(picture, Frame) and picture.raw is not None:
        return picture
    if isinstance(picture, str | Path):
        try:
            found = form.load(Path(picture))
        except Unreadable as error:
            raise InputError(str(error), file=picture, key="raw", allowed="a whole PNG or TIFF of 16 bits") from None
    else:
        found = form.checked(np.asarray(picture.data if isinstance(picture, Frame) else picture))
    return Frame(data=found.data, raw=found.raw)


def _square(picture: Picture, side_mm: float, colour: Colour, calibration: Calibration) -> SquareScale:
    """Measure the square by the reference segmentation, after undistortion."""
    image, file = as_image(picture), picture if isinstance(picture, str | Path) else None
    (cols, rows), (high, wide) = calibration.image_size, image.shape[:2]
    if (wide, high) != (cols, rows):
        raise InputError(
            f"changed resolution: {wide} x {high} pixels", file=file, key="square",
            allowed=f"{cols} x {rows}, as the checkerboard's pictures are",
        )  # fmt: skip
    return square_scale(rectify(image, rectification(calibration)), side_mm, square=colour)


def _complete(
    boards: Calibrated, pictures: BoardPictures | None, square: SquareScale | None, side_mm: float, flat: int | None
) -> Calibration:
    """Return the calibration with the area of a pixel and everything reported beside it."""
    details = report(boards)
    found = [*(pictures.warnings if pictures else []), *(square.warnings if square else [])]
    if square is not None:
        details["board_and_card"], odds = compare_scales(boards, square.mm2_per_px, side_mm, flat)
        found += odds
    if flat is not None:
        details["on_glass_view"] = flat
    details["warnings"] = [{"code": w.code, "text": w.text} for w in found] + details["warnings"]
    if square is not None:
        details["square"] = {
            "pixels": square.pixels,
            "sides_px": list(square.sides_px),
            "rotation_deg": square.rotation_deg,
            "threshold": square.threshold,
        }
    if pictures is not None:
        details["blur_px"] = pictures.blurs
    return Calibration(
        image_size=boards.calibration.image_size,
        camera_matrix=boards.fit.camera_matrix,
        distortion=boards.fit.distortion,
        mm2_per_px=None if square is None else square.mm2_per_px,
        square_side_mm=None if square is None else side_mm,
        details=details,
    )
