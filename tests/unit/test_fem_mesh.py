"""Meshes of the finger: volumes and areas against closed forms, no inverted element, what is held where."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evanesce.contact.fem.mesh import FingerShape, MeshSize, SolidMesh, finger_section, graded, nodal_areas
from evanesce.contact.fem.mesh_half import finger_half
from evanesce.core.errors import InputError

SHAPES = {
    "thesis": FingerShape(),
    "bone": FingerShape(bone_radius=3.1),
    "flatter tip": FingerShape(tip_radius=10.0, diameter=15.0, length=21.0),
    "tip alone": FingerShape(length=7.5),
    "slender": FingerShape(tip_radius=4.3, diameter=8.2, length=30.0, bone_radius=1.4),
}


def _cap(radius: float, half: float) -> tuple[float, float, float]:
    """Volume, curved area and height of a spherical cap of a base radius."""
    height = radius - np.sqrt(max(radius**2 - half**2, 0.0))
    return np.pi * height**2 * (3 * radius - height) / 3, 2 * np.pi * radius * height, height


def _volume(shape: FingerShape) -> float:
    volume, _, height = _cap(shape.tip_radius, shape.diameter / 2)
    total = volume + np.pi * (shape.diameter / 2) ** 2 * (shape.length - height)
    b = shape.bone_radius
    return float(total - (2 / 3 * np.pi * b**3 + np.pi * b**2 * (shape.length - shape.diameter / 2) if b else 0.0))


def _ring_volume(mesh: SolidMesh) -> float:
    """Pappus' rule for every quadrilateral, cut into two triangles."""
    total = 0.0
    for cut in (mesh.cells[:, [0, 1, 2]], mesh.cells[:, [0, 2, 3]]):
        p = mesh.points[cut]
        a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
        total += float((0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * 2 * np.pi * p[:, :, 0].mean(axis=1)).sum())
    return total


def _hex_volumes(mesh: SolidMesh) -> np.ndarray:
    """Six tetrahedra each."""
    p = mesh.points[mesh.cells]
    total = np.zeros(len(p))
    for i, j in ((1, 2), (2, 3), (3, 7), (7, 4), (4, 5), (5, 1)):
        edges = [p[:, k] - p[:, 0] for k in (i, j, 6)]
        total += np.einsum("ij,ij->i", np.cross(edges[0], edges[1]), edges[2]) / 6
    return total


@pytest.mark.parametrize("name", SHAPES)
def test_section_has_the_fingers_volume_and_skin(name: str) -> None:
    shape, h = SHAPES[name], 0.3
    mesh = finger_section(shape, MeshSize(contact=h, coarsest=0.6))
    # chords of length c inside a circle of radius R lose about c^2/(6 R^2) of volume and c^2/(24 R^2) of skin
    loss = 0.6**2 / (2 * shape.tip_radius**2)
    assert 0 <= 1 - _ring_volume(mesh) / _volume(shape) < loss or shape.bone_radius > 0
    assert _ring_volume(mesh) == pytest.approx(_volume(shape), rel=2 * loss)
    _, area, height = _cap(shape.tip_radius, shape.diameter / 2)
    skin = area + np.pi * shape.diameter * (shape.length - height)
    assert nodal_areas(mesh.points, mesh.facets).sum() == pytest.approx(skin, rel=loss)


@pytest.mark.parametrize("name", SHAPES)
def test_half_body_has_half_the_volume_and_no_inverted_element(name: str) -> None:
    shape = SHAPES[name]
    mesh = finger_half(shape, MeshSize(contact=0.9, growth=1.3, coarsest=1.5))
    volumes = _hex_volumes(mesh)
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(_volume(shape) / 2, rel=0.04)  # chords of up to 1.5 mm: 1.5^2/(6 R^2), twice
    assert np.unique(mesh.cells).size == len(mesh.points)


@pytest.mark.parametrize("make", [finger_section, finger_half])
@pytest.mark.parametrize("name", SHAPES)
def test_what_is_held(make: object, name: str) -> None:
    shape = SHAPES[name]
    mesh = make(shape, MeshSize(contact=1.1, growth=1.3))  # type: ignore[operator]
    top = np.flatnonzero(np.abs(mesh.points[:, -1] - shape.length) < 1e-6)
    assert set(top) <= set(mesh.clamped)
    across = 0 if mesh.dim == 2 else 1
    assert np.abs(mesh.points[mesh.mirror, across]).max() < 1e-9
    assert not set(mesh.mirror) & set(mesh.clamped)
    on_plane = np.flatnonzero(np.abs(mesh.points[:, across]) < 1e-9)
    assert set(on_plane) == (set(mesh.mirror) | (set(mesh.clamped) & set(on_plane)))
    cap = mesh.points[mesh.candidates]
    distance = np.linalg.norm(cap - np.append(np.zeros(mesh.dim - 1), shape.tip_radius), axis=1)
    np.testing.assert_allclose(distance, shape.tip_radius, rtol=1e-9)


@pytest.mark.parametrize("tilt", [12.0, 45.0])
@pytest.mark.parametrize("name", ["thesis", "bone", "flatter tip"])
def test_a_tilted_finger_is_the_upright_one_turned_about_its_tip(name: str, tilt: float) -> None:
    size = MeshSize(contact=0.9, growth=1.3, coarsest=1.5)
    upright, leant = finger_half(SHAPES[name], size), finger_half(replace(SHAPES[name], tilt_deg=tilt), size)
    np.testing.assert_array_equal(leant.clamped, upright.clamped)
    np.testing.assert_allclose(_hex_volumes(leant), _hex_volumes(upright), rtol=1e-9)
    tip = np.array([0.0, 0.0, SHAPES[name].tip_radius])
    for mesh in (upright, leant):  # the sphere stays where it was, and no skin lies lower
        away = np.linalg.norm(mesh.points[mesh.candidates] - tip, axis=1)
        np.testing.assert_allclose(away, SHAPES[name].tip_radius, rtol=1e-9)
        assert mesh.points[:, 2].min() > -1e-9
    top = leant.points[upright.points[:, 2] > SHAPES[name].length - 1e-7].mean(axis=0) - tip
    assert np.degrees(np.arctan2(top[0], top[2])) == pytest.approx(tilt, abs=1e-6)


def test_tilts_that_no_mesh_has_are_refused() -> None:
    with pytest.raises(InputError, match="rim"):
        FingerShape(tip_radius=10.0, diameter=15.0, tilt_deg=49.0)
    with pytest.raises(InputError, match="axisymmetric"):
        finger_section(FingerShape(tilt_deg=5.0), MeshSize(contact=0.9))


def test_every_inner_edge_of_the_section_joins_two_elements() -> None:
    mesh = finger_section(FingerShape(length=19.3), MeshSize(contact=0.7))
    edges = np.sort(np.vstack([mesh.cells[:, [i, (i + 1) % 4]] for i in range(4)]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() == 2
    # Euler: V - E + F = 1 for a piece without holes
    assert len(mesh.points) - len(count) + len(mesh.cells) == 1


def test_projected_area_of_a_cap_is_its_disc() -> None:
    mesh = finger_section(FingerShape(tip_radius=10.0, diameter=12.0), MeshSize(contact=0.2))
    cap = mesh.facets[: mesh.candidates.size - 1]
    assert nodal_areas(mesh.points, cap, projected=True).sum() == pytest.approx(np.pi * 36.0, rel=1e-12)


@pytest.mark.parametrize("length", [0.31, 1.0, 7.3, 40.0])
def test_graded_division_ends_where_it_should_and_never_shrinks(length: float) -> None:
    points = graded(length, 0.3, 1.0, 1.2, 2.0)
    assert points[0] == 0
    assert points[-1] == pytest.approx(length, rel=1e-12)
    assert (np.diff(points, 2) > -1e-9).all()


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"tip_radius": 5.0}, "tip_radius"),
        ({"length": 2.0}, "length"),
        ({"bone_radius": 7.4}, "bone_radius"),
        ({"diameter": float("nan")}, "diameter"),
    ],
)
def test_impossible_fingers_are_refused(change: dict[str, float], key: str) -> None:
    with pytest.raises(InputError, match=key):
        FingerShape(**change)
