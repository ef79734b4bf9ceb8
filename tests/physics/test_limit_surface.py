"""Force and torque of a contact that slides and spins; friction by the ridges' direction; ridged fingers that slide."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import dblquad

from evanesce.contact.analytic.hertz import hertz_contact
from evanesce.contact.sliding.limit_surface import directional_friction, ellipsoid_wrench, sliding_wrench
from evanesce.contact.sliding.torsion import sliding_torque
from evanesce.contact.solve import contact_sequence
from evanesce.core.errors import InputError
from evanesce.materials.friction import InterfaceFriction, coulomb
from evanesce.rig import Scene, load_scene

CONTACT = hertz_contact(1.1, 7.5, 0.4)
RIDGES = {"pattern": "parallel", "pitch_um": 900.0, "orientation_deg": 50.0}


def sliding(**more: object) -> Scene:
    base = {
        "contact": {"law": "hertz", "reduced_modulus_MPa": 0.4}, "grid.size_mm": 30.0, "grid.samples": 300,
        "press.frame_rate_hz": 10.0, "slide.shaft": "rigid", "slide.direction_deg": 20.0,
    }  # fmt: skip
    return load_scene("thesis_slide", base | {key.replace("__", "."): value for key, value in more.items()})


@pytest.mark.parametrize("spin", [0.3, 1.7, 12.0])
def test_force_and_torque_are_integrals_of_the_pressure(spin: float) -> None:
    a, mu, v = CONTACT.contact_radius, 0.6, 2.0
    peak = 1.5 * 1.1 / (np.pi * a**2)

    def local(r: float, phi: float, torque: bool) -> float:
        x, y = v - spin * r * np.sin(phi), spin * r * np.cos(phi)
        unit = (r * (-x * np.sin(phi) + y * np.cos(phi)) if torque else x) / max(np.hypot(x, y), 1e-12)
        return mu * peak * np.sqrt(max(1 - (r / a) ** 2, 0)) * unit * r

    exact = [
        dblquad(lambda r, p, t=t: local(r, p, t), 0, 2 * np.pi, 0, a, epsabs=1e-4, epsrel=1e-4)[0]
        for t in (False, True)
    ]
    assert sliding_wrench(CONTACT, coulomb(mu), v, spin) == pytest.approx(exact, rel=2e-3)


def test_even_strength_about_a_centre_on_the_edge() -> None:
    # The mean distance from a disc's rim to its points is 32 a/(9 pi), and the power is F v + M spin.
    a, tau, spin = CONTACT.contact_radius, 0.02, 1.3
    force, torque = sliding_wrench(CONTACT, InterfaceFriction(tau, 0.0), spin * a, spin)
    assert force * spin * a + torque * spin == pytest.approx(tau * np.pi * a**2 * spin * 32 * a / (9 * np.pi), rel=1e-4)


def test_limits_and_the_ellipsoid() -> None:
    friction = InterfaceFriction(0.01, 0.4)
    most, twist = 0.01 * np.pi * CONTACT.contact_radius**2 + 0.4 * 1.1, sliding_torque(CONTACT, friction)
    assert sliding_wrench(CONTACT, friction, 1.0, 0.0) == pytest.approx((most, 0.0), abs=1e-9)
    assert sliding_wrench(CONTACT, friction, 0.0, 1.0) == pytest.approx((0.0, twist), rel=1e-3, abs=1e-9)
    away = []
    for spin in np.logspace(-2, 2, 41):
        force, torque = sliding_wrench(CONTACT, friction, 1.0, spin)
        away.append(np.hypot(force / most, torque / twist) - 1.0)
        by_ellipsoid = ellipsoid_wrench(most, twist, 1.0, spin)
        assert (by_ellipsoid[0] / most) ** 2 + (by_ellipsoid[1] / twist) ** 2 == pytest.approx(1.0, rel=1e-12)
        # largest dissipation: no other wrench of the surface resists this motion more
        assert force + spin * torque >= (1 - 1e-3) * max(most, spin * twist)
    assert max(np.abs(away)) < 0.06


def test_friction_across_ridges_resists_most_of_an_ellipse() -> None:
    for ratio, angle in ((0.6, 0.4), (1.8, -1.1), (0.7, np.pi / 2), (0.7, 0.0)):
        t = np.linspace(0, 2 * np.pi, 200_001)
        along, across = ratio * np.cos(t), np.sin(t)
        x, y = along * np.cos(angle) - across * np.sin(angle), along * np.sin(angle) + across * np.cos(angle)
        best = int(np.argmax(x))
        assert directional_friction(ratio, angle) == pytest.approx((x[best], y[best]), abs=1e-4)


def test_a_spinning_slide_pulls_less_and_records_its_torque() -> None:
    plain, spun = (contact_sequence(sliding(slide__spin_deg_per_s=s))[-1] for s in (0.0, 200.0))
    force, torque = sliding_wrench(hertz_contact(1.0, 7.5, 0.4), coulomb(0.67), 5.0, np.radians(200.0))
    assert np.hypot(*plain.tangential_force) == pytest.approx(0.67, rel=1e-6)
    assert np.hypot(*spun.tangential_force) == pytest.approx(force, rel=1e-3)
    assert spun.parameters["sliding_torque_N_mm"] == pytest.approx(torque, rel=1e-3)


def test_null_spin_and_even_ridges_change_no_bit() -> None:
    plain = contact_sequence(sliding(finger__ridges=RIDGES))[-1]
    null = contact_sequence(sliding(finger__ridges=RIDGES, slide__spin_deg_per_s=0.0))[-1]
    even = contact_sequence(sliding(finger__ridges=RIDGES, slide__ridge_friction_ratio=1.0))[-1]
    assert np.array_equal(plain.traction, null.traction)
    assert np.array_equal(plain.traction, even.traction)


def test_ridges_that_slide_askew_push_to_the_side_and_travel_with_the_finger() -> None:
    state = contact_sequence(sliding(finger__ridges=RIDGES, slide__ridge_friction_ratio=0.6))[-1]
    along, across = directional_friction(0.6, np.radians(30.0))
    c, s = np.cos(np.radians(20.0)), np.sin(np.radians(20.0))
    x, y = state.tangential_force
    assert (x * c + y * s, y * c - x * s) == pytest.approx((0.67 * along, 0.67 * across), rel=1e-6)
    total = state.traction.sum(axis=(1, 2)) * state.grid.pitch**2
    assert total == pytest.approx([x, y], rel=0.01)
    assert state.law == "hertz+sliding+ridges"
    # Crests: the same skin, 8 mm less what the contact gave way further along.
    ratio = float(np.hypot(x, y) / 0.67)
    assert ratio == pytest.approx(np.hypot(along, across), rel=1e-6)


def test_what_does_not_slide_is_refused() -> None:
    with pytest.raises(InputError, match="ridge_friction_ratio"):
        sliding(slide__ridge_friction_ratio=0.8)
    with pytest.raises(InputError, match="glass_moves"):
        sliding(finger__ridges=RIDGES, slide__glass_moves=True)
