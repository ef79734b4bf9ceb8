"""Levels read from colour frames, and the refined estimator on them: closed forms, Monte Carlo, own mosaics."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.stats import norm
from test_estimator import BLUR_PX, SCALE_PX_PER_MM, ellipse, uniform_calibration

import evanesce as ev
from evanesce.core.errors import InputError
from evanesce.core.states import Frame
from evanesce.evaluation.camera_model import camera_model, clipped_normal, read_camera_model
from evanesce.measurement.io.frames import open_frames
from evanesce.measurement.refined.colour import CameraModel
from evanesce.measurement.refined.estimator import Estimator
from evanesce.measurement.refined.light import Radiometry
from evanesce.measurement.refined.raw import RawModel
from evanesce.measurement.uncertainty.area import refined_uncertainty
from evanesce.measurement.uncertainty.components import film_opening
from evanesce.measurement.warnings import EdgeLog
from evanesce.rig import load_scene
from evanesce.sensor.codec import write_video
from evanesce.sensor.colour import ImageProcessor, colour_of_level

RESPONSE = np.array([1.0, 0.15, 0.05])
GAINS = np.array([2.1, 1.0, 2.0])
MATRIX = np.array([[2.0, -0.75, -0.25], [-0.4, 2.0, -0.6], [0.0, -0.9, 1.9]])
FULL_E = 4000.0


def curve(light: np.ndarray) -> np.ndarray:
    return np.clip(light, 0.0, 1.0) ** 0.45


def own_model() -> CameraModel:
    """Return the model of the camera drawn here, by Monte Carlo of single pixels."""
    levels = np.concatenate([[0.0], np.geomspace(1e-3, 60.0, 500)])
    rng = np.random.default_rng(0)
    charge = rng.poisson(levels[:, None, None] * RESPONSE * FULL_E, (len(levels), 400, 3))
    balanced = np.minimum(np.minimum(charge / FULL_E, 1.0) * GAINS, 1.0)
    output = balanced @ MATRIX.T
    return CameraModel(
        levels=levels, output=output.mean(axis=1), noise=output.std(axis=1), tone=(np.arange(256) / 255) ** (1 / 0.45),
        balanced=balanced.mean(axis=1), matrix=MATRIX,
    )  # fmt: skip


def photograph(level: np.ndarray, seed: int) -> np.ndarray:
    """Return the frame of a light level: mosaic, shot noise, bilinear demosaicing, matrix, curve."""
    rows, cols = np.indices(level.shape)
    channel = np.where((rows % 2 == 0) & (cols % 2 == 0), 0, np.where((rows % 2) & (cols % 2), 2, 1))
    charge = np.random.default_rng(seed).poisson(level * RESPONSE[channel] * FULL_E)
    mosaic = np.minimum(np.minimum(charge / FULL_E, 1.0) * GAINS[channel], 1.0)
    kernel = np.array([[1.0, 2.0, 1.0], [2.0, 4.0, 2.0], [1.0, 2.0, 1.0]])
    planes = []
    for k in range(3):
        here = (channel == k).astype(float)
        own = kernel if k != 1 else np.array([[0.0, 1.0, 0.0], [1.0, 4.0, 1.0], [0.0, 1.0, 0.0]])
        planes.append(cv2.filter2D(mosaic * here, -1, own) / cv2.filter2D(here, -1, own))
    return np.floor(255 * curve(np.stack(planes, axis=-1) @ MATRIX.T) + 0.5).astype(np.uint8)


def test_mean_and_deviation_of_a_clipped_normal() -> None:
    """Against numerical integration."""
    x = np.linspace(-8.0, 10.0, 400_001)
    for mean, deviation, end in ((0.3, 0.2, 0.5), (1.0, 0.7, 0.1), (0.0, 1.0, 6.0)):
        weight = norm.pdf(x, mean, deviation) * (x[1] - x[0])
        value = np.minimum(x, end)
        first = (value * weight).sum()
        found = clipped_normal(np.array(mean), np.array(deviation), end)
        assert found[0] == pytest.approx(first, abs=1e-5)
        assert found[1] == pytest.approx(np.sqrt(((value - first) ** 2 * weight).sum()), abs=1e-5)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_level_of_a_colour_is_within_its_deviation(seed: int) -> None:
    """A level's own colour, without noise, is read back within its stated deviation, for drawn processors."""
    rng = np.random.default_rng(seed)
    response = [1.0, float(rng.uniform(0.04, 0.3)), float(rng.uniform(0.01, 0.15))]
    kelvin = float(rng.uniform(2400, 5800))
    scene = load_scene("thesis_ridged_red", {"camera.colour": {"response": response, "temperature_K": kelvin}})
    model = camera_model(scene)
    levels = np.geomspace(0.02, 0.9 * model.top, 60)
    colours = colour_of_level(levels, response, ImageProcessor.of(scene.camera))
    level, deviation, above = model.read(colours[None])
    # a flat posterior's ends lie sqrt(3) standard deviations from its mean
    assert (np.abs(level[0] - levels) < 2.2 * deviation[0] + 0.01 * levels).all()
    assert not above.any()
    beyond = colour_of_level(np.array([2.0, 5.0]) * model.top, response, ImageProcessor.of(scene.camera))
    assert model.read(beyond[None])[2].all()


def test_deviation_against_drawn_pixels() -> None:
    """Pixels drawn one by one: the error's RMS is the stated deviation, and the mean of many is the level."""
    model = own_model()
    rng = np.random.default_rng(5)
    for level in (0.1, 3.0, 4.5, 8.0):
        charge = rng.poisson(level * RESPONSE * FULL_E, (20_000, 3))
        balanced = np.minimum(np.minimum(charge / FULL_E, 1.0) * GAINS, 1.0)
        pixels = np.floor(255 * curve(balanced @ MATRIX.T) + 0.5).astype(np.uint8)
        found, deviation, _ = model.read(pixels[None])
        # noise of one filter reaches two channels through the matrix: the channels count as independent
        assert 0.6 < np.sqrt(((found - level) ** 2).mean()) / deviation.mean() < 1.3
        assert found.mean() == pytest.approx(level, rel=0.02)


AREA = np.pi * 93.4 * 71.7 / SCALE_PX_PER_MM**2


def frame_of(contact: float, seed: int = 4) -> np.ndarray:
    share = cv2.GaussianBlur(ellipse(93.4, 71.7, (187.3, 151.8), 0.4), (0, 0), BLUR_PX)
    return photograph(contact * (0.008 + 0.992 * share), seed)


def estimator(model: CameraModel | None) -> Estimator:
    return Estimator.of(uniform_calibration(), replace(Radiometry.of({}), camera=model))


@pytest.mark.parametrize("contact", [2.0, 5.0, 8.0, 12.0])
def test_area_where_red_is_clipped(contact: float) -> None:
    """Frames drawn here, red full by 4 to 24 times: half a per cent."""
    assert estimator(own_model()).area(frame_of(contact)).area_mm2 == pytest.approx(AREA, rel=5e-3)


@pytest.mark.parametrize("contact", [1.3, 1.6, 2.0, 5.0, 8.0])
def test_shift_by_demosaicing_of_a_drawn_contact(contact: float) -> None:
    """Where half the light lies near a channel's end the boundary moves as an edge through the mosaic does: 0.05 px."""
    found = estimator(own_model()).area(frame_of(contact))
    way = (found.area_mm2 - AREA) / found.perimeter_mm * SCALE_PX_PER_MM + found.colour_shift_px
    assert found.unseen == ""
    assert found.colour_shift_px == pytest.approx(way, abs=0.05)


@pytest.mark.parametrize("contact", [2.0, 5.0, 8.0])
def test_film_beside_a_colour_contact_is_bounded_by_the_width_of_its_edge(contact: float) -> None:
    """Without the card's part the interval holds a contact without a film, corrected for under a tenth of a pixel."""
    tool = estimator(own_model())
    found = tool.area(frame_of(contact))
    said = refined_uncertainty(found, tool, np.random.default_rng(1), cards=())
    assert said.interval_mm2[0] < AREA < said.interval_mm2[1]
    (film,) = (part for part in said.components if part.name.startswith("film"))
    assert film.mean < 0.1 / SCALE_PX_PER_MM
    assert film.high < film_opening(found.area_mm2 / found.perimeter_mm)


@pytest.mark.parametrize("contact", [9.0, 20.0])
def test_contact_between_the_ends_of_green_and_the_beginning_of_blue(contact: float, monkeypatch) -> None:
    """Green is full from 4.7, blue shows from 24: the level is not known and the interval says so."""
    monkeypatch.setitem(globals(), "RESPONSE", np.array([1.0, 0.15, 0.01]))
    tool = estimator(own_model())
    found = tool.area(frame_of(contact))
    low, high = refined_uncertainty(found, tool, np.random.default_rng(1), cards=()).interval_mm2
    assert found.colour_uncertainty_px > 0.3
    assert low < AREA < high


def test_area_twice_above_what_any_channel_shows() -> None:
    """The foot of the edge alone: within the interval that the estimator states, without the calibration's part."""
    tool = estimator(own_model())
    found = tool.area(frame_of(20.0))
    low, high = refined_uncertainty(found, tool, np.random.default_rng(1), cards=()).interval_mm2
    assert found.unseen == "top"
    assert low < AREA < high
    assert found.area_mm2 == pytest.approx(AREA, rel=1.5e-2)


def test_grey_reading_fails_there_and_says_so() -> None:
    found = estimator(None).area(frame_of(5.0))
    assert abs(found.area_mm2 / AREA - 1) > 0.04
    log = EdgeLog()
    log.add(0, found.unseen, found.colour_unread)
    assert "camera_model_missing" in [w.code for w in log.warnings(1)]
    assert not estimator(own_model()).area(frame_of(5.0)).colour_unread
    grey = np.repeat(frame_of(5.0)[..., :1], 3, axis=2)
    assert not estimator(None).area(grey).colour_unread


def test_area_through_h264(tmp_path) -> None:
    """4:2:0 at quality 18: colour at half resolution."""
    frame = frame_of(8.0)[:330]
    write_video(tmp_path / "press.mp4", [Frame(data=frame, time=0.0, index=0)])
    (back,) = open_frames(tmp_path / "press.mp4")
    padded = np.concatenate([back.data, back.data[-1:]])
    assert estimator(own_model()).area(padded).area_mm2 == pytest.approx(AREA, rel=1e-2)


def test_table_measured_by_exposure(tmp_path) -> None:
    """A table of an even patch at many levels does what the scene's own model does."""
    scene = load_scene("thesis_ridged_red", {"camera.colour.response": [1.0, 0.15, 0.05]})
    levels = np.concatenate([[0.0], np.geomspace(0.01, 30.0, 80)])
    colours = colour_of_level(levels, [1.0, 0.15, 0.05], ImageProcessor.of(scene.camera))
    rows = [f"{x:.6g},{r},{g},{b}" for x, (r, g, b) in zip(levels, colours, strict=True)]
    file = tmp_path / "levels.csv"
    file.write_text("\n".join(["level,red,green,blue", *rows]))
    table, model = read_camera_model(file), camera_model(scene)
    pixels = colour_of_level(np.array([0.05, 3.0, 5.0, 8.0]), [1.0, 0.15, 0.05], ImageProcessor.of(scene.camera))
    assert table.read(pixels[None])[0] == pytest.approx(model.read(pixels[None])[0], rel=0.05)


def mosaic(level: np.ndarray, seed: int) -> np.ndarray:
    """Return the raw mosaic of a light level, 12 bits over a black level of 256 DN; shot noise."""
    rows, cols = np.indices(level.shape)
    channel = np.where((rows % 2 == 0) & (cols % 2 == 0), 0, np.where((rows % 2) & (cols % 2), 2, 1))
    charge = np.random.default_rng(seed).poisson(level * RESPONSE[channel] * FULL_E)
    return np.rint(256 + (4095 - 256) * np.minimum(charge / FULL_E, 1.0)).astype(np.uint16)


RAW = RawModel(mosaic="RGGB", response=(1.0, 0.15, 0.05), black_DN=256, full_DN=4095)


@pytest.mark.parametrize(("level", "left"), [(0.5, "RGB"), (3.0, "GB"), (12.0, "B")])
def test_even_light_of_a_mosaic_has_the_least_variance_of_what_is_not_full(level: float, left: str) -> None:
    """Cramer and Rao: 1/variance is the charge that the pixels of a 3 x 3 kernel collect, by its weights."""
    found, full = RAW.level(mosaic(np.full((240, 260), level), 3))
    assert not full.any()
    weights = np.outer([1, 2, 1], [1, 2, 1]).astype(float)
    rows, cols = np.indices((3, 3))
    for at_row, at_col in ((0, 0), (0, 1), (1, 1)):
        # place in the mosaic of the kernel's pixels around a pixel at (at_row, at_col)
        down, across = (at_row + rows - 1) % 2, (at_col + cols - 1) % 2
        channel = np.where((down == 0) & (across == 0), 0, np.where((down == 1) & (across == 1), 2, 1))
        share = np.where(np.isin(np.array(list("RGB"))[channel], list(left)), RESPONSE[channel], 0.0)
        expected, variance = (weights * share).sum(), (weights**2 * share).sum() * level / FULL_E
        here = found[2 + at_row : -2 : 2, 2 + at_col : -2 : 2]
        # a kernel without any pixel of the colours that are left is full
        error = np.sqrt(variance) / expected
        assert here.mean() == pytest.approx(level, abs=5 * error / np.sqrt(here.size / 4) + 2e-4 * level)
        assert here.std() == pytest.approx(error, rel=0.06)


def test_a_mosaic_in_which_every_colour_is_full_is_full() -> None:
    level, full = RAW.level(mosaic(np.full((40, 44), 40.0), 3))
    assert full.all()
    assert (level == RAW.top).all()
    assert RAW.top == pytest.approx(0.95 / 0.05)


@pytest.mark.parametrize("contact", [0.7, 1.3, 2.0, 5.0, 12.0])
def test_area_of_a_raw_mosaic_where_colours_show_the_level_and_where_they_do_not(contact: float) -> None:
    """A fifth of a per cent from unclipped to red full by 12 times; by the API, and within the stated interval."""
    share = cv2.GaussianBlur(ellipse(93.4, 71.7, (187.3, 151.8), 0.4), (0, 0), BLUR_PX)
    raw = mosaic(contact * (0.008 + 0.992 * share), 4)
    found = ev.measure(raw, calibration=uniform_calibration(), estimator="refined", camera_model=RAW)
    assert found.area_mm2 == pytest.approx(AREA, rel=2e-3)
    low, high = found.interval_mm2
    assert low < AREA < high
    with pytest.raises(InputError, match="raw mosaic"):
        ev.measure(frame_of(2.0), calibration=uniform_calibration(), estimator="refined", camera_model=RAW)
    with pytest.raises(InputError, match="monochrome"):
        ev.raw_model("thesis")


def test_area_of_a_raw_mosaic_in_which_every_colour_is_full() -> None:
    """One and a half times what the least sensitive pixels show: from the foot, within the interval."""
    share = cv2.GaussianBlur(ellipse(93.4, 71.7, (187.3, 151.8), 0.4), (0, 0), BLUR_PX)
    tool = Estimator.of(uniform_calibration(), Radiometry.of({}, raw=RAW), blur_px=BLUR_PX)
    found = tool.area(mosaic(30.0 * (0.008 + 0.992 * share), 4))
    low, high = refined_uncertainty(found, tool, np.random.default_rng(1), cards=()).interval_mm2
    assert found.unseen == "top"
    assert low < AREA < high
    assert found.area_mm2 == pytest.approx(AREA, rel=1.5e-2)


@pytest.mark.parametrize("text", ["", "level,red,green,blue\n0,0,0,0\n1,2,3,4", "level,red,green,blue\n0,0\n",
                                  "level,red,green,blue\n0,0,0,0\n2,9,0,0\n1,9,0,0"])  # fmt: skip
def test_bad_table(tmp_path, text: str) -> None:
    file = tmp_path / "levels.csv"
    file.write_text(text)
    with pytest.raises(InputError, match="levels rising from 0"):
        read_camera_model(file)


def test_monochrome_scene_has_no_camera_model() -> None:
    with pytest.raises(InputError, match="monochrome"):
        read_camera_model("thesis")
