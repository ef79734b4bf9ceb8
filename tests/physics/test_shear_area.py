"""Area under shear: peeling against the minimum of energy, the solved slides, and what a scene's slide shows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from evanesce.contact.analytic.hertz import hertz_radius
from evanesce.contact.analytic.jkr import jkr_radius
from evanesce.contact.fem.library import FAR_SLIDES, library_press, library_slide
from evanesce.contact.sliding.shear_area import bulging_share, peeled_radius, peeling_share
from evanesce.contact.solve import contact_sequence
from evanesce.core.states import ContactState
from evanesce.materials import material
from evanesce.rig import load_scene
from evanesce.studies.mechanics.curves import slide_curves

STICKY = {"finger.work_of_adhesion_N_per_mm": 5e-5, "contact": {"law": "hertz", "reduced_modulus_MPa": 0.4}}


def slide(**more: object) -> list[ContactState]:
    base = {"grid.size_mm": 34.0, "grid.samples": 400, "press.frame_rate_hz": 10.0, "slide.shaft": "rigid"}
    states = contact_sequence(load_scene("thesis_slide", base | {k.replace("__", "."): v for k, v in more.items()}))
    return [states[i] for i in range(12, len(states))]


@pytest.mark.parametrize("shear", [0.0, 0.03, 0.06, 0.09])
def test_peeling_is_the_minimum_of_the_potential(shear: float) -> None:
    force, radius, modulus, tangential, work = 0.3, 7.5, 0.4, 0.53, 1e-4

    def potential(a: float) -> float:
        # Johnson's superposition: press to a as Hertz, then pull back as a flat punch; loads, surface and shear.
        hertz = 4 * modulus * a**3 / (3 * radius)
        punch = hertz - force
        depth = a**2 / radius - punch / (2 * modulus * a)
        strain = 8 * modulus * a**5 / (15 * radius**2) - (hertz**2 - force**2) / (4 * modulus * a)
        twist = shear**2 / (2 * 2 * a * tangential)
        return strain - force * depth - twist - work * np.pi * a**2

    low = float(hertz_radius(force, radius, modulus))
    best = minimize_scalar(potential, bounds=(low, 1.5 * low), method="bounded", options={"xatol": 1e-10}).x
    assert peeled_radius(force, shear, radius, modulus, tangential, work) == pytest.approx(best, rel=1e-5)


def test_limits_of_peeling() -> None:
    inputs = (0.5, 7.5, 0.4, 0.53, 8e-5)
    share = peeling_share(*inputs)
    hertz, jkr = float(hertz_radius(0.5, 7.5, 0.4)), float(jkr_radius(0.5, 7.5, 0.4, 8e-5))
    assert share(0.0) == pytest.approx(1.0, rel=1e-12)
    assert share(9.0) == share(-9.0) == pytest.approx((hertz / jkr) ** 2, rel=1e-9)
    small = [1.0 - share(q) for q in (0.004, 0.008)]
    assert small[1] == pytest.approx(4 * small[0], rel=0.05)  # by the square of the shear, as Sahli measured


@pytest.mark.parametrize(("name", "bone"), list(FAR_SLIDES))
def test_bulging_is_that_of_the_solved_slide(name: str, bone: str) -> None:
    one, fit = library_slide(FAR_SLIDES[name, bone][0]).scalars, material(name).mooney_rivlin
    assert fit is not None
    share = bulging_share(library_press(name, bone).area(1.0), fit.shear_modulus_MPa, name, bone)
    away = [share(float(q)) - a / one["area"][0] for q, a in zip(one["tangential_force"], one["area"], strict=True)]
    assert share(0.0) == 1.0
    assert np.sqrt(np.mean(np.square(away))) < 0.06  # single steps of coarse elements scatter
    assert share(1e3) == share(one["tangential_force"].max() + 1e-6)  # it stays beyond the last


def test_a_solid_finger_of_soft_silicone_gains_area_before_it_loses_it() -> None:
    """As the thesis reports of Silskin 20 %, which slid by 15 mm without gross slip (section 6.4.3)."""
    one, fit = library_slide(FAR_SLIDES["silskin_20", "none"][0]).scalars, material("silskin_20").mooney_rivlin
    assert fit is not None
    share = bulging_share(library_press("silskin_20").area(1.0), fit.shear_modulus_MPa, "silskin_20", "none")
    gained = [share(q) for q in np.linspace(0.0, 0.2, 21)]
    assert 1.08 < max(gained) < 1.16
    assert share(0.67) < 0.6
    at_15 = np.interp(15.0, one["slide"], one["tangential_force"] / one["normal_force"])
    assert at_15 < 0.5 * 1.75


@pytest.mark.parametrize("bone", ["none", "half"])
def test_the_share_is_that_of_a_slide_on_a_finer_mesh_at_another_friction(bone: str) -> None:
    """Elements of 0.8 in place of 1.1 mm, 0.82 in place of 1.13: the strain decides."""
    one = slide_curves()[f"silskin_0_{bone}_mu082_force"]
    fit = material("silskin_0").mooney_rivlin
    assert fit is not None
    share = bulging_share(library_press("silskin_0", bone).area(1.0), fit.shear_modulus_MPa, "silskin_0", bone)
    away = [share(q) - ratio for q, ratio in zip(one["tangential_force_N"], one["area_ratio"], strict=True) if q < 0.8]
    assert max(np.abs(away)) < 0.05


def test_an_adhesive_slide_loses_area_by_default_and_a_dry_one_does_not() -> None:
    sticky, dry = slide(**STICKY), slide(contact=STICKY["contact"])
    areas = np.array([state.nominal_contact_area for state in sticky])
    assert areas[0] == pytest.approx(np.pi * float(jkr_radius(1.0, 7.5, 0.4, 5e-5)) ** 2, rel=1e-6)
    assert areas[-1] == pytest.approx(np.pi * float(hertz_radius(1.0, 7.5, 0.4)) ** 2, rel=1e-6)
    assert (np.diff(areas) <= 1e-12).all()
    assert dry[-1].nominal_contact_area == dry[0].nominal_contact_area
    held = slide(**STICKY, slide__area_under_shear="constant")
    assert held[-1].nominal_contact_area == pytest.approx(areas[0], rel=1e-9)


def test_a_solid_finger_gains_then_loses_and_one_with_a_bone_loses() -> None:
    held = {"slide__friction_coefficient": 0.82, "slide__shaft": "silicone", "slide__distance_mm": 12.0}
    bone, solid_law = {"contact": {"law": "fem"}}, {"contact": {"law": "fem", "bone": "none"}}
    solid, boned = (np.array([s.nominal_contact_area for s in slide(**held, **law)]) for law in (solid_law, bone))
    assert solid.max() > 1.015 * solid[0]
    assert solid[-1] == pytest.approx(0.946 * solid[0], rel=0.03)
    assert boned.max() == boned[0]
    assert boned[-1] == pytest.approx(0.873 * boned[0], rel=0.02)
    # lost at the trailing edge: the middle moves on, along the finger's force on the glass
    states = slide(**held, **bone, slide__glass_moves=True)
    x = [float((s.contact_mask.sum(axis=0) @ s.grid.x) / s.contact_mask.sum()) for s in (states[0], states[-1])]
    assert x[1] - x[0] == pytest.approx((1 - boned[-1] / boned[0]) * np.sqrt(boned[0] / np.pi), rel=0.02)
