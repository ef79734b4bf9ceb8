"""The twin of a contact frame: outlines of drawn frames, the camera's curve, fits of frames whose light is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.chain.simulate import simulate
from evanesce.cli.app import app
from evanesce.core.errors import InputError
from evanesce.render.fast.transport import render_fast
from evanesce.rig import load_scene
from evanesce.sensor.codec import write_png
from evanesce.sensor.colour import ImageProcessor, colour_of_level, exact_colour_of_level
from evanesce.sensor.response import led_response
from evanesce.studies.contact_twin.fit import _covariance, fit, log_score, response_of, streak_start
from evanesce.studies.contact_twin.light import press_of
from evanesce.studies.contact_twin.model import Believed, Model
from evanesce.studies.contact_twin.picture import Outline, outline_of, picture_of, regions
from evanesce.studies.contact_twin.study import peaks

SCENE = load_scene("thesis_ridged_red").with_({"finger.ridges": None, "grid.samples": 256})


def drawn(
    shape: tuple[int, int], centre: tuple[float, float], contact: float, finger: float, streak: bool = False
) -> np.ndarray:
    """Return a frame of a white disc in a red one on a dark red ground, drawn with four samples a side of a pixel."""
    rows, cols = shape
    y, x = (np.arange(n * 4) / 4 - 0.375 for n in (rows, cols))
    distance = np.hypot(x[None] - centre[0], y[:, None] - centre[1])
    image = np.empty((rows * 4, cols * 4, 3))
    image[:] = (70, 0, 0)
    image[distance < finger] = (254, 0, 18)
    image[distance < contact] = (254, 254, 210)
    if streak:
        image[(np.abs(x[None] - centre[0] - 0 * y[:, None]) < 2) & (y[:, None] > centre[1] + finger)] = (250, 120, 90)
    return np.rint(image.reshape(rows, 4, cols, 4, 3).mean(axis=(1, 3))).astype(np.uint8)


@pytest.mark.parametrize(
    ("shape", "centre", "contact", "finger"),
    [
        ((42, 53), (20.4, 18.1), 8.2, 14.0),
        ((90, 120), (60.0, 50.5), 12.0, 30.0),
        ((300, 400), (230.0, 140.0), 40.0, 90.0),
    ],
)
def test_outlines_of_drawn_discs(
    shape: tuple[int, int], centre: tuple[float, float], contact: float, finger: float
) -> None:
    picture = picture_of(drawn(shape, centre, contact, finger))
    found, step = outline_of(picture), picture.bin_px
    assert picture.data.shape[1] <= 64
    middle = [(c + 0.5) / step - 0.5 for c in centre]
    assert found.centre == pytest.approx(middle, abs=0.2)
    assert found.contact_radius * step == pytest.approx(contact, abs=0.3 * step)
    assert found.finger_radius * step == pytest.approx(finger, abs=1.1 * step)
    assert 0.4 < picture.held_out.mean() < 0.6
    masks = regions(picture.data)
    assert masks["contact"].sum() == pytest.approx(np.pi * (contact / step) ** 2, rel=0.15)
    assert not (masks["ring"] & masks["ground"]).any()


def test_a_finger_that_is_not_lit_gets_an_outline_all_the_same() -> None:
    found = outline_of(picture_of(drawn((60, 80), (40.0, 30.0), 9.0, 9.0)))
    assert found.finger_radius == pytest.approx(1.5 * found.contact_radius)


def test_pictures_that_no_twin_can_be_made_of_are_refused_in_one_line() -> None:
    with pytest.raises(InputError, match="grey picture"):
        picture_of(np.zeros((40, 40), np.uint8))
    with pytest.raises(InputError, match="sides from 16 px"):
        picture_of(np.zeros((8, 40, 3), np.uint8))
    with pytest.raises(InputError, match="no contact"):
        outline_of(picture_of(np.zeros((40, 40, 3), np.uint8)))


@pytest.mark.parametrize("kelvin", [2500.0, 3250.0, 5500.0])
def test_the_curve_of_the_fit_is_the_cameras(kelvin: float) -> None:
    processor = ImageProcessor.imx477(kelvin)
    level, response = np.geomspace(1e-3, 100, 500), (1.0, 0.2, 0.05)
    exact = exact_colour_of_level(level, response, processor)
    assert np.abs(exact - colour_of_level(level, response, processor)).max() <= 0.6


def test_peaks_of_a_histogram_are_found_highest_first() -> None:
    grey = np.concatenate([np.full(500, 0.213), np.full(300, 0.985), np.full(900, 0.094), np.linspace(0, 1, 50)])
    np.testing.assert_allclose(peaks(grey), [0.094, 0.213, 0.985], atol=0.003)


def test_force_and_light_of_a_press() -> None:
    force, light = press_of(SCENE, 0.5)
    assert force == pytest.approx(light.state.normal_force, rel=1e-4)
    assert light.contact_mm / light.rim_mm == pytest.approx(0.5, abs=0.01)
    # The silhouette of the tip's sphere: a cone that touches it, from the pinhole, cut by the plate.
    camera = SCENE.camera
    away = camera.lens.focal_length_mm * 1e3 / camera.pixel.pitch_um / camera.scale_px_per_mm
    radius = SCENE.finger.tip_radius_mm
    rim = away * np.tan(np.arcsin(radius / (away + radius - light.state.depth)))
    assert light.rim_mm == pytest.approx(rim, abs=0.15)
    side = light.parts["contact"].shape[0]
    y, x = (np.indices((side, side)) - (side - 1) / 2) / light.px_per_mm
    radius = np.hypot(x, y)
    contact, spill, haze = (light.parts[name] for name in ("contact", "spill", "haze"))
    assert contact[radius < light.contact_mm - 0.3].mean() == pytest.approx(1.0, abs=0.02)
    assert contact[radius > light.contact_mm + 0.2].max() == 0.0
    assert spill[radius < light.contact_mm - 0.3].max() == 0.0, "silicone wets the glass: no spill reaches the contact"
    assert spill[(radius > 4.5) & (radius < light.rim_mm - 0.3)].mean() > 0.1
    assert spill[radius > light.rim_mm + 0.5].max() < 0.01
    assert haze[radius > 12].mean() > 0.0
    with pytest.raises(InputError, match="contact"):
        press_of(SCENE, 1.6)


@pytest.fixture(scope="module")
def hazy() -> tuple[np.ndarray, float]:
    """A frame of the whole chain with haze of 0.6 %, and the level of its contact."""
    view = {"camera.resolution_px": [318, 252], "camera.scale_px_per_mm": 10.0, "finger.position_mm": [1.0, -0.7]}
    scene = SCENE.with_({"surroundings": {"haze": {"top_share": 0.006, "contrast": 0.0}}, **view})
    shot = simulate(scene, 8.0, seed=1, render=render_fast)
    raw = simulate(scene.with_({"camera.analogue_gain": 1.0}), 8.0, seed=1, render=render_fast).frame.raw
    assert raw is not None
    red = raw[0::2, 0::2].astype(float) - 256.0
    level = float(np.percentile(red, 99)) / (4095 - 256) * 16.0
    return shot.frame.data, level


def test_a_hazy_frame_gives_back_its_haze_exposure_and_scale(hazy: tuple[np.ndarray, float]) -> None:
    frame, level = hazy
    picture = picture_of(frame)
    outline = outline_of(picture)
    believed = SCENE.with_(camera__scale_px_per_mm=10.0)  # which says how far away the camera is
    _, light = press_of(believed, outline.contact_radius / outline.finger_radius)
    response = led_response(believed)
    assert response is not None
    model = Model(picture, light, Believed(believed.camera, response, 0.5), outline)
    causes = ("place", "exposure", "colour", "plate_haze")
    plain, found = fit(model, causes[:3]), fit(model, causes)
    held = picture.held_out
    assert (log_score(model, found) - log_score(model, plain))[held].sum() > 300
    assert np.sqrt(((found.predicted - picture.data)[held] ** 2).mean()) < 8.0
    assert 0.01 * np.exp(found.value["haze"]) == pytest.approx(0.006, rel=0.15)
    assert 0.5 * np.exp(found.value["exposure"]) == pytest.approx(level, rel=0.15)
    assert found.value["rim_px"] * picture.bin_px / light.rim_mm == pytest.approx(10.0, rel=0.02)
    # the filters of the scene are those that are believed: the frame must not move them far
    settings = response_of(model)
    assert settings["green"] == pytest.approx(np.log(response[1] / response[0]), abs=0.35)


def test_a_streak_is_looked_for_where_it_is() -> None:
    outline = Outline((26.0, 16.0), 6.0, 11.0)
    picture = picture_of(drawn((60, 53), outline.centre, 6.0, 11.0, streak=True))
    response = led_response(SCENE)
    assert response is not None
    _, light = press_of(SCENE, 6.0 / 11.0)
    model = Model(picture, light, Believed(SCENE.camera, response, 0.5), outline)
    start = streak_start(model, fit(model, ("place", "exposure", "colour", "plate_haze")))
    assert start["streak_angle"] == pytest.approx(np.pi / 2, abs=0.2)
    assert start["streak_x"] == pytest.approx(26.0, abs=2.0)
    causes = ("place", "streak")
    bare = model.level(model.values({}, ("place",)), ("place",))
    streak = model.level(model.values(start, causes), causes) - bare
    outwards, back = streak[3 * 40, 3 * 26], streak[3 * 14, 3 * 26]
    assert outwards > 50 * back, "it begins at the rim and leads away from the finger"


def test_the_command_refuses_a_grey_picture_and_a_monochrome_scene(tmp_path: Path) -> None:
    grey, colour = tmp_path / "grey.png", tmp_path / "colour.png"
    write_png(grey, np.zeros((40, 40), np.uint8))
    write_png(colour, drawn((42, 53), (20.0, 18.0), 8.0, 14.0))
    found = CliRunner().invoke(app, ["twin", str(grey), "--contact", "--out", str(tmp_path / "a")])
    assert found.exit_code == 2
    found = CliRunner().invoke(
        app, ["twin", str(colour), "--contact", "--scene", "thesis", "--out", str(tmp_path / "b")]
    )
    assert found.exit_code == 2
    assert not (tmp_path / "b" / "report.html").exists()


def test_a_number_that_nothing_but_its_prior_tells_of_leaves_the_others_as_they_are():
    """Its one row has no residual, so that its gradient is 0: no overflow, the prior's variance, others as without."""
    rng = np.random.default_rng(2)
    jacobian, residual, blocks = np.zeros((61, 3)), np.zeros(61), np.repeat(np.arange(10), 6)
    jacobian[:60, :2], residual[:60] = rng.standard_normal((60, 2)), 3.0 * rng.standard_normal(60)
    jacobian[60, 2] = 1e-4
    found = _covariance(jacobian, residual, blocks)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[:2, :2], _covariance(jacobian[:60, :2], residual[:60], blocks), rtol=1e-6)
    assert found[2, 2] == pytest.approx(1e8 * np.mean(residual[:60] ** 2), rel=1e-6)
    # Independent residuals in a plain regression: the variance of least squares, or the blocks' where that is larger.
    plain = np.linalg.inv(jacobian[:60, :2].T @ jacobian[:60, :2]) * np.mean(residual[:60] ** 2)
    assert np.all(np.diag(found)[:2] >= np.diag(plain) * (1 - 1e-6))
