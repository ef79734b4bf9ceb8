"""The camera of one's own rig: part, lens, scale, cards, and what a calibration says of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from evanesce.core.errors import InputError
from evanesce.measurement.calibration.model import Calibration
from evanesce.optics.projection import Projection
from evanesce.rig import Camera, Plate, Scene
from evanesce.rig.catalogue import CAMERAS, chosen
from evanesce.rig.explain import scene_keys

if TYPE_CHECKING:
    from evanesce.api.own_answers import Changes, RigAnswers
    from evanesce.rig.card import Cards

UNKNOWN_LENS = "not known: calibrate the camera"
LEAST_SQUARE_PX = 8.0
"""Side of a checkerboard's square below which its corners are not found [px]."""
GRID_POINTS = 41
SAME_SIDE = 1e-4
"""Relative difference up to which two sides are one that was rounded."""


def camera_changes(scene: Scene, answers: RigAnswers, found: Changes) -> None:
    """Add what is known of the camera to a rig's changes.

    Parameters
    ----------
    scene : Scene
    answers : RigAnswers
    found : Changes
    """
    camera = scene.camera
    cols, rows = camera.resolution_px
    pitch, focal = camera.pixel.pitch_um, camera.lens.focal_length_mm
    if answers.camera is not None:
        part = chosen(CAMERAS, answers.camera, "camera")
        (cols, rows), pitch, focal = part.resolution_px, part.pitch_um, part.focal_length_mm
        _part(answers.camera, answers, found)
    if answers.resolution_px is not None:
        cols, rows = answers.resolution_px
        found.known("camera.resolution_px", [cols, rows])
    if answers.camera is not None and answers.resolution_px is not None and answers.pixel_um is None:
        _says_crop(answers.camera, (cols, rows), found)
    found.known("camera.pixel.pitch_um", answers.pixel_um)
    found.known("camera.lens.focal_length_mm", answers.focal_mm)
    pitch = pitch if answers.pixel_um is None else answers.pixel_um
    focal = focal if answers.focal_mm is None else answers.focal_mm
    found.known("camera.lens.f_number", answers.f_number)
    if answers.camera is not None or answers.focal_mm is not None:
        found.values["camera.lens.distortion"] = {}
        found.values["camera.principal_point_offset_px"] = [0.0, 0.0]
        found.notes.append("distortion of the lens is not known: give --calibration or --checkerboard")
    found.known("camera.exposure_ms", answers.exposure_ms)
    if answers.colour:
        found.known("camera.colour.infrared_cut", not answers.noir, "the camera's filter")
    elif answers.noir:
        raise InputError("is given without colour", key="noir", allowed="with colour frames")
    if answers.calibration is not None:
        _calibrated(scene, answers, (cols, rows), focal, pitch, found)
    else:
        _scale(scene, answers, cols, focal / pitch * 1e3, found)


def _says_crop(name: str, size: tuple[int, int], found: Changes) -> None:
    """Say how frames of another size than a camera's are read: a smaller field, not larger pixels."""
    part = CAMERAS[name]
    cols, rows = part.resolution_px
    if size == part.resolution_px:
        return
    ratio = cols / size[0]
    same_shape = abs(rows / size[1] / ratio - 1.0) < 0.01
    larger = f" larger, --pixel-um {_four(part.pitch_um * ratio):g}" if same_shape and ratio > 1.0 else " others"
    found.notes.append(
        f"{size[0]} x {size[1]} px of {name}'s {cols} x {rows} are read as a part of its sensor with pixels of"
        f" {part.pitch_um:g} um; where it scales its frames, pixels are{larger}"
    )


def _part(name: str, answers: RigAnswers, found: Changes) -> None:
    """Take resolution, pixel and lens from the catalogue."""
    part = CAMERAS[name]
    found.known("camera.resolution_px", list(part.resolution_px), part.source)
    found.known("camera.pixel.pitch_um", part.pitch_um, part.source)
    found.known("camera.lens.focal_length_mm", part.focal_length_mm, part.source)
    found.known("camera.lens.f_number", part.f_number, part.source)
    found.assumed("camera.tone_curve", part.tone_curve, "a camera's curve is seldom published")
    found.assumed(
        "camera.pixel.full_well_capacity_e", part.full_well_capacity_e, "an IMX477's per area where not published"
    )
    black = 2.0 ** (part.bits - 4)
    found.known("camera.pixel.bits", part.bits, part.source)
    found.assumed("camera.pixel.black_level_DN", black, "a sixteenth of full scale")
    gain = part.full_well_capacity_e / (2.0**part.bits - 1.0 - black)
    found.assumed("camera.pixel.conversion_gain_e_per_DN", float(f"{gain:.3g}"), "full well over full scale")
    if not part.colour and answers.colour:
        raise InputError("is asked of a monochrome camera", key="colour", allowed="a camera with filters")
    if not answers.colour:
        found.values["camera.colour"] = None


def _scale(scene: Scene, answers: RigAnswers, cols: int, focal_px: float, found: Changes) -> None:
    """Find the scale from itself, from the field's width or the distance, or keep the preset's field."""
    ways = {
        "scale_px_per_mm": answers.scale_px_per_mm,
        "field_mm": answers.field_mm,
        "distance_mm": answers.distance_mm,
    }
    given = [name for name, value in ways.items() if value is not None]
    if len(given) > 1:
        raise InputError(f"is given beside {given[0]}", key=given[1], allowed="one of them")
    camera, plate = scene.camera, scene.plate
    deep = plate.thickness_mm / plate.refractive_index
    low, high = _bounds("camera.scale_px_per_mm")
    for name, value, least, most, unit in (
        ("scale_px_per_mm", answers.scale_px_per_mm, low, high, "px/mm"),
        ("field_mm", answers.field_mm, cols / high, cols / low, "mm"),
        ("distance_mm", answers.distance_mm, max(focal_px / high - deep, 0.0), focal_px / low - deep, "mm"),
    ):
        if value is not None and not least <= value <= most:
            raise InputError(f"{value:g} is out of range", key=name, allowed=f"{least:.3g} to {most:.3g} {unit}")
    if answers.scale_px_per_mm is not None:
        found.known("camera.scale_px_per_mm", answers.scale_px_per_mm)
    elif answers.field_mm is not None:
        found.known(
            "camera.scale_px_per_mm", _four(cols / answers.field_mm), f"field {answers.field_mm:g} mm wide, given"
        )
    elif answers.distance_mm is not None:
        source = f"lens {answers.distance_mm:g} mm below the plate, given, and its focal length"
        found.known("camera.scale_px_per_mm", _four(focal_px / (answers.distance_mm + deep)), source)
    elif cols != camera.resolution_px[0]:
        width = camera.resolution_px[0] / camera.scale_px_per_mm
        found.assumed("camera.scale_px_per_mm", _four(cols / width), f"keeps the preset's field, {width:.4g} mm wide")
        found.notes.append(f"scale is not given: the frame is taken to be {width:.4g} mm wide, as the preset's")


def _bounds(key: str) -> tuple[float, float]:
    quantity = scene_keys()[key].quantity
    assert quantity is not None
    return quantity.bounds


def _four(value: float) -> float:
    return float(f"{value:.5g}")


def _calibrated(
    scene: Scene, answers: RigAnswers, size: tuple[int, int], focal: float, pitch: float, found: Changes
) -> None:
    """Take resolution, scale, axis and distortion from a calibration through the plate."""
    calibration = answers.calibration
    assert calibration is not None
    for name in ("scale_px_per_mm", "field_mm", "distance_mm"):
        if getattr(answers, name) is not None:
            raise InputError("is given beside a calibration", key=name, allowed="one of them")
    if answers.resolution_px not in (None, calibration.image_size):
        (a, b), (c, d) = calibration.image_size, size
        raise InputError(f"{c} x {d} pixels; the calibration has {a} x {b}", key="resolution_px", allowed=f"{a}x{b}")
    name = answers.calibration_name or "calibration"
    if calibration.details.get("focal_length_identified") is True:
        focal = float(calibration.camera_matrix[0, 0]) * pitch * 1e-3
        found.known("camera.lens.focal_length_mm", _four(focal), f"{name}, from the pixel's pitch")
    camera = scene.camera.model_copy(
        update={
            "resolution_px": calibration.image_size, "tilt_x_deg": 0.0, "tilt_y_deg": 0.0, "roll_deg": 0.0,
            "pixel": scene.camera.pixel.model_copy(update={"pitch_um": pitch}),
            "lens": scene.camera.lens.model_copy(update={"focal_length_mm": _four(focal)}),
        }
    )  # fmt: skip
    fitted, left = calibrated_camera(calibration, camera, scene.plate, key=name)
    found.known("camera.resolution_px", list(calibration.image_size), name)
    found.known("camera.scale_px_per_mm", fitted["scale_px_per_mm"], name)
    found.known("camera.principal_point_offset_px", fitted["offset"], name)
    for key, value in fitted["distortion"].items():
        found.known(f"camera.lens.distortion.{key}", value, f"{name}, less the plate's refraction")
    found.notes = [note for note in found.notes if not note.startswith("distortion")]
    found.notes.append(f"camera from {name}: the scene's geometry is within {left:.2g} px RMS of it over the frame")
    if calibration.mm2_per_px is None:
        found.notes += _flattest_note(calibration)


def _flattest_note(calibration: Calibration) -> list[str]:
    """Say which of several pictures the scale comes from: only one that lay on the glass tells it."""
    details = calibration.details
    views, spread = details.get("distinct_views"), details.get("flat_view_depth_spread")
    if not isinstance(views, list) or len(views) < 2:
        return []
    if not isinstance(spread, float):  # a file of an earlier version
        return [f"scale from {views[0]}, the first of {len(views)} pictures: calibrate again for that on the glass"]
    stated = "stated" if details.get("on_glass_view") else "the flattest"
    return [
        f"scale from {details.get('flat_view')}, {stated} of {len(views)} pictures (distance to the lens differs by"
        f" {100 * (spread - 1):.2g} % across it): right only if that board lay on the glass"
    ]


def calibrated_camera(
    calibration: Calibration, camera: Camera, plate: Plate, *, key: str = "calibration"
) -> tuple[dict[str, Any], float]:
    """Return scale, axis and distortion of a camera that sees the contact plane as a calibration does.

    A calibration of boards on the glass has the plate's refraction in its distortion; a scene adds it by Snell's law.
    The lens's own coefficients are those, by least squares over the frame, with which both agree.

    Parameters
    ----------
    calibration : Calibration
    camera : Camera
        Its focal length and pixel pitch count.
    plate : Plate
    key : str
        Named in errors.

    Returns
    -------
    found : dict
        ``scale_px_per_mm``, ``offset`` (x, y) [px], ``distortion``: k1, k2, p1, p2.
    left : float
        RMS distance of both geometries over the frame [px].

    Raises
    ------
    InputError
        If the calibration knows no scale.
    """
    scale = _scale_of(calibration, key)
    (cols, rows), matrix = calibration.image_size, calibration.camera_matrix
    offset = [round(float(matrix[k, 2]) - (n - 1) / 2, 3) for k, n in ((0, cols), (1, rows))]
    u, v = (
        a.ravel() for a in np.meshgrid(np.linspace(0, cols - 1, GRID_POINTS), np.linspace(0, rows - 1, GRID_POINTS))
    )
    from evanesce.bundle.board import calibrated_plane

    x, y = calibrated_plane(calibration, scale**-2)(u, v)
    # the calibration's plane has its origin where the undistorted view's pixel (0, 0) is
    x, y = x - matrix[0, 2] / scale, y - matrix[1, 2] / scale
    plain = camera.model_copy(
        update={
            "scale_px_per_mm": scale, "principal_point_offset_px": (offset[0], offset[1]), "centre_mm": (0.0, 0.0),
            "lens": camera.lens.model_copy(update={"distortion": camera.lens.distortion.model_copy(
                update=dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0))}),
        }
    )  # fmt: skip
    projection = Projection.of(plain, plate)
    xn, yn = projection.plate_to_ray(x, y)
    cx, cy = projection.principal_point
    wanted = np.concatenate([(u - cx) / projection.focal_px - xn, (v - cy) / projection.focal_px - yn])
    r2 = xn**2 + yn**2
    columns = (
        (xn * r2, yn * r2), (xn * r2**2, yn * r2**2), (2 * xn * yn, r2 + 2 * yn**2), (r2 + 2 * xn**2, 2 * xn * yn),
    )  # fmt: skip
    names = ("k1", "k2", "p1", "p2") if any(calibration.distortion[2:4]) else ("k1", "k2")
    design = np.stack([np.concatenate(pair) for pair in columns[: len(names)]], axis=1)
    solution = np.linalg.lstsq(design, wanted, rcond=None)[0]
    left = float(np.sqrt(np.mean((wanted - design @ solution) ** 2) * 2)) * projection.focal_px
    return {
        "scale_px_per_mm": float(f"{scale:.6g}"), "offset": offset,
        "distortion": {name: float(f"{value:.5g}") for name, value in zip(names, solution, strict=True)},
    }, left  # fmt: skip


def _scale_of(calibration: Calibration, key: str) -> float:
    """Return the scale of the undistorted view [px/mm]: of the square card, or of the board on the glass."""
    if calibration.mm2_per_px is not None:
        return float(calibration.mm2_per_px**-0.5)
    board = calibration.details.get("scale_undistorted_px_per_mm2")
    median = board.get("median") if isinstance(board, dict) else None
    if isinstance(median, int | float) and median > 0:
        return float(median**0.5)
    raise InputError("knows no scale", key=key, allowed="a calibration with a square card or a board on the glass")


def card_changes(scene: Scene, answers: RigAnswers, found: Changes) -> None:
    """Add what is known of the calibration cards; those of the preset are made to fit the frame.

    Parameters
    ----------
    scene : Scene
    answers : RigAnswers
    found : Changes
    """
    scale, least = scene.camera.scale_px_per_mm, min(scene.camera.resolution_px)
    field = least / scale
    card = scene.card
    if answers.board_squares is not None:
        found.known("card.checkerboard_squares", list(answers.board_squares))
    found.known("card.checkerboard_side_mm", answers.board_square_mm)
    _board(card, answers, found)
    found.known("card.square_side_mm", answers.square_mm)
    if answers.board_inverted:
        found.known("card.checkerboard_inverted", answers.board_inverted, "seen on the board's picture")
        found.notes.append("the board's square at the upper left is black: card.checkerboard_inverted = true")
    side = card.checkerboard_side_mm if answers.board_square_mm is None else answers.board_square_mm
    if side * scale < LEAST_SQUARE_PX:
        found.notes.append(
            f"squares of the checkerboard are {side * scale:.1f} px wide: corners need {LEAST_SQUARE_PX:g} px or more, "
            f"{LEAST_SQUARE_PX / scale:.2g} mm (--board-square-mm)"
        )
    square = card.square_side_mm if answers.square_mm is None else answers.square_mm
    if square >= field:
        if answers.square_mm is not None:
            found.notes.append(f"the square card of {square:g} mm is wider than the field of view, {field:.3g} mm")
        else:
            fits = float(f"{0.6 * field:.1g}") if field < 10 else float(round(0.6 * field))
            found.assumed("card.square_side_mm", max(fits, 0.5), "fits the frame")


def _board(card: Cards, answers: RigAnswers, found: Changes) -> None:
    """Hold the board against what the calibration's pictures show; take from them what is not given."""
    from evanesce.bundle.board import calibrated_boards, other_card, squares_shown

    calibration = answers.calibration
    boards = [] if calibration is None else calibrated_boards(calibration)
    if calibration is None or not boards:
        return
    side = boards[0].side_mm
    if answers.board_square_mm is None:
        found.known("card.checkerboard_side_mm", side, answers.calibration_name)
    elif abs(answers.board_square_mm / side - 1) > SAME_SIDE:
        raise InputError(
            f"{answers.board_square_mm:g}, but the calibration was made with squares of {side:g} mm",
            key="board_square_mm", allowed=f"{side:g}, or another calibration",
        )  # fmt: skip
    card = card.model_copy(update={"checkerboard_side_mm": side})
    if answers.board_squares is not None:
        card = card.model_copy(update={"checkerboard_squares": answers.board_squares})
    why = other_card(boards, card)
    if why is None:
        return
    if answers.board_squares is not None:
        raise InputError(
            why.replace("the scene's card has", "given are"), key="board_squares", allowed="squares of that board, WxH"
        )
    shown = squares_shown(calibration)
    found.assumed("card.checkerboard_squares", list(shown), "as many as the pictures show")
    found.notes.append(
        f"the checkerboard is taken to have {shown[0]} x {shown[1]} squares, as many as the pictures show; --board"
        " tells of a larger one"
    )
