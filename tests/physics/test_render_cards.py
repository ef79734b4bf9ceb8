"""Calibration targets: printed corners appear where the projection says, evenly lit, in every pose."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.core.errors import InputError
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.cards import CHECKERBOARD, SQUARE, Card, Illumination, Pose, render_card
from evanesce.render.variant import select
from support.rigs import need, small_rig

BOARD = Card(squares=(5, 4), side=2.0, margin=1.5, white=0.8, black=0.04)
POSE = Pose(shift=(2.0, -1.0), height=0.05, rotation_deg=17.0)


def corner_pixels(scene, view, card, pose):
    """Return where flat cards' corners appear, by the projection's law of refraction (no path traced)."""
    placed = pose.to_plate(card.corners())
    x, y = Projection.of(scene.camera, scene.plate).plate_to_ray(placed[:, 0], placed[:, 1])
    return x * view.focal_px + view.principal_point[0], y * view.focal_px + view.principal_point[1]


@pytest.fixture(scope="module")
def seen():
    need("llvm")
    scene = small_rig(camera__scale_px_per_mm=9.0, camera__tilt_x_deg=5.0)
    projection = Projection.of(scene.camera, scene.plate)
    view = IdealView((150, 170), projection.focal_px, (81.0, 77.5))
    light = render_card(scene, BOARD, POSE, samples_per_pixel=64, passes=2, view=view, variant="llvm")
    return scene, view, light


def test_corners_are_saddles_where_the_projection_says(seen):
    scene, view, light = seen
    u, v = corner_pixels(scene, view, BOARD, POSE)
    image = light.radiance / np.median(light.radiance[light.radiance > 0])
    angle = np.arange(48) / 48 * 2 * np.pi
    for x, y in zip(u, v, strict=True):
        # Around a corner of a board, light and dark alternate twice; a pixel off, and the second harmonic loses to
        # the first.
        ring_x, ring_y = np.round(x + 5 * np.cos(angle)).astype(int), np.round(y + 5 * np.sin(angle)).astype(int)
        harmonics = np.abs(np.fft.rfft(image[ring_y, ring_x]))
        assert harmonics[2] > 2.5 * harmonics[1]
        assert harmonics[2] > 8.0


def test_paper_and_ink_have_their_ratio(seen):
    scene, view, light = seen
    centres = np.array([[-4.0, -3.0], [-2.0, -3.0]])  # middles of the first two squares: paper, then ink
    placed = POSE.to_plate(centres)
    x, y = Projection.of(scene.camera, scene.plate).plate_to_ray(placed[:, 0], placed[:, 1])
    rows = np.round(y * view.focal_px + view.principal_point[1]).astype(int)
    cols = np.round(x * view.focal_px + view.principal_point[0]).astype(int)
    paper, ink = (light.radiance[r - 2 : r + 3, c - 2 : c + 3].mean() for r, c in zip(rows, cols, strict=True))
    # The glass's own reflection (8 % of the illumination) lies under both, and ink is lit a little less by returns.
    glare = 0.085 * 3.0e-6
    assert (ink - glare) / (paper - glare) == pytest.approx(0.05, abs=0.04)
    # White paper under a film of air and 5 mm of glass: two passes of about 0.92.
    assert paper / 3.0e-6 == pytest.approx(0.8 * 0.92**2 + 0.085, abs=0.06)


def test_illumination_brightens_towards_its_gradient():
    need("llvm")
    select("llvm")
    import mitsuba as mi

    light = Illumination(radiance=1.0, gradient=(0.3, -0.2))
    scene = mi.load_dict({"type": "scene", "source": light.shape()})

    def towards(x, y):
        ray = mi.Ray3f(mi.Point3f(0, 0, -10), mi.Vector3f(x, y, -1.0) / np.sqrt(x * x + y * y + 1))
        si = scene.ray_intersect(ray)
        return float(np.array(si.emitter(scene).eval(si))[0, 0])

    assert towards(0.0, 0.0) == pytest.approx(1.0, abs=0.02)
    # SOURCE_DISTANCE is measured from the plate's top: from z = -10 the tangent reaches 390/400 of it.
    assert towards(0.8, 0.0) == pytest.approx(1 + 0.3 * np.tanh(0.8 * 390 / 400), abs=0.03)
    assert towards(0.0, 0.8) == pytest.approx(1 - 0.2 * np.tanh(0.8 * 390 / 400), abs=0.03)


def test_tilted_card_must_clear_the_glass():
    with pytest.raises(InputError, match=r"into the glass.*at least"):
        render_card(small_rig(), BOARD, Pose(tilt_x_deg=10.0, height=0.2))


def test_shipped_cards():
    assert CHECKERBOARD.size == (42.0, 31.0)
    assert len(CHECKERBOARD.corners()) == 41 * 30
    assert SQUARE.size == (15.0, 15.0)
    assert np.ptp(SQUARE.corners(), axis=0).tolist() == [15.0, 15.0]
