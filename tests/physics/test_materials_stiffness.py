"""Mooney-Rivlin fits and limits, elliptic Hertz, deadener trend: identities, limits, synthetic truth with noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from evanesce.bench import compression, indentation
from evanesce.bench.compression import fit_mooney_rivlin
from evanesce.contact.analytic.hertz import hertz_radius
from evanesce.core.errors import InputError, WorkError
from evanesce.materials import hyperelastic
from evanesce.materials.deadener import fit_deadener, interpolate_modulus
from evanesce.materials.hyperelastic import MooneyRivlin, drucker_tangent, stability_limits
from evanesce.materials.tables import read_tables

S0, S20 = hyperelastic.of_material("silskin_0"), hyperelastic.of_material("silskin_20")
ODD = MooneyRivlin(0.031, 0.017, 0.0043)


def test_stress_is_the_derivative_of_the_energy():
    for s in (0.44, 0.9, 1.7):
        h = 1e-5
        slope = (ODD.energy(s + h, (s + h) ** -0.5) - ODD.energy(s - h, (s - h) ** -0.5)) / (2 * h)
        assert ODD.uniaxial(s) == pytest.approx(slope, rel=1e-7, abs=1e-10)
    # Simple shear of amount g has principal stretches g/2 + sqrt(1 + g^2/4) and its inverse.
    for g in (0.3, 1.4):
        big = [x / 2 + np.sqrt(1 + x**2 / 4) for x in (g - 1e-5, g + 1e-5)]
        low, high = (ODD.energy(b, 1 / b) for b in big)
        assert ODD.simple_shear(g) == pytest.approx((high - low) / 2e-5, rel=1e-7)


def test_small_strain_moduli_of_the_thesis():
    assert S0.shear_modulus == pytest.approx(0.1063, abs=5e-5)
    assert S20.youngs_modulus == pytest.approx(0.0304, abs=5e-5)
    h = 1e-6
    assert (S0.uniaxial(1 + h) - S0.uniaxial(1 - h)) / (2 * h) == pytest.approx(S0.youngs_modulus, rel=1e-6)


def test_drucker_tangent_is_the_hessian_of_the_energy_in_log_strain():
    x, y, h = np.log(1.31), np.log(0.83), 1e-4

    def w(a, b):
        return float(ODD.energy(np.exp(a), np.exp(b)))

    xx = (w(x + h, y) - 2 * w(x, y) + w(x - h, y)) / h**2
    yy = (w(x, y + h) - 2 * w(x, y) + w(x, y - h)) / h**2
    xy = (w(x + h, y + h) - w(x + h, y - h) - w(x - h, y + h) + w(x - h, y - h)) / (4 * h**2)
    lowest = np.linalg.eigvalsh([[xx, xy], [xy, yy]])[0]
    assert drucker_tangent(ODD, 1.31, 0.83) == pytest.approx(lowest, rel=1e-6)


def test_limits_of_the_thesis_materials():
    limits = stability_limits(S0)
    assert limits.compression == pytest.approx(0.36, abs=0.005)  # as found independently for the finite elements
    assert limits.tension == pytest.approx(2.63, abs=0.005)
    assert limits.simple_shear == pytest.approx(np.sqrt((S0.c10 + S0.c01) / (6 * -S0.c11)), rel=1e-6)
    assert limits.equibiaxial == pytest.approx(limits.compression**-0.5, rel=1e-4)  # the same state of strain
    assert set(vars(stability_limits(S20)).values()) == {None}
    assert set(vars(stability_limits(MooneyRivlin(0.1, 0.05))).values()) == {None}


def test_fit_recovers_coefficients_within_their_standard_errors():
    """Pulls over many noisy repeats: mean 0, standard deviation 1 (chi-square over 200 repeats, 3 coefficients)."""
    rng = np.random.default_rng(11)
    stretch = np.linspace(0.99, 0.55, 60)
    clean = S0.uniaxial(stretch)
    pulls = []
    for _ in range(200):
        fit = fit_mooney_rivlin(stretch, clean + 5e-4 * rng.normal(size=60))
        found = np.array([fit.material.c10, fit.material.c01, fit.material.c11])
        pulls.append((found - [S0.c10, S0.c01, S0.c11]) / fit.standard_error)
    pulls = np.array(pulls)
    # Standard errors of mean and deviation over 200 repeats: 0.07 and 0.05; five of each.
    assert np.abs(pulls.mean(0)).max() < 0.36
    assert np.abs(pulls.std(0) - 1).max() < 0.27


def test_band_covers_the_truth_and_terms_can_be_left_out():
    rng = np.random.default_rng(5)
    stretch = np.linspace(0.98, 0.6, 50)
    true = MooneyRivlin(0.06, 0.02)
    covered = []
    for _ in range(200):
        fit = fit_mooney_rivlin(stretch, true.uniaxial(stretch) + 3e-4 * rng.normal(size=50), terms=2)
        covered.append(abs(fit.material.uniaxial(0.75) - true.uniaxial(0.75)) < fit.band(0.75))
        assert fit.material.c11 == 0.0
        assert fit.standard_error[2] == 0.0
    assert np.mean(covered) == pytest.approx(0.95, abs=5 * np.sqrt(0.95 * 0.05 / 200))


def test_condition_warns_of_a_short_curve():
    long = fit_mooney_rivlin(np.linspace(0.99, 0.4, 40), S0.uniaxial(np.linspace(0.99, 0.4, 40)))
    short = fit_mooney_rivlin(np.linspace(0.99, 0.85, 40), S0.uniaxial(np.linspace(0.99, 0.85, 40)))
    assert short.condition > 4 * long.condition


def test_compression_files(tmp_path):
    s = np.linspace(1.0, 0.6, 30)
    strain = tmp_path / "strain.csv"
    np.savetxt(
        strain, np.c_[100 * (1 - s), -1e3 * S0.uniaxial(s)], delimiter=",", header="strain_%,stress_kPa", comments=""
    )
    force = tmp_path / "force.csv"
    columns = np.c_[(s - 1) * 12.5, S0.uniaxial(s) * 660]  # compression written negative
    np.savetxt(force, columns, delimiter=",", header="displacement_mm,force_N", comments="")
    one = compression.read_compression(strain)
    two = compression.read_compression(force, height=12.5, area=660.0)
    np.testing.assert_allclose(one, two, rtol=1e-12)
    assert fit_mooney_rivlin(*one).material.c01 == pytest.approx(S0.c01, rel=1e-6)
    with pytest.raises(InputError, match="need the sample's size"):
        compression.read_compression(force)
    with pytest.raises(InputError, match="compressed by"):
        compression.read_compression(force, height=4.0, area=660.0)


def test_bad_curves():
    s = np.linspace(0.9, 0.6, 10)
    with pytest.raises(ValueError, match="wrong sign"):
        fit_mooney_rivlin(s, -S0.uniaxial(s))
    with pytest.raises(ValueError, match="at least 5"):
        fit_mooney_rivlin(s[:3], S0.uniaxial(s[:3]))
    with pytest.raises(InputError, match="no compression test"):
        hyperelastic.of_material("silastic_10")


# --- elliptic Hertz


def test_equal_radii_are_a_circle():
    """Crossed equal cylinders are a sphere on a plane."""
    g = indentation.elliptic_geometry(6.3, 6.3)
    a, b = g.semi_axes(2.2, 0.9)
    assert a == b == pytest.approx(hertz_radius(2.2, 6.3, 0.9))
    assert g.depth(2.2, 0.9) == pytest.approx(a**2 / 6.3)
    near = indentation.elliptic_geometry(6.3, 6.3 * 1.00001)
    assert near.depth(2.2, 0.9) == pytest.approx(g.depth(2.2, 0.9), rel=1e-4)


def test_ellipse_presses_bodies_into_contact():
    """The displacement under the pressure, by quadrature, has the bodies' curvatures."""
    r1, r2, force, modulus = 8.2, 12.725, 3.1, 0.45
    g = indentation.elliptic_geometry(r1, r2)
    a, b = (float(v) for v in g.semi_axes(force, modulus))
    front = 3 * force / (4 * np.pi * modulus)

    def potential(power_a, power_b):
        # w = tan^2 maps the half line; Johnson (1985), eq 3.61 to 3.64.
        def integrand(p):
            w = (b * np.tan(p)) ** 2
            jac = 2 * b**2 * np.tan(p) / np.cos(p) ** 2
            return jac / ((a**2 + w) ** power_a * (b**2 + w) ** power_b * np.sqrt(w))

        return quad(integrand, 0, np.pi / 2)[0]

    depth = front * potential(0.5, 0.5)
    assert g.depth(force, modulus) == pytest.approx(depth, rel=1e-9)
    assert front * potential(1.5, 0.5) == pytest.approx(1 / (2 * r2), rel=1e-9)
    assert front * potential(0.5, 1.5) == pytest.approx(1 / (2 * r1), rel=1e-9)


def test_mean_pressure_carries_the_force_and_peak_is_half_as_much_again():
    g = indentation.elliptic_geometry(7.5, 12.725)
    a, b = g.semi_axes(4.0, 0.4)
    assert indentation.mean_pressure(4.0, a, b) * np.pi * a * b == pytest.approx(4.0)
    peak = float(indentation.peak_pressure(4.0, a, b))
    carried = 2 * np.pi * float(a * b) * quad(lambda s: peak * np.sqrt(1 - s**2) * s, 0, 1)[0]
    assert carried == pytest.approx(4.0)


def test_thesis_depth_formulas_are_twice_the_modulus_with_regression_constants():
    """Eqs 3.4 and 3.7: with E' = 2 E* and the Brewe-Hamrock regressions, not the exact elliptic integrals."""
    for radius, printed in ((8.2, 0.5881), (7.5, 0.5988)):
        ratio = max(radius, 12.725) / min(radius, 12.725)
        k = 1.0339 * ratio**0.636
        second, first = 1.0003 + 0.5968 / ratio, 1.5277 + 0.6023 * np.log(ratio)
        g = indentation.elliptic_geometry(radius, 12.725)
        factor = 2 / np.pi * first * (np.pi / (2 * k**2 * second)) ** (1 / 3)
        regression = factor * (3 * g.effective_radius) ** (2 / 3) / (2 * g.effective_radius)
        assert regression == pytest.approx(printed, abs=1e-4)
        exact = float(g.depth(1.0, 0.5))  # E' = 1 is E* = 1/2
        assert 0.018 < exact / printed - 1 < 0.026


def test_youngs_modulus_of_the_thesis_needs_the_fingers_poisson_ratio():
    """Eq 3.6 prints nu1 in the numerator; the printed 0.0836 to 0.229 MPa follow from the finger's nu near 0.5."""
    printed = np.array([0.0836, 0.229])
    modulus = 0.5 * np.array([0.2216, 0.2216 + 10 * 0.0392])  # E* = E'/2
    np.testing.assert_allclose(indentation.youngs_from_reduced(modulus, 0.5), printed, rtol=0.01)
    as_printed = 2 * modulus * 210e3 * (1 - 0.3**2) / (2 * 210e3 - 2 * modulus * (1 - 0.3**2))
    assert np.all(as_printed > 1.19 * printed)
    # Definition of E*, forwards.
    assert 1 / indentation.youngs_from_reduced(5.0, 0.4, 300.0, 0.2) * (1 - 0.16) + (1 - 0.04) / 300.0 == pytest.approx(
        0.2
    )


def test_indentation_recovers_modulus_and_touch():
    rng = np.random.default_rng(8)
    g = indentation.elliptic_geometry(7.5, 12.725)
    force = np.linspace(0.05, 10, 300)
    pulls = []
    for _ in range(40):
        x = 0.37 + g.depth(force, 0.2963 + 0.0332 * force) + 0.004 * rng.normal(size=300)
        r = indentation.analyse(force, x, g, 0.49)
        pulls.append([(r.intercept - 0.2963) / r.intercept_se, (r.slope - 0.0332) / r.slope_se])
        assert r.touch == pytest.approx(0.37, abs=0.005)
        assert r.depth_rms == pytest.approx(0.004, rel=0.25)
    # Mean and spread of 40 pulls: standard errors 0.16 and 0.11; five of each.
    assert np.abs(np.mean(pulls, 0)).max() < 0.8
    assert np.abs(np.std(pulls, 0) - 1).max() < 0.6
    np.testing.assert_allclose(r.peak_pressure, 1.5 * r.mean_pressure)


def test_bad_indentations(tmp_path):
    g = indentation.elliptic_geometry(7.5, 12.7)
    with pytest.raises(WorkError, match="at least 6"):
        indentation.analyse([1, 2], [1, 2], g, 0.49)
    with pytest.raises(ValueError, match="positive"):
        indentation.elliptic_geometry(0.0, 1.0)
    with pytest.raises(ValueError, match="exceeds"):
        indentation.youngs_from_reduced(3e5, 0.3)
    path = tmp_path / "zero.csv"
    path.write_text("force_N,displacement_mm\n0,0\n0,1\n")
    with pytest.raises(InputError, match="zero throughout"):
        indentation.read_indentation(path)


# --- deadener


def test_deadener_interpolation_passes_through_the_table_monotonically():
    sweep = read_tables().youngs_modulus["silskin"]
    percent, modulus = np.array(sweep.deadener_percent), np.array(sweep.modulus_MPa)
    np.testing.assert_allclose(interpolate_modulus(percent, percent, modulus), modulus)
    fine = interpolate_modulus(np.linspace(0, 40, 200), percent, modulus)
    assert np.all(np.diff(fine) < 0)
    with pytest.raises(ValueError, match="outside the table"):
        interpolate_modulus(41.0, percent, modulus)


def test_deadener_fit_returns_an_exponential():
    d = np.array([0.0, 7.0, 20.0, 33.0])
    fit = fit_deadener(d, 0.8 * np.exp(-0.11 * d))
    assert (fit.modulus_0, fit.decay) == pytest.approx((0.8, 0.11))
    assert fit.log_rms < 1e-12
    sweep = read_tables().youngs_modulus["silskin"]
    thesis = fit_deadener(sweep.deadener_percent, sweep.modulus_MPa)
    assert thesis.decay == pytest.approx(0.12, abs=3 * thesis.decay_se)
    with pytest.raises(ValueError, match="at least 3"):
        fit_deadener([0, 1], [1, 2])
