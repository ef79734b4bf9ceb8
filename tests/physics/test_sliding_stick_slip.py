"""Stick-slip of a finger on a compliant drive against the closed form, energy and limits."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.bench.friction import spectrum
from evanesce.contact.sliding.stick_slip import Slider, simulate_stick_slip, stick_slip_period

SLIDER = Slider(mass=0.043, stiffness=1.7, normal_force=1.2, static_friction=0.88, dynamic_friction=0.61)


@pytest.mark.parametrize("speed", [1.0, 13.0, 140.0])
def test_period_is_the_closed_form(speed):
    period = stick_slip_period(SLIDER, speed)
    run = simulate_stick_slip(SLIDER, speed, 8 * period + 0.5, 400 / period)
    # Every slide after the first starts from the same state; the solver's tolerance is 1e-9.
    np.testing.assert_allclose(np.diff(run.onsets)[1:7], period, rtol=1e-6)


def test_slow_drive_is_all_spring_and_fast_drive_all_inertia():
    drop = 2 * (0.88 - 0.61) * 1.2 / 1.7
    assert stick_slip_period(SLIDER, 0.01) == pytest.approx(drop / 0.01, rel=1e-3)
    assert stick_slip_period(SLIDER, 1e5) == pytest.approx(1 / SLIDER.natural_frequency, rel=1e-3)


def test_force_rises_to_static_friction_and_overshoots_below_dynamic():
    run = simulate_stick_slip(SLIDER, 1.0, 4.0, 5000)
    assert run.spring_force[run.sticking].max() == pytest.approx(0.88 * 1.2, abs=1.7 * 1.0 / 5000 + 1e-9)
    # Without damping a slow slide swings as far below the dynamic force as it started above it.
    assert run.spring_force.min() >= 0.0
    late = run.time > run.onsets[1]
    assert run.spring_force[late].min() == pytest.approx((2 * 0.61 - 0.88) * 1.2, rel=0.02)
    assert np.all(np.diff(run.position) > -1e-9)


def test_work_of_the_drive_is_dissipated_by_friction():
    run = simulate_stick_slip(SLIDER, 20.0, 2.0, 40000)
    onsets = np.searchsorted(run.time, run.onsets[[2, 9]])
    a, b = int(onsets[0]), int(onsets[1])  # the same phase of the cycle: stored energy is equal
    driven = np.trapezoid(run.spring_force[a:b], 20.0 * run.time[a:b])
    dissipated = 0.61 * 1.2 * (run.position[b] - run.position[a])
    assert driven == pytest.approx(dissipated, rel=5e-4)  # one sample in some 1600


def test_spectrum_shows_the_frequency():
    run = simulate_stick_slip(SLIDER, 2.0, 20.0, 500)
    found = spectrum(run.time[run.time > 2], run.spring_force[run.time > 2])
    assert found.peak == pytest.approx(1 / stick_slip_period(SLIDER, 2.0), abs=0.1 / 18)  # a tenth of a bin
    assert found.peak_share > 0.4


def test_no_drop_means_no_stick_slip_and_damping_calms():
    even = Slider(0.043, 1.7, 1.2, 0.6, 0.6, damping=0.02)
    run = simulate_stick_slip(even, 3.0, 6.0)
    assert np.ptp(run.spring_force[run.time > 5]) < 1e-3
    damped = Slider(0.043, 1.7, 1.2, 0.88, 0.61, damping=0.02)
    assert np.ptp(simulate_stick_slip(damped, 60.0, 6.0).spring_force[5000:]) < 0.2


def test_natural_frequency_in_hz():
    assert Slider(1e-3, 1.0, 1, 1, 1).natural_frequency == pytest.approx(1000 / (2 * np.pi))  # 1 g on 1 N/mm


def test_bad_input():
    with pytest.raises(ValueError, match="not exceed"):
        Slider(1, 1, 1, 0.5, 0.6)
    with pytest.raises(ValueError, match="closed form"):
        stick_slip_period(Slider(1, 1, 1, 0.6, 0.5, damping=0.1), 1.0)
    with pytest.raises(ValueError, match="samples"):
        simulate_stick_slip(SLIDER, 1.0, 1e9)
