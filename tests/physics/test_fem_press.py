"""Pressing with finite elements: patch test, Hertz's limit, balance, control, limits, checkpoints after kill -9."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("felupe", reason="the optional extra 'fem' is not installed")

from evanesce.contact.fem.felupe_adapter import Body
from evanesce.contact.fem.material import Rubber, distortional_stress, rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize, SolidMesh, finger_section
from evanesce.contact.fem.mesh_half import finger_half
from evanesce.contact.fem.programme import press, run_state
from evanesce.contact.fem.result import SolvedRun, load_run, write_vtk
from evanesce.contact.fem.steps import LimitReached, StepSizes
from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid, SurfaceState

COARSE = MeshSize(contact=0.45, fine_extent=2.5, growth=1.4, coarsest=2.5)
SHAPE = FingerShape(tip_radius=6.8, diameter=12.6, length=17.0)


@pytest.fixture(scope="module")
def run() -> SolvedRun:
    return press(SHAPE, rubber("silskin_0"), forces=(0.3, 1.1), friction=0.4, size=COARSE)


def _affine(mesh: SolidMesh, gradient: np.ndarray) -> np.ndarray:
    return mesh.points @ (gradient - np.eye(mesh.dim)).T


def _inner(mesh: SolidMesh) -> np.ndarray:
    """Nodes on no outer face: not on skin, top or mirror plane."""
    return np.setdiff1d(np.arange(len(mesh.points)), np.concatenate([mesh.facets.ravel(), mesh.clamped, mesh.mirror]))


@pytest.mark.parametrize("dim", [2, 3])
def test_patch_a_uniform_deformation_leaves_inner_nodes_unloaded(dim: int) -> None:
    mesh = finger_section(SHAPE, COARSE) if dim == 2 else finger_half(SHAPE, MeshSize(1.7, growth=1.4))
    gradient = (
        np.diag([1.08, 0.91]) if dim == 2 else np.array([[1.05, 0.07, -0.02], [0.01, 0.96, 0.04], [0.1, 0.0, 0.93]])
    )
    forces = Body(mesh, rubber("silskin_20")).forces(_affine(mesh, gradient))
    # rounding: bulk modulus 5 MPa times faces of some mm^2 times 1e-16, summed over 8 elements of 8 points
    assert np.abs(forces[_inner(mesh)]).max() < 1e-12 * np.abs(forces).max() * 1e2


def test_patch_the_top_carries_the_closed_form_stress() -> None:
    material, mesh = rubber("silskin_20"), finger_section(SHAPE, COARSE)
    radial, axial = 1.04, 0.93
    forces = Body(mesh, material).forces(_affine(mesh, np.diag([radial, axial])))
    gradient = np.diag([radial, radial, axial])
    volume = radial**2 * axial
    nominal = (
        distortional_stress(material, gradient[:, :, None])[2, 2, 0]
        + material.bulk_modulus * (volume - 1) * volume / axial
    )
    top = np.abs(mesh.points[:, 1] - SHAPE.length) < 1e-9
    # what holds the top face is all of the load along z on a shaft whose sides are parallel to it
    assert forces[top, 1].sum() == pytest.approx(nominal * np.pi * (SHAPE.diameter / 2) ** 2, rel=1e-10)


@pytest.mark.parametrize("dim", [2, 3])
def test_tangent_is_the_derivative_of_the_forces(dim: int) -> None:
    mesh = (
        finger_section(SHAPE, MeshSize(2.5))
        if dim == 2
        else finger_half(SHAPE, MeshSize(3.0, growth=1.8, coarsest=5.0))
    )
    body = Body(mesh, rubber("silskin_20"))
    rng = np.random.default_rng(3)
    u = 0.05 * rng.normal(size=mesh.points.shape)
    way = rng.normal(size=mesh.points.shape)
    u[mesh.mirror, 0 if dim == 2 else 1] = way[mesh.mirror, 0 if dim == 2 else 1] = 0.0
    body.forces(u)
    product = body.tangent() @ way.ravel()
    h = 1e-6  # truncation h^2 against rounding 1e-16/h: both below 1e-8 of the tangent
    slope = (body.forces(u + h * way) - body.forces(u - h * way)) / (2 * h)
    np.testing.assert_allclose(product, slope.ravel(), atol=1e-6 * np.abs(product).max())


def test_small_load_on_a_stiff_ball_is_hertz() -> None:
    """E* from a and F: a^3 = 3 F R/(4 E*); free of the shaft's own compression, which only enters the depth."""
    material, radius, a, h = Rubber(0.31, 0.14), 7.5, 0.32, 0.03
    e = material.reduced_modulus
    force = 4 * e * a**3 / (3 * radius)
    steps = StepSizes(largest=0.005, first=0.001, smallest=1e-6)
    size = MeshSize(contact=h, fine_extent=0.55, growth=1.25, coarsest=3.0)
    run = press(FingerShape(length=12.0), material, forces=(force,), size=size, sizes=steps, penalty=3e4)
    print_ = run.footprint(-1)
    found = np.sqrt(print_.area / np.pi)
    # the edge is continued over less than one element from a law with relative remainder h/a: within h/4; strains of
    # a/R change the stiffness by as much
    assert found == pytest.approx(a, abs=h / 4 + a * a / radius / 3)
    modulus = 0.75 * force * radius / found**3
    assert modulus == pytest.approx(e, rel=3 * (h / 4 / a + a / radius / 3))
    peak = 1.5 * force / (np.pi * a**2)
    inner = print_.place[:, 0] < 0.7 * a
    shape = peak * np.sqrt(1 - (print_.place[inner, 0] / a) ** 2)
    # from the second node on: the first one's area, a disc of h/2, makes lumping first order there
    np.testing.assert_allclose(print_.pressure[inner][2:], shape[2:], rtol=a / radius + (h / a) ** 2)


def test_forces_balance(run: SolvedRun) -> None:
    mesh = run.mesh
    body = Body(mesh, rubber("silskin_0"))
    for index in run.reached():
        state = run.history.steps[index].state
        forces = body.forces(state.displacement)
        held = forces[mesh.clamped, 1].sum()
        assert held == pytest.approx(
            -state.normal_force, rel=1e-6
        )  # Newton's residual is 1e-8 per node, some 1e2 nodes
        print_ = run.footprint(index)
        assert (np.abs(print_.traction[:, 0]) <= 0.4 * print_.pressure * (1 + 1e-9)).all()


def test_force_control_reaches_the_forces_and_depth_control_agrees(run: SolvedRun) -> None:
    reached = [run.history.steps[i].state for i in run.reached()]
    assert [s.normal_force for s in reached] == pytest.approx([0.3, 1.1], rel=1e-7)
    again = press(SHAPE, rubber("silskin_0"), depths=(reached[1].depth,), friction=0.4, size=COARSE)
    # friction remembers the steps between, which differ: with 0.4 the path changes the force by far less than 1 %
    assert again.history.steps[-1].state.normal_force == pytest.approx(1.1, rel=2e-3)


def test_contact_state_carries_area_force_and_place(run: SolvedRun) -> None:
    grid = PlateGrid((150, 190), 0.07, (0.8, -0.3))
    centre = (1.1, -0.55)
    state = run_state(run, -1, grid, centre=centre)
    cell = grid.pitch**2
    assert state.contact_mask.sum() * cell == pytest.approx(run.row(-1)["area_mm2"], rel=1e-9)
    # annuli placed on squares: the border's cells, 2 pi a/pitch of them, each with the pressure's half cell
    assert state.pressure.sum() * cell == pytest.approx(1.1, rel=0.01)
    x, y = np.meshgrid(grid.x, grid.y)
    mass = state.pressure.sum()
    assert (state.pressure * x).sum() / mass == pytest.approx(centre[0], abs=grid.pitch / 10)
    assert (state.pressure * y).sum() / mass == pytest.approx(centre[1], abs=grid.pitch / 10)
    inside, outside = state.contact_mask == 1, state.contact_mask == 0
    assert (state.gap[inside] == 0).all()
    assert (state.gap[outside] > 0).all()
    assert set(np.unique(state.state[inside])) <= {SurfaceState.STICK, SurfaceState.SLIP}
    assert set(np.unique(state.state[outside])) <= {SurfaceState.NONE, SurfaceState.NEAR}
    # traction on the finger points along the radius: no moment about the axis
    moment = state.traction[1] * (x - centre[0]) - state.traction[0] * (y - centre[1])
    assert np.abs(moment).max() < 1e-9


def test_contact_off_the_grid_is_refused(run: SolvedRun) -> None:
    with pytest.raises(InputError, match="does not fit"):
        run_state(run, -1, PlateGrid((40, 40), 0.05))


def test_limit_of_the_material_is_named_and_the_steps_before_are_kept(tmp_path: Path) -> None:
    fragile = Rubber(0.0037, 0.0495, -0.00175, stretch_limit=1.05)
    for _ in range(2):  # the second time from the cache
        with pytest.raises(LimitReached, match=r"material limit reached: stretch \d\.\d+ at step \d+") as caught:
            press(SHAPE, fragile, forces=(2.0,), size=COARSE, cache=tmp_path)
        kept = caught.value.history.steps
        assert kept
        assert max(s.stretch_max for s in kept) <= 1.05
    (file,) = tmp_path.glob("*.npz")
    assert len(load_run(file)) == len(kept)
    assert load_run(file).limit == str(caught.value)


def test_a_step_that_cannot_be_halved_is_named() -> None:
    with pytest.raises(LimitReached, match="step limit reached"):
        press(SHAPE, rubber("silskin_0"), depths=(9.0,), size=COARSE, sizes=StepSizes(9.0, 9.0, 8.0))


SCRIPT = """
import sys, time
from pathlib import Path
from evanesce.contact.fem.material import rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize
from evanesce.contact.fem.programme import press
press(FingerShape(6.8, 12.6, 17.0), rubber("silskin_20"), forces=(0.2, 0.35), friction=0.6,
      size=MeshSize(0.9, 2.5, 1.4, 3.0), cache=Path(sys.argv[1]), on_step=lambda run, goal: time.sleep(0.15))
"""


def test_a_killed_run_goes_on_where_it_was(tmp_path: Path) -> None:
    environment = os.environ | {"MKL_NUM_THREADS": "1"}
    child = subprocess.Popen([sys.executable, "-c", SCRIPT, str(tmp_path)], env=environment)
    deadline = time.monotonic() + 60
    try:
        while time.monotonic() < deadline:
            files = list(tmp_path.glob("[!.]*.npz"))
            if files and len(load_run(files[0])) >= 3:
                break
            time.sleep(0.02)
        assert child.poll() is None, "the run ended before it could be killed"
        os.kill(child.pid, signal.SIGKILL)
    finally:
        child.kill()
        child.wait()
    (file,) = tmp_path.glob("[!.]*.npz")
    before = load_run(file)
    assert not before.history.complete
    solved_now: list[int] = []
    arguments = {"forces": (0.2, 0.35), "friction": 0.6, "size": MeshSize(0.9, 2.5, 1.4, 3.0)}
    shape, material = FingerShape(6.8, 12.6, 17.0), rubber("silskin_20")
    resumed = press(shape, material, cache=tmp_path, on_step=lambda r, g: solved_now.append(len(r)), **arguments)
    whole = press(shape, material, **arguments)
    assert solved_now[0] == len(before) + 1
    assert len(resumed) == len(whole)
    for a, b in zip(resumed.history.steps, whole.history.steps, strict=True):
        # two processes may sum in another order: Newton's tolerance of 1e-8, not rounding, bounds the difference
        assert a.state.depth == pytest.approx(b.state.depth, rel=1e-6)
        np.testing.assert_allclose(a.state.displacement, b.state.displacement, atol=1e-6)
    again = press(shape, material, cache=tmp_path, on_step=lambda r, g: pytest.fail("solved anew"), **arguments)
    assert again.history.complete


def test_solved_run_survives_its_file_and_a_damaged_one_is_refused(run: SolvedRun, tmp_path: Path) -> None:
    from evanesce.contact.fem.result import save_run

    save_run(tmp_path / "run.npz", run)
    back = load_run(tmp_path / "run.npz")
    assert back.inputs == run.inputs
    assert back.row(-1) == run.row(-1)
    broken = tmp_path / "broken.npz"
    broken.write_bytes((tmp_path / "run.npz").read_bytes()[:5000])
    with pytest.raises(InputError, match="broken"):
        load_run(broken)
    np.savez(tmp_path / "other.npz", a=np.arange(3))
    with pytest.raises(InputError, match="not a solved run"):
        load_run(tmp_path / "other.npz")


def test_vtk_holds_the_pressure(run: SolvedRun, tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio")
    write_vtk(tmp_path / "run.vtu", run, -1)
    grid = meshio.read(tmp_path / "run.vtu")
    force = grid.point_data["contact_force_N"][:, 2].sum()
    assert force == pytest.approx(1.1, rel=1e-6)
    with pytest.raises(InputError, match="vtu"):
        write_vtk(tmp_path / "run.nonsense", run, -1)


def test_without_the_extra_solving_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "felupe", None)
    with pytest.raises(InputError, match=r"pip install 'evanesce\[fem\]'"):
        press(SHAPE, rubber("silskin_0"), forces=(0.3,), size=COARSE)


@pytest.mark.parametrize(
    "arguments", [{}, {"forces": (1.0,), "depths": (1.0,)}, {"forces": (-1.0,)}, {"forces": (1.0,), "friction": -0.1}]
)
def test_impossible_presses_are_refused(arguments: dict[str, object]) -> None:
    with pytest.raises(InputError):
        press(SHAPE, rubber("silskin_0"), size=COARSE, **arguments)  # type: ignore[arg-type]
