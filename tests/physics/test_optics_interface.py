"""Frustrated reflectance against Fresnel, total reflection, and a transfer-matrix program that shares no formula."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from evanesce.optics.interface import (
    critical_angle,
    decay_constant,
    fresnel_reflectance,
    frustrated_reflectance,
    frustrated_transmittance,
    guided_coupling,
    internal_diffuse_reflectance,
)

GLASS, SILICONE, AIR, WAVELENGTH = 1.523, 1.41, 1.0, 550.0


def characteristic_matrix(cos1: float, gap: float, wavelength: float, n1: float, n3: float, n2: float) -> float:
    """Reflectance by Abeles' 2 x 2 matrices of tangential fields, one polarisation after the other."""
    sin1 = np.sqrt(1 - cos1**2)
    cosines = [np.sqrt(complex(1 - (n1 * sin1 / n) ** 2)) for n in (n1, n2, n3)]
    delta = 2 * np.pi * n2 * (gap * 1e6) * cosines[1] / wavelength
    total = 0.0
    for admittance in (lambda n, c: n * c, lambda n, c: n / c):
        y1, y2, y3 = (admittance(n, c) for n, c in zip((n1, n2, n3), cosines, strict=True))
        film = np.array([[np.cos(delta), -1j * np.sin(delta) / y2], [-1j * y2 * np.sin(delta), np.cos(delta)]])
        field, flux = film @ np.array([1.0, y3])
        total += 0.5 * abs((y1 * field - flux) / (y1 * field + flux)) ** 2
    return total


@settings(max_examples=300, deadline=None)
@given(
    cos1=st.floats(0.02, 0.999),
    gap=st.floats(0.0, 2e-3),
    wavelength=st.floats(400.0, 900.0),
    n1=st.floats(1.3, 1.9),
    n3=st.floats(1.05, 1.8),
)
def test_agrees_with_the_transfer_matrix(cos1, gap, wavelength, n1, n3):
    # The matrix's cosh and sinh cancel to 1e-16 e^{2|beta|}: compare where that stays below 1e-9.
    if decay_constant(cos1, wavelength, n1) * gap > 8 or abs(1 - n1**2 * (1 - cos1**2)) < 1e-6:
        return
    here = frustrated_reflectance(cos1, gap, wavelength, n1, n3)
    assert here == pytest.approx(characteristic_matrix(cos1, gap, wavelength, n1, n3, 1.0), abs=1e-9)


def test_media_in_contact_are_fresnel():
    cos = np.cos(np.deg2rad([0.0, 12.3, 41.1, 55.0, 67.0, 69.9, 81.0]))
    np.testing.assert_allclose(
        frustrated_reflectance(cos, 0.0, WAVELENGTH, GLASS, SILICONE),
        fresnel_reflectance(cos, GLASS, SILICONE),
        atol=1e-14,
    )


def test_fresnel_against_textbook_numbers():
    assert fresnel_reflectance(1.0, 1.0, 1.5) == pytest.approx(0.04, rel=1e-14)  # ((n-1)/(n+1))^2
    brewster = np.cos(np.arctan(1.5))
    # At Brewster's angle only s is reflected, by (n^2 - 1)^2/(n^2 + 1)^2.
    assert fresnel_reflectance(brewster, 1.0, 1.5) == pytest.approx(0.5 * (1.25 / 3.25) ** 2, rel=1e-12)


def test_far_silicone_leaves_total_reflection():
    cos = np.cos(critical_angle(GLASS) + np.deg2rad([3.0, 11.0, 30.0]))
    np.testing.assert_allclose(frustrated_reflectance(cos, 0.05, WAVELENGTH, GLASS, SILICONE), 1.0, atol=1e-14)


def test_coupling_decays_as_the_square_of_the_evanescent_field():
    cos = np.cos(np.deg2rad(57.0))
    kappa = decay_constant(cos, WAVELENGTH, GLASS)
    gaps = np.array([4.0, 4.5, 5.5]) / kappa
    t = frustrated_transmittance(cos, gaps, WAVELENGTH, GLASS, SILICONE)
    slopes = np.diff(np.log(t)) / np.diff(gaps)
    # The next term of the expansion is e^{-2 kappa g} = 3e-4 of the leading one; 1 - R loses 1e-16/T = 1e-11.
    np.testing.assert_allclose(slopes, -2 * kappa, rtol=5e-4)


def test_decay_constant_by_hand():
    # 2 pi/550 nm sqrt(1.523^2 sin^2 57 deg - 1) = 2 pi/550e-6 mm * 0.794659
    assert decay_constant(np.cos(np.deg2rad(57.0)), 550.0, 1.523) == pytest.approx(11423.973 * 0.794659, rel=2e-6)
    assert decay_constant(1.0, 550.0, 1.523) == 0.0


@settings(max_examples=100, deadline=None)
@given(sin1=st.floats(0.0, 0.9), gap=st.floats(0.0, 1e-3), n1=st.floats(1.3, 1.7), n3=st.floats(1.3, 1.7))
def test_reciprocity(sin1, gap, n1, n3):
    sin3 = n1 * sin1 / n3
    if sin3 > 0.999:
        return
    forward = frustrated_transmittance(np.sqrt(1 - sin1**2), gap, WAVELENGTH, n1, n3)
    backward = frustrated_transmittance(np.sqrt(1 - sin3**2), gap, WAVELENGTH, n3, n1)
    assert forward == pytest.approx(backward, abs=1e-10)


def test_reflectance_stays_between_zero_and_one_and_is_finite_everywhere():
    cos = np.concatenate([[0.0, 1.0, np.cos(critical_angle(GLASS))], np.linspace(0, 1, 401)])
    r = frustrated_reflectance(cos[:, None], np.array([0.0, 1e-5, 3e-4, 1.0]), WAVELENGTH, GLASS, SILICONE)
    assert np.isfinite(r).all()
    assert r.min() >= 0.0
    assert r.max() <= 1.0


def test_continuous_through_the_critical_angle():
    cos = np.cos(critical_angle(GLASS))
    gaps = np.array([5e-5, 4e-4])
    here = frustrated_reflectance(cos, gaps, WAVELENGTH, GLASS, SILICONE)
    for side in (-1e-9, 1e-9):
        np.testing.assert_allclose(
            frustrated_reflectance(cos + side, gaps, WAVELENGTH, GLASS, SILICONE), here, atol=1e-5
        )


@pytest.mark.parametrize("gap", [0.0, 1.7e-4, 9e-4])
@pytest.mark.parametrize(("n1", "n3"), [(1.523, 1.41), (1.46, 1.55)])
def test_internal_diffuse_reflectance_by_brute_integration(gap, n1, n3):
    # Straight from the definition, on the silicone's side: integral of R31 2 cos sin d(theta).
    def integrand(theta):
        return 2 * np.cos(theta) * np.sin(theta) * frustrated_reflectance(np.cos(theta), gap, WAVELENGTH, n3, n1)

    kinks = [np.arcsin(1 / n3)] + ([np.arcsin(n1 / n3)] if n1 < n3 else [])
    brute, error = quad(integrand, 0, np.pi / 2, points=kinks, limit=400, epsabs=1e-10)
    assert internal_diffuse_reflectance(gap, WAVELENGTH, n1, n3) == pytest.approx(brute, abs=1e-8 + error)


def test_guided_coupling_falls_from_one_to_nothing():
    gaps = np.array([0.0, 5e-5, 1e-4, 3e-4, 5e-3])
    coupling = guided_coupling(gaps, WAVELENGTH, GLASS, SILICONE)
    assert coupling[0] == pytest.approx(1.0, abs=1e-12)
    assert np.all(np.diff(coupling) < 0)
    assert coupling[-1] < 1e-4
