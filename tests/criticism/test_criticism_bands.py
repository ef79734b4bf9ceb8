"""Bands of a rippling light: frequency and phase that the data choose, and what views show them."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.chain.simulate import simulate_card
from evanesce.criticism.bands import brightest_bands, row_times
from evanesce.prediction.predict import Predictor
from evanesce.prediction.views import View
from evanesce.rig import load_scene

ROWS, COLS, READOUT_S = 61, 17, 0.0211
TIMES_S = np.array([0.31, 4.7, 5.9, 17.3, 30.1, 55.2, 91.7, 140.4])


def planted(seed: int, amplitude: float, frequency_hz: float, phase_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Return unit noise with a triangle wave's bands in it, and what light changes; other weights everywhere."""
    rng = np.random.default_rng(seed)
    light = rng.uniform(2.0, 9.0, (TIMES_S.size, 1, 1)) * rng.uniform(0.1, 1.0, (1, ROWS, COLS))
    late = row_times(ROWS, 4 * ROWS, READOUT_S)
    cycles = frequency_hz * (TIMES_S[:, None] + late) + phase_deg / 360.0
    wave = 4 * np.abs(np.mod(cycles, 1.0) - 0.5) - 1
    return rng.standard_normal(light.shape) + amplitude * wave[:, :, None] * light, light


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_ripple_of_twelve_deviations_has_its_frequency_and_phase(seed: int) -> None:
    """A triangle's fundamental has 8/pi^2 of its height. In frames that show little a phase is nobody's to know."""
    frequency, phase = 117.4131, 77.0
    _, light = planted(seed, 0.0, frequency, phase)
    amplitude = 12.0 / np.sqrt((light**2).sum() / 3)
    residual, light = (part.astype(np.float32) for part in planted(seed, amplitude, frequency, phase))
    light[:, 50:] = 0.0  # rows that no LED lights, in single precision as fits hold them
    found = brightest_bands(residual, light, TIMES_S, row_times(ROWS, 4 * ROWS, READOUT_S))
    assert found is not None
    assert found.amplitude == pytest.approx(8 / np.pi**2 * amplitude, rel=3 / 12)
    assert found.frequency_hz == pytest.approx(frequency, abs=0.5 / np.ptp(TIMES_S))
    apart = (found.frequency_hz - frequency) * TIMES_S + (found.phase_deg - phase) / 360
    weight = (light**2).sum(axis=(1, 2), dtype=float)
    # Phases known to 1/12 rad leave 1 - 1/288; a frequency between those tried half a step of 1/4 of a period.
    assert abs(weight @ np.exp(2j * np.pi * apart)) / weight.sum() > 0.97


def test_noise_has_hardly_ever_bands() -> None:
    late = row_times(ROWS, 4 * ROWS, READOUT_S)
    found = [brightest_bands(*planted(seed, 0.0, 100.0, 0.0), TIMES_S, late) for seed in range(40)]
    # A choice that costs its odds is worth it in some per cent of all cases.
    assert sum(f is not None for f in found) <= 4


def test_a_mean_light_that_is_off_is_no_band() -> None:
    """Light of each frame is a nuisance."""
    residual, light = planted(5, 0.0, 100.0, 0.0)
    residual = residual + 0.3 * np.sin(np.arange(TIMES_S.size))[:, None, None] * light
    assert brightest_bands(residual, light, TIMES_S, row_times(ROWS, 4 * ROWS, READOUT_S)) is None


def test_a_pattern_that_stands_is_no_ripple() -> None:
    """Rationale: light that sloped over a contact was named a ripple of a rate that agreed with all full seconds."""
    residual, light = planted(6, 0.0, 100.0, 0.0)
    late = row_times(ROWS, 4 * ROWS, READOUT_S)
    slope = 25.0 * late[:, None] / np.ptp(late) * light / np.linalg.norm(light)
    whole = np.round(TIMES_S)
    assert brightest_bands(residual + slope, light, whole, late) is None


def test_frequencies_that_cannot_be_seen_are_not_tried() -> None:
    _, light = planted(3, 0.0, 120.0, 0.0)
    residual, light = planted(3, 30.0 / np.sqrt((light**2).sum() / 3), 120.0, 0.0)
    late = row_times(ROWS, 4 * ROWS, READOUT_S)
    found = brightest_bands(residual, light, TIMES_S, late, lambda f: f > 160.0)
    assert found is None or found.frequency_hz > 160.0


@pytest.mark.slow  # 6 s
def test_bands_average_out_and_cards_have_none() -> None:
    scene = load_scene("thesis", {"camera.resolution_px": [48, 36], "camera.scale_px_per_mm": 1.7})
    views = (
        View(kind="press", force_N=2.3, voltage_V=9.0, time_s=1.003),
        View(kind="replicate", force_N=2.3, voltage_V=9.0, time_s=1.003, frames=7),
        View(kind="checkerboard"),
    )
    predictor = Predictor(scene, views)
    change = predictor.cube({"rolling_shutter:ripple": 0.8}) - predictor.cube({})
    assert np.abs(change[0]).max() > 0.5
    assert not change[1].any()
    assert not change[2].any()


@pytest.mark.slow
def test_a_card_is_lit_by_the_room_which_does_not_ripple_with_the_leds() -> None:
    shown = {"camera.resolution_px": [96, 72], "camera.scale_px_per_mm": 3.4}
    calm = load_scene("thesis", shown)
    rippling = load_scene("thesis", shown | {"effects.rolling_shutter.ripple": 0.5})
    frames = [simulate_card(s, "square", seed=4, samples_per_pixel=2, passes=1).data for s in (calm, rippling)]
    assert np.array_equal(*frames)
