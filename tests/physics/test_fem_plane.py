"""Forces of the glass on nodes: the tangent against differences, Coulomb's cone, stick before slip, the first touch."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.contact.fem.descent import Lagged
from evanesce.contact.fem.plane import Anchors, Glass, free_anchors, plane_forces

GLASS = Glass(friction=0.63, penalty=170.0, tangential_ratio=0.4, softness=0.003)
AREAS = np.array([0.11, 0.27, 0.05, 0.19])


def _memory(relative: np.ndarray, touching: list[bool], shift: np.ndarray, before: float) -> Anchors:
    last = relative - np.append(shift, 0.0)
    last[:, -1] = before
    return Anchors(np.array(touching), relative[:, :-1] - shift, relative[:, :-1] - shift, last)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("shift", [1e-4, 0.05], ids=["stick", "slip"])
@pytest.mark.parametrize("known", [True, False], ids=["touched before", "new"])
def test_tangent_is_the_derivative_of_the_forces(dim: int, shift: float, known: bool) -> None:
    rng = np.random.default_rng(5)
    relative = rng.normal(scale=0.2, size=(4, dim))
    relative[:, -1] = [-0.001, -0.02, 0.004, -0.011]  # within the soft start, well in, free, well in
    way = shift * np.array([0.8, -0.6])[: dim - 1]
    memory = _memory(relative, [known] * 4, way, 0.015)
    found = plane_forces(relative, AREAS, GLASS, memory)
    h = 1e-8  # rounding 1e-16 * 5 N / h and truncation h * 1e5 N/mm^2 both stay below 1e-3 of the largest entry
    for c in range(dim):
        step = np.zeros(dim)
        step[c] = h
        high = plane_forces(relative + step, AREAS, GLASS, memory).force
        low = plane_forces(relative - step, AREAS, GLASS, memory).force
        np.testing.assert_allclose(-(high - low) / (2 * h), found.stiffness[:, :, c], atol=1e-4 * GLASS.penalty * 0.27)


@pytest.mark.parametrize("shift", [1e-4, 0.05], ids=["stick", "slip"])
def test_forces_with_given_limits_are_those_of_an_energy(shift: float) -> None:
    rng = np.random.default_rng(5)
    relative = rng.normal(scale=0.2, size=(4, 3))
    relative[:, -1] = [-0.001, -0.02, 0.004, -0.011]
    origin = relative[:, :-1] - shift * np.array([0.8, -0.6])
    lagged = Lagged(GLASS, AREAS, origin, np.array([0.02, 0.3, 0.0, 0.1]))
    found = lagged.forces(relative)
    assert found.slipping[[0, 1, 3]].all() == (shift > 0.01)
    h = 1e-7
    for node in range(4):
        for c in range(3):
            step = np.zeros((4, 3))
            step[node, c] = h
            slope = (lagged.energy(relative + step) - lagged.energy(relative - step)) / (2 * h)
            assert -slope == pytest.approx(found.force[node, c], abs=2e-6)
            change = lagged.forces(relative + step).force - lagged.forces(relative - step).force
            np.testing.assert_allclose(-change[node] / (2 * h), found.stiffness[node, :, c], atol=1e-4 * GLASS.penalty)
    assert np.array_equal(found.stiffness, found.stiffness.transpose(0, 2, 1))
    np.testing.assert_allclose(
        found.force[:, -1], plane_forces(relative, AREAS, GLASS, free_anchors(relative)).force[:, -1]
    )


def test_friction_stays_in_coulombs_cone_and_points_against_the_way() -> None:
    relative = np.array([[0.3, 0.1, -0.01], [0.2, -0.4, -0.03], [1.0, 0.5, 0.02], [0.0, 0.0, -0.002]])
    shift = np.array([0.07, -0.02])
    found = plane_forces(relative, AREAS, GLASS, _memory(relative, [True] * 4, shift, -0.01))
    tangential, normal = np.linalg.norm(found.force[:, :2], axis=1), found.force[:, 2]
    assert (tangential <= GLASS.friction * normal * (1 + 1e-12)).all()
    assert found.slipping.tolist() == [True, True, False, True]
    cosine = found.force[[0, 1, 3], :2] @ shift / np.linalg.norm(shift) / tangential[[0, 1, 3]]
    np.testing.assert_allclose(cosine, -1.0, atol=1e-12)
    assert (found.force[2] == 0).all()


def test_a_node_sticks_until_the_cone_is_reached() -> None:
    relative = np.tile([0.4, 0.0, -0.02], (4, 1))
    at_limit = GLASS.friction * (0.02 - 0.5 * GLASS.softness) / GLASS.tangential_ratio  # mu p over the stick stiffness
    for factor, slips in ((0.999, False), (1.001, True)):
        memory = _memory(relative, [True] * 4, np.array([factor * at_limit, 0.0]), -0.02)
        assert plane_forces(relative, AREAS, GLASS, memory).slipping.all() == slips


def test_the_way_before_the_touch_costs_nothing() -> None:
    """A node falling steeply through the glass is anchored where its path crossed it."""
    before = np.array([[0.0, 0.0, 0.03]])
    after = np.array([[0.4, -0.2, -0.01]])
    found = plane_forces(after, AREAS[:1], Glass(friction=1e6, penalty=100.0), free_anchors(before))
    np.testing.assert_allclose(found.anchors.place, [[0.3, -0.15]], atol=1e-12)
    np.testing.assert_allclose(found.anchors.touchdown, [[0.3, -0.15]], atol=1e-12)


def test_a_node_that_slipped_and_goes_back_sticks_first() -> None:
    glass = Glass(friction=0.5, penalty=200.0, tangential_ratio=0.5)
    here = np.array([[0.2, 0.0, -0.01]])
    slid = plane_forces(here, AREAS[:1], glass, _memory(here, [True], np.array([0.1, 0.0]), -0.01))
    assert slid.slipping.all()
    back = plane_forces(here - [[1e-3, 0.0, 0.0]], AREAS[:1], glass, slid.anchors)
    assert not back.slipping.any()
    assert -slid.force[0, 0] > -back.force[0, 0]
