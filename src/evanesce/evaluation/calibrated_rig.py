"""Calibration of a simulated rig without rendering a card: projected corners with scatter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.write import Rig
from evanesce.evaluation.camera_model import tone_values
from evanesce.measurement.calibration.corners import find_corners
from evanesce.measurement.calibration.fit import calibrate, report
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.calibration.rectify import undistort_points
from evanesce.measurement.refined.blur import blur_of_board
from evanesce.measurement.refined.light import CURVES as NAMED_CURVES
from evanesce.measurement.refined.plate import shoelace
from evanesce.optics.projection import Projection
from evanesce.rig import Scene

Floats = NDArray[np.float64]

CORNER_NOISE_PX = 0.03
"""Scatter of a corner found in a rendered checkerboard, per axis; docs/validation/measurement.md has 0.02 to 0.04."""

SQUARE_EDGE_PX = 0.5
"""Greatest displacement of the printed square's edges by threshold and blur [px]."""

BOARD_WHITE_DN = 240
"""Brightest squares of a board that is exposed for itself [DN]."""

MOST_HALVINGS = 16
"""Of an exposure time, until a board is no longer full."""


@dataclass(frozen=True, kw_only=True)
class CardErrors:
    """Deviations of the cards of one calibration from their nominal values.

    Attributes
    ----------
    board_scale, square_scale : float
        Printed over stated length of checkerboard and square [1].
    height_mm : float
        Printed side over the contact plane, that is farther from the camera [mm].
    square_edge_px : float
        Displacement of the square's edge outwards, by threshold and blur [px].
    corner_noise_px : float
        Standard deviation of a corner per axis [px].
    """

    board_scale: float = 1.0
    square_scale: float = 1.0
    height_mm: float = 0.0
    square_edge_px: float = 0.0
    corner_noise_px: float = CORNER_NOISE_PX


def calibrated(
    scene: Scene,
    rng: np.random.Generator,
    errors: CardErrors | None = None,
    *,
    rotation_deg: float = 1.3,
    shift_mm: tuple[float, float] = (0.37, -0.21),
) -> Calibration:
    """Calibrate a scene's camera from one checkerboard and one square that lie on the glass.

    Parameters
    ----------
    scene : Scene
    rng : numpy.random.Generator
        Of the corners' scatter.
    errors : CardErrors, optional
    rotation_deg, shift_mm : float, tuple of float
        Orientation and position of the cards [deg], [mm].

    Returns
    -------
    Calibration
    """
    errors = errors or CardErrors()
    projection = _above(scene, errors.height_mm)
    world, seen = _board(scene, errors, projection, rng, rotation_deg, shift_mm)
    focal_px = Projection.of(
        scene.camera, scene.plate
    ).focal_px  # on the lens's label; a flat board does not determine it
    found = calibrate([BoardView("board", world, seen)], scene.camera.resolution_px, expect_focal_px=focal_px)
    stated = scene.card.square_side_mm
    square = _square(stated * errors.square_scale, projection, rotation_deg, shift_mm)
    straight = undistort_points(square, found.calibration.camera_matrix, found.calibration.distortion)
    pixels = abs(shoelace(straight))
    pixels += 4 * np.sqrt(pixels) * errors.square_edge_px
    return Calibration(
        image_size=found.calibration.image_size,
        camera_matrix=found.calibration.camera_matrix,
        distortion=found.calibration.distortion,
        mm2_per_px=stated**2 / float(pixels),
        square_side_mm=stated,
        details=report(found) | {"tone_curve": _stated_curve(scene)},
    )


def _stated_curve(scene: Scene) -> str | list[float]:
    """Return the name of the tone curve, or its values where the measurement does not know it by name."""
    curve = scene.camera.tone_curve
    return tone_values(curve).tolist() if curve not in NAMED_CURVES else curve


def with_board_blur(calibration: Calibration, scene: Scene, seed: int) -> Calibration:
    """Return a calibration with the blur of a frame of the scene's board, as ``evanesce calibrate`` finds it.

    A colour camera's exposure for red light leaves a board under a lamp white: the board gets one of its own.

    Parameters
    ----------
    calibration : Calibration
    scene : Scene
    seed : int
        Of the simulated frame.

    Returns
    -------
    Calibration

    Raises
    ------
    WorkError
        If no board is found in the frame.
    """
    colour = scene.camera.colour is not None
    picture = _unclipped_board(scene, seed) if colour else Rig(scene, seed).card("checkerboard", 0)
    blur = blur_of_board(picture, find_corners(picture))
    return replace(calibration, details={**calibration.details, "blur_px": [blur]})


def _unclipped_board(scene: Scene, seed: int) -> NDArray[np.uint8]:
    """Return the board at the longest of halved exposure times, at gain 1, that fills no channel."""
    exposure = scene.camera.exposure_ms
    for _ in range(MOST_HALVINGS):
        camera = scene.camera.model_copy(update={"analogue_gain": 1.0, "exposure_ms": exposure})
        picture = Rig(scene.model_copy(update={"camera": camera}), seed).card("checkerboard", 0)
        if np.percentile(picture, 99) < BOARD_WHITE_DN:
            break
        exposure /= 2
    return np.asarray(picture, np.uint8)


def drawn_corners(
    scene: Scene,
    errors: CardErrors,
    rng: np.random.Generator,
    *,
    rotation_deg: float = 1.3,
    shift_mm: tuple[float, float] = (0.37, -0.21),
) -> list[dict[str, float]]:
    """Return the corners of a board as a calibration keeps them; parameters as for :func:`calibrated`.

    Parameters
    ----------
    scene : Scene
    errors : CardErrors
    rng : numpy.random.Generator
    rotation_deg, shift_mm : float, tuple of float
        Orientation and position of the board [deg], [mm].

    Returns
    -------
    list of dict
    """
    world, seen = _board(scene, errors, _above(scene, errors.height_mm), rng, rotation_deg, shift_mm)
    keys = ("view", "world_x_mm", "world_y_mm", "image_x_px", "image_y_px")
    rows = np.column_stack([np.ones(len(world)), world, seen]).tolist()
    return [dict(zip(keys, row, strict=True)) for row in rows]


def _above(scene: Scene, height: float) -> Projection:
    """Return the projection of a plane above the glass [mm]: light continues through air, as if from farther."""
    flat = Projection.of(scene.camera, scene.plate)
    return replace(flat, pinhole=flat.pinhole - [0.0, 0.0, height])


def _board(
    scene: Scene, errors: CardErrors, projection: Projection, rng: np.random.Generator, rotation_deg: float,
    shift_mm: tuple[float, float],
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return nominal corners [mm] and where they are found in the frame [px]."""
    side, (across, down) = scene.card.checkerboard_side_mm, scene.card.checkerboard_squares
    grid = np.stack(np.meshgrid(np.arange(1, across), np.arange(1, down)), axis=-1).reshape(-1, 2) * float(side)
    placed = _placed((grid - grid.mean(axis=0)) * errors.board_scale, rotation_deg, shift_mm)
    u, v = projection.to_image(placed[:, 0], placed[:, 1])
    seen = np.stack([u, v], axis=-1) + rng.normal(0.0, errors.corner_noise_px, (len(u), 2))
    inside = np.all((seen > 2) & (seen < np.array(scene.camera.resolution_px) - 3), axis=1)
    return np.asarray(grid[inside], np.float64), np.asarray(seen[inside], np.float64)


def _placed(points: Floats, rotation_deg: float, shift_mm: tuple[float, float]) -> Floats:
    turn = np.deg2rad(rotation_deg)
    matrix = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return np.asarray(points @ matrix + np.array(shift_mm))


def _square(side: float, projection: Projection, rotation_deg: float, shift_mm: tuple[float, float]) -> Floats:
    """Return the outline of a square card in the frame (n, 2) [px]."""
    along = np.linspace(-0.5, 0.5, 101)
    one = np.full_like(along, 0.5)
    outline = np.concatenate(
        [np.stack(e, axis=-1) for e in ((along, -one), (one, along), (-along, one), (-one, -along))]
    )
    placed = _placed(outline * side, rotation_deg, shift_mm)
    u, v = projection.to_image(placed[:, 0], placed[:, 1])
    return np.stack([u, v], axis=-1)
