"""Adhesion: Maugis's equations between their limits, the cohesive zone on the grid against them and against JKR."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from evanesce.contact.analytic.hertz import hertz_radius
from evanesce.contact.analytic.jkr import jkr_depth, jkr_pull_off_force, jkr_radius
from evanesce.contact.halfspace.adhesion import (
    maugis_force_and_depth,
    maugis_parameter,
    maugis_pull_off_force,
    press_adhesive_height_map,
    resolved_cohesive_stress,
)
from evanesce.contact.halfspace.resolved import Adhesion, contact_area, resolved_state
from evanesce.core.errors import WorkError
from evanesce.core.states import PlateGrid

R, E, W = 7.1, 0.77, 1.1e-3  # mm, MPa, N/mm


def maugis_radius(force: float, stress: float) -> float:
    """Largest radius in equilibrium [mm]."""
    top = float(jkr_radius(force, R, E, W))
    return brentq(lambda a: maugis_force_and_depth(a, R, E, W, stress)[0] - force, 0.85 * top, 1.2 * top)


def test_maugis_runs_from_dmt_to_jkr() -> None:
    unit = np.pi * W * R
    stresses = (1e-4, 0.02, 0.3, 30.0)
    pulls = [maugis_pull_off_force(R, E, W, s) / unit for s in stresses]
    assert pulls == sorted(pulls)
    assert pulls[0] == pytest.approx(-2.0, rel=1e-3)
    assert pulls[-1] == pytest.approx(-1.5, rel=1e-4)
    assert pulls[-1] * unit == pytest.approx(jkr_pull_off_force(R, W), rel=1e-4)
    a = maugis_radius(0.4, 30.0)
    assert a == pytest.approx(float(jkr_radius(0.4, R, E, W)), rel=1e-4)
    assert maugis_force_and_depth(a, R, E, W, 30.0)[1] == pytest.approx(float(jkr_depth(0.4, R, E, W)), rel=1e-3)


def test_maugis_parameter_refuses_what_is_not_positive() -> None:
    assert maugis_parameter(R, E, W, 0.2) == pytest.approx(2 * maugis_parameter(R, E, W, 0.1), rel=1e-14)
    with pytest.raises(ValueError, match="positive"):
        maugis_parameter(R, E, 0.0, 0.1)


def sphere(n: int = 128, side: float = 4.2) -> tuple[np.ndarray, float]:
    grid = PlateGrid((n, n), side / n, (0.03, -0.05))
    return (grid.x[None, :] ** 2 + grid.y[:, None] ** 2) / (2 * R), grid.pitch


@pytest.mark.parametrize(("force", "preload"), [(0.3, None), (0.3, 0.5), (0.0, 0.2)])
def test_cohesive_zone_on_the_grid_is_maugis(force: float, preload: float | None) -> None:
    heights, pitch = sphere()
    stress = resolved_cohesive_stress(E, W, pitch)
    found = press_adhesive_height_map(heights, pitch, E, force, W, stress, preload=preload)
    radius = np.sqrt(contact_area(found.gap == 0, pitch) / np.pi)
    expected = maugis_radius(force, stress)
    assert radius == pytest.approx(expected, abs=0.3 * pitch)  # edge within a fraction of a cell
    depth = maugis_force_and_depth(expected, R, E, W, stress)[1]
    assert found.depth == pytest.approx(depth, abs=2e-3 * expected**2 / R)
    # the last round's change of the zone is what the force misses
    assert found.pressure.sum() * pitch**2 == pytest.approx(force, abs=1e-3)
    assert found.pressure.min() >= -stress * (1 + 1e-12)


def test_pull_off_is_maugis_and_near_jkr() -> None:
    heights, pitch = sphere()
    stress = resolved_cohesive_stress(E, W, pitch)
    pull = maugis_pull_off_force(R, E, W, stress)
    held = press_adhesive_height_map(heights, pitch, E, 0.96 * pull, W, stress, preload=0.1)
    assert contact_area(held.gap == 0, pitch) > 0
    with pytest.raises(WorkError, match="lets go"):
        press_adhesive_height_map(heights, pitch, E, 1.04 * pull, W, stress, preload=0.1)
    # four cells to the zone: a Maugis parameter of about 2, whose pull-off is 3 % beyond JKR's
    assert pull == pytest.approx(jkr_pull_off_force(R, W), rel=0.04)


def test_unloading_keeps_more_contact_than_loading_and_weak_adhesion_is_hertz() -> None:
    heights, pitch = sphere()
    stress = resolved_cohesive_stress(E, W, pitch)
    up = press_adhesive_height_map(heights, pitch, E, 0.05, W, stress)
    down = press_adhesive_height_map(heights, pitch, E, 0.05, W, stress, preload=0.6)
    assert contact_area(down.gap == 0, pitch) >= contact_area(up.gap == 0, pitch) * (1 - 1e-3)
    weak = press_adhesive_height_map(heights, pitch, E, 0.3, 1e-7, 1e-3)
    radius = np.sqrt(contact_area(weak.gap == 0, pitch) / np.pi)
    # JKR grows the radius by (a few) sqrt(w) terms: sqrt(6 pi w R/F)/3, here 0.2 %
    assert radius == pytest.approx(float(hertz_radius(0.3, R, E)), rel=1e-2)


def test_an_adhesive_state_pulls_at_its_edge() -> None:
    grid = PlateGrid((96, 96), 0.045, (0.2, -0.1))
    heights = ((grid.x[None, :] - 0.23) ** 2 + (grid.y[:, None] + 0.14) ** 2) / (2 * R)
    sticky = resolved_state(grid, heights, E, 0.2, law="halfspace", adhesion=Adhesion(W))
    dry = resolved_state(grid, heights, E, 0.2, law="halfspace", adhesion=Adhesion(0.0))
    assert sticky.nominal_contact_area > 1.05 * dry.nominal_contact_area
    assert sticky.pressure.min() == pytest.approx(-sticky.parameters["cohesive_stress_MPa"], rel=1e-9)
    assert sticky.contact_mask.sum() * grid.pitch**2 == pytest.approx(sticky.nominal_contact_area, rel=1e-9)


def test_a_pull_needs_a_history() -> None:
    heights, pitch = sphere(32)
    with pytest.raises(ValueError, match="preload"):
        press_adhesive_height_map(heights, pitch, E, -0.01, W, 0.05)
    with pytest.raises(ValueError, match="preload"):
        press_adhesive_height_map(heights, pitch, E, 0.2, W, 0.05, preload=0.1)
    with pytest.raises(ValueError, match="positive"):
        press_adhesive_height_map(heights, pitch, E, 0.2, W, 0.0)
