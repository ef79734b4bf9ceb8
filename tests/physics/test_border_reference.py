"""LEDs at the frame's border, path traced: images of the LEDs in the faces, what bevels turn, and the effect's law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evanesce.effects import Context, all_effects
from evanesce.optics.led import each_led_power, led_positions
from evanesce.optics.projection import Projection
from evanesce.render.fast.defects import plate_points
from evanesce.render.fast.transport import render_fast
from evanesce.render.reference.border import image_positions, render_border
from evanesce.render.reference.path import render
from evanesce.rig import Scene, load_scene
from evanesce.rig.coarser import coarser_camera

EDGE = -15.0
"""x of the lit edge, within the frame [mm]."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    changes = {"plate.size_mm": [-2 * EDGE, 64.0], "plate.thickness_mm": 5.0, "leds.edges": ["left"]}
    return coarser_camera(load_scene("thesis", changes), 5, key="factor")


def seen_at(scene: Scene, height: float, at: tuple[float, float]) -> tuple[float, float]:
    """Where on the top face a point ``height`` over it, in glass throughout, appears: Snell's law, by bisection."""
    flat = Projection.of(scene.camera, scene.plate)
    nadir, air, n, t = flat.pinhole[:2], flat.clearance, scene.plate.refractive_index, scene.plate.thickness_mm
    way = np.array(at) - nadir
    far = float(np.hypot(*way))

    def reach(sine: float, glass: float) -> float:
        return air * sine / np.sqrt(1 - sine**2) + glass * sine / np.sqrt(n**2 - sine**2)

    low, high = 0.0, 0.999
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if reach(middle, t + height) < far else (low, middle)
    x, y = nadir + way / far * reach(low, t)
    return float(x), float(y)


@pytest.mark.slow  # 30 s
def test_images_of_the_leds_stand_where_the_faces_mirror_them_and_fall_by_the_faces_reflectance(scene: Scene) -> None:
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    traced = render_border(scene, each_led_power(scene.plate, scene.leds), view, samples_per_pixel=32, seed=3)
    x, y = plate_points(scene, traced)
    heights, shares = image_positions(scene, 2)
    centres = [c for c in led_positions(scene.plate, scene.leds)["left"] if abs(c) < 10]
    assert len(centres) == 2
    flux = np.zeros((len(centres), 2))
    for i, centre in enumerate(centres):
        for k in (1, 2):
            at = seen_at(scene, heights[k], (EDGE, centre))
            near = (np.abs(x - at[0]) < 0.55) & (np.abs(y - at[1]) < 2.5)
            light = traced.radiance[near] - np.median(traced.radiance[near])
            flux[i, k - 1] = light.sum()
            if k == 1:
                # a fifth of a pixel of 0.086 mm, and the image's own perspective
                assert (x[near] @ light / light.sum(), y[near] @ light / light.sum()) == pytest.approx(at, abs=0.12)
                # the effect has the LED's own coordinate there: the image is nearer to the middle by a twentieth
                assert 0.93 < at[1] / centre < 0.98
    # images shrink towards the middle; R is that of 12 degrees
    assert flux[:, 1].sum() / flux[:, 0].sum() == pytest.approx(shares[2] / shares[1], rel=0.25)


@pytest.mark.slow  # 20 s
def test_without_bevels_it_is_the_path_tracers_plate(scene: Scene) -> None:
    coarse = coarser_camera(scene, 2, key="factor")
    view = Projection.of(coarse.camera, coarse.plate).ideal_view()
    powers = each_led_power(coarse.plate, coarse.leds)
    own = render_border(coarse, powers, view, samples_per_pixel=64, seed=3)
    other = render(coarse, None, view=view, samples_per_pixel=64, passes=8, seed=4)
    x, _ = plate_points(coarse, own)
    for low, high in ((EDGE - 1.0, EDGE - 0.3), (EDGE + 0.3, EDGE + 1.3)):
        where = (x > low) & (x < high)
        error = np.sqrt((own.variance + other.variance)[where].sum()) / where.sum()
        assert own.radiance[where].mean() == pytest.approx(other.radiance[where].mean(), abs=5 * error)


@pytest.mark.slow  # 20 s
def test_a_bevel_shows_the_far_edges_leds_where_the_clear_plate_is_dark(scene: Scene) -> None:
    """Camera rays that go up and outwards meet a bevel of 45 degrees and are turned along the plate."""
    coarse = coarser_camera(scene, 2, key="factor")
    view = Projection.of(coarse.camera, coarse.plate).ideal_view()
    powers = each_led_power(coarse.plate, coarse.leds)
    plain, cut, rough = (
        render_border(coarse, powers, view, bevel_mm=width, roughness=alpha, samples_per_pixel=64, seed=3)
        for width, alpha in ((0.0, 0.0), (1.0, 0.0), (1.0, 0.4))
    )
    x, y = plate_points(coarse, plain)
    # within the bevel's width of the edge that is not lit; the middle, away from the plate's other edges
    band = (x > -EDGE - 0.9) & (x < -EDGE - 0.2) & (np.abs(y) < 8)
    inner = (np.abs(x) < 8) & (np.abs(y) < 8)
    levels = [float(light.radiance[band].mean()) for light in (plain, cut, rough)]
    errors = [float(np.sqrt(light.variance[band].sum()) / band.sum()) for light in (plain, cut, rough)]
    assert levels[2] > levels[0] + 5 * np.hypot(errors[2], errors[0])
    assert levels[1] != levels[0]
    for light in (plain, cut, rough):
        assert light.radiance[inner].mean() < 0.01 * max(levels)


def test_the_effects_band_has_one_decay_where_images_fall_in_steps(scene: Scene) -> None:
    """Of a clear plate the images fall by R = 4.3 % a step: an e-fold of half a millimetre, not of 3."""
    heights, shares = image_positions(scene, 3)
    found = [seen_at(scene, h, (EDGE, 0.0))[0] - EDGE for h in heights[1:]]
    decay = -np.polyfit(found, np.log(shares[1:]), 1)[0]
    assert 0.3 < 1 / decay < 0.7
    effect = all_effects()["led_edge_reflections"]
    light = render_fast(scene, None)
    added = effect.apply(light, effect.parameters(relative_radiance=0.13), Context(scene, seed=1))
    x, _ = plate_points(scene, light)
    rows = np.abs(plate_points(scene, light)[1]) < 8
    profile = [added.radiance[rows & (np.abs(x - at) < 0.2)].mean() for at in (-8.0, -4.9)]
    assert profile[0] / profile[1] == pytest.approx(np.e, rel=0.05)
    assert replace(light, radiance=added.radiance).radiance.max() > 0
