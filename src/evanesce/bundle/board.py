"""The board and the square in a lab's pictures against the card that the scene names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import WorkError
from evanesce.measurement.calibration.corners import CornerGrid, find_corners
from evanesce.measurement.calibration.model import Calibration
from evanesce.rig import Scene
from evanesce.rig.card import Cards

Array = NDArray[np.float64]
ToPlate = Callable[[Array, Array], tuple[Array, Array]]
"""``to_plate(u, v) -> (x, y)``: contact plane [mm] from pixel positions, such as :meth:`Projection.to_plate`."""

OTHER_CARD = 0.1
"""Relative difference of lengths that make it another card: a choice, beyond errors of printers and nominal lenses."""

WHOLE_MARGIN = 1.5
"""Squares that must fit into the frame beyond the outermost corners for the whole board to be seen: one and a half."""


MISSED_LINES = 2
"""Lines of corners that blur or glare may hide at the rim of a board seen whole: a choice, one on either side."""

UNEVEN = 1.03
"""Large squares over small ones beyond which a board was tilted: a camera askew by 3 degrees makes 1.025."""


@dataclass(frozen=True)
class SeenBoard:
    """A board found in a picture.

    Attributes
    ----------
    name : str
        Of the picture.
    corners : tuple of int
        Lines of inner corners along both axes, the longer first.
    side_mm : float
        Median side of a square on the contact plane [mm].
    whole : bool
        Whether the board ends within the frame all round, so that there is not more of it.
    """

    name: str
    corners: tuple[int, int]
    side_mm: float
    whole: bool = False
    uneven: float = 1.0
    """Large squares over small ones, ninetieth and tenth hundredth of their sides as if on the glass [1]."""


def nominal_plane(scene: Scene) -> ToPlate:
    """Return the contact plane [mm] as the scene's camera sees it."""
    from evanesce.optics.projection import Projection

    return Projection.of(scene.camera, scene.plate).to_plate


def calibrated_plane(calibration: Calibration, mm2_per_px: float) -> ToPlate:
    """Return the contact plane [mm] of a calibration that knows the area of a pixel of its undistorted view."""
    matrix, scale = calibration.camera_matrix, float(np.sqrt(mm2_per_px))

    def to_plate(u: Array, v: Array) -> tuple[Array, Array]:
        points = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
        straight = cv2.undistortPoints(points, matrix, calibration.distortion, P=matrix).reshape(-1, 2) * scale
        return straight[:, 0].reshape(np.shape(u)), straight[:, 1].reshape(np.shape(v))

    return to_plate


def seen_board(picture: NDArray[np.uint8], name: str, to_plate: ToPlate) -> SeenBoard | None:
    """Find the board in a picture.

    Parameters
    ----------
    picture : ndarray of uint8 (rows, cols[, 3])
        [DN].
    name : str
    to_plate : callable
        :data:`ToPlate`.

    Returns
    -------
    SeenBoard or None
        None where there is no board.
    """
    try:
        grid = find_corners(picture)
    except WorkError:
        return None
    position = grid.fit.position
    x, y = to_plate(position[:, 0], position[:, 1])
    at = {(int(i), int(j)): k for k, (i, j) in enumerate(grid.index)}
    sides = [
        np.hypot(x[k] - x[other], y[k] - y[other])
        for (i, j), k in at.items()
        for other in (at.get((i + 1, j)), at.get((i, j + 1)))
        if other is not None
    ]
    small, large = np.quantile(sides, (0.1, 0.9))
    return replace(board_of(grid, picture.shape, name, float(np.median(sides))), uneven=float(large / small))


def board_of(grid: CornerGrid, shape: tuple[int, ...], name: str, side_mm: float) -> SeenBoard:
    """Return the board of a picture's corners.

    Parameters
    ----------
    grid : CornerGrid
    shape : tuple of int
        Rows, columns of the picture.
    name : str
    side_mm : float
        Of a square.

    Returns
    -------
    SeenBoard
    """
    position = grid.fit.position
    beyond = WHOLE_MARGIN * np.abs(grid.lattice).sum(axis=2)  # of both steps, along x and y of the picture
    inside = (position - beyond >= 0).all() and (position + beyond <= [shape[1] - 1, shape[0] - 1]).all()
    lines = sorted((_lines(grid.index[:, 0]), _lines(grid.index[:, 1])), reverse=True)
    return SeenBoard(name, (lines[0], lines[1]), side_mm, bool(inside))


def calibrated_boards(calibration: Calibration) -> list[SeenBoard]:
    """Return the boards that a calibration was made of, as its file lists them; empty where it lists none.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    list of SeenBoard
        Sides as they were stated to it.
    """
    found = []
    for view, (world, image) in _corners_of_views(calibration).items():
        steps = np.concatenate([np.diff(np.unique(np.round(world[:, k], 6))) for k in (0, 1)])
        if not steps.size:
            continue
        side = float(np.median(steps))
        index = np.round(world / side).astype(int)
        lines = sorted((_lines(index[:, 0]), _lines(index[:, 1])), reverse=True)
        whole = _ends_within(world, image, side, calibration.image_size)
        found.append(SeenBoard(f"view {view} of the calibration", (lines[0], lines[1]), side, whole))
    return found


def squares_shown(calibration: Calibration) -> tuple[int, int]:
    """Return the most columns and rows of squares that a picture of a calibration shows.

    Parameters
    ----------
    calibration : Calibration
        Of pictures of a board, see :func:`calibrated_boards`.

    Returns
    -------
    tuple of int
    """
    worlds = [world for world, _ in _corners_of_views(calibration).values()]
    counts = [[_lines(np.unique(world[:, k], return_inverse=True)[1]) for k in (0, 1)] for world in worlds]
    across, down = np.max(counts, axis=0) + 1
    return int(across), int(down)


def _corners_of_views(calibration: Calibration) -> dict[Any, tuple[Array, Array]]:
    """Return the corners by view, on the board [mm] and in the picture [px], each (n, 2); empty without a list."""
    keys = ("world_x_mm", "world_y_mm", "image_x_px", "image_y_px")
    views: dict[Any, list[list[float]]] = {}
    try:
        for corner in calibration.details.get("corners", ()):
            views.setdefault(corner["view"], []).append([float(corner[key]) for key in keys])
    except (KeyError, TypeError, ValueError):
        return {}
    return {view: (np.array(places)[:, :2], np.array(places)[:, 2:]) for view, places in views.items()}


def _ends_within(world: Array, image: Array, side: float, size: tuple[int, int]) -> bool:
    """Return whether a board ends within the frame all round, by its corners on it [mm] and in the picture [px]."""
    homography, _ = cv2.findHomography(world, image)
    if homography is None:
        return False
    low, high = world.min(axis=0) - WHOLE_MARGIN * side, world.max(axis=0) + WHOLE_MARGIN * side
    rim = np.array([[[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])]])
    outline = cv2.perspectiveTransform(rim, homography)[0]
    return bool((outline >= 0).all() and (outline <= np.array(size) - 1.0).all())


def other_card(boards: Sequence[SeenBoard], card: Cards) -> str | None:
    """Return in words why the boards cannot be the scene's card; None where they can.

    Parameters
    ----------
    boards : sequence of SeenBoard
    card : Cards
        Of the scene.

    Returns
    -------
    str or None
    """
    most, least = sorted((n - 1 for n in card.checkerboard_squares), reverse=True)
    for board in boards:
        long, short = board.corners
        more = long > most or short > least
        fewer = board.whole and (most - long > MISSED_LINES or least - short > MISSED_LINES)
        if more or fewer or abs(board.side_mm / card.checkerboard_side_mm - 1) > OTHER_CARD:
            cols, rows = card.checkerboard_squares
            seen = "" if board.whole else "at least "
            tilted = f" (they differ by {100 * (board.uneven - 1):.0f} %: it was tilted, not flat on the glass)"
            return (
                f"{board.name} shows a board of {seen}{long + 1} x {short + 1} squares of {board.side_mm:.3g} mm"
                f"{tilted if board.uneven > UNEVEN else ''}; "
                f"the scene's card has {cols} x {rows} of {card.checkerboard_side_mm:g} mm"
            )
    return None


def other_square(side_mm: float | None, card: Cards) -> str | None:
    """Return in words why the square of a calibration cannot be the scene's; None where it can."""
    if side_mm is None or abs(side_mm / card.square_side_mm - 1) <= OTHER_CARD:
        return None
    return f"the calibration's square card is {side_mm:g} mm wide; the scene's {card.square_side_mm:g} mm"


def _lines(index: NDArray[np.integer[Any]]) -> int:
    """Return the number of lattice lines at least half as full as the median line."""
    counts = np.unique(index, return_counts=True)[1]
    return int((counts >= 0.5 * np.median(counts)).sum())
