"""Analytic laws against quadrature, the elastic half-space's Green function, and their own limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import ellipk

from evanesce.contact.analytic.hertz import (
    hertz_contact,
    hertz_depth,
    hertz_force_within,
    hertz_gap,
    hertz_pressure,
    hertz_radius,
    reduced_modulus,
    scaled_hertz_contact,
)
from evanesce.contact.analytic.jkr import (
    jkr_depth,
    jkr_force_within,
    jkr_gap,
    jkr_pressure,
    jkr_pull_off_force,
    jkr_radius,
)
from evanesce.contact.analytic.xydas_kao import xydas_kao_force_within, xydas_kao_pressure, xydas_kao_radius

R, E, F, W = 7.3, 0.41, 1.7, 2.3e-3  # mm, MPa, N, N/mm


def surface_displacement(r: float, a: float, pressure) -> float:
    """Displacement of an elastic half-space [mm] by Boussinesq's point load summed over annuli of pressure.

    An annulus of radius s, load p(s) s ds, moves the surface at r by 4/(pi E*) p s/(s + r) K(m), m = 4 s r/(s + r)^2.
    The substitution s = a sin(t) takes the roots at the edge out of the integrand.
    """

    def annulus(t: float) -> float:
        s = a * np.sin(t)
        m = 4 * s * r / (s + r) ** 2
        return 4 / (np.pi * E) * pressure(s) * s / (s + r) * ellipk(m) * a * np.cos(t)

    breaks = [np.arcsin(r / a)] if r < a else None
    return quad(annulus, 0, np.pi / 2, points=breaks, limit=400, epsabs=1e-12, epsrel=1e-9)[0]


def test_hertz_pressure_integrates_to_the_force() -> None:
    a = float(hertz_radius(F, R, E))
    total = quad(lambda r: 2 * np.pi * r * hertz_pressure(r, F, a), 0, a, epsrel=1e-11)[0]
    assert total == pytest.approx(F, rel=1e-9)
    part = quad(lambda r: 2 * np.pi * r * hertz_pressure(r, F, a), 0, 0.37 * a, epsrel=1e-11)[0]
    assert hertz_force_within(0.37 * a, F, a) == pytest.approx(part, rel=1e-9)


@pytest.mark.parametrize("ratio", [0.31, 0.83, 1.02, 1.4, 3.1])
def test_hertz_gap_is_sphere_minus_depth_plus_boussinesq_displacement(ratio: float) -> None:
    a = float(hertz_radius(F, R, E))
    depth = float(hertz_depth(F, R, E))
    r = ratio * a
    moved = surface_displacement(r, a, lambda s: float(hertz_pressure(s, F, a)))
    gap = r**2 / (2 * R) - depth + moved
    assert float(hertz_gap(r, a, R)) == pytest.approx(gap, abs=1e-8 * depth + 1e-9)


@pytest.mark.parametrize("ratio", [0.4, 0.9, 1.02, 1.6])
def test_jkr_gap_is_sphere_minus_depth_plus_boussinesq_displacement(ratio: float) -> None:
    a = float(jkr_radius(F, R, E, W))
    depth = float(jkr_depth(F, R, E, W))
    r = ratio * a
    moved = surface_displacement(r, a, lambda s: float(jkr_pressure(s, a, R, E, W)) if s < a else 0.0)
    gap = r**2 / (2 * R) - depth + moved
    # the edge singularity is integrable after the substitution; quad reports about 1e-8
    assert float(jkr_gap(r, a, R, E, W)) == pytest.approx(gap, abs=3e-7)


def test_jkr_pressure_integrates_to_the_force() -> None:
    a = float(jkr_radius(F, R, E, W))
    total = quad(
        lambda t: 2 * np.pi * a**2 * np.sin(t) * np.cos(t) * jkr_pressure(a * np.sin(t), a, R, E, W), 0, np.pi / 2
    )
    assert total[0] == pytest.approx(F, rel=1e-8)
    assert jkr_force_within(a, a, R, E, W) == pytest.approx(F, rel=1e-12)


def test_jkr_without_adhesion_is_hertz() -> None:
    forces = np.array([0.0, 0.013, 1.1, 4.9])
    assert jkr_radius(forces, R, E, 0.0) == pytest.approx(hertz_radius(forces, R, E), rel=1e-14)
    assert jkr_depth(forces, R, E, 0.0) == pytest.approx(hertz_depth(forces, R, E), rel=1e-14)
    r = np.array([0.1, 1.3, 2.9, 6.0])
    a = float(hertz_radius(F, R, E))
    assert jkr_pressure(r, a, R, E, 0.0) == pytest.approx(hertz_pressure(r, F, a), rel=1e-12, abs=1e-15)


def test_jkr_lets_go_at_the_pull_off_force_where_equilibrium_ends() -> None:
    pull = jkr_pull_off_force(R, W)
    a = float(jkr_radius(pull, R, E, W))

    # Independent: F(a) from the stress intensity at the edge, K = p1 sqrt(pi a) with w = K^2/(2 E*).
    def force(radius: float) -> float:
        return 4 * E * radius**3 / (3 * R) - np.sqrt(8 * np.pi * W * E * radius**3)

    assert force(a) == pytest.approx(pull, rel=1e-12)
    step = 1e-4 * a
    assert force(a - step) > pull < force(a + step)  # the minimum of the equilibrium curve
    with pytest.raises(ValueError, match="pull-off"):
        jkr_radius(1.001 * pull, R, E, W)


def test_jkr_depth_minimises_the_energy_at_fixed_depth() -> None:
    # At fixed depth the elastic energy of a contact of radius a, less its surface energy pi a^2 w, is stationary in a.
    depth = float(jkr_depth(F, R, E, W))
    a = float(jkr_radius(F, R, E, W))

    def energy(radius: float) -> float:
        # elastic energy of a punch of radius a in the sphere at depth d: E*(d^2 a - 2 d a^3/(3R) + a^5/(5 R^2))
        return (
            E * (depth**2 * radius - 2 * depth * radius**3 / (3 * R) + radius**5 / (5 * R**2)) - np.pi * radius**2 * W
        )

    h = 1e-4 * a
    slope = (energy(a + h) - energy(a - h)) / (2 * h)
    scale = 2 * np.pi * a * W
    assert (
        abs(slope) < 1e-5 * scale
    )  # central difference: relative truncation (h/a)^2 = 1e-8 of terms ~100 times larger


@given(
    k=st.floats(1.2, 6.0),
    gamma=st.floats(0.0, 1 / 3),
    c=st.floats(0.3, 5.0),
    force=st.floats(0.01, 20.0),
)
@settings(max_examples=30, deadline=None)
def test_xydas_kao_keeps_the_force_for_every_shape(k: float, gamma: float, c: float, force: float) -> None:
    a = float(xydas_kao_radius(force, c, gamma))
    total = quad(lambda r: 2 * np.pi * r * xydas_kao_pressure(r, force, a, k), 0, a, epsrel=1e-10, limit=200)[0]
    assert total == pytest.approx(force, rel=1e-7)
    part = quad(lambda r: 2 * np.pi * r * xydas_kao_pressure(r, force, a, k), 0, 0.6 * a, epsrel=1e-10)[0]
    assert float(xydas_kao_force_within(0.6 * a, force, a, k)) == pytest.approx(part, rel=1e-8)


def test_xydas_kao_spans_from_constant_radius_to_hertz() -> None:
    forces = np.array([0.2, 1.0, 3.7])
    assert xydas_kao_radius(forces, 2.2, 0.0) == pytest.approx(2.2)
    c = float(hertz_radius(1.0, R, E))
    assert xydas_kao_radius(forces, c, 1 / 3) == pytest.approx(hertz_radius(forces, R, E), rel=1e-14)
    assert xydas_kao_radius(0.0, 2.2, 0.0) == 0.0
    a = float(hertz_radius(F, R, E))
    r = np.array([0.0, 0.9, 2.2, 5.0])
    assert xydas_kao_pressure(r, F, a, 2.0) == pytest.approx(hertz_pressure(r, F, a), rel=1e-12)


def test_scaled_hertz_keeps_force_and_depth_and_scales_area_and_pressure() -> None:
    plain, wide = hertz_contact(F, R, E), scaled_hertz_contact(F, R, E, 1.66)
    assert wide.contact_radius**2 == pytest.approx(1.66 * plain.contact_radius**2, rel=1e-14)
    assert wide.depth == plain.depth
    far = np.array(10.0)
    assert float(wide.force_within(far)) == pytest.approx(F, rel=1e-14)
    small = np.array(1e-3)
    assert float(plain.force_within(small) / wide.force_within(small)) == pytest.approx(1.66, rel=1e-6)
    edge = np.array(wide.contact_radius)
    assert float(wide.gap(edge)) == 0.0
    assert float(wide.gap(1.1 * edge)) > 0.0


@pytest.mark.parametrize(
    "call",
    [
        lambda: hertz_radius(-0.1, R, E),
        lambda: hertz_radius(np.nan, R, E),
        lambda: hertz_radius(1.0, 0.0, E),
        lambda: hertz_radius(1.0, R, -E),
        lambda: hertz_pressure(0.3, 1.0, 0.0),
        lambda: hertz_gap(0.3, -1.0, R),
        lambda: reduced_modulus(2.0, 0.5, -0.3),
        lambda: reduced_modulus(2.0, float("nan"), 0.3),
        lambda: scaled_hertz_contact(1.0, R, E, 0.0),
        lambda: jkr_radius(1.0, R, E, -1e-3),
        lambda: xydas_kao_radius(1.0, 2.0, 0.34),
        lambda: xydas_kao_radius(1.0, 2.0, -0.01),
        lambda: xydas_kao_radius(-1.0, 2.0, 0.2),
        lambda: xydas_kao_pressure(0.1, 1.0, 1.0, 0.0),
    ],
)
def test_outside_their_domain_the_laws_refuse(call) -> None:
    with pytest.raises(ValueError, match=r"\d|must|not positive|not finite"):
        call()
