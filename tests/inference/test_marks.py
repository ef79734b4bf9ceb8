"""Localised defects on full pixels: planted in frames of a development rig by NumPy, found, named, placed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import development_rigs as rigs
import numpy as np
import pytest
from scipy import ndimage

from evanesce.bundle.read import read_bundle
from evanesce.effects import all_effects
from evanesce.inference.causes import causes_of
from evanesce.inference.data import data_vector
from evanesce.inference.explained import Explained
from evanesce.inference.gate import gate_of
from evanesce.inference.marks import MarkSearch
from evanesce.inference.model import AnchoredModel
from evanesce.inference.row_waves import brightest_ripple, row_times
from evanesce.inference.single_effects import UNKNOWN
from evanesce.prediction.observe import Observation, observe

READ_DN, SHOT_DN = 0.15, 0.034


@pytest.fixture(scope="module")
def seen(tmp_path_factory: Any) -> tuple[Observation, dict[str, float]]:
    """Frames as the fine model predicts them: what is planted is all that there is beside noise."""
    folder: Path = tmp_path_factory.mktemp("marks") / "linear"
    rigs.write_rig("linear", folder)
    observation = observe(read_bundle(folder))
    model = AnchoredModel(observation, data_vector(observation))
    point = gate_of(observation, model.coarse).start
    frames = model.frames(point, range(len(observation.views)))
    return replace(observation, images=frames.astype(np.float32)), dict(point)


def planted(seen: tuple[Observation, dict[str, float]], add: Any, seed: int = 1) -> Any:
    """Return what is found where ``add(view, shape)`` [DN] was added to each view, and noise."""
    observation, point = seen
    rng = np.random.default_rng(seed)
    images = observation.images.astype(float).copy()
    for k, view in enumerate(observation.views):
        level = images[k] + add(view, images[k])
        # Shot noise, and read noise before rounding to whole numbers from 0 to 255.
        sd = np.sqrt(READ_DN**2 + SHOT_DN * level.clip(0))
        frames = level + sd * rng.standard_normal((view.frames, *level.shape))
        images[k] = frames.round().clip(0, 255).mean(axis=0)
    noisy = replace(observation, images=images.astype(np.float32))
    model = AnchoredModel(noisy, data_vector(noisy))
    local = [c for c in causes_of(noisy)[0] if c.local and c.id in all_effects()]
    return MarkSearch(model, local).scan(point)


def spot(shape: tuple[int, ...], row: float, col: float, width: float) -> np.ndarray:
    """Return a Gaussian spot of unit height."""
    y, x = np.indices(shape)
    return np.asarray(np.exp(-((y - row) ** 2 + (x - col) ** 2) / (2 * width**2)))


def test_nothing_planted_nothing_found(seen: Any) -> None:
    found = [planted(seen, lambda view, frame: 0.0, seed) for seed in range(2)]
    assert sum(len(scan.marks) for scan in found) == 0
    # Six scales of Gumbel's law above its mean, which these draws give to half a standard deviation.
    assert all(5.0 < scan.threshold < 7.5 for scan in found)


def test_hot_pixels_are_as_bright_in_the_dark(seen: Any) -> None:
    places = [(20, 30), (61, 88), (44, 100)]

    def add(view: Any, frame: np.ndarray) -> np.ndarray:
        out = np.zeros(frame.shape)
        if not view.is_card:
            for row, col in places:
                out[row, col] = 14.0
        return out

    scan = planted(seen, add)
    assert {(round(m.row), round(m.col)) for m in scan.marks} == set(places)
    assert {m.cause for m in scan.marks} <= {"hot_pixels", UNKNOWN}


def test_specks_are_bright_only_where_leds_are_on(seen: Any) -> None:
    places = [(15, 22), (70, 95), (30, 104)]

    def add(view: Any, frame: np.ndarray) -> np.ndarray:
        out = np.zeros(frame.shape)
        if view.kind in ("press", "replicate"):
            for row, col in places:
                # As bright in each view as the contact is, to which the same LEDs give light.
                out += 0.15 * frame.max() * spot(frame.shape, row, col, 0.8)
        return out

    scan = planted(seen, add)
    assert {(round(m.row), round(m.col)) for m in scan.marks if m.cause == "specks"} == set(places)
    assert scan.places()["specks"].probability["specks"] > 0.95


def test_a_grain_on_the_sensor_darkens_all_light(seen: Any) -> None:
    place = (44.0, 60.0)
    scan = planted(seen, lambda view, frame: -0.12 * frame * spot(frame.shape, *place, 1.6))
    dark = [m for m in scan.marks if np.hypot(m.row - place[0], m.col - place[1]) < 2]
    assert dark
    assert dark[0].cause == "sensor_dust"


def test_a_scratch_is_one_line(seen: Any) -> None:
    """Forty faint points in a row: none would stand out much, the line does."""
    length, angle, middle = 40, np.radians(30.0), (66.0, 62.0)

    def add(view: Any, frame: np.ndarray) -> np.ndarray:
        out = np.zeros(frame.shape)
        if view.kind in ("press", "replicate"):
            for s in np.linspace(-length / 2, length / 2, 2 * length):
                out += (
                    0.015
                    * frame.max()
                    * spot(frame.shape, middle[0] + s * np.sin(angle), middle[1] + s * np.cos(angle), 0.8)
                )
        return out

    scan = planted(seen, add)
    best, *others = scan.marks
    assert all(m.z < 0.25 * best.z for m in others)
    assert best.atom.kind == "line"
    assert best.atom.size_px == pytest.approx(length, rel=0.15)
    assert best.cause == "scratch"
    assert np.degrees(best.atom.angle) == pytest.approx(30.0, abs=2.0)
    assert (best.row, best.col) == pytest.approx(middle, abs=2.0)


def test_what_comes_and_goes_is_no_cause_of_the_library(seen: Any) -> None:
    """A bright dot in half of the presses, whatever the light: a fly."""

    def add(view: Any, frame: np.ndarray) -> np.ndarray:
        there = view.kind == "press" and view.index % 2 == 0
        return 40.0 * there * spot(frame.shape, 25.0, 40.0, 1.0)

    scan = planted(seen, add)
    assert [m.cause for m in scan.marks] == [UNKNOWN]
    assert (scan.marks[0].row, scan.marks[0].col) == pytest.approx((25.0, 40.0), abs=1.0)


def test_weights_of_one_group_do_not_carry_over_to_the_next(seen: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: a line was weighed with what points had been allowed to be off by, and the other way round."""
    weights: list[bool] = []
    whole = Explained.marks

    def watched(self: Explained, peaks: Any) -> Any:
        before = self.weight.copy()
        found = whole(self, peaks)
        weights.append(bool(np.array_equal(before, self.weight)))
        return found

    monkeypatch.setattr(Explained, "marks", watched)
    scan = planted(seen, lambda view, frame: 0.2 * frame.max() * view.touches * spot(frame.shape, 70.0, 95.0, 0.8))
    assert scan.marks
    assert weights == [True]


def test_a_ripple_is_read_from_rows() -> None:
    rng = np.random.default_rng(3)
    times, late = np.array([0.0, 7.31, 19.77, 41.2, 63.9, 88.0, 105.3, 131.9]), row_times(90, 0.0227)
    light = np.full((8, 90, 4), 30.0)
    wave = 0.02 * np.cos(2 * np.pi * 100.37 * (times[:, None] + late) + 0.7)
    found = brightest_ripple(light * wave[..., None] + rng.standard_normal(light.shape), light, times, late)
    assert found is not None
    assert found.frequency_hz == pytest.approx(100.37, abs=0.01)
    assert found.phase_deg == pytest.approx(np.degrees(0.7), abs=15.0)
    assert found.amplitude == pytest.approx(0.02, rel=0.15)
    assert found.log_bayes > 10.0
    assert brightest_ripple(rng.standard_normal(light.shape), light, times, late) is None


def test_waves_that_draws_of_a_codecs_noise_have_as_well_are_no_ripple() -> None:
    """Errors with a wave over the rows that goes on from frame to frame, of another frequency in each film."""
    times, late = np.array([0.0, 7.31, 19.77, 41.2, 88.0, 131.9]), row_times(90, 0.0227)
    light, rng = np.full((6, 90, 4), 30.0), np.random.default_rng(11)

    def film(size: float) -> np.ndarray:
        hertz, phase = rng.uniform(80.0, 300.0), rng.uniform(0.0, 2 * np.pi)
        wave = size * np.cos(2 * np.pi * hertz * (times[:, None] + late) + phase)
        return np.asarray(light * wave[..., None] + rng.standard_normal(light.shape))

    drawn = np.array([(film(0.02 * abs(rng.standard_normal())) * light).sum(axis=2) for _ in range(12)])
    data, strong = film(0.02), film(0.3)
    assert brightest_ripple(data, light, times, late) is not None
    assert brightest_ripple(data, light, times, late, drawn=drawn) is None
    assert brightest_ripple(strong, light, times, late, drawn=drawn) is not None


def test_noise_that_a_sensor_smooths_is_no_ripple() -> None:
    """Smoothed over 0.6 px, noise has twice the power in long waves over rows that it has from row to row."""
    times, late = np.cumsum([0.0, 7.31, 12.4, 21.4, 46.8, 43.9]), row_times(300, 0.0227)
    for seed in range(6):
        noise = ndimage.gaussian_filter1d(np.random.default_rng(seed).standard_normal((6, 300, 4)), 0.6, axis=1)
        assert brightest_ripple(noise / noise.std(), np.full(noise.shape, 30.0), times, late) is None
