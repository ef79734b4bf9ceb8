"""Frames in colour are predicted as a camera makes them: noise cut off at black, demosaicing, matrix, curve."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import ndimage
from tests.inference import development_rigs as rigs

from evanesce.bundle.layout import Shot
from evanesce.bundle.read import read_bundle
from evanesce.bundle.write import Rig
from evanesce.core.errors import InputError
from evanesce.effects import all_effects
from evanesce.inference.calibration.fit import fit_rig
from evanesce.inference.critic import criticise_frames
from evanesce.inference.data import data_vector
from evanesce.prediction.codecs import Codec
from evanesce.prediction.colour import area_in, expected_grey, grey_of, reading_of, require_predictable
from evanesce.prediction.fine import FinePredictor
from evanesce.prediction.observe import Observation, observe
from evanesce.prediction.predict import Predictor
from evanesce.prediction.recoded import Shooting
from evanesce.prediction.tone import expected_tone
from evanesce.prediction.views import View, binned
from evanesce.rig import Scene, load_scene
from evanesce.sensor.colour import ImageProcessor
from evanesce.sensor.response import card_response, led_response

GREY = np.array([0.2125, 0.7154, 0.0721])
"""Of scikit-image's rgb2gray."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    return rigs.RIGS["red"].scene()


def own_frames(scene: Scene, light: np.ndarray, response: tuple[float, ...], rng: np.random.Generator) -> np.ndarray:
    """Return the grey of a frame of light [raw DN before a filter], by NumPy alone but for the processor's numbers."""
    camera, pixel, processor = scene.camera, scene.camera.pixel, ImageProcessor.of(scene.camera)
    e_per_DN = pixel.conversion_gain_e_per_DN / camera.analogue_gain
    _rows, _cols = light.shape
    y, x = np.indices(light.shape)
    sites = {0: (y % 2 == 0) & (x % 2 == 0), 1: (y + x) % 2 == 1, 2: (y % 2 == 1) & (x % 2 == 1)}
    share = sum(response[c] * where for c, where in sites.items())
    charge = rng.poisson(share * light * e_per_DN) + pixel.read_noise_e * rng.standard_normal(light.shape)
    raw = np.clip(np.round(charge / e_per_DN + pixel.black_level_DN), 0, 2**pixel.bits - 1)
    value = np.clip((raw - pixel.black_level_DN) / (2**pixel.bits - 1 - pixel.black_level_DN), 0.0, 1.0)
    square = np.array([[0.25, 0.5, 0.25], [0.5, 1.0, 0.5], [0.25, 0.5, 0.25]])
    cross = np.array([[0.0, 0.25, 0.0], [0.25, 1.0, 0.25], [0.0, 0.25, 0.0]])
    colour = np.stack(
        [
            ndimage.convolve(
                np.where(sites[c], np.minimum(processor.gains[c] * value, 1.0), 0.0), kernel, mode="mirror"
            )
            for c, kernel in enumerate((square, cross, square))
        ],
        axis=-1,
    )
    linear = np.clip(colour @ np.array(processor.matrix).T, 0.0, 1.0)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)
    return np.floor(255.0 * curve + 0.5) @ GREY


@pytest.mark.parametrize("gain", [1.0, 8.0])
@pytest.mark.parametrize("lamp", [False, True])
def test_mean_and_scatter_of_grey_are_those_of_noisy_mosaics(scene: Scene, gain: float, lamp: bool) -> None:
    camera = scene.camera.model_copy(update={"analogue_gain": gain, "tone_curve": "srgb", "resolution_px": (400, 400)})
    pixel = camera.pixel.model_copy(update={"dark_current_e_per_s": 0.0})
    own = scene.model_copy(update={"camera": camera.model_copy(update={"pixel": pixel})})
    response = card_response(own.camera) if lamp else led_response(own)
    assert response is not None
    tone, rng = expected_grey(own, card=lamp), np.random.default_rng(2)
    for light in (0.0, 30.0, 150.0, 1000.0, 0.6 * 4095 / max(response)):
        frames = [own_frames(own, np.full((400, 400), light), response, rng)[8:-8, 8:-8] for _ in range(4)]
        bins = np.array([binned(frame) for frame in frames])
        at = np.array(pixel.black_level_DN + light)
        mean = float(np.mean(frames))
        error = float(np.std([b.mean() for b in bins]) / 2) + 1e-3
        # Neighbours' means are taken for nearly normal: to two hundredths of the noise.
        assert abs(mean - tone.mean_of(at)) < 5 * error + 0.02 * np.std(frames), (light, mean, tone.mean_of(at))
        if np.std(frames) > 0.05 and mean < 0.99 * tone.full_DN:
            assert tone.variance_at(np.array(mean)) == pytest.approx(np.var(frames), rel=0.16)
            assert tone.binned_variance_at(np.array(mean)) == pytest.approx(bins.var(), rel=0.35)


def test_a_frame_of_a_contact_is_the_mean_of_noisy_ones(scene: Scene) -> None:
    rig, count = Rig(scene, 4, finer=1), 24
    shot = Shot(index=0, time_s=0.0, force_N=3.0, voltage_V=9.0)
    frames = np.array([grey_of(rig.press(shot, index=k)[0]) for k in range(count)])
    view = View(kind="press", force_N=3.0, voltage_V=9.0)
    fine = FinePredictor(scene, [view], 1, fine_px=1).image({}, 0)
    quick = Predictor(scene, [view]).image({}, 0)
    error = frames.std(axis=0, ddof=1) / np.sqrt(count)
    edge = (fine > 6) & (fine < 30)
    assert edge.sum() > 60
    for predicted in (fine, quick):
        away = (frames.mean(axis=0) - predicted)[edge] / error[edge]
        assert np.mean(away**2) < 2.0
    # Demosaicing shows at the edge: light alone, developed pixel by pixel, is off by many times that.
    other = Predictor(scene, [view], pixels=1.0 + 1e-9).image({}, 0)
    assert np.mean(((frames.mean(axis=0) - other)[edge] / error[edge]) ** 2) > 10.0


@pytest.mark.parametrize(
    "point",
    [
        {"saturation:well_loss": 0.93, "saturation:knee": 0.02},
        {"black_level:offset_DN": 6.0},
        {"tone_curve:gamma": 0.1},
    ],
)
def test_an_effect_behind_the_lens_acts_on_each_filter(scene: Scene, point: dict[str, float]) -> None:
    rig, count = Rig(rigged(scene, point), 4, finer=1), 24
    shot = Shot(index=0, time_s=0.0, force_N=3.0, voltage_V=9.0)
    frames = np.array([grey_of(rig.press(shot, index=k)[0]) for k in range(count)])
    view = View(kind="press", force_N=3.0, voltage_V=9.0)
    predictor = FinePredictor(scene, [view], 1, fine_px=1)
    before, after = (binned(predictor.image(p, 0)) for p in ({}, point))
    change = binned(frames.mean(axis=0)) - before
    noise = binned(frames).std(axis=0) / np.sqrt(count) + 0.1
    assert (change**2).sum() > 20 * ((after - before - change) ** 2).sum()
    assert np.mean(((after - before - change) / noise) ** 2) < 1.5


def rigged(scene: Scene, point: dict[str, float]) -> Scene:
    """Return a scene with the effect of a point."""
    table: dict[str, dict[str, float]] = {}
    for name, value in point.items():
        effect, _, parameter = name.partition(":")
        table.setdefault(effect, {})[parameter] = value
    return scene.model_copy(update={"effects": table})


def test_a_card_is_lit_by_the_lamp_whatever_light_the_leds_have(scene: Scene) -> None:
    shown = Rig(scene, 1, finer=1).card("square", 0)
    paper = shown[4:20, 4:20].reshape(-1, 3).mean(axis=0)
    assert paper.min() > 0.6 * paper.max()  # of red light green and blue are cut to nothing


def test_areas_are_read_by_steps_as_fine_as_of_a_monochrome_frame(scene: Scene) -> None:
    full = expected_grey(scene).full_DN
    assert full == pytest.approx(255 * GREY[0], rel=0.01)
    cols, rows = scene.camera.resolution_px
    y, x = np.mgrid[0:rows, 0:cols]
    radius = 2.5 * scene.camera.scale_px_per_mm
    disc = np.clip(radius - np.hypot(x - cols / 2, y - rows / 2) + 0.5, 0.0, 1.0)
    plain = scene.model_copy(update={"camera": scene.camera.model_copy(update={"colour": None})})
    assert area_in(0.8 * full * disc, scene) == pytest.approx(area_in(0.8 * 255 * disc, plain), rel=1e-3)
    assert area_in(0.8 * 255 * disc, plain) == pytest.approx(np.pi * 2.5**2, rel=0.2)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"camera.colour.white_balance": "automatic"}, "camera.colour.white_balance"),
        ({"camera.auto_exposure.mode": "normal"}, "camera.auto_exposure"),
        ({"camera.colour.contrast_enhancement": True}, "camera.colour.contrast_enhancement"),
        ({"camera.colour.sharpening": 0.5}, "camera.colour.sharpening"),
    ],
)
def test_what_follows_the_frame_is_refused(changes: dict[str, object], key: str, tmp_path: Path) -> None:
    shown = load_scene("thesis_ridged_red", changes)
    bundle = type("Bundle", (), {"scene": shown, "path": tmp_path})()
    with pytest.raises(InputError, match=key):
        require_predictable(bundle)


def test_a_codec_keeps_colour() -> None:
    rng = np.random.default_rng(0)
    frame = np.clip(ndimage.gaussian_filter(rng.normal(120, 300, (48, 64, 3)), (3, 3, 0)), 0, 255).astype(np.uint8)
    _, data = cv2.imencode(".jpg", frame[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])
    back = next(Codec("jpeg", 80).through(iter([frame])))
    np.testing.assert_array_equal(back, cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1])
    film = next(Codec("h264", 20, 1).through(iter([frame])))
    assert film.shape == frame.shape
    assert np.abs(film.astype(float) - frame).mean() < 12


@pytest.mark.parametrize("card", [False, True])
def test_shot_frames_have_the_grey_that_was_asked_for(scene: Scene, card: bool) -> None:
    shooting = Shooting(scene, 1.0, 1, card=card)
    level = np.linspace(1.0, 180.0 if card else 45.0, 88 * 120).reshape(88, 120)
    frames = shooting.frames(shooting.signal(level), np.random.default_rng(3))
    shown = np.array([grey_of(next(frames)) for _ in range(60)])
    away = (binned(shown.mean(axis=0)) - binned(level))[1:-1, 1:-1]  # demosaicing has no neighbours beyond
    assert np.abs(away).mean() < 0.15


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("red") / "bundle"
    rigs.write_rig("red", folder)
    return folder


def test_noise_of_colour_frames_is_measured(bundle: Path) -> None:

    seen = observe(read_bundle(bundle))
    assert seen.images.shape[1:] == (88, 120)
    data = data_vector(seen)
    assert 0.9 < data.scale < 1.1
    # Demosaicing makes neighbours alike.
    assert data.correlation is not None
    assert data.correlation.spectrum[0, 0, 1] > 1.15 > 0.9 > data.correlation.spectrum[0, -1, -1]


def test_bins_at_the_end_of_the_scale_are_left_out_by_their_level(scene: Scene) -> None:
    """Rationale: of bins about the end those were kept that were low by chance, and the answer was saturation."""
    mono = load_scene("thesis", {"camera.resolution_px": [120, 88], "camera.scale_px_per_mm": 6.0})
    rng = np.random.default_rng(1)
    # a ramp up to the end: kept are the bins below it, at their level and by no chance
    mean = np.broadcast_to(np.linspace(235.0, 253.9, 120), (88, 120))
    images = (mean + 0.6 * rng.standard_normal((3, 88, 120))).astype(np.float32)
    views = tuple(View(kind="press", force_N=1.0, voltage_V=9.0, index=k) for k in range(3))
    data = data_vector(Observation(believed=mono, scene=mono, views=views, images=images), np.array([binned(mean)] * 3))
    kept, level = data.valid, np.array([binned(mean)] * 3)
    assert 0.5 < kept.mean() < 1.0
    assert not kept[level > 253.5].any()
    assert (kept == kept[:, :1]).all()
    assert abs((data.cube - level)[kept].mean()) < 0.02


def test_a_monochrome_camera_has_the_tone_it_had() -> None:
    mono = load_scene("thesis")
    assert expected_grey(mono, 1.1) is expected_tone(mono.camera, 1.1)
    assert replace(expected_grey(mono), black_DN=0.0).full_DN == 255.0


@pytest.mark.slow  # 80 s: a fit of all that hides in a red rig
def test_causes_are_found_in_frames_in_colour(bundle: Path) -> None:
    considered = {"modulus", "black_level", "vignetting", "tone_curve", "led_droop", "defocus"}
    found = criticise_frames(read_bundle(bundle), exclude=set(all_effects()) - considered).result
    causes = {cause["id"]: cause for cause in found["causes"]}
    assert {"modulus", "black_level"} <= set(causes)
    stiffer = causes["modulus"]["parameters"]["relative"]
    assert stiffer["lo"] < 0.15 < stiffer["hi"]
    before, after = found["held_out"]["area_error_percent"]
    assert after < 0.5 < before


@pytest.mark.slow  # 190 s, of one process
def test_a_red_rig_is_calibrated(bundle: Path) -> None:
    fitted = fit_rig(read_bundle(bundle))
    assert fitted.gain is not None
    assert fitted.gain.area_percent[1] < 0.5 < fitted.gain.area_percent[0]
    stiffer = fitted.figures["modulus:relative"]
    assert stiffer.low < 0.15 < stiffer.high


def test_a_threshold_stands_clear_of_ground_and_contact() -> None:
    """Rationale: over a ground at the usual threshold the whole frame was read as contact, in every press alike."""
    mono = load_scene("thesis", {"camera.resolution_px": [200, 150], "camera.scale_px_per_mm": 10.0})
    y, x = np.mgrid[0:150, 0:200]
    inside = np.hypot(x - 100, y - 75) < 30
    assert reading_of(np.where(inside, 130.0, 20.0), mono) is None
    assert reading_of(np.full((150, 200), 4.0), mono) is None
    assert reading_of(np.random.default_rng(0).normal(30.0, 1.0, (150, 200)), mono) is None
    over = np.where(inside, 200.0, 40.0)
    assert area_in(over, mono) > 200.0
    reading = reading_of(over, mono)
    assert reading is not None
    assert reading.threshold == pytest.approx(120 / 255)
    assert area_in(over, mono, reading) == pytest.approx(np.pi * 3.0**2, rel=0.03)
