"""Partial slip and sliding against Cattaneo-Mindlin, Mindlin-Deresiewicz, Jaeger's superposition and balances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from evanesce.contact.analytic import partial_slip
from evanesce.contact.analytic.hertz import hertz_contact, hertz_pressure, hertz_radius
from evanesce.contact.analytic.xydas_kao import xydas_kao_contact, xydas_kao_pressure
from evanesce.contact.sliding.area_loss import area_loss_for, area_loss_scaled, area_under_shear
from evanesce.contact.sliding.shaft import shaft_stiffness, tilted_compliance, tip_contact_fits
from evanesce.contact.sliding.solver import march, spring_load
from evanesce.contact.sliding.states import force_within_matrix
from evanesce.materials.friction import InterfaceFriction, coulomb, interface_of

E, R, N, MU, NU = 0.71, 6.9, 1.3, 0.83, 0.5
G = float(partial_slip.tangential_modulus(E, NU))
A = float(hertz_radius(N, R, E))
STEP = A / 1024  # width of a spring


def press(force=N):
    return hertz_contact(force, R, E)


def test_closed_forms_agree_with_each_other():
    q = 0.62 * MU * N
    c = float(partial_slip.stick_radius(A, N, q, MU))
    carried = quad(lambda r: 2 * np.pi * r * partial_slip.traction(r, A, N, q, MU), 0, A, points=[c])[0]
    assert carried == pytest.approx(q, rel=1e-8)
    assert partial_slip.slip(c * 0.999, A, N, q, MU, G) == 0.0
    assert partial_slip.slip(c * 1.0001, A, N, q, MU, G) < 1e-6
    # Johnson (1985) eq 7.41: the rigid displacement, with G* = 8 G/(2 - nu) * 1/2 written out for a rigid plate.
    shear = E * (1 - NU**2) / (2 * (1 + NU))
    johnson = 3 * MU * N * (2 - NU) / (16 * A * shear) * (1 - (1 - q / (MU * N)) ** (2 / 3))
    assert partial_slip.rigid_displacement(A, N, q, MU, G) == pytest.approx(johnson, rel=1e-12)


def test_slip_is_the_gap_between_rigid_and_surface_displacement():
    """Surface displacement from the traction by direct integration of the axisymmetric potential kernel."""
    from scipy.special import ellipkm1

    q = 0.7 * MU * N

    def displaced(r):
        # The mean tangential displacement has the normal problem's kernel, G* for E*: an annulus's is 4 K/(r + s).
        def annulus(s):
            kernel = ellipkm1(max(((r - s) / (r + s)) ** 2, 1e-40))
            return partial_slip.traction(s, A, N, q, MU) * s * 4 * kernel / (r + s)

        parts = (quad(annulus, *ends, limit=200, epsrel=1e-7)[0] for ends in ((0, r), (r, A)))
        return sum(parts) / (np.pi * G)

    whole = float(partial_slip.rigid_displacement(A, N, q, MU, G))
    for share in (0.4, 0.9, 0.97):
        r = share * A
        expected = float(partial_slip.slip(r, A, N, q, MU, G))
        assert whole - displaced(r) == pytest.approx(expected, abs=1e-6 * whole)


def test_springs_carry_the_normal_force_and_its_abel_transform():
    edges = np.linspace(0, 1.2 * A, 700)
    load = spring_load(press(), edges)
    assert 2 * load @ np.diff(edges) == pytest.approx(N, rel=1e-12)
    x = 0.5 * (edges[1:] + edges[:-1])
    whole = (edges[1:] <= A) | (edges[:-1] > A)  # the cut spring holds the mean over its inner part
    # 384 annuli of constant pressure: relative error of an annulus's width squared.
    exact = 0.75 * N / A * np.clip(1 - x**2 / A**2, 0, None)
    np.testing.assert_allclose(load[whole], exact[whole], atol=1e-4 * 0.75 * N / A)
    flat = xydas_kao_contact(N, R, 2.1, 0.25, k=4.0)
    load = spring_load(flat, edges)
    a, r0 = flat.contact_radius, x[200]
    direct = quad(lambda u: 2 * float(xydas_kao_pressure(np.sqrt(r0**2 + u**2), N, a, 4.0)), 0, np.sqrt(a**2 - r0**2))[
        0
    ]
    assert load[200] == pytest.approx(direct, rel=2e-4)


def test_marched_slide_is_cattaneo_mindlin():
    t = np.linspace(0, 1, 60)
    whole = 0.75 * MU * N / (G * A)
    slide = march([press()] * 60, t, 1.2 * whole * t, coulomb(MU), G)
    q = slide.series("tangential_force")
    partial = (q > 0.02) & (q < 0.98 * MU * N)
    assert partial.sum() > 30
    # The springs' widths are the only discretisation: (1/1024)^2 in force and displacement, one width in radius.
    np.testing.assert_allclose(
        partial_slip.rigid_displacement(A, N, q[partial], MU, G), 1.2 * whole * t[partial], rtol=1e-4
    )
    np.testing.assert_allclose(
        slide.series("stick_radius")[partial], partial_slip.stick_radius(A, N, q[partial], MU), atol=2 * STEP
    )
    assert q[-1] == pytest.approx(MU * N, rel=1e-12)
    assert slide.series("stick_ratio")[-1] == 0.0
    # Once it slides as a whole, the middle has slipped by the excess.
    assert slide.frames[-1].spring_slip[0] == pytest.approx(0.2 * whole, rel=1e-3)
    radii = np.linspace(0.1, 0.99 * A, 25)
    frame = slide.frames[30]
    within = force_within_matrix(radii, slide.edges) @ frame.force_density
    exact = [
        quad(lambda r: 2 * np.pi * r * partial_slip.traction(r, A, N, frame.tangential_force, MU), 0, b)[0]
        for b in radii
    ]
    np.testing.assert_allclose(within, exact, atol=2e-4 * MU * N)


def test_reversal_follows_masing():
    """Mindlin and Deresiewicz at constant N: unloading is the virgin curve doubled, and the loop closes."""
    whole = 0.75 * MU * N / (G * A)
    peak = 0.7 * whole
    d = np.concatenate([np.linspace(0, peak, 40), np.linspace(peak, -peak, 80)[1:], np.linspace(-peak, peak, 80)[1:]])
    slide = march([press()] * len(d), np.arange(len(d)) * 0.01, d, coulomb(MU), G)
    q = slide.series("tangential_force")

    def virgin(x):
        return MU * N * (1 - (1 - x / whole) ** 1.5)

    np.testing.assert_allclose(q[:40], virgin(d[:40]), atol=1e-4)
    np.testing.assert_allclose(q[40:119], virgin(peak) - 2 * virgin((peak - d[40:119]) / 2), atol=1e-4)
    assert q[118] == pytest.approx(-virgin(peak), abs=1e-4)
    assert q[-1] == pytest.approx(virgin(peak), abs=1e-4)
    # Dissipation of the loop equals the slip's work, spring by spring, at their limit.
    loop = np.trapezoid(q[39:], d[39:])
    forces = np.array([f.force_density for f in slide.frames[39:]])
    slips = np.array([f.spring_slip for f in slide.frames[39:]])
    work = 2 * np.sum(0.5 * (forces[1:] + forces[:-1]) * np.diff(slips, axis=0)) * STEP
    assert work == pytest.approx(loop, rel=2e-3)


def test_jaegers_superposition_with_a_growing_normal_force():
    """N and Q rise together below mu dN: everything sticks, dQ/dN = const, traction is a scaled pressure (Jaeger)."""
    n = 80
    force = np.linspace(0.0, N, n + 1)[1:]
    ratio = 0.5 * MU
    # Full stick with dQ = ratio dN needs dU = ratio (E*/G*) d(depth).
    depth = hertz_radius(force, R, E) ** 2 / R
    d = ratio * E / G * (depth - depth[0])
    slide = march([press(f) for f in force], np.arange(n) * 0.02, d, coulomb(MU), G, substeps=8)
    q = slide.series("tangential_force")
    # Springs that come in between two frames meet the path's chord; the first frame starts without traction.
    np.testing.assert_allclose(q[10:], ratio * (force[10:] - force[0]), rtol=3e-2)
    assert np.all(slide.series("stick_ratio")[10:] > 0.95)  # springs of the last step are still on their way


def test_partial_slip_of_a_flat_topped_pressure_is_the_superposition_of_ciavarella():
    """In the slip annulus the traction is mu p, whatever the pressure; inside it sticks; the total is Q."""
    contact = xydas_kao_contact(N, R, 2.1, 0.25, k=4.0)
    t = np.linspace(0, 1, 30)
    slide = march([contact] * 30, t, 0.9 * t, coulomb(MU), G)
    frame = next(f for f in slide if 0.3 < f.stick_ratio < 0.7)
    annulus = np.linspace(frame.stick_radius + 0.05, 0.97 * contact.contact_radius, 12)
    h = 0.02
    inner = force_within_matrix(annulus - h, slide.edges) @ frame.force_density
    outer = force_within_matrix(annulus + h, slide.edges) @ frame.force_density
    mean = (outer - inner) / (4 * np.pi * annulus * h)
    expected = MU * (contact.force_within(annulus + h) - contact.force_within(annulus - h)) / (4 * np.pi * annulus * h)
    np.testing.assert_allclose(mean, expected, rtol=5e-3)


def test_falling_normal_force_sheds_tangential_force():
    force = np.concatenate([np.full(20, N), np.linspace(N, 0.3 * N, 30)])
    d = np.concatenate([np.linspace(0, 0.3, 20), np.full(30, 0.3)])
    slide = march([press(f) for f in force], np.arange(50) * 0.1, d, coulomb(MU), G)
    q = slide.series("tangential_force")
    assert np.all(q <= MU * force + 1e-9)
    # Springs only lose on this path, so the end is Cattaneo-Mindlin's for the last N at the held displacement.
    whole = 0.75 * MU * 0.3 * N / (G * hertz_radius(0.3 * N, R, E))
    assert q[-1] == pytest.approx(MU * 0.3 * N * (1 - (1 - 0.3 / whole) ** 1.5), rel=1e-4)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(st.floats(0.05, 2.0), st.floats(-0.8, 0.8)), min_size=3, max_size=9),
    st.floats(0.3, 1.0),
    st.floats(0.0, 0.08),
)
def test_any_path_dissipates_and_stays_within_strength(path, ratio, tau0):
    """Second law, and |Q| at most tau0 A + alpha N, for random presses and slides with weakening."""
    force, drive = (np.repeat(np.array(v), 3) for v in zip(*path, strict=True))
    friction = InterfaceFriction(tau0, 0.6, dynamic_ratio=ratio)
    contacts = [press(float(f)) for f in force]
    slide = march(contacts, np.arange(len(force)) * 0.1, drive, friction, G, springs=128)
    q = slide.series("tangential_force")
    strength = tau0 * np.pi * np.array([c.contact_radius for c in contacts]) ** 2 + 0.6 * force
    assert np.all(np.abs(q) <= strength * (1 + 1e-9))
    for before, after in zip(slide.frames, slide.frames[1:], strict=False):
        moved = after.spring_slip - before.spring_slip
        kept = (after.spring_slip != 0) & (before.contact.contact_radius == after.contact.contact_radius)
        # At constant load a spring that slipped pulls the way it slipped.
        assert np.all(moved[kept] * after.force_density[kept] >= -1e-12)


def test_series_stiffness_adds_compliance():
    t = np.linspace(0, 1, 40)
    d = 0.9 * t
    k = 2.3
    slide = march([press()] * 40, t, d, coulomb(MU), G, drive_stiffness=k)
    q = slide.series("tangential_force")
    partial = (q > 0.01) & (q < 0.97 * MU * N)
    expected = partial_slip.rigid_displacement(A, N, q[partial], MU, G) + q[partial] / k
    np.testing.assert_allclose(d[partial], expected, rtol=2e-4)
    np.testing.assert_allclose(slide.series("tip_displacement"), d - q / k, atol=1e-12)


def test_interfacial_rheology_and_area_loss_are_solved_together():
    friction = interface_of("silskin_0")
    area = np.pi * A**2
    loss = area_loss_for(area, 0.9, 0.8)
    t = np.linspace(0, 1, 50)
    slide = march([press()] * 50, t, 0.9 * t, friction, G, area_loss=loss)
    q, left = slide.series("tangential_force"), slide.series("area")
    np.testing.assert_allclose(left, area - loss * q**2, rtol=1e-12)
    # Gross slip: Q = tau0 (A0 - alpha_A Q^2) + alpha N is a quadratic.
    a, b, c = friction.tau0 * loss, 1.0, -(friction.tau0 * area + friction.alpha * N)
    assert q[-1] == pytest.approx((-b + np.sqrt(b**2 - 4 * a * c)) / (2 * a), rel=1e-9)
    assert np.all(np.diff(left) <= 1e-12)


def test_static_to_dynamic_drop_and_healing():
    friction = InterfaceFriction(0.0, MU, dynamic_ratio=0.7, weakening_distance=0.02, healing_time=0.5)
    d = np.concatenate([np.linspace(0, 1.0, 100), np.full(60, 1.0), np.linspace(1.0, 2.0, 100)])
    slide = march([press()] * len(d), np.arange(len(d)) * 0.1, d, friction, G)
    q = slide.series("tangential_force")
    assert 0.7 * MU * N < q[:100].max() < MU * N
    assert q[99] == pytest.approx(0.7 * MU * N, rel=1e-6)
    # 6 s of rest are 12 healing times. The second break-away is the higher one: rest left every spring at its limit, so
    # that none slips, and weakens, before the others.
    assert q[:100].max() < q[160:].max() <= MU * N
    tired = InterfaceFriction(0.0, MU, dynamic_ratio=0.7, weakening_distance=0.02, healing_time=1e6)
    again = march([press()] * len(d), np.arange(len(d)) * 0.1, d, tired, G).series("tangential_force")
    assert again[160:].max() == pytest.approx(0.7 * MU * N, rel=1e-4)
    flat = march([press()] * 100, np.arange(100) * 0.1, d[:100], coulomb(MU), G).series("tangential_force")
    assert flat.max() == pytest.approx(MU * N, rel=1e-9)


def test_friction_rises_with_speed_as_told():
    friction = InterfaceFriction(0.0, MU, speed_exponent=0.11)
    last = []
    for speed in (1.0, 5.0, 25.0):
        t = np.linspace(0, 2.0 / speed, 50)
        last.append(march([press()] * 50, t, speed * t, friction, G).series("tangential_force")[-1])
    np.testing.assert_allclose(np.array(last) / (MU * N), np.array([1.0, 5.0, 25.0]) ** 0.11, rtol=1e-9)


def test_mu_falls_with_normal_force_as_tau0_over_p_plus_alpha():
    friction = interface_of("silskin_20")
    for force in (0.5, 2.0, 5.0):
        contact = press(force)
        p = force / (np.pi * contact.contact_radius**2)
        t = np.linspace(0, 1, 20)
        slide = march([contact] * 20, t, 2.0 * t, friction, G)
        assert slide.series("tangential_force")[-1] / force == pytest.approx(0.0148 / p + 0.3820, rel=1e-9)


def test_tilted_finger():
    c = tilted_compliance(40.0, 2.5, np.radians(31))
    np.testing.assert_allclose(np.sort(np.linalg.eigvalsh(c)), [1 / 40.0, 1 / 2.5])
    upright = tilted_compliance(40.0, 2.5, 0.0)
    np.testing.assert_allclose(upright, [[1 / 2.5, 0], [0, 1 / 40.0]], atol=1e-15)
    axis = np.array([np.sin(np.radians(31)), np.cos(np.radians(31))])  # tangential, normal
    np.testing.assert_allclose(np.abs(axis @ c @ axis), 1 / 40.0)
    assert tip_contact_fits(5.0, 7.5, np.radians(45))
    assert not tip_contact_fits(5.5, 7.5, np.radians(45))


def test_shaft_stiffness_has_the_limits_of_beam_theory():
    slender = shaft_stiffness(0.3, 1.0, 400.0)
    assert slender == pytest.approx((0.3 * np.pi / 400.0, 3 * 0.3 * np.pi / 4 / 400.0**3), rel=1e-3)
    stubby = shaft_stiffness(0.3, 400.0, 1.0, poisson_ratio=0.5)[1]
    assert stubby == pytest.approx(0.9 * 0.1 * np.pi * 400.0**2, rel=1e-3)
    euler = np.pi**3 * 0.3 * 7.5**4 / (16 * 25.0**2)
    half = shaft_stiffness(0.3, 7.5, 25.0, normal_force=euler / 2)[1]
    assert half == pytest.approx(0.5 * shaft_stiffness(0.3, 7.5, 25.0)[1])
    rolling = shaft_stiffness(0.3, 7.5, 25.0, normal_force=euler / 2, tip_radius=12.5)[1]
    assert rolling == pytest.approx(0.875 * shaft_stiffness(0.3, 7.5, 25.0)[1])  # half the column, four times the load
    with pytest.raises(ValueError, match="folds"):
        shaft_stiffness(0.3, 7.5, 25.0, normal_force=1.01 * euler)


def test_area_laws():
    assert area_under_shear(12.0, 0.8, 2.5) == pytest.approx(12.0 - 2.5 * 0.64)
    assert area_loss_scaled(4.0, 2.0, 1.0) == pytest.approx(0.25)
    with pytest.raises(ValueError, match="more area than there is"):
        area_under_shear(1.0, 2.0, 0.5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": [0, 0, 1]}, "ascend"),
        ({"displacement": [0, 1]}, "at least 2 of each"),
        ({"tangential_modulus": 0.0}, "positive"),
        ({"contacts": [hertz_contact(0.0, R, E)] * 3}, "never touches"),
        ({"springs": 2}, "16 springs"),
    ],
)
def test_bad_slides_are_refused(change, message):
    given = {
        "contacts": [press()] * 3,
        "time": [0, 1, 2],
        "displacement": [0, 0.1, 0.2],
        "friction": coulomb(MU),
        "tangential_modulus": G,
    } | change
    with pytest.raises(ValueError, match=message):
        march(**given)


def test_beyond_gross_slip_is_refused():
    with pytest.raises(ValueError, match="slides as a whole"):
        partial_slip.stick_radius(A, N, 1.01 * MU * N, MU)


def test_hertz_pressure_is_what_the_springs_came_from():
    edges = np.linspace(0, A, 1025)
    load = spring_load(press(), edges)
    radii = np.array([0.2, 0.7, 1.6])
    h = 0.02
    within = force_within_matrix(np.concatenate([radii - h, radii + h]), edges) @ load
    mean = (within[3:] - within[:3]) / (4 * np.pi * radii * h)
    np.testing.assert_allclose(mean, hertz_pressure(radii, N, A), rtol=2e-3)
