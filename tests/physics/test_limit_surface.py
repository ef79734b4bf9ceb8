"""Force and torque of a contact that slides and spins; friction by the ridges' direction; ridged fingers that slide."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.integrate import dblquad

from evanesce.contact.analytic.hertz import hertz_contact
from evanesce.contact.slide import slide_forces
from evanesce.contact.sliding.friction_ellipse import directional_friction
from evanesce.contact.sliding.torsion import sliding_torque
from evanesce.contact.solve import contact_sequence
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState
from evanesce.materials.friction import InterfaceFriction, coulomb
from evanesce.rig import Scene, load_scene
from support.limit_surface import ellipsoid_wrench, sliding_wrench

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


@pytest.mark.parametrize(("stiff", "apart"), [(1.0, 0.1), (20.0, 0.03)])
def test_a_spinning_slide_pulls_less_and_its_field_turns(stiff: float, apart: float) -> None:
    own = {"law": "hertz", "reduced_modulus_MPa": 0.4 * stiff}
    plain, spun = (
        contact_sequence(sliding(contact=own, slide__spin_deg_per_s=s, press__forces_N=[1.0]))[-1] for s in (0.0, 200.0)
    )
    force, torque = sliding_wrench(hertz_contact(1.0, 7.5, 0.4 * stiff), coulomb(0.67), 5.0, np.radians(200.0))
    assert np.hypot(*plain.tangential_force) == pytest.approx(0.67, rel=1e-6)
    assert np.hypot(*spun.tangential_force) == pytest.approx(force, rel=apart)
    assert spun.parameters["torque_N_mm"] == pytest.approx(torque, rel=apart)
    # about the instantaneous centre the traction has every direction; a plain slide's has one
    angles = [
        np.arctan2(state.traction[1], state.traction[0])[np.asarray(state.contact_mask) > 0.5]
        for state in (plain, spun)
    ]
    assert np.std(angles[0]) < 1e-6 < 0.3 < np.std(angles[1])


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
    assert (x * c + y * s, y * c - x * s) == pytest.approx((0.67 * along, 0.67 * across), rel=0.02)
    total = state.traction.sum(axis=(1, 2)) * state.grid.pitch**2
    assert total == pytest.approx([x, y], rel=0.01)
    assert state.law == "hertz+sliding+ridges"
    # Crests: the same skin, 8 mm less what the contact gave way further along.
    ratio = float(np.hypot(x, y) / 0.67)
    assert ratio == pytest.approx(np.hypot(along, across), rel=0.02)


def test_ridges_turn_with_a_spinning_finger() -> None:
    """A quarter turn: grooves that lay along the slide lie across it."""
    scene = sliding(
        finger__ridges=RIDGES | {"orientation_deg": 20.0}, slide__spin_deg_per_s=90.0, slide__distance_mm=5.0,
        slide__speed_mm_per_s=5.0, grid__samples=500,
    )  # fmt: skip
    states = contact_sequence(scene)

    def lines(state: ContactState) -> float:
        """Angle of the ridges, from the mask's structure tensor within the contact [deg]."""
        mask = ndimage.gaussian_filter(np.asarray(state.contact_mask, dtype=float), 1.5)
        gy, gx = np.gradient(mask)
        here = np.hypot(*(np.stack(np.meshgrid(state.grid.x, state.grid.y)) - middle(state)[:, None, None])) < 1.2
        xx, yy, xy = ((a * b)[here].sum() for a, b in ((gx, gx), (gy, gy), (gx, gy)))
        return (np.degrees(0.5 * np.arctan2(2 * xy, xx - yy)) + 90.0) % 180.0

    def middle(state: ContactState) -> np.ndarray:
        mask = np.asarray(state.contact_mask, dtype=float)
        x, y = np.meshgrid(state.grid.x, state.grid.y)
        return np.array([(mask * x).sum(), (mask * y).sum()]) / mask.sum()

    first, last = lines(states[2]), lines(states[-1])
    assert first == pytest.approx(20.0, abs=3.0)
    assert last == pytest.approx(20.0 + states[-1].parameters["rotation_deg"], abs=6.0)


def test_stick_slip_of_a_slide_hardly_pulled_aside_is_that_along_its_line() -> None:
    leaping = {
        "finger__ridges": RIDGES, "slide__stick_slip_drop": 0.3, "slide__drive_stiffness_N_per_mm": 0.5,
        "press__frame_rate_hz": 40.0, "slide__speed_mm_per_s": 2.0, "slide__distance_mm": 5.0,
    }  # fmt: skip
    found = []
    for ratio in (1.0, 1.0001):
        states = slide_forces(sliding(**leaping, slide__ridge_friction_ratio=ratio))
        force = np.array([np.hypot(*state.tangential_force) for state in states])
        jumps = np.flatnonzero(np.diff(force) < -0.1)
        found.append((force[jumps + 1].mean(), np.diff(jumps).mean() / 40.0, force.max()))
    assert found[1] == pytest.approx(found[0], rel=0.08)


def test_a_spin_takes_friction_off_a_slide_whose_friction_follows_speed() -> None:
    """By a power law of each cell's speed: what a sum over the contact by NumPy gives."""
    own = {"law": "hertz", "reduced_modulus_MPa": 8.0}
    held = {"contact": own, "press__forces_N": [1.0], "slide__speed_exponent": 0.3, "slide__speed_mm_per_s": 2.0}
    held |= {"slide__distance_mm": 4.0, "slide__friction_coefficient": 0.67, "grid__samples": 400}
    plain, spun = (slide_forces(sliding(**held, slide__spin_deg_per_s=s))[-1] for s in (0.01, 400.0))
    a = hertz_contact(1.0, 7.5, 8.0).contact_radius
    x = (np.arange(801) - 400) / 400 * a
    x, y = x[None, :], x[:, None]
    pressure = np.sqrt(np.clip(1 - (x**2 + y**2) / a**2, 0, None))
    velocity = 2.0 - np.radians(400.0) * y + 0 * x, np.radians(400.0) * x + 0 * y
    size = np.hypot(*velocity)
    expected = 0.67 * (pressure * velocity[0] * size ** (0.3 - 1.0)).sum() / pressure.sum()
    assert np.hypot(*plain.tangential_force) == pytest.approx(0.67 * 2.0**0.3, rel=0.01)
    assert np.hypot(*spun.tangential_force) == pytest.approx(expected, rel=0.03)


def test_a_spinning_slide_that_leaves_the_grid_is_refused_at_its_first_frame() -> None:
    with pytest.raises(InputError, match=r"grid\.size_mm"):
        contact_sequence(sliding(slide__spin_deg_per_s=90.0, slide__distance_mm=20.0))[0]


def test_losses_along_one_direction_are_refused_where_there_is_more_than_one() -> None:
    with pytest.raises(InputError, match="area_loss_mm2_per_N2"):
        sliding(slide__spin_deg_per_s=90.0, slide__area_loss_mm2_per_N2=2.0)


def test_what_does_not_slide_is_refused() -> None:
    with pytest.raises(InputError, match="ridge_friction_ratio"):
        sliding(slide__ridge_friction_ratio=0.8)
    with pytest.raises(InputError, match="glass_moves"):
        sliding(finger__ridges=RIDGES, slide__glass_moves=True)
