"""Partial slip in the plane against Mindlin, Cattaneo, Lubkin, the limit surface and Bowden's saw tooth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ellipe

from evanesce.contact.analytic.hertz import hertz_contact, hertz_radius
from evanesce.contact.patch import cell_pressure
from evanesce.contact.sliding.friction_ellipse import directional_friction
from evanesce.contact.sliding.planar import MARGIN, PlanarFrame, PlanarPath, PlanarSolver
from evanesce.contact.sliding.planar_states import planar_state
from evanesce.contact.sliding.solver import march
from evanesce.contact.sliding.torsion import sliding_torque, twisted
from evanesce.core.states import PlateGrid, SurfaceState
from evanesce.materials.friction import InterfaceFriction, coulomb
from support.limit_surface import sliding_wrench

E, R, N, MU = 0.64, 7.1, 1.3, 0.83
G = E / 4  # incompressible
CONTACT, A = hertz_contact(N, R, E), float(hertz_radius(N, R, E))
TORQUE = sliding_torque(CONTACT, coulomb(MU))


def moved(x=0.0, y=0.0, rotation=0.0, *, frames=30, rate=30.0, modulus=G, friction=None, **options):
    """March a held contact; the drive's motions are functions of time [s] or 0."""
    t = np.arange(frames) / rate
    at = [np.asarray(f(t) if callable(f) else np.full(t.shape, f), dtype=float) for f in (x, y, rotation)]
    solver = PlanarSolver(A, modulus, 0.5, friction or coulomb(MU), **options)
    return solver, solver.march([CONTACT] * frames, PlanarPath(t, *at))


def stick_radius(solver: PlanarSolver, frame: PlanarFrame) -> float:
    inner = frame.stick[MARGIN:-MARGIN, MARGIN:-MARGIN]
    return math.sqrt((inner > 0).sum() * solver.grid.pitch**2 / math.pi)


def torque(solver: PlanarSolver, frame: PlanarFrame) -> float:
    """Torque from the fields [N mm]."""
    x, y = np.meshgrid(solver.grid.x, solver.grid.y)
    q = MU * cell_pressure(solver.grid, (0.0, 0.0), CONTACT) * (np.hypot(x, y) < A) * frame.weakened * frame.ratio
    return float((x * q[1] - y * q[0]).sum()) * solver.grid.pitch**2


def test_a_sticking_circle_is_as_stiff_as_mindlin_and_reissner_say():
    _, frames = moved(lambda t: 1e-4 * t, lambda t: -2e-4 * t)
    stiff = 2 * A * 8 / 3 * G  # 2 a G*, G* = 4 G/(2 - nu)
    np.testing.assert_allclose(frames[-1].force, stiff * np.array(frames[-1].tip), rtol=0.01)
    solver, frames = moved(rotation=lambda t: 1e-5 * t)
    assert torque(solver, frames[-1]) / frames[-1].rotation == pytest.approx(16 / 3 * G * A**3, rel=0.03)


def test_the_stick_circle_is_cattaneos():
    solver, frames = moved(lambda t: 0.8 * t * math.cos(0.7), lambda t: 0.8 * t * math.sin(0.7))
    for k in (10, 16, 22):
        share = math.hypot(*frames[k].force) / (MU * N)
        assert 0.4 < share < 0.9
        assert stick_radius(solver, frames[k]) == pytest.approx(A * (1 - share) ** (1 / 3), abs=0.02 * A)
        assert math.atan2(frames[k].force[1], frames[k].force[0]) == pytest.approx(0.7, abs=1e-3)


def test_a_twist_is_lubkins():
    solver, frames = moved(rotation=lambda t: -0.3 * t)
    for k in (12, 20, 28):
        share = abs(torque(solver, frames[k])) / TORQUE
        exact = twisted(CONTACT, coulomb(MU), G, share)
        assert frames[k].rotation == pytest.approx(-exact.angle, rel=0.05)
        assert stick_radius(solver, frames[k]) == pytest.approx(exact.stick_radius, abs=0.04 * A)


@pytest.mark.parametrize(("ratio", "ridges", "rotation"), [(0.6, 0.0, 0.0), (0.6, 1.1, 0.0), (1.7, 0.4, 0.7)])
def test_ridges_pull_a_slide_aside_as_their_ellipse_says(ratio, ridges, rotation):
    way = 0.9
    _, frames = moved(
        lambda t: 2.0 * t * math.cos(way),
        lambda t: 2.0 * t * math.sin(way),
        rotation,
        ridges=(ratio, ridges),
        frames=60,
    )
    against, aside = directional_friction(ratio, ridges + rotation - way)
    x, y = np.array(frames[-1].force) / (MU * N)
    assert math.cos(way) * x + math.sin(way) * y == pytest.approx(against, rel=0.01)
    assert math.cos(way) * y - math.sin(way) * x == pytest.approx(aside, abs=0.01)


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_a_spin_over_ridges_has_the_mean_of_their_ellipse(ratio):
    solver, frames = moved(rotation=lambda t: 2.0 * t, ridges=(ratio, 0.3), modulus=30 * G)
    # a stiff skin does not lag; power of spinning, |M v| about the circle, is a complete elliptic integral
    assert torque(solver, frames[-1]) / TORQUE == pytest.approx(2 / math.pi * ellipe(1 - ratio**2), rel=0.03)


def test_ridges_of_even_friction_change_no_bit():
    _, plain = moved(lambda t: 0.5 * t, lambda t: 0.2 * t)
    _, even = moved(lambda t: 0.5 * t, lambda t: 0.2 * t, ridges=(1.0, 0.8))
    assert plain[-1].force == even[-1].force
    np.testing.assert_array_equal(plain[-1].ratio, even[-1].ratio)


def test_reversals_are_those_of_springs_along_a_line():
    t = np.arange(60) / 30.0

    def drive(t):
        return 0.5 * np.sin(2.0 * math.pi * 0.8 * t)

    friction = InterfaceFriction(0.02, 0.6)
    line = march([CONTACT] * 60, t, drive(t), friction, 8 / 3 * G, drive_stiffness=3.0)
    _, frames = moved(drive, frames=60, friction=friction, drive_stiffness=3.0)
    force = np.array([frame.force[0] for frame in frames])
    assert np.abs(force - line.series("tangential_force")).max() < 0.02 * np.abs(force).max()


def test_a_stiff_finger_that_slides_and_spins_is_on_the_limit_surface():
    solver, frames = moved(lambda t: 2.0 * t, rotation=lambda t: 1.2 * t, modulus=30 * G)
    force, turning = sliding_wrench(CONTACT, coulomb(MU), 2.0, 1.2)
    assert frames[-1].force[0] == pytest.approx(force, rel=0.02)
    assert abs(frames[-1].force[1]) < 0.02 * force
    assert torque(solver, frames[-1]) == pytest.approx(turning, rel=0.04)


def test_a_soft_finger_that_slides_and_spins_carries_less_torque():
    """Its skin turns through a field of traction that stands still, and is displaced anew."""
    solver, frames = moved(lambda t: 2.0 * t, rotation=lambda t: 1.2 * t, frames=120)
    force, turning = sliding_wrench(CONTACT, coulomb(MU), 2.0, 1.2)
    assert math.hypot(*frames[-1].force) == pytest.approx(force, rel=0.03)
    assert torque(solver, frames[-1]) == pytest.approx(0.93 * turning, rel=0.02)


def test_friction_follows_a_turned_slide():
    angle = math.radians(110.0)
    solver, frames = moved(
        lambda t: np.minimum(1.6 * t, 1.6) + math.cos(angle) * np.maximum(1.6 * (t - 1.0), 0),
        lambda t: math.sin(angle) * np.maximum(1.6 * (t - 1.0), 0),
        frames=130,
    )
    np.testing.assert_allclose(frames[29].force, [MU * N, 0.0], atol=0.02)
    np.testing.assert_allclose(frames[-1].force, [MU * N * math.cos(angle), MU * N * math.sin(angle)], atol=0.02)
    assert max(float(np.hypot(*frame.ratio).max()) for frame in frames) <= 1 + 1e-6
    middle = solver.grid.shape[0] // 2
    along = np.array([math.cos(angle), math.sin(angle)])
    np.testing.assert_allclose(frames[-1].velocity[:, middle, middle], 1.6 * along, atol=0.02)


def test_stick_slip_is_a_saw_tooth():
    """Each jump loses the stated share of the friction, and the drive's stiffness sets the time between two."""
    _, frames = moved(lambda t: 1.5 * t, frames=150, drive_stiffness=2.0, drop=0.4)
    force = np.array([frame.force[0] for frame in frames])
    jumps = np.flatnonzero(np.diff(force) < -0.1)
    assert len(jumps) >= 6
    np.testing.assert_allclose(force[jumps + 1], 0.6 * MU * N, rtol=0.03)
    assert np.all(force[jumps] > 0.95 * MU * N)
    stiff = 1 / (1 / (2 * A * 8 / 3 * G) + 1 / 2.0)
    period = 0.4 * MU * N / stiff / 1.5
    # partial slip softens the contact before the jump
    assert period < np.diff(jumps).mean() / 30.0 < 1.5 * period
    stuck = [float((frame.stick > 0).mean()) for frame in frames]
    assert all(stuck[k + 1] == 0.0 and stuck[k + 2] > 0.5 for k in jumps[:-1])


def test_a_state_carries_force_and_keeps_below_its_strength():
    solver, frames = moved(lambda t: 0.7 * t, rotation=lambda t: 0.4 * t, friction=InterfaceFriction(0.02, 0.6, 0.8))
    grid = PlateGrid((240, 251), 0.027, (0.3, -0.2))
    friction = InterfaceFriction(0.02, 0.6, 0.8)
    state = planar_state(frames[15], solver.grid, grid, (0.11, -0.23), friction).state
    assert np.all(np.hypot(*state.traction) <= np.asarray(state.strength) * (1 + 1e-6))
    np.testing.assert_allclose(state.traction.sum((1, 2)) * grid.pitch**2, frames[15].force, atol=0.02 * MU * N)
    stuck = np.asarray(state.state) == SurfaceState.STICK
    assert 0.1 < stuck.sum() / (np.asarray(state.state) >= SurfaceState.STICK).sum() < 0.9
    assert not np.hypot(*state.slip_velocity)[stuck].any()


def test_a_spun_skin_turns_with_its_finger():
    """Where everything slips a piece of skin is where a rigid rotation takes it."""
    solver, frames = moved(rotation=lambda t: 2.0 * t, modulus=100 * G)
    grid, origin, frame = PlateGrid((200, 210), 0.03), (0.2, -0.1), frames[-1]
    found = planar_state(frame, solver.grid, grid, origin, coulomb(MU))
    x, y = np.meshgrid(grid.x - origin[0], grid.y - origin[1])
    cos, sin = math.cos(frame.rotation), math.sin(frame.rotation)
    exact = np.stack([x - (cos * x + sin * y), y - (cos * y - sin * x)])
    inside = np.hypot(x, y) < 0.9 * A
    np.testing.assert_allclose(found.skin[:, inside], exact[:, inside], atol=0.02)
    np.testing.assert_allclose(found.speed[:, inside], (2.0 * np.stack([-y, x]))[:, inside], atol=0.15)
