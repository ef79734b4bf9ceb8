"""Cards by counted sub-rays against the path tracer, and against what Fresnel's equations alone say."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.bundle.card_light import card_light, plane_points, through_glass
from evanesce.optics.interface import fresnel_reflectance
from evanesce.optics.projection import Projection
from evanesce.render.cards import Card, Illumination, Pose, render_card
from evanesce.rig import load_scene

CAMERA = {
    "camera.resolution_px": [120, 88],
    "camera.scale_px_per_mm": 3.65,
    "camera.pixel.pitch_um": 49.6,
    "plate.absorption_coefficient_per_mm": 0.002,
}
POSE = Pose(shift=(1.3, -0.7), rotation_deg=4.0)


def test_lying_square_agrees_with_the_path_tracer() -> None:
    scene, card = load_scene("thesis", CAMERA), Card(side=15.0, white=0.8, black=0.05)
    fast = card_light(scene, card, POSE).radiance
    traced = render_card(scene, card, POSE, samples_per_pixel=64, passes=4, seed=3)
    white = fast > 0.97 * fast.max()
    ink = (fast > 0.1 * fast.max()) & (fast < 0.2 * fast.max())
    for region in (white, ink):
        mean = float(traced.radiance[region].mean())
        error = float(np.sqrt(traced.variance[region].sum())) / region.sum()
        # The reference's illumination is a square, without the last degrees of the hemisphere: up to 2 % of its light.
        assert abs(float(fast[region].mean()) - mean) < 3 * error + 0.02 * mean


def test_table_of_fresnel_is_fresnel_for_each_pixel() -> None:
    """Bare glass sends back 2 R / (1 + R), R solved for every angle itself."""
    scene, cosine = load_scene("thesis", CAMERA), np.linspace(0.31, 0.997, 30011) ** 0.7
    face = fresnel_reflectance(cosine, 1.0, scene.plate.refractive_index)
    found = through_glass(scene, np.zeros_like(cosine), cosine, 0.4)
    np.testing.assert_allclose(found, 2 * face / (1 + face), atol=1e-7)


def test_bare_glass_mirrors_as_two_faces_do() -> None:
    scene = load_scene("thesis", CAMERA)
    n = scene.plate.refractive_index
    nothing = Card(side=0.5, margin=0.0, white=0.0, black=0.0)
    light = card_light(scene, nothing, Pose(shift=(400.0, 0.0)), illumination=Illumination(radiance=2.5))
    px, py = light.principal_point
    face = ((n - 1) / (n + 1)) ** 2
    # Within a degree of the axis Fresnel's reflectance is that of normal incidence to 1e-4.
    assert light.radiance[round(py), round(px)] == pytest.approx(2.5 * 2 * face / (1 + face), rel=1e-3)


def test_points_of_a_plane_over_the_glass_lie_on_the_rays_of_a_tilted_camera() -> None:
    """A plane at the glass is where rays meet it; 3 mm above, they have gone on in air."""
    scene = load_scene("thesis", CAMERA | {"camera.tilt_x_deg": 3.0, "camera.tilt_y_deg": -2.0, "camera.roll_deg": 7.0})
    projection = Projection.of(scene.camera, scene.plate)
    view = projection.ideal_view().finer(2)
    (rows, cols), (px, py) = view.shape, view.principal_point
    u, v = np.meshgrid((np.arange(cols) - px) / view.focal_px, (np.arange(rows) - py) / view.focal_px)
    at_glass, above = (plane_points(projection, view, height) for height in (0.0, 3.0))
    np.testing.assert_allclose(at_glass[:2], projection.ray_to_plate(u, v), rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        np.subtract(above[:2], at_glass[:2]), 3.0 * np.array(projection.tangents(u, v)), atol=1e-9
    )
    np.testing.assert_allclose(above[2], 1 / np.sqrt(1 + np.square(projection.tangents(u, v)).sum(0)), atol=1e-12)


def test_rays_of_a_finer_grid_average_to_the_directions_of_the_grid() -> None:
    view = Projection.of(load_scene("thesis", CAMERA).camera, load_scene("thesis").plate).ideal_view()
    finer = view.finer(3)
    assert finer.shape == (3 * view.shape[0], 3 * view.shape[1])
    for axis, count in ((0, view.shape[1]), (1, view.shape[0])):
        coarse = (np.arange(count) - view.principal_point[axis]) / view.focal_px
        fine = (np.arange(3 * count) - finer.principal_point[axis]) / finer.focal_px
        np.testing.assert_allclose(fine.reshape(count, 3).mean(axis=1), coarse, atol=1e-12)
