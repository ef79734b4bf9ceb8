"""Cards as they really are, and effects on geometry, against projection, trigonometry and hand-made figures."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.chain.simulate import simulate_card
from evanesce.core.errors import InputError
from evanesce.effects import Context, all_effects
from evanesce.optics.projection import Projection
from evanesce.render.cards import CHECKERBOARD, SQUARE, Pose, checkerboard_of, pose_of, square_of
from evanesce.rig import Cards, Scene, load_scene
from support.rigs import need

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
    # 66 px sides; noise and the black frame's own light leave less than a quarter pixel on each of four borders
    assert lit_area(scene, frame.data) == pytest.approx(7.3**2, rel=4 * 0.25 / (7.3 * 9.0))


# --- effects ---------------------------------------------------------------------------------------------------------


def changed(scene: Scene, name: str, **values: float) -> Scene:
    effect = all_effects()[name]
    return effect.apply(scene, effect.parameters(**values), Context(scene, seed=1))


def test_a_tilted_plate_is_seen_as_the_turned_points() -> None:
    """Oracle: points turned by hand before a camera that stands still; a plate without refraction or lens error."""
    scene = load_scene(
        "thesis",
        {
            "plate.refractive_index": 1.0,
            "camera.centre_mm": [1.3, -2.1],
            "camera.tilt_x_deg": 4.0,
            "camera.tilt_y_deg": -3.0,
            "camera.roll_deg": 20.0,
            "camera.principal_point_offset_px": [17.0, -9.0],
            "camera.lens.distortion": {"k1": 0.0, "k2": 0.0},
        },
    )
    camera = Projection.of(scene.camera, scene.plate)
    points = np.array([[3.0, -4.0, 0.0], [-5.5, 1.0, 0.0], [2.2, 6.0, 0.0], [1.3, -2.1, 0.0]])
    a, b = np.deg2rad([2.5, -1.5])
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    target = np.array([1.3, -2.1, 0.0])
    turned = target + (points - target) @ (about_y @ about_x).T
    seen = (turned - camera.pinhole) @ camera.axes
    expected = camera.focal_px * seen[:, :2] / seen[:, 2:] + camera.principal_point
    rig = changed(scene, "plate_tilt", about_x_deg=2.5, about_y_deg=-1.5)
    found = np.stack(Projection.of(rig.camera, rig.plate).to_image(points[:, 0], points[:, 1]), axis=-1)
    np.testing.assert_allclose(found, expected, atol=1e-7)
    assert np.abs(found - np.stack(camera.to_image(points[:, 0], points[:, 1]), axis=-1)).max() > 3.0


def test_a_tilt_beyond_the_rig_is_refused() -> None:
    scene = load_scene("thesis", {"camera.tilt_x_deg": -24.0})
    with pytest.raises(InputError, match=r"plate_tilt.*tilt_x_deg.*-30 to 30 deg"):
        changed(scene, "plate_tilt", about_x_deg=8.0)


def test_misprints_are_of_each_card() -> None:
    scene = load_scene("thesis", {"card.square_side_mm": 14.0})
    one = changed(scene, "square_size", square=0.03)
    assert one.card.square_side_mm == pytest.approx(14.42)
    assert one.card.checkerboard_side_mm == 1.0
    both = changed(one, "square_size", square=-0.1, checkerboard=0.02)
    assert both.card.square_side_mm == pytest.approx(14.42 * 0.9)
    assert both.card.checkerboard_side_mm == pytest.approx(1.02)
    with pytest.raises(InputError, match=r"square_size.*0\.05 to 100 mm"):
        changed(load_scene("thesis", {"card.checkerboard_side_mm": 0.05}), "square_size", checkerboard=-0.1)


def test_a_card_cannot_go_into_the_glass() -> None:
    scene = load_scene("thesis", {"card.height_mm": 0.02})
    assert changed(scene, "card_offset", height_mm=0.7).card.height_mm == pytest.approx(0.72)
    with pytest.raises(InputError, match=r"card_offset\.height_mm.*0\.001 to 50 mm"):
        changed(scene, "card_offset", height_mm=-0.03)


def test_a_card_that_stands_off_looks_smaller_and_a_larger_print_larger() -> None:
    """In the picture: a square 4 mm further than the lens's distance shrinks by that ratio; a print grows by itself."""
    need("llvm")
    more = {"card_offset": {"height_mm": 4.0}, "square_size": {"square": 0.09}}
    options = {"seed": 3, "variant": "llvm", "samples_per_pixel": 36, "passes": 2}
    scene = load_scene("thesis", SMALL)
    area = {
        name: lit_area(scene, simulate_card(scene.model_copy(update={"effects": e}), "square", **options).data)
        for name, e in {"plain": {}, "off": {"card_offset": more["card_offset"]}, "both": more}.items()
    }
    distance = scene.camera.lens.focal_length_mm * 1e3 / scene.camera.pixel.pitch_um / scene.camera.scale_px_per_mm
    ratio = (distance / (distance + 4.0)) ** 2
    noise = 4 * 0.25 / (7.3 * 9.0)  # as above, for each of the two areas
    assert area["off"] / area["plain"] == pytest.approx(ratio, abs=noise)
    assert ratio < 1 - 4 * noise
    assert area["both"] / area["off"] == pytest.approx(1.09**2, abs=noise)
