"""The time study: smear, knee and rolling rows against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.core.states import PlateLight
from evanesce.studies.time.area import FINE_HZ, averaged, broken_line, onsets, reading_errors, rolled, stamped
from evanesce.studies.time.study import smeared


def disc(radius: float, rows: int = 201, cols: int = 317) -> PlateLight:
    y, x = np.mgrid[:rows, :cols]
    inside = np.clip(radius - np.hypot(x - 151.3, y - 97.6) + 0.5, 0.0, 1.0)
    return PlateLight(radiance=inside, variance=inside * 0, focal_px=1000.0, principal_point=(158.0, 100.0))


@pytest.mark.parametrize("way", [3.0, 8.8, 29.4])
def test_a_smeared_disc_keeps_light_and_place_and_grows_by_the_swept_strip(way: float) -> None:
    radius = 41.7
    light = np.asarray(disc(radius).radiance)
    moved = np.asarray(smeared(disc(radius), way).radiance, float)
    assert moved.sum() == pytest.approx(light.sum(), rel=1e-5)
    columns = np.arange(light.shape[1])
    assert (moved.sum(axis=0) * columns).sum() == pytest.approx((light.sum(axis=0) * columns).sum(), rel=1e-5)
    # all that was ever covered: the disc and a strip of its diameter as long as the way; borders of a pixel
    swept, slack = np.pi * radius**2 + 2 * radius * way, 2 * np.pi * radius
    assert np.count_nonzero(moved > 1e-4) == pytest.approx(swept, abs=slack)
    # covered at all times: the lens of two discs a way apart
    half = way / (2 * radius)
    lens = 2 * radius**2 * (np.arccos(half) - half * np.sqrt(1 - half**2))
    assert np.count_nonzero(moved > 1 - 1e-4) == pytest.approx(lens, abs=slack)


def test_no_way_leaves_the_light_alone() -> None:
    light = disc(20.0)
    assert smeared(light, 0.0) is light


@pytest.mark.parametrize(("onset", "speed"), [(0.237, 25.0), (1.031, 5.0)])
def test_the_knee_of_a_noisy_line_is_found_to_its_standard_error(onset: float, speed: float) -> None:
    noise, step = 0.002, 1 / 150
    time = np.arange(onset - 0.21, onset + 0.31, step)
    way = 3.7 + speed * np.maximum(0.0, time - onset) + np.random.default_rng(8).normal(0, noise, time.size)
    found, rate = broken_line(time, way)
    # some thirty frames on either side; three standard errors and the grid of candidates
    error = 3 * noise / speed * 2 / np.sqrt(30)
    assert found == pytest.approx(onset, abs=error + (time[-2] - time[0]) / (20 * time.size))
    assert rate == pytest.approx(speed, rel=0.02)


def test_a_point_that_rests_has_no_onset() -> None:
    time = np.linspace(0, 1, 31)
    assert np.isnan(broken_line(time, np.full(31, 2.2) - 0.1 * time)).all()


def test_a_wrong_clock_stretches_the_onset_and_phases_are_those_of_the_camera() -> None:
    time = 0.6 + np.arange(0, 0.5, 1 / FINE_HZ)
    row = {"time_s": time.tolist(), "slide_starts_s": 0.6, "x_mm": (25 * np.maximum(0, time - 0.871)).tolist()}
    right, wrong = onsets(row, 30.0, 30.0), onsets(row, 30.0, 25.0)
    assert len(right) == 5
    assert len(onsets(row, 25.0, 25.0)) == 6
    np.testing.assert_allclose(right, 0.271, atol=1e-3)
    np.testing.assert_allclose(np.array(wrong) / right, 1.2, rtol=1e-12)


def test_a_mean_of_frames_is_taken_in_light_not_in_grey_levels() -> None:
    dark, bright = np.full((3, 4), 0, np.uint8), np.full((3, 4), 255, np.uint8)
    # half of full light after BT.709, by hand: 1.099 x 0.5^0.45 - 0.099
    level = 255 * (1.099 * 0.5**0.45 - 0.099)
    assert abs(int(averaged([dark, bright], "bt709")[0, 0]) - level) <= 0.5
    assert int(averaged([dark, bright], "linear")[1, 2]) in (127, 128)
    some = np.random.default_rng(5).integers(0, 256, (6, 7), np.uint8)
    np.testing.assert_array_equal(averaged([some, some, some], "bt709"), some)


def test_rolling_rows_shift_a_sliding_patch_by_its_rows_delay_and_keep_its_area() -> None:
    time, speed = np.arange(20) / FINE_HZ, 3 * FINE_HZ  # three pixels a frame
    masks = np.zeros((20, 31, 120), bool)
    for k in range(20):
        masks[k, 7:18, 11 + 3 * k : 29 + 3 * k] = True
    delay = (np.arange(31) - 4.0) * 0.4e-3
    pixels, column = rolled(time, masks, delay)
    inner = slice(2, -2)
    np.testing.assert_allclose(pixels[inner], 11 * 18)
    # rows 7 to 17 are read at 12 - 4 = 8 rows' delay on the mean
    expected = 11 + 8.5 + speed * (time + 8 * 0.4e-3)
    np.testing.assert_allclose(column[inner], expected[inner], atol=1e-9)


def test_lost_frames_make_stamps_early_by_their_number() -> None:
    time = 0.31 + np.arange(60) / 30
    kept, stamp = stamped(time, 30.0, np.random.default_rng(2), dropped=0.1)
    assert 40 < len(kept) < 60
    early = 30 * (time[kept] - stamp)
    np.testing.assert_allclose(early, np.rint(early), atol=1e-9)
    # what is lost between two that arrive is what the later one is early by, more
    np.testing.assert_allclose(np.diff(early), np.diff(kept) - 1, atol=1e-9)
    assert early[0] >= kept[0]
    _, jittered = stamped(time, 30.0, np.random.default_rng(2), jitter_s=0.004)
    assert np.std(jittered - time) == pytest.approx(0.004, rel=0.3)


def test_a_slow_clock_reads_a_growing_area_late_by_its_share() -> None:
    time = np.arange(0, 0.5, 1 / FINE_HZ)
    press = {"time_s": time, "seen": {"6 ms": {"area_mm2": 20.0 * time}}}
    error, growth = reading_errors(press, rate=30.0, clock=30.0)
    np.testing.assert_allclose(error, 0, atol=1e-12)
    np.testing.assert_allclose(growth, 1)
    error, growth = reading_errors(press, rate=30.0, clock=25.0)
    np.testing.assert_allclose(growth, 25 / 30)
    # at 0.4 s the film shows what was there at 1/3 s; later its clock outruns the press
    assert error.min() == pytest.approx(20 * (0.5 / 1.2 - 0.5), abs=0.1)
