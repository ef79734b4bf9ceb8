"""The rubber: stress and tangent against differences of the energy, closed forms, and where it stops being stable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evanesce.contact.fem.material import Rubber, carried_on, distortional_stress, distortional_tangent, energy, rubber
from evanesce.core.errors import InputError
from evanesce.materials.hyperelastic import MooneyRivlin, drucker_tangent

MATERIALS = {
    "silskin_0": rubber("silskin_0"),
    "silskin_20": rubber("silskin_20"),
    "all terms": Rubber(0.031, 0.017, 0.008, 0.0023, 0.0041, 0.15),
}


def _gradients() -> np.ndarray:
    rng = np.random.default_rng(11)
    return np.eye(3)[:, :, None] + 0.25 * rng.normal(size=(3, 3, 6))


@pytest.mark.parametrize("name", MATERIALS)
def test_stress_and_tangent_are_derivatives_of_the_energy(name: str) -> None:
    material, gradient = MATERIALS[name], _gradients()
    stress, tangent = distortional_stress(material, gradient), distortional_tangent(material, gradient)
    h = 1e-5  # central differences err by h^2 times a third derivative, some 1e3 times the largest second
    for k in range(3):
        for m in range(3):
            d = np.zeros((3, 3, 1))
            d[k, m] = h
            slope = (energy(material, gradient + d) - energy(material, gradient - d)) / (2 * h)
            np.testing.assert_allclose(stress[k, m], slope, atol=1e-6 * np.abs(stress).max())
            bend = (distortional_stress(material, gradient + d) - distortional_stress(material, gradient - d)) / (2 * h)
            np.testing.assert_allclose(tangent[:, :, k, m], bend, atol=1e-6 * np.abs(tangent).max())


def test_a_change_of_volume_or_a_turn_costs_nothing() -> None:
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    gradient = (1.3 * turn)[:, :, None]
    material = MATERIALS["all terms"]
    assert abs(float(energy(material, gradient)[0])) < 1e-15
    assert np.abs(distortional_stress(material, gradient)).max() < 1e-15


@pytest.mark.parametrize("name", ["silskin_0", "silskin_20"])
@pytest.mark.parametrize("stretch", [0.7, 0.95, 1.2, 1.6])
def test_uniaxial_stress_is_the_closed_form(name: str, stretch: float) -> None:
    """P11 - P22 l2/l1 frees the sides of an incompressible bar; the closed form is that of evanesce.materials."""
    material = MATERIALS[name]
    side = stretch**-0.5
    stress = distortional_stress(material, np.diag([stretch, side, side])[:, :, None])[..., 0]
    nominal = stress[0, 0] - stress[1, 1] * side / stretch
    closed = MooneyRivlin(material.c10, material.c01, material.c11).uniaxial(stretch)
    assert nominal == pytest.approx(float(closed), rel=1e-10)


def test_stable_range_of_the_thesis_materials() -> None:
    """Silskin 0 % loses Drucker stability at 0.36 and 2.63, as its table says; 20 % is stable throughout."""
    low, high = MATERIALS["silskin_0"].stable_stretches()
    step = np.log(6) / 600  # spacing of the search in log stretch
    assert low == pytest.approx(0.36, rel=2 * step + 0.005)  # 0.36 is rounded to 0.005
    assert high == pytest.approx(2.63, rel=2 * step + 0.002)
    low, high = MATERIALS["silskin_20"].stable_stretches()
    assert high == pytest.approx(6.0)
    assert low == pytest.approx(1 / 6)


def test_stability_agrees_with_the_closed_form_tangent() -> None:
    """Differences of the energy here; the analytic Hessian of evanesce.materials there."""
    material = MATERIALS["silskin_0"]
    a, b = (values.ravel() for values in np.meshgrid(np.geomspace(0.3, 3.3, 60), np.geomspace(0.3, 3.3, 60)))
    smallest = drucker_tangent(MooneyRivlin(material.c10, material.c01, material.c11), a, b)
    clear = np.abs(smallest) > 1e-3  # [MPa]: differences of step 1e-3 err by some 1e-6 of moduli of up to 10 MPa
    found = material.is_stable(1.2 * np.column_stack([a, b, 1 / (a * b)]))
    assert 0.05 < found.mean() < 0.95
    np.testing.assert_array_equal(found[clear], smallest[clear] > 0)


def test_a_cubic_term_widens_the_stable_range() -> None:
    plain = MATERIALS["silskin_0"]
    assert replace(plain, c30=1e-3).stable_stretches()[1] > plain.stable_stretches()[1]


def test_reduced_modulus_of_an_almost_incompressible_rubber() -> None:
    material = replace(MATERIALS["silskin_0"], bulk_ratio=1e5)
    assert material.reduced_modulus == pytest.approx(4 * material.shear_modulus, rel=1e-4)


@pytest.mark.parametrize(
    "change", [{"c10": -1.0}, {"c30": -0.1}, {"bulk_ratio": 1.0}, {"c11": float("inf")}, {"stretch_limit": 0.9}]
)
def test_impossible_rubbers_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(InputError):
        replace(MATERIALS["silskin_0"], **change)


def test_silicone_without_a_fit_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="silskin_0, silskin_20"):
        rubber("silastic_20")


def test_a_material_that_is_carried_on_is_the_published_one_until_its_fit_fails() -> None:
    """Silskin 0 %'s coefficients lose stability at a stretch of 0.36; as published up to where the term sets in."""
    published = rubber("silskin_0")
    carried = carried_on(published)
    assert carried.stable_stretches() == pytest.approx((1 / 6, 6.0))
    stretches = np.exp(np.linspace(-0.95, 1.0, 40))
    bars = np.stack([np.diag([s, s**-0.5, s**-0.5]) for s in stretches], axis=-1)
    before = np.einsum("ij...,ij...->...", bars, bars) - 3.0 < carried.beyond_from
    stress, kept = (distortional_stress(one, bars) for one in (carried, published))
    np.testing.assert_array_equal(stress[..., before], kept[..., before])
    assert 5 < before.sum() < 40
    assert (np.abs(stress - kept)[..., ~before].max(axis=(0, 1)) > 0).all()
    # stable in compression until 0.36: the term sets in before, by no more than a fifth
    low = stretches[before].min()
    assert published.stable_stretches()[0] < low < 1.2 * published.stable_stretches()[0]
    assert carried_on(rubber("silskin_20")) == rubber("silskin_20")
    assert "beyond" not in published.identity()
    assert carried.identity()["beyond"] > 0
