"""Viscoelastic Hertz contact against closed forms (standard linear solid, Maxwell), quadrature and limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from evanesce.contact.analytic.hertz import hertz_gap, hertz_pressure, hertz_radius
from evanesce.contact.analytic.viscoelastic import press_by_depth, press_by_force, reduced_series, viscoelastic_states
from evanesce.core.states import PlateGrid
from evanesce.materials.prony import PronySeries

R = 6.8  # mm
SOLID = PronySeries(0.37, (0.52,), (0.73,))  # a standard linear solid
MAXWELL = PronySeries(0.0, (0.81,), (0.73,))


def solid_compliance(t):
    """Creep of the standard linear solid, written out: J = 1/E_inf - (1/E_inf - 1/E_0) exp(-t E_inf/(E_0 tau))."""
    e0, ei = 0.89, 0.37
    return 1 / ei - (1 / ei - 1 / e0) * np.exp(-t * ei / (e0 * 0.73))


def solid_relaxation(t):
    return 0.37 + 0.52 * np.exp(-t / 0.73)


def test_creep_under_a_sudden_force_follows_the_standard_linear_solid():
    t = np.linspace(0.0, 3.1, 150)
    history = press_by_force(t, np.full_like(t, 1.3), R, SOLID)
    # The force is piecewise constant, for which the step weights are exact: rounding only.
    np.testing.assert_allclose(history.radius**3, 0.75 * R * 1.3 * solid_compliance(t), rtol=1e-11)
    np.testing.assert_allclose(history.force, 1.3)


def test_creep_under_a_force_ramp():
    t = np.linspace(0.0, 2.0, 101)
    history = press_by_force(t, 0.7 * t, R, SOLID)
    integral = np.array([quad(solid_compliance, 0.0, s)[0] for s in t])
    # A ramp is piecewise linear as well: exact.
    np.testing.assert_allclose(history.radius[1:] ** 3, 0.75 * R * 0.7 * integral[1:], rtol=1e-10)


def test_force_relaxes_at_a_held_depth():
    t = np.linspace(0.0, 2.5, 77)
    history = press_by_depth(t, np.full_like(t, 0.41), R, SOLID)
    np.testing.assert_allclose(history.force, 4 / 3 * np.sqrt(R) * 0.41**1.5 * solid_relaxation(t), rtol=1e-11)
    np.testing.assert_allclose(history.radius, np.sqrt(R * 0.41))


def test_force_of_a_depth_ramp_is_the_hereditary_integral():
    t = np.linspace(0.0, 1.4, 561)
    speed = 0.3
    history = press_by_depth(t, speed * t, R, SOLID)
    i = 409
    exact = 4 / 3 * np.sqrt(R) * quad(lambda s: solid_relaxation(t[i] - s) * 1.5 * speed**1.5 * np.sqrt(s), 0, t[i])[0]
    # delta^1.5 is taken linear over steps of 1/560: relative error below the step's square (1/409)^1.5 at the start.
    assert history.force[i] == pytest.approx(exact, rel=5e-5)


def test_release_of_a_maxwell_sphere_has_tings_closed_form():
    """Triangle in depth: exp(-(t - t1)/tau) = 2 exp(-(t - tm)/tau) - 1 for the time t1 of equal radius."""
    t = np.concatenate([np.linspace(0, 1, 201), np.linspace(1, 1.6, 151)[1:]])
    depth = 0.5 * np.where(t <= 1, t, 2 - t)
    history = press_by_depth(t, depth, R, MAXWELL)
    after = t > 1
    decay = 2 * np.exp(-(t[after] - 1) / 0.73) - 1
    t1 = np.where(decay > 0, t[after] + 0.73 * np.log(np.maximum(decay, 1e-300)), -1.0)
    np.testing.assert_allclose(history.growing_until[after], np.maximum(t1, 0), atol=2e-5)  # step^2 = 2.5e-5
    lost = t[after][t1 < 0]
    assert len(lost)
    assert np.all(history.force[after][t1 < 0] == 0.0)  # separated although the depth is still positive
    assert depth[t == lost[0]][0] > 0.15


def test_release_of_a_solid_against_a_second_implementation():
    """Ting's two equations by root finding and quadrature on the continuous programme."""
    t = np.concatenate([np.linspace(0, 1, 401), np.linspace(1, 2, 401)[1:]])
    history = press_by_depth(t, 0.5 * np.where(t <= 1, t, 2 - t), R, SOLID)
    for i in (460, 540, 610):
        now = t[i]

        def balance(t1, now=now):
            up = quad(lambda s: solid_relaxation(now - s), t1, 1)[0]
            return up - quad(lambda s: solid_relaxation(now - s), 1, now)[0]

        t1 = brentq(balance, 0, 1)
        force = (
            4 / 3 * np.sqrt(R) * quad(lambda s, n=now: solid_relaxation(n - s) * 1.5 * 0.5**1.5 * np.sqrt(s), 0, t1)[0]
        )
        assert history.growing_until[i] == pytest.approx(t1, abs=2e-5)
        assert history.force[i] == pytest.approx(force, rel=2e-4)
        assert history.radius[i] == pytest.approx(np.sqrt(R * 0.5 * t1), rel=5e-5)


def test_force_and_depth_control_are_inverse():
    """A press driven by the force that a depth programme gave returns its radius, release included."""
    t = np.concatenate([np.linspace(0, 0.6, 301), np.linspace(0.6, 1.4, 401)[1:]])
    given = press_by_depth(t, 0.4 * np.where(t <= 0.6, t / 0.6, 1 - (t - 0.6) / 1.1), R, SOLID)
    back = press_by_force(t, given.force, R, SOLID)
    np.testing.assert_allclose(back.radius[5:], given.radius[5:], rtol=2e-3)  # force is taken linear between steps
    touching = np.flatnonzero(given.force > 0)[20:]  # afterwards one depth is prescribed, the other recovers freely
    np.testing.assert_allclose(back.depth[touching], given.depth[touching], rtol=4e-3)


def test_elastic_limit_is_hertz_all_the_way():
    t = np.linspace(0, 2, 81)
    elastic = PronySeries(0.77, (), ())
    history = press_by_force(t, 2.1 * np.sin(np.pi * t / 2), R, elastic)
    np.testing.assert_allclose(history.radius, hertz_radius(history.force, R, 0.77), rtol=2e-4, atol=1e-5)
    r = np.array([0.0, 0.4, 1.1, 4.2])
    np.testing.assert_allclose(
        history.pressure(30, r), hertz_pressure(r, history.force[30], history.radius[30]), rtol=1e-3, atol=1e-9
    )


def test_dwell_keeps_growing_and_slow_release_grows_on():
    """Creep: the largest area comes after the largest force."""
    t = np.concatenate([np.linspace(0, 0.1, 41), np.linspace(0.1, 5, 400)[1:]])
    force = np.where(t <= 0.1, 10 * t, 1 - 0.05 * (t - 0.1))
    history = press_by_force(t, force, R, SOLID)
    peak = t[np.argmax(history.radius)]
    assert 0.5 < peak < 4.9
    assert np.all(np.diff(history.radius[t > peak]) <= 1e-12)


def test_pressure_carries_the_force_and_gap_is_hertz_while_growing():
    t = np.concatenate([np.linspace(0, 0.5, 201), np.linspace(0.5, 1.1, 241)[1:]])
    history = press_by_force(t, 1.7 * np.where(t <= 0.5, t / 0.5, 1 - (t - 0.5)), R, SOLID)
    for i in (150, 330):
        a = history.radius[i]
        r = np.linspace(0, a, 4001)
        carried = np.trapezoid(2 * np.pi * r * history.pressure(i, r), r)
        assert carried == pytest.approx(history.force[i], rel=2e-3)
    r = np.linspace(0, 9, 40)
    np.testing.assert_allclose(history.gap(150, r), hertz_gap(r, history.radius[150], R), atol=2e-6)
    # In release the recovering surface lags: the gap beside the contact is narrower than Hertz's of the same radius.
    i, a = 380, history.radius[380]
    beside = a + np.array([0.1, 0.4, 0.9])
    assert np.all(history.gap(i, beside) < hertz_gap(beside, a, R))
    assert np.all(np.diff(history.gap(i, np.linspace(a, 8, 50))) > -1e-9)


def test_a_creeping_contact_lies_on_the_grid_like_any_other():
    t = np.concatenate([np.linspace(0, 1, 60), np.linspace(1, 1.5, 60)[1:]])
    history = press_by_force(t, np.where(t <= 1, 1.1, 1.1 * (2 - t)), R, reduced_series(SOLID, 0.49))
    grid = PlateGrid((180, 200), 0.05, (0.3, -0.2))
    states = list(viscoelastic_states(grid, (0.21, 0.17), history, [0.0, 1.0, 1.4], {"material": "solid"}))
    early, late, released = states
    assert [s.time for s in states] == pytest.approx([0.0, 1.0, 1.4], abs=0.01)
    assert late.nominal_contact_area > 1.3 * early.nominal_contact_area > released.nominal_contact_area
    assert released.parameters["grown_until_s"] < 1.0
    for state, force in zip(states, (1.1, 1.1, 1.1 * 0.6), strict=True):
        assert state.pressure.sum() * grid.pitch**2 == pytest.approx(force, rel=0.015)  # a frame's step in the release
        assert np.all(state.gap[state.contact_mask > 0.999] == 0)


@pytest.mark.parametrize(
    ("time", "force", "message"),
    [
        ([0, 1], [1, -1], "negative"),
        ([1, 0], [1, 1], "descend"),
        ([0, 1], [0, 0], "zero throughout"),
        ([0, 1, 2], [1, 1], "3 times and 2"),
        ([0, 1], [1, float("nan")], "finite"),
    ],
)
def test_bad_programmes_are_refused(time, force, message):
    with pytest.raises(ValueError, match=message):
        press_by_force(time, force, R, SOLID)


def test_a_second_press_is_refused():
    t = np.linspace(0, 3, 301)
    with pytest.raises(ValueError, match="single maximum"):
        press_by_force(t, 1.0 + 0.9 * np.cos(2 * np.pi * t / 1.5), R, SOLID)
