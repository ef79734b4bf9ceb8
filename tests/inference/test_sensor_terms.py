"""Terms of the sensor model: those that were planted are found, and no other; the law is that of its frames."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.core import rng
from evanesce.core.states import SensorLight
from evanesce.inference.sensor.compare import compare, fit, held_out_score, search
from evanesce.inference.sensor.law import VarianceSeries
from evanesce.rig import Camera
from evanesce.rig.camera import Pixel
from evanesce.sensor.expose import charge_of, signal_of
from evanesce.sensor.pixel import fixed_pattern
from evanesce.sensor.variance import frame_variance

NOMINAL = Pixel(conversion_gain_e_per_DN=2.13, read_noise_e=3.0)


def transfers(seed, gain=2.13, read=3.0, prnu=0.0, scatter=0.01, kinds=4, rows=40):
    """Series of variances by the formula, written out here once more, with scatter."""
    r, found = np.random.default_rng(seed), []
    for k in range(kinds):
        x = np.geomspace(15 + 5 * k, 2600, rows)
        v = (read / gain) ** 2 + 1 / 12 + x / gain + (prnu * x) ** 2
        found.append(VarianceSeries(f"s{k}", str(k), x, v * np.exp(scatter * r.normal(size=rows))))
    return found


def darks(seed, energy, current=0.3, spread=0.0, kinds=3):
    r, found = np.random.default_rng(seed), []
    t = np.arange(0.0, 300, 10)
    for at in (2.0, 20.0, 35.0):
        rate = np.exp(energy / 8.617333e-5 * (1 / 293.15 - 1 / (at + 273.15)))
        for k in range(kinds):
            v = (3.0**2 + current * rate * t + (spread * rate * t) ** 2) / 2.13**2 + 1 / 12
            found.append(VarianceSeries(f"{k} {at}", str(k), t, v * np.exp(0.02 * r.normal(size=t.size)), 1.0, at))
    return found


def test_the_nominal_model_lacks_nothing_of_its_own_data():
    for seed in range(8):
        assert search(transfers(seed), "transfer", NOMINAL).terms == frozenset()


def test_a_quadratic_term_is_found_with_its_size_and_predicts_held_out_rows():
    found = compare(transfers(1, prnu=0.012), "transfer", NOMINAL)
    assert found.best.terms == {"prnu"}
    assert found.best.law.found(found.best.values)["prnu"][""] == pytest.approx(0.012, rel=0.02)
    assert found.gain[1] > 50
    assert found.gain_of["prnu"] == pytest.approx(found.gain, rel=0.2)
    assert found.chosen["prnu"] == 5
    assert found.rms[1] < 0.02 < found.rms[0]


def test_gain_and_read_noise_are_found():
    fitted = search(transfers(2, gain=2.4, read=5.0), "transfer", NOMINAL)
    assert fitted.terms == {"gain", "read_noise"}
    found = fitted.law.found(fitted.values)
    assert found["gain"][""] == pytest.approx(2.4, rel=0.01)
    assert found["read_noise"][""] == pytest.approx(5.0, rel=0.02)


def test_dark_current_and_temperature_law_are_found_and_no_law_where_there_is_none():
    fitted = search(darks(3, 0.55), "dark", NOMINAL)
    assert fitted.terms == {"dark_current", "temperature_law"}
    assert fitted.law.found(fitted.values)["temperature_law"][""] == pytest.approx(0.55, rel=0.05)
    assert search(darks(3, 0.0), "dark", NOMINAL).terms == {"dark_current"}
    assert "dark_nonuniformity" in search(darks(4, 0.5, current=0.02, spread=0.05), "dark", NOMINAL).terms


def test_held_out_scores_are_calibrated():
    """Mean log density of fresh rows under the truth's own model is that of their scatter: its entropy."""
    scores = []
    for seed in range(12):
        fitted = fit(transfers(seed, prnu=0.012), "transfer", NOMINAL, {"prnu"})
        scores.append(held_out_score(fitted, transfers(seed + 100, prnu=0.012)).sum())
    rows = 160
    expected = -rows * (0.5 + np.log(0.01 * np.sqrt(2 * np.pi)))
    # Of 160 normal rows the score's standard deviation is sqrt(160/2) = 9; twelve of them, and the scatter's own error.
    assert np.mean(scores) == pytest.approx(expected, abs=12)


def test_the_law_is_that_of_the_programs_frames():
    """Variance over the pixels of a frame by the program's exposure, light and dark, against the closed form."""
    pixel = Pixel(
        prnu=0.015, dsnu_e=4.0, read_noise_e=3.5, dark_current_e_per_s=60.0, dark_nonuniformity_e_per_s=25.0,
        conversion_gain_e_per_DN=2.2, temperature_C=31.0, dark_activation_energy_eV=0.4, quantum_efficiency=1.0,
    )  # fmt: skip
    cam = Camera(resolution_px=(500, 400), exposure_ms=4000.0, analogue_gain=2.0, pixel=pixel)
    pattern = fixed_pattern((400, 500), pixel.prnu, pixel.dsnu_e, rng.generator(1, "sensor"), pixel.dark_spread)
    rate = np.exp(0.4 / 8.617333e-5 * (1 / 293.15 - 1 / 304.15))
    one = charge_of(
        SensorLight(irradiance=np.full((400, 500), 1e-12)), Camera(**cam.model_dump() | {"exposure_ms": 1.0})
    )
    per_watt = float(one.mean() - 60.0 * rate * 1e-3) / 1e-12 * 4000.0
    for electrons in (0.0, 1500.0):
        light = SensorLight(irradiance=np.full((400, 500), electrons / per_watt))
        signal = signal_of(charge_of(light, cam, pattern), cam, rng.generator(2, "exposure"))
        expected = frame_variance(
            electrons, exposure_s=4.0, conversion_gain_e_per_DN=2.2, analogue_gain=2.0, read_noise_e=3.5, prnu=0.015,
            dsnu_e=4.0, dark_current_e_per_s=60.0 * rate, dark_nonuniformity_e_per_s=25.0 * rate,
        )  # fmt: skip
        # A variance of 200,000 pixels is good to 0.3 %, with the gamma's tail to 0.6 %; rounding comes later.
        assert signal.var() + 1 / 12 == pytest.approx(float(expected), rel=0.02)
