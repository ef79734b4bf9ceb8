"""Sliding with finite elements in three dimensions: stick before slip, Coulomb's cone, balance, symmetry, sampling."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("felupe", reason="the optional extra 'fem' is not installed")

from evanesce.contact.fem.descent import BALANCED, descended
from evanesce.contact.fem.felupe_adapter import Body, linear_solver
from evanesce.contact.fem.material import carried_on, rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize
from evanesce.contact.fem.mesh_half import finger_half
from evanesce.contact.fem.newton import Model, Target, equilibrium
from evanesce.contact.fem.plane import Glass
from evanesce.contact.fem.programme import press, run_state, slide
from evanesce.contact.fem.result import SolvedRun
from evanesce.contact.fem.steps import StepSizes
from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid, SurfaceState

SHAPE = FingerShape(tip_radius=7.5, diameter=15.0, length=13.0)
SIZE = MeshSize(contact=1.25, fine_extent=3.0, growth=1.8, coarsest=4.0)
MU = 0.35


@pytest.fixture(scope="module")
def run() -> SolvedRun:
    steps = StepSizes(largest=0.6, first=0.1, smallest=1e-3)
    return slide(SHAPE, rubber("silskin_0"), force=0.8, distances=(0.1, 2.4), friction=MU, size=SIZE, sizes=steps)


def test_press_in_three_dimensions_agrees_with_the_section(run: SolvedRun) -> None:
    pressed = run.history.steps[run.reached()[0]].state
    flat = press(SHAPE, rubber("silskin_0"), forces=(0.8,), friction=MU, size=MeshSize(0.4, 3.0, 1.4, 2.5))
    # facets of 1.25 mm cut 1.25^2/(8 R) = 0.03 mm off the ball between nodes: 4 % of the depth
    assert pressed.depth == pytest.approx(flat.history.steps[-1].state.depth, rel=0.05)


@pytest.mark.slow  # 20 s: two presses in three dimensions
def test_a_tilted_tip_over_a_bone_is_pressed_like_an_upright_one() -> None:
    """Sphere on sphere: what differs is the shaft, and where elements lie."""
    size = MeshSize(contact=1.0, fine_extent=8.8, growth=1.4, coarsest=3.0)
    found = []
    for tilt in (0.0, 30.0):
        shape = FingerShape(bone_radius=3.75, tilt_deg=tilt)
        pressed = slide(shape, rubber("silskin_0"), force=1.0, distances=(0.01,), friction=MU, size=size)
        found.append(pressed.row(pressed.reached()[0]))
    assert found[1]["depth_mm"] == pytest.approx(found[0]["depth_mm"], rel=0.03)
    assert found[1]["area_mm2"] == pytest.approx(found[0]["area_mm2"], rel=0.08)


def test_all_sticks_before_it_slips(run: SolvedRun) -> None:
    """A first move of 0.1 mm is met by the shear of the whole finger: global stick, tangential force in proportion."""
    start = run.reached()[0]
    early = run.history.steps[run.reached()[1]]
    print_ = run.footprint(run.reached()[1])
    # Cattaneo and Mindlin: the annulus that slips is 1 - (1 - Q/(mu F))^(1/3) of the radius, here below one element
    a = np.sqrt(print_.area / np.pi)
    load = early.state.tangential_force / (MU * early.state.normal_force)
    assert a * (1 - (1 - load) ** (1 / 3)) < 1.25
    middle = print_.place[print_.touching].mean(axis=0) * [1.0, 0.0]
    assert (np.linalg.norm(print_.place[print_.slipping] - middle, axis=1) > a - 1.25).all()
    assert run.row(run.reached()[1])["stick_force_share"] > 0.75
    assert 0 < early.state.tangential_force < 0.5 * MU * early.state.normal_force
    shares = [run.row(i)["stick_force_share"] for i in range(start + 1, len(run))]
    assert shares[-1] == 0.0
    tangential = [run.history.steps[i].state.tangential_force for i in range(start, len(run))]
    assert all(b >= a * (1 - 1e-6) for a, b in pairwise(tangential))


def test_gross_slip_pulls_with_mu_times_the_load(run: SolvedRun) -> None:
    last = run.history.steps[-1].state
    assert last.normal_force == pytest.approx(0.8, rel=1e-6)
    # every node pulls with mu p; the pulls differ in direction by the skin's sideways spread only, within 1 %
    assert last.tangential_force == pytest.approx(MU * 0.8, rel=0.01)
    assert last.tangential_force <= MU * last.normal_force * (1 + 1e-9)


def test_no_traction_leaves_the_cone_and_the_top_holds_it_all(run: SolvedRun) -> None:
    body = Body(run.mesh, rubber("silskin_0"))
    for step in run.history.steps:
        force = step.state.contact.force
        assert (np.linalg.norm(force[:, :2], axis=1) <= MU * force[:, 2] * (1 + 1e-9) + 1e-15).all()
    state = run.history.steps[-1].state
    held = 2 * body.forces(state.displacement)[run.mesh.clamped].sum(axis=0)
    assert held[0] == pytest.approx(state.tangential_force, rel=1e-6)
    assert held[2] == pytest.approx(-state.normal_force, rel=1e-6)


def test_state_on_a_grid_is_symmetric_and_carries_the_forces(run: SolvedRun) -> None:
    grid = PlateGrid((121, 141), 0.1, (1.0, 0.0))
    state = run_state(run, -1, grid)
    cell = grid.pitch**2
    assert state.pressure.sum() * cell == pytest.approx(state.normal_force, rel=1e-9)
    np.testing.assert_allclose(state.contact_mask, state.contact_mask[::-1], atol=0.2)  # one of 4 x 4 points a side
    # a polygon of facets 1.25 mm long, sampled by 16 points a cell
    assert state.contact_mask.sum() * cell == pytest.approx(state.nominal_contact_area, rel=0.02)
    labels = np.unique(state.state[state.contact_mask == 1.0])
    assert labels.tolist() == [SurfaceState.SLIP]
    # the finger slides along +x: it pulls the glass along and slips that way; its skin lags behind its axis
    assert state.tangential_force[0] == pytest.approx(MU * 0.8, rel=0.01)
    assert state.traction[0].sum() * cell == pytest.approx(state.tangential_force[0], rel=0.15)
    assert state.slip[0][state.contact_mask == 1.0].min() > 0
    middle = (state.contact_mask * grid.x).sum() / state.contact_mask.sum()
    assert 0 < middle < run.history.steps[-1].state.slide
    assert abs(state.traction[1].sum()) < 0.02 * state.traction[0].sum()


def test_slide_off_the_grid_is_refused(run: SolvedRun) -> None:
    with pytest.raises(InputError, match="off the contact grid"):
        run_state(run, -1, PlateGrid((40, 40), 0.05))


@pytest.mark.parametrize(
    "arguments", [{}, {"force": 1.0, "depth": 1.0}, {"force": -1.0}, {"depth": 1.0, "distances": (float("nan"),)}]
)
def test_impossible_slides_are_refused(arguments: dict[str, object]) -> None:
    with pytest.raises(InputError):
        slide(SHAPE, rubber("silskin_0"), friction=0.3, size=SIZE, **arguments)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def boned() -> tuple[Model, float]:
    """A coarse finger over a bone, and its penalty."""
    mesh = finger_half(FingerShape(bone_radius=3.75), MeshSize(contact=1.1, growth=1.5, coarsest=4.0))
    material = carried_on(rubber("silskin_0"))
    glass = Glass(friction=1.13, penalty=1000.0 * material.shear_modulus, softness=0.002)
    return Model(mesh, Body(mesh, material), glass, linear_solver()), glass.penalty


def test_forces_of_a_body_are_the_slope_of_its_energy(boned: tuple[Model, float]) -> None:
    solid, points = boned[0].solid, boned[0].mesh.points
    rng = np.random.default_rng(1)
    there, way = 0.01 * rng.normal(size=points.shape), rng.normal(size=points.shape)
    h = 1e-5
    slope = (solid.energy(there + h * way) - solid.energy(there - h * way)) / (2 * h)
    assert slope == pytest.approx(float((solid.forces(there) * way).sum()), rel=1e-6)
    assert solid.energy(-points) == np.inf


@pytest.mark.parametrize("held", ["depth", "force"])
def test_descent_of_energy_ends_where_newtons_method_does(boned: tuple[Model, float], held: str) -> None:
    """Both from one press, slid 0.1 mm with all but a rim sticking: by an energy and lagged friction, and without."""
    model, state = boned[0], boned[0].start()
    for depth in (0.05, 0.15, 0.3, 0.5):
        state = equilibrium(model, state, Target(depth=depth))
    target = Target(0.1, state.depth) if held == "depth" else Target(0.1, None, state.normal_force)
    newton, descent = equilibrium(model, state, target), descended(model, state, target)
    assert descent.normal_force == pytest.approx(newton.normal_force, rel=1e-4)
    assert descent.tangential_force == pytest.approx(newton.tangential_force, rel=1e-3)
    assert descent.depth == pytest.approx(newton.depth, rel=1e-5)
    np.testing.assert_allclose(descent.displacement, newton.displacement, atol=1e-3 * np.abs(newton.displacement).max())


@pytest.mark.slow
def test_a_finger_that_springs_from_stick_to_slip_goes_on(boned: tuple[Model, float]) -> None:
    """mu 1.13 over a bone: Newton's steps end at 2.7 mm (slow: a minute of descents past that)."""
    mesh, penalty = boned[0].mesh, boned[1]
    run = slide(
        FingerShape(bone_radius=3.75), carried_on(rubber("silskin_0")), force=1.0, distances=(3.5,), friction=1.13,
        hold="depth", size=MeshSize(contact=1.1, growth=1.5, coarsest=4.0), sizes=StepSizes(0.5, 0.1, 1e-3),
        penalty=penalty,
    )  # fmt: skip
    assert run.history.complete
    free = boned[0].free
    for step in run.history.steps:
        state = step.state
        left = boned[0].solid.forces(state.displacement)
        left[mesh.candidates] -= state.contact.force
        assert np.linalg.norm(left.ravel()[free]) < 1.01 * BALANCED * np.linalg.norm(state.contact.force)
        force = state.contact.force
        assert (np.linalg.norm(force[:, :2], axis=1) <= 1.13 * force[:, 2] * (1 + 1e-9) + 1e-15).all()
    pulls = np.array([step.state.tangential_force for step in run.history.steps])
    assert (np.diff(pulls) < -0.02).any()  # a part of the contact springs off
