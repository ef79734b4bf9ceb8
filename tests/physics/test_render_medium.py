"""The medium inside a body: against Chandrasekhar's H function, conservation, the random walk and the flat model."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from evanesce.contact.solve import contact_state
from evanesce.optics.subsurface import profile_kernel
from evanesce.render.fast.subsurface import Spread, body_light
from evanesce.render.reference.medium import Body, Silicone, exitance, finger_body, medium_scene, slab_body
from evanesce.render.variant import select
from evanesce.rig import load_scene
from support.rigs import need


def h_function(albedo: float, nodes: int = 64) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Chandrasekhar's H of isotropic scattering: 1/H = sqrt(1 - w) + w/2 int mu' H(mu')/(mu + mu') dmu', iterated."""
    u, w = np.polynomial.legendre.leggauss(nodes)
    mu, weight = 0.5 * (u + 1), 0.5 * w
    h = np.ones(nodes)
    for _ in range(300):
        new = 1 / (np.sqrt(1 - albedo) + 0.5 * albedo * (weight * mu * h / (mu[:, None] + mu[None, :])).sum(axis=1))
        if np.abs(new - h).max() < 1e-14:
            break
        h = new
    return mu, weight, h


def diffuse_reflectance(albedo: float) -> float:
    """Half-space under diffuse light: 1 - 2 sqrt(1 - w) int H mu dmu (Chandrasekhar, Radiative Transfer, 1960)."""
    mu, weight, h = h_function(albedo)
    return float(1 - 2 * np.sqrt(1 - albedo) * (weight * mu * h).sum())


def square(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return (np.abs(x - 0.3) < 1.1) & (np.abs(y + 0.2) < 0.8)


def everywhere(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.ones(x.shape, bool)


def test_h_function_has_its_known_moments() -> None:
    # int H dmu = 2 (1 - sqrt(1 - w))/w: an identity that the iteration does not use
    for albedo in (0.5, 0.9, 0.99):
        _, weight, h = h_function(albedo)
        assert (weight * h).sum() == pytest.approx(2 * (1 - np.sqrt(1 - albedo)) / albedo, rel=1e-4)


@pytest.mark.parametrize("albedo", [0.7, 0.95])
def test_thick_slab_reflects_as_the_h_function_says(albedo: float) -> None:
    """Rationale: lit everywhere by diffuse light, a thick matched slab is a half-space. Expected: Chandrasekhar's."""
    need("llvm")
    select("llvm")
    body = slab_body(everywhere, half=40.0, depth=40.0, cell=2.0, fine=6.0)
    scene = medium_scene(body, Silicone(1.25, albedo), "matched")
    points = np.random.default_rng(3).uniform(-4, 4, (60_000, 2))
    value = exitance(scene, points, seed=3)
    noise = value.std() / np.sqrt(value.size)
    # 4.5 standard errors: 1e-5 by chance. Beyond 40 mm lies e^-19 of the light even at the higher albedo.
    assert value.mean() == pytest.approx(diffuse_reflectance(albedo), abs=4.5 * noise)
    assert noise < 0.004


def test_no_more_leaves_a_matched_slab_than_entered_and_none_is_lost_without_absorption() -> None:
    """A white slab on both of whose sides all that entered comes out: half-space bounds and conservation."""
    need("llvm")
    select("llvm")
    # Lit from below over its whole lower side; 1 mm thick, 30 mm wide: what leaves below and above adds up to 1.
    body = slab_body(everywhere, half=30.0, depth=1.0, cell=2.0, fine=6.0)
    points = np.random.default_rng(8).uniform(-2, 2, (60_000, 2))
    below = exitance(medium_scene(body, Silicone(2.0, 1.0), "matched"), points, seed=1)
    # The same slab upside down: lit above, seen below.
    turned = Body(body.mesh, (body.mesh.triangles[:, :, 2] > 1 - 1e-9).all(axis=1))
    above = exitance(medium_scene(turned, Silicone(2.0, 1.0), "matched"), points, seed=2)
    noise = np.hypot(below.std(), above.std()) / np.sqrt(points.shape[0])
    assert below.mean() + above.mean() == pytest.approx(1.0, abs=4.5 * noise)


def test_llvm_and_scalar_agree() -> None:
    need("llvm")
    need("scalar")
    found = {}
    points = np.random.default_rng(5).uniform(-1.5, 1.5, (4000, 2))
    for family in ("llvm", "scalar"):
        select(family)
        body = slab_body(square, half=15.0, depth=10.0, cell=0.1, fine=2.0)
        value = exitance(medium_scene(body, Silicone.of(0.55, 0.6), "air"), points, seed=4)
        found[family] = value.mean(), value.std() / np.sqrt(value.size)
    (a, da), (b, db) = found.values()
    select("llvm")
    assert a == pytest.approx(b, abs=4.5 * np.hypot(da, db))


def test_beside_an_ugly_contact_the_model_holds_to_its_fits_error() -> None:
    """Flat and matched, where the diffusion model claims to be right; a rectangle off the axes."""
    need("llvm")
    select("llvm")
    reflectance, length, cell = 0.6, 0.5, 0.05
    body = slab_body(square, half=20.0, depth=20.0, cell=0.1, fine=3.0)
    scene = medium_scene(body, Silicone.of(reflectance, length), "matched")
    # A window that straddles one side, half in contact and half beside it.
    points = np.random.default_rng(9).uniform([0.9, -0.6], [1.9, 0.2], (100_000, 2))
    value = exitance(scene, points, seed=9)
    x = (np.arange(240) + 0.5 - 120) * cell
    touching = square(x[None, :], x[:, None]).astype(float)
    flat = body_light(Spread(profile_kernel(reflectance, length, cell, 239)), touching, np.zeros_like(touching))
    rows = (x > -0.6) & (x < 0.2)
    for low, high in ((0.9, 1.35), (1.45, 1.9)):
        some, columns = (points[:, 0] > low) & (points[:, 0] < high), (x > low) & (x < high)
        noise = value[some].std() / np.sqrt(some.sum())
        # The profile's encircled share is good to 0.025; so then is the light from any region, times the reflectance.
        expected = flat[np.ix_(rows, columns)].mean()
        assert value[some].mean() == pytest.approx(expected, abs=0.025 * reflectance + 4.5 * noise)


def test_open_boundary_keeps_light_inside_and_brightens_the_contact() -> None:
    need("llvm")
    select("llvm")
    body = slab_body(square, half=20.0, depth=20.0, cell=0.1, fine=3.0)
    points = np.random.default_rng(2).uniform(-2.5, 2.5, (60_000, 2))
    inside = square(points[:, 0], points[:, 1])
    level, noise = {}, {}
    for boundary in ("matched", "air"):
        value = exitance(medium_scene(body, Silicone.of(0.6, 0.7), boundary), points, seed=6)
        for name, some in (("in", inside), ("out", ~inside)):
            level[boundary, name] = value[some].mean()
            noise[boundary, name] = value[some].std() / np.sqrt(some.sum())
    assert level["air", "out"] < level["matched", "out"] - 4.5 * noise["matched", "out"]
    assert level["air", "in"] > level["matched", "in"] - 4.5 * noise["matched", "in"]


def test_ridged_finger_is_closed_and_its_contact_is_that_of_the_state() -> None:
    changes = {
        "contact": {"law": "hertz", "reduced_modulus_MPa": 4.0},
        "finger.ridges.orientation_deg": 0.0,  # along x, so that swapped axes show
        "finger.position_mm": [1.3, -0.7],
    }
    scene = load_scene("thesis_ridged", changes)
    state = contact_state(scene, 1.0)
    body = finger_body(scene.finger, state)
    assert body.mesh.is_watertight
    # sphere's half and cylinder, less what the press flattens (0.05 %)
    radius, length = 7.5, 25.0
    expected = 2 / 3 * np.pi * radius**3 + np.pi * radius**2 * (length - radius)
    assert body.mesh.volume == pytest.approx(expected, rel=0.01)
    faces = body.mesh.triangles[body.touching]
    # A face counts if all of it is in contact: along the edges half a face is missing, 0.05 mm of some 30 mm of edge
    area = body.mesh.area_faces[body.touching].sum()
    assert area == pytest.approx(state.nominal_contact_area, rel=0.15)
    middle = faces.mean(axis=1)
    grid = state.grid
    row, col = (np.rint(v).astype(int) for v in grid.index(middle[:, 0], middle[:, 1]))
    assert (np.asarray(state.contact_mask)[row, col] > 0).mean() > 0.98


def test_an_open_mesh_is_refused() -> None:
    mesh = trimesh.creation.box()
    holed = trimesh.Trimesh(mesh.vertices, mesh.faces[1:], process=False)
    with pytest.raises(ValueError, match="not closed"):
        Body(holed, np.zeros(len(holed.faces), bool))
    with pytest.raises(ValueError, match="flags"):
        Body(mesh, np.zeros(3, bool))
