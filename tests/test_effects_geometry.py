"""Cards as they really are, and effects on geometry, against projection, trigonometry and hand-made figures."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.errors import InputError
from evanesce.optics.projection import Projection
from evanesce.render.cards import CHECKERBOARD, SQUARE, Pose, checkerboard_of, pose_of, square_of
from evanesce.rig import Cards, Scene, load_scene
from evanesce.simulate import simulate_card
from rigs import need

# --- the [card] table ------------------------------------------------------------------------------------------------

SMALL = {
    "camera.resolution_px": [210, 180],
    "camera.scale_px_per_mm": 9.0,
    "camera.centre_mm": [1.1, -0.7],
    "camera.exposure_ms": 2.0,
    "camera.lens.focal_length_mm": 2.6,
    "camera.lens.f_number": 4.0,
    "camera.lens.distortion": {"k1": 0.0},
    "camera.tone_curve": "linear",
    "card.square_side_mm": 7.3,
    "card.square_margin_mm": 12.0,
}


def test_a_scene_without_cards_has_those_of_the_thesis() -> None:
    cards = load_scene("thesis").card
    assert cards == Cards()
    assert (checkerboard_of(cards), square_of(cards)) == (CHECKERBOARD, SQUARE)
    assert (CHECKERBOARD.squares, CHECKERBOARD.side, SQUARE.side) == ((42, 31), 1.0, 15.0)
    assert pose_of(cards) == Pose()


def test_the_table_reaches_card_and_pose() -> None:
    scene = load_scene(
        "thesis",
        {
            "card.square_side_mm": 14.2,
            "card.square_inverted": True,
            "card.checkerboard_squares": [9, 7],
            "card.checkerboard_side_mm": 2.03,
            "card.height_mm": 0.31,
            "card.black_reflectance": 0.09,
        },
    )
    square, board = square_of(scene.card), checkerboard_of(scene.card)
    assert (square.size, square.inverted, square.black) == ((14.2, 14.2), True, 0.09)
    assert board.size == pytest.approx((9 * 2.03, 7 * 2.03))
    assert pose_of(scene.card, Pose(height=6.0, tilt_x_deg=9.0)).height == pytest.approx(6.26)
    assert pose_of(scene.card, Pose(height=6.0, tilt_x_deg=9.0)).tilt_x_deg == 9.0


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("card.square_side_mm", 0.0, "0.5 to 500 mm"),
        ("card.height_mm", 0.0, "0.001 to 50 mm"),
        ("card.square_side_um", 15000.0, "square_side_mm"),
        ("card.checkerboard_squares", [42, 1], "2 to 1000"),
    ],
)
def test_wrong_cards_are_one_clear_line(key: str, value: object, words: str) -> None:
    with pytest.raises(InputError, match="card") as error:
        load_scene("thesis", {key: value})
    assert words in str(error.value)


def lit_area(scene: Scene, data: np.ndarray) -> float:
    """Area [mm^2] of the white square in a linear picture: each pixel counts by its place between black and white."""
    grey = data.astype(float)
    black, white = np.percentile(grey, 5), np.median(grey[grey > 0.5 * grey.max()])
    share = np.clip((grey - black) / (white - black), 0.0, 1.0)
    rows, cols = grey.shape
    edge_u, edge_v = np.meshgrid(np.arange(cols + 1) - 0.5, np.arange(rows + 1) - 0.5)
    x, y = Projection.of(scene.camera, scene.plate).to_plate(edge_u, edge_v)
    dx, dy = np.diff(x, axis=1)[:-1], np.diff(y, axis=0)[:, :-1]
    return float((share * dx * dy)[share > 0.2].sum())


def test_the_picture_of_a_square_shows_the_printed_size() -> None:
    need("llvm")
    scene = load_scene("thesis", SMALL)
    frame = simulate_card(scene, "square", seed=3, variant="llvm", samples_per_pixel=36, passes=2)
    # 53 px sides; noise and the black frame's own light leave less than a quarter pixel on each of four borders
    assert lit_area(scene, frame.data) == pytest.approx(7.3**2, rel=4 * 0.25 / (7.3 * 9.0))
