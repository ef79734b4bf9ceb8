"""Stick-slip of a finger on a compliant drive against the closed form, energy and limits."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.bench.friction import spectrum
from evanesce.contact.sliding.stick_slip import Slider, simulate_stick_slip, stick_slip_period
from evanesce.contact.solve import contact_sequence
from evanesce.core.errors import InputError
from evanesce.rig import load_scene

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


STICKS = {
    "contact": {"law": "hertz", "reduced_modulus_MPa": 12.0}, "grid.size_mm": 30.0, "grid.samples": 256,
    "press.frame_rate_hz": 60.0, "slide.shaft": "rigid", "slide.drive_stiffness_N_per_mm": 0.3,
    "slide.stick_slip_drop": 0.2, "slide.speed_mm_per_s": 1.0,
}  # fmt: skip


@pytest.mark.slow
def test_frames_of_a_scene_stick_and_slip_with_the_period_of_a_mass_on_a_spring() -> None:
    """A stiff contact is the point mass of the closed form; a light one leaps in no time."""
    states = contact_sequence(load_scene("thesis_slide", STICKS))
    time = np.array([s.time for s in states])
    force = np.array([np.hypot(*s.tangential_force) for s in states])
    place = np.array([s.parameters["tip_displacement_mm"] for s in states])
    leaps = np.flatnonzero(np.diff(force) < -0.1)
    assert len(leaps) >= 5
    light = Slider(1e-6, 0.3, 1.0, 0.67, 0.8 * 0.67)
    assert np.diff(time[leaps]).mean() == pytest.approx(stick_slip_period(light, 1.0), rel=0.06)
    # it overshoots: as far below the friction in motion as it was above
    np.testing.assert_allclose(force[leaps], 0.67, rtol=1e-3)
    np.testing.assert_allclose(force[leaps + 1], 0.6 * 0.67, rtol=0.03)
    # the patch moves in leaps and stands between
    moved = np.diff(place)
    assert moved[leaps].sum() > 0.9 * (place[leaps[-1] + 1] - place[leaps[0] - 2])
    middle = states[int(leaps[1] + leaps[2]) // 2]
    assert middle.parameters["stick_ratio"] > 0.5  # its core, half way to the next leap


def test_stick_slip_needs_a_drive_that_gives_way_and_off_changes_no_bit() -> None:
    rigid = {k: v for k, v in STICKS.items() if "drive" not in k}
    with pytest.raises(InputError, match=r"slide\.stick_slip_drop: 0\.2 with a rigid drive \(allowed: none"):
        contact_sequence(load_scene("thesis_slide", rigid))[-1]
    with pytest.raises(InputError, match=r"slide\.stick_slip_drop"):
        load_scene("thesis_slide", STICKS | {"slide.stick_slip_drop": 0.6})
    off = contact_sequence(load_scene("thesis_slide", STICKS | {"slide.stick_slip_drop": 0.0}))[-1]
    none = {k: v for k, v in STICKS.items() if "drop" not in k}
    np.testing.assert_array_equal(off.traction, contact_sequence(load_scene("thesis_slide", none))[-1].traction)
