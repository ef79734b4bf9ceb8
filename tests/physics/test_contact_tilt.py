"""A tilted finger: sphere, flat punch in closed form, a truncated tip against another solver, turned ridges."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from evanesce.contact.halfspace.solver import press_height_map
from evanesce.contact.solve import contact_grid, contact_state
from evanesce.contact.tilt import tilted_heights
from evanesce.core.errors import InputError
from evanesce.rig import Scene, load_scene

HALF = {"law": "halfspace", "reduced_modulus_MPa": 0.4}


def scene(law: dict[str, object], **more: object) -> Scene:
    base = {"grid.samples": 160, "grid.size_mm": 12.8, "finger.position_mm": [0.7, -0.4], "contact": law}
    return load_scene("thesis", base | {key.replace("__", "."): value for key, value in more.items()})


@pytest.mark.parametrize("law", [{"law": "hertz"}, {"law": "jkr", "work_of_adhesion_N_per_mm": 1e-4}, HALF])
def test_a_tilted_sphere_is_an_upright_one(law: dict[str, object]) -> None:
    upright, tilted = (
        contact_state(scene(law), 1.3),
        contact_state(scene(law | {"tilt_deg": 35.0, "tilt_direction_deg": 20.0}), 1.3),
    )
    assert tilted.parameters["tilt_deg"] == 35.0
    assert tilted.nominal_contact_area == pytest.approx(upright.nominal_contact_area, rel=1e-6)
    np.testing.assert_allclose(tilted.pressure, upright.pressure, atol=1e-5)  # the half-space stops at 1e-5


def test_no_tilt_changes_no_bit() -> None:
    plain, null = (
        contact_state(scene(HALF), 0.8),
        contact_state(scene(HALF | {"tilt_deg": 0.0, "tilt_direction_deg": 70.0}), 0.8),
    )
    assert np.array_equal(plain.pressure, null.pressure)
    assert np.array_equal(plain.gap, null.gap)
    assert plain.parameters == null.parameters


def test_a_tilted_flat_punch_shifts_its_pressure() -> None:
    # p = E*(d + 2 t x)/(pi sqrt(a^2 - r^2)): F = 2 E* a d, moment 4 E* t a^3/3
    a, modulus, tilt, force, pitch = 2.0, 0.4, 0.03, 1.1, 0.05
    axis = (np.arange(128) - 63.5) * pitch
    x, y = np.meshgrid(axis, axis)
    heights = np.where(np.hypot(x, y) < a, -tilt * x, 50.0)
    found = press_height_map(heights, pitch, modulus, force, tolerance=1e-8)
    moment = float((found.pressure * x).sum()) * pitch**2
    assert moment == pytest.approx(4.0 * modulus * tilt * a**3 / 3.0, rel=0.03)  # cells of a fortieth of the radius
    assert found.depth == pytest.approx(force / (2.0 * modulus * a), rel=0.02)


def test_a_contact_over_the_rim_is_that_of_another_solver() -> None:
    # Tip radius 10 on a shaft of 15 mm: its rim, at 48.6 deg, lies 1.5 mm from the contact's middle.
    rim = scene(
        HALF | {"tilt_deg": 40.0, "tilt_direction_deg": 30.0},
        finger__tip_radius_mm=10.0,
        grid__samples=32,
        grid__size_mm=6.0,
    )
    grid, force = contact_grid(rim), 0.5
    state = contact_state(rim, force)
    heights = tilted_heights(rim, grid)
    # Boussinesq's cells, summed by quadrature instead of Love's form; non-negative least squares of the energy
    x, y = (v.ravel() for v in np.meshgrid(grid.x, grid.y))
    near = np.flatnonzero(heights.ravel() < 0.6)
    nodes = (np.arange(8) + 0.5) / 8 - 0.5
    dx, dy = (v.ravel() * grid.pitch for v in np.meshgrid(nodes, nodes))
    far = np.hypot(x[near, None, None] - x[None, near, None] + dx, y[near, None, None] - y[None, near, None] + dy)
    influence = (1.0 / far).mean(axis=2) * grid.pitch**2 / (np.pi * 0.4)
    np.fill_diagonal(influence, 4 * np.log(1 + np.sqrt(2)) * grid.pitch / (np.pi * 0.4))
    upper = cholesky(influence)
    target = solve_triangular(upper, state.depth - heights.ravel()[near], trans="T")
    pressure = np.zeros(x.size)
    pressure[near], _ = nnls(upper, target)
    assert pressure.sum() * grid.pitch**2 == pytest.approx(force, rel=0.01)
    assert np.abs(pressure - state.pressure.ravel()).sum() * grid.pitch**2 < 0.02 * force
    # The apex lies against the lean; on the other side the contact ends at the rim.
    along = (x - 0.7) * np.cos(np.pi / 6) + (y + 0.4) * np.sin(np.pi / 6)
    touching = along[state.contact_mask.ravel() > 0.5]
    assert touching.max() < 10.0 * np.sin(np.arcsin(0.75) - np.radians(40.0)) + 0.5 * grid.pitch
    assert touching.min() < -touching.max() - 0.3


def test_the_ridges_turn_with_the_skin() -> None:
    # Half a pitch along the skin puts a furrow where a crest was; a whole one changes nothing.
    ridges = {"pattern": "parallel", "pitch_um": 1000.0, "orientation_deg": 90.0}
    turn = np.degrees(0.5 / 7.5)
    states = [contact_state(scene(HALF | {"tilt_deg": t}, finger__ridges=ridges), 0.4) for t in (turn, 2 * turn)]
    upright = contact_state(scene(HALF, finger__ridges=ridges), 0.4)
    # as far as either of them has converged
    np.testing.assert_allclose(states[1].pressure, upright.pressure, atol=1e-4 * upright.pressure.max())
    assert abs(float(states[0].pressure[76, 88] - upright.pressure[76, 88])) > 0.01
    assert states[0].nominal_contact_area == pytest.approx(upright.nominal_contact_area, rel=0.1)


def test_what_no_law_solves_is_refused() -> None:
    with pytest.raises(InputError, match=r"contact\.tilt_deg.*at most"):
        contact_state(scene({"law": "hertz", "tilt_deg": 45.0}, finger__tip_radius_mm=10.0), 1.0)
    with pytest.raises(InputError, match="another law"):
        contact_state(scene({"law": "fem", "tilt_deg": 5.0}), 1.0)
    with pytest.raises(InputError, match="contact_angle_deg"):
        load_scene("thesis_slide", {"contact.tilt_deg": 5.0})
    with pytest.raises(InputError, match=r"contact\.tilt_deg"):
        scene(HALF | {"tilt_deg": 70.0})
