"""The fast renderer's operators against closed forms, direct sums and conservation; what its caches reuse."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss

from evanesce.contact.solve import contact_state
from evanesce.optics.edge_rays import EdgeLight, led_count
from evanesce.optics.flank import escape
from evanesce.optics.flank.escape import GRAZING, escaping_irradiance, exit_slope
from evanesce.optics.flank.irradiance import (
    contact_on_flank,
    flank_sums,
    mirrored_exchange,
    sampled_irradiance,
)
from evanesce.optics.flank.surface import FingerSurface
from evanesce.optics.guided_field import azimuthal_radiance, edge_radiance, exchange_sums
from evanesce.optics.interface import fresnel_reflectance, frustrated_transmittance
from evanesce.optics.patch_light import (
    Interface,
    angle_nodes,
    feedback,
    returned_radiance,
    transmitted_irradiance_kernel,
    window_transmittance,
)
from evanesce.optics.path_sums import in_plate
from evanesce.optics.projection import Projection
from evanesce.render.fast import rig_fields, rig_optics, transport
from evanesce.render.fast.feedback import CoarseGrid, coarse_mean
from evanesce.render.fast.feedback import feedback as coarse_feedback
from evanesce.render.fast.fields import Fields, fields_of
from evanesce.render.fast.flank import flank_image, table_position
from evanesce.render.fast.patch import InterfaceBox, field_images, patch_light, patch_radiance, refinement
from evanesce.render.fast.sampling import view_rays
from evanesce.render.fast.transport import render_fast
from evanesce.render.kept import forget
from evanesce.render.reference.scene import interface_maps
from evanesce.rig import Scene, load_scene
from support.rigs import hard_contact, small_rig


@pytest.fixture(scope="module")
def scene() -> Scene:
    return small_rig()


@pytest.fixture(scope="module")
def fields(scene: Scene) -> Fields:
    return fields_of(scene)


# --- fields and tables -----------------------------------------------------------------------------------------------


def test_field_and_coupling_are_those_of_rays_cast_from_the_contact(scene: Scene, fields: Fields) -> None:
    """LEDs as columns of images, binned by angle, against rays followed back from the point, angle by angle."""
    light, interface = rig_optics.edge_light(scene), rig_optics.interface_of(scene)
    theta, weights = angle_nodes(400, interface.n_glass)
    diffuse = edge_radiance(light, per_edge=48, rays=2048)
    x, y = np.array([4.4, 1.9]), np.array([-3.7, 0.6])
    radiance = azimuthal_radiance(light, x, y, theta, azimuths=720, diffuse=diffuse)
    images = [image[0] for image in field_images(fields, x[None, :], y[None, :])]
    contact = np.zeros(2)
    for k in (0, 600, 1100):
        kernel = transmitted_irradiance_kernel(theta, weights, fields.gaps[k : k + 1], interface)[0]
        found = sum(image * table[k] for image, table in zip(images, fields.coupling, strict=True))
        # The rays hit or miss LEDs of 4 mm by 2.5 mm: 800 angles and 720 azimuths know that to some 0.3 %. Nodes stand
        # 1.5 mm apart in a field that each bin of angle sees in steps: half a per cent.
        expected = radiance @ kernel
        contact = expected if k == 0 else contact
        np.testing.assert_allclose(found, expected, rtol=0.01, atol=3e-3 * contact.min())
    assert fields.coupling[:, -1].max() == 0.0


def test_tables_between_their_knots_are_the_formulas(scene: Scene, fields: Fields) -> None:
    interface = rig_optics.interface_of(scene)
    view = np.arcsin(np.sin(_view_angle(scene)) / interface.n_glass)
    window = window_transmittance(view, interface.n_glass)
    window = window * np.exp(-0.002 * 5.0 / np.cos(view))
    which = [1, 77, 513, 998, 1501, 2001, 2046]  # fringes are narrowest, by knots, at wide gaps
    expected = returned_radiance(fields.gaps[which], view, interface) * window
    np.testing.assert_allclose(fields.response[which], expected, rtol=1e-4)


def _view_angle(scene: Scene) -> float:
    projection = Projection.of(scene.camera, scene.plate)
    u, v = (float(a[0]) for a in projection.plate_to_ray(*(np.array([p]) for p in scene.finger.position_mm)))
    ray = projection.axes @ np.array([u, v, 1.0])
    return float(np.arccos(ray[2] / np.linalg.norm(ray)))


# --- interface -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rough", [False, True])
def test_box_holds_what_the_path_tracers_textures_hold(rough: bool) -> None:
    """Gap and share of the box are a part of the whole textures; outside it nothing couples."""
    state = hard_contact(samples=128)
    gap = np.array(state.gap)
    gap[40:50, 60:70] = 3e-4
    gap[44, 66] = np.nan
    share = np.array(state.contact_mask)
    share[60, 40:80] = 0.37
    fraction = np.linspace(0.2, 1.0, gap.size).reshape(gap.shape) if rough else None
    state = dataclasses.replace(state, gap=gap, contact_mask=share, real_contact_fraction=fraction)
    end = 0.0022
    full_gap, full_share = interface_maps(state, end)
    box = InterfaceBox.of(state, end, 1)
    part = np.s_[box.row : box.row + box.gap.shape[0], box.col : box.col + box.gap.shape[1]]
    np.testing.assert_allclose(box.gap, full_gap[part], rtol=1e-6)
    np.testing.assert_allclose(box.share, full_share[part], rtol=1e-6)
    outside = np.ones(gap.shape, bool)
    outside[part] = False
    assert full_gap[outside].min() >= end
    assert full_share[outside].max() == 0.0
    assert box.gap.size < gap.size / 2


def test_no_point_in_contact_is_dark(scene: Scene, fields: Fields) -> None:
    state = hard_contact()
    lifted = dataclasses.replace(state, gap=np.full(state.gap.shape, 0.3), contact_mask=np.zeros(state.gap.shape))
    assert patch_radiance(fields, lifted)[0].max() == 0.0
    assert render_fast(scene, None).radiance.max() == 0.0


def test_finer_samples_do_not_change_the_light(fields: Fields) -> None:
    state = hard_contact(samples=400)
    sums = []
    for refine in (1, 2, 4):
        radiance, pitch = patch_radiance(fields, state, refine)
        sums.append(float(radiance.astype(float).sum() * pitch**2))
    # The film around a stamp of straight walls lies within one cell of 27 um, on a rim of 16 mm about 15 mm^2.
    np.testing.assert_allclose(sums, sums[-1], rtol=2e-3)
    assert refinement(0.02, 0.05) == 1
    assert refinement(0.02, 0.03) == 2


# --- feedback --------------------------------------------------------------------------------------------------------


def test_feedback_is_the_direct_sum_over_cells_and_nodes(fields: Fields) -> None:
    """Two rounds by transforms and matrices against loops over pairs of cells."""
    grid = hard_contact(side=6.0, samples=48).grid
    coarse = CoarseGrid.of(fields, grid)
    rng = np.random.default_rng(3)
    entering = rng.uniform(0.0, 1.0, coarse.shape) * coarse.contact
    change, taken = coarse_feedback(fields, coarse, entering)
    middle = fields.rig.gain.shape[0] // 2
    kernel = fields.rig.gain - fields.rig.loss
    rows, cols = coarse.shape
    expected = np.zeros(coarse.shape)
    for _ in range(2):
        inside = entering * (1 + expected)
        returned = np.zeros(coarse.shape)
        for r in range(rows):
            for c in range(cols):
                window = kernel[middle - r : middle - r + rows, middle - c : middle - c + cols]
                returned += inside[r, c] * window
        power = inside * coarse.area
        shares = np.einsum("yr,xc,rc->yx", coarse.onto_y, coarse.onto_x, power).ravel()
        at_nodes = (fields.rig.edges @ shares).reshape(fields.y.size, fields.x.size)
        returned += np.einsum("yr,xc,yx->rc", coarse.onto_y, coarse.onto_x, at_nodes)
        expected = returned / coarse.contact
    np.testing.assert_allclose(change, expected, atol=2e-6)
    np.testing.assert_allclose(taken, shares, rtol=1e-6)
    assert taken.sum() == pytest.approx(power.sum(), rel=1e-9)  # shared among nodes, none lost
    assert -0.05 < change.min() < 0.0


def test_annuli_lose_what_the_contact_took() -> None:
    """Over the whole plane the first annulus' loss is the mean transmittance of guided light, weighted by itself."""
    interface = Interface(1.523, 1.41, 0.6, 550.0)
    theta, weights = angle_nodes(96, 1.523)
    guided = theta > np.arcsin(1 / 1.523)
    even = np.where(guided, 1.0, 0.0)
    r = 6.0 * np.sinh(np.linspace(-6.0, 4.6, 4000))[np.linspace(-6.0, 4.6, 4000) > 0]
    w = np.gradient(r)
    first = feedback(r, 6.0, interface, theta, even, bounces=1)
    t = frustrated_transmittance(np.cos(theta), 0.0, 550.0, 1.523, 1.41)
    flux = np.cos(theta) * np.sin(theta) * weights * even
    assert np.sum(2 * np.pi * r * first.loss * w) == pytest.approx(np.sum(flux * t * t) / np.sum(flux * t), rel=5e-3)
    # What the body sends beyond the critical angle comes back in full; nearer the glass lets most of it out.
    sent = returned_radiance(0.0, theta, interface) * 2 * np.pi * np.cos(theta) * np.sin(theta) * weights * t
    expected = np.sum(sent * fresnel_reflectance(np.cos(theta), 1.523, 1.0))
    assert np.sum(2 * np.pi * r * first.gain * w) == pytest.approx(expected, rel=5e-3)


def test_edges_respond_reciprocally_but_for_light_withheld(scene: Scene) -> None:
    """Light that nodes send to each other over the edges: the same both ways, because etendue is."""
    unit = rig_fields.unit_light(scene)
    light, interface = rig_optics.edge_light(scene), rig_optics.interface_of(scene)
    bins = rig_fields._bins(scene)
    response = rig_fields.edge_response(
        rig_fields.EdgeExchange(unit.edge_from_led.astype(float), unit.edge_from_edge.astype(float)), 0.35
    )
    area = rig_fields.segment_areas(light, rig_fields.PER_EDGE)
    taken = frustrated_transmittance(bins.cosines, 0.0, 550.0, 1.523, 1.41).mean(axis=1)
    edge = unit.edge.astype(float)
    # Segments exchange light by reciprocal factors, up to their quasi-random error.
    flux = area[:, None] * unit.edge_from_edge
    assert np.abs(flux - flux.T).max() < 0.06 * flux.max()
    assert (response > -1e-12).all()
    # A body's radiance back into the glass is its irradiance times T: sources and receivers share one table.
    both = (edge @ taken).T @ (response / area[None, :]) @ (edge @ taken)
    np.testing.assert_allclose(both, both.T, rtol=0.02)
    found = returned_radiance(0.0, np.arccos(bins.cosines), interface).mean(axis=1)
    np.testing.assert_allclose(found / taken, found[3] / taken[3], rtol=1e-3)


def test_large_contacts_are_darker_in_their_middle(scene: Scene, fields: Fields) -> None:
    """A plate of 6 mm, radius 7.5 mm against 1 mm: 1.4 % by the closed form; here radius 4.5 against 0.9 in 5 mm."""
    middles = []
    for radius in (0.9, 4.5):
        state = hard_contact(radius, side=11.0, samples=220, notch=False)
        found = patch_light(fields, state, 1)
        row, col = 110 - found.row, 110 - found.col
        middles.append(float(found.radiance[row, col]))
    assert -0.03 < middles[1] / middles[0] - 1 < -0.001


def test_coarse_means_keep_the_sum() -> None:
    rng = np.random.default_rng(5)
    part = rng.uniform(size=(37, 53)).astype(np.float32)
    for fine, coarse in (((96, 128), (12, 16)), ((100, 130), (12, 16))):
        found = coarse_mean(part, (29, 41), fine, coarse)
        assert found.mean() * fine[0] * fine[1] == pytest.approx(float(part.sum()), rel=1e-5)


# --- flank -----------------------------------------------------------------------------------------------------------


SURFACE = FingerSurface((1.3, -0.8), 7.5, 6.1, 21.0)


def test_surface_and_sight_are_inverse() -> None:
    """A ray aimed at a point of the surface meets it there, at its station and azimuth, unless the body hides it."""
    depth = 0.83
    rng = np.random.default_rng(2)
    station, azimuth = rng.uniform(0.01, 1.9, 400), rng.uniform(-np.pi, np.pi, 400)
    points, normals = SURFACE.points(station, azimuth, np.full(400, depth))
    slope_x, slope_y = rng.uniform(-1.5, 1.5, (2, 400))
    facing = -(normals[:, 0] * slope_x + normals[:, 1] * slope_y + normals[:, 2])
    x, y = points[:, 0] - points[:, 2] * slope_x, points[:, 1] - points[:, 2] * slope_y
    seen = facing > 0.02  # a convex body hides only what faces away
    found_station, found_azimuth = SURFACE.intersect(x, y, slope_x, slope_y, depth)
    assert seen.sum() > 100
    np.testing.assert_allclose(found_station[seen], station[seen], atol=1e-6)
    np.testing.assert_allclose(np.cos(found_azimuth - azimuth)[seen], 1.0, atol=1e-9)


def test_normals_are_across_the_surface() -> None:
    depth = np.full(60, 0.4)
    station, azimuth = np.linspace(0.05, 1.9, 60), np.linspace(0.0, 6.0, 60)
    points, normals = SURFACE.points(station, azimuth, depth)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    for step_station, step_azimuth in ((1e-5, 0.0), (0.0, 1e-5)):
        moved, _ = SURFACE.points(station + step_station, azimuth + step_azimuth, depth)
        along = (moved - points) / 1e-5
        good = np.abs(station - 1.0) > 1e-3  # the kink
        assert np.abs((along * normals).sum(axis=1)[good]).max() < 2e-3
    radial = points[:, :2] - np.array(SURFACE.centre)
    assert ((radial * normals[:, :2]).sum(axis=1) > 0).all()


def test_contacts_light_on_a_plane_is_what_leaves_the_glass() -> None:
    """All that the bottom face mirrors below the critical angle crosses a plane above the plate."""
    interface, thickness, height = Interface(1.523, 1.41, 0.6, 550.0), 6.0, 2.2
    # Annuli of equal steps in the sine of the angle in the air, in closed form for where they land.
    u, w = leggauss(200)
    sine, weight = 0.4995 * (u + 1), 0.4995 * w
    glass = sine / 1.523
    reach = 2 * thickness * glass / np.sqrt(1 - glass**2) + height * sine / np.sqrt(1 - sine**2)
    slope = 2 * thickness / 1.523 / (1 - glass**2) ** 1.5 + height / (1 - sine**2) ** 1.5
    points = np.stack([reach, np.zeros(200), np.full(200, height)], axis=1)
    down = np.tile([0.0, 0.0, -1.0], (200, 1))
    found = contact_on_flank(points, down, np.zeros((1, 2)), thickness, interface, 0.0)[:, 0]
    power = np.sum(found * 2 * np.pi * reach * slope * weight)

    theta = 0.5 * np.arcsin(0.999 / 1.523) * (u + 1)
    bare = fresnel_reflectance(np.cos(theta), 1.523, 1.0)
    leaving = returned_radiance(0.0, theta, interface) * bare * (1 - bare) * 2 * np.pi * np.cos(theta) * np.sin(theta)
    assert power == pytest.approx(np.sum(leaving * w) * 0.5 * np.arcsin(0.999 / 1.523), rel=1e-3)


def invisible_plate(**changes: object) -> EdgeLight:
    """Return a plate whose glass is air: light from the edges goes straight."""
    values: dict = {
        "size": (62.0, 47.0),
        "thickness": 5.0,
        "refractive_index": 1.0,
        "absorption_coefficient": 0.0,
        "edge_reflectance": 0.5,
        "positions": {"left": np.array([-9.0, 4.0])},
        "radiances": {"left": np.ones(2)},
        "emitter_size": (4.0, 2.5),
    }
    return EdgeLight(**(values | changes))


def test_flank_of_an_invisible_plate_sees_the_edges_form_factor() -> None:
    """With air for glass the irradiance per radiance is the projected solid angle of the edges, and of each LED."""
    light = invisible_plate()
    points = np.array([[6.0, -3.0, 4.0], [-11.0, 5.0, 2.0]])
    normals = np.array([[-0.8, 0.0, -0.6], [-1.0, 0.0, 0.0]])
    (led, *_), (edge, *_) = flank_sums(light, points, normals, per_edge=48)
    assert led_count(light) == 2
    u, w = leggauss(60)
    for k, (p, n) in enumerate(zip(points, normals, strict=True)):
        for source, centre in enumerate((-9.0, 4.0)):
            y, z = centre + 2.0 * u[:, None], -2.5 + 1.25 * u[None, :]
            way = np.stack(np.broadcast_arrays(-31.0 - p[0], y - p[1], z - p[2]), axis=-1)
            length = np.linalg.norm(way, axis=-1)
            cos_here, cos_there = (way @ n) / length, -way[..., 0] / length
            expected = np.sum(cos_here.clip(0) * cos_there / length**2 * w[:, None] * w[None, :]) * 2.0 * 1.25
            assert led[source, k] == pytest.approx(expected, rel=2e-3)
        total = _edges_form_factor(light, p, n)
        assert edge[:, k].sum() == pytest.approx(total, rel=0.01)


@pytest.mark.parametrize("polish", [0.0, 0.6])
def test_flank_light_by_images_is_that_of_rays(polish: float) -> None:
    """Images and Snell's law against rays traced from random points of the top face, which share no formula of it."""
    light = invisible_plate(
        refractive_index=1.523,
        absorption_coefficient=0.004,
        air_gap_share=0.3,
        edge_polish=polish,
        positions={"left": np.array([-9.0, 4.0]), "top": np.array([2.5])},
        radiances={"left": np.ones(2), "top": np.ones(1)},
    )
    points = np.array([[6.0, -3.0, 4.0], [-11.0, 5.0, 1.3]])
    normals = np.array([[-0.76, -0.24, -0.6], [-0.8, -0.6, 0.0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    (led, *_), (edge, *_) = escaping_irradiance(light, points, normals, per_edge=12)
    if polish:
        more = sampled_irradiance(light, points, normals, samples=1 << 16, per_edge=12, mirrorings=1)
        led, edge = led + more[0][0], edge + more[1][0]
    (seen_led, *_), (seen_edge, *_) = sampled_irradiance(light, points, normals, samples=1 << 16, per_edge=12)
    # some thousands of the ways hit LEDs, and nearly all the edges
    np.testing.assert_allclose(led.sum(axis=0), seen_led.sum(axis=0), rtol=0.04)
    np.testing.assert_allclose(edge.sum(axis=0), seen_edge.sum(axis=0), rtol=0.01)


def test_angles_within_an_image_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """Down to a hundredth of a millimetre above the glass; with three angles an image it was a per cent."""
    light = invisible_plate(refractive_index=1.523, thickness=6.0)
    height = np.array([0.01, 0.1, 0.5, 2.0, 8.0])
    points = np.stack([np.full(5, -6.0), np.linspace(-5.0, 5.0, 5), height], axis=1)
    normals = np.tile(np.array([-0.6, 0.0, -0.8]), (5, 1))
    found = escaping_irradiance(light, points, normals)
    monkeypatch.setattr(escape, "ANGLES", 40)
    for part, exact in zip(found, escaping_irradiance(light, points, normals), strict=True):
        np.testing.assert_allclose(part[0], exact[0], atol=1e-3 * exact[0].max())


def test_ways_out_obey_snell() -> None:
    """From grazing paths to upright ones, for points a nanometre above the glass and far above it."""
    rng = np.random.default_rng(8)
    run, height = 10.0 ** rng.uniform(-2.0, 2.3, 5000), 10.0 ** rng.uniform(-6.0, 1.3, 5000)
    drop = rng.integers(0, 30, 5000) * 3.0
    slope = exit_slope(run, drop, height, 1.523)
    seen = slope < GRAZING
    sine = slope / np.hypot(1.0, slope)
    there = drop * np.tan(np.arcsin(sine / 1.523)) + height * slope
    assert seen.mean() > 0.9
    np.testing.assert_allclose(there[seen], run[seen], rtol=1e-9)
    # what is flatter than that has not come so far yet
    assert (there[~seen] < run[~seen]).all()


@pytest.mark.parametrize(("polish", "absorption"), [(0.0, 0.0045), (0.5, 0.0009)])
def test_sums_over_paths_give_the_light_of_other_plates(polish: float, absorption: float) -> None:
    """Other absorption and air films than sums were made for, with edges that mirror or not: as for that plate."""
    light = invisible_plate(
        refractive_index=1.523,
        absorption_coefficient=absorption,
        air_gap_share=0.4,
        edge_polish=polish,
        positions={"left": np.array([-9.0, 4.0]), "top": np.array([2.5])},
        radiances={"left": np.ones(2), "top": np.ones(1)},
    )
    points, normals = np.array([[6.0, -3.0, 4.0], [-11.0, 5.0, 1.3]]), np.array([[-0.8, 0.0, -0.6], [-0.8, -0.6, 0.0]])

    def sums_of(plate: EdgeLight) -> list[np.ndarray]:
        return [
            *flank_sums(plate, points, normals, per_edge=12, samples=1024),
            *exchange_sums(plate, per_edge=12, rays=1024),
        ]

    made: list[EdgeLight] = []
    found = in_plate(light, lambda plate: made.append(plate) or sums_of(plate))
    assert {(plate.absorption_coefficient, plate.air_gap_share) for plate in made} == {(0.0, 0.0), (0.0, 1.0)}
    other = in_plate(dataclasses.replace(light, absorption_coefficient=0.0), sums_of)
    for part, without, (whole, *_) in zip(found, other, sums_of(light), strict=True):
        assert abs(without.sum() / whole.sum() - 1) > 0.005
        np.testing.assert_allclose(part.sum(), whole.sum(), rtol=5e-4)
        np.testing.assert_allclose(part, whole, atol=1e-3 * whole.max())


def _edges_form_factor(light: EdgeLight, p: np.ndarray, n: np.ndarray) -> float:
    u, w = leggauss(200)
    total = 0.0
    for on_x, sign in ((True, -1), (True, 1), (False, -1), (False, 1)):
        half, wall = (light.size[1] / 2, light.size[0] / 2) if on_x else (light.size[0] / 2, light.size[1] / 2)
        along, z = half * u[:, None], -2.5 + 2.5 * u[None, :]
        across = np.full_like(along + z, sign * wall)
        x, y = (across, along + 0 * z) if on_x else (along + 0 * z, across)
        way = np.stack([x - p[0], y - p[1], z + 0 * along - p[2]], axis=-1)
        length = np.linalg.norm(way, axis=-1)
        cos_there = np.abs(way[..., 0 if on_x else 1]) / length
        part = (way @ n).clip(0) / length * cos_there / length**2
        total += float(np.sum(part * w[:, None] * w[None, :]) * half * 2.5)
    return total


def test_mirrored_light_vanishes_without_mirror_or_body() -> None:
    station, azimuth = np.meshgrid(np.linspace(0.1, 1.5, 6), np.arange(8) * np.pi / 4, indexing="ij")
    points, normals = SURFACE.points(station, azimuth, np.full(station.shape, 0.3))
    identity = np.eye(48)
    np.testing.assert_allclose(mirrored_exchange(points, normals, 0.0, 1.523), identity, atol=1e-12)
    np.testing.assert_allclose(mirrored_exchange(points, normals, 0.6, 1.0), identity, atol=1e-12)
    real = mirrored_exchange(points, normals, 0.6, 1.523) - identity
    assert real.min() > -1e-12
    assert 0.0 < real.sum(axis=1).max() < 0.6


def test_field_of_surface_scatterers_holds_for_narrow_cones() -> None:
    """Behind an air film LEDs light cones with steep edges; against dense rays, the ratio of two nodes."""
    from evanesce.render.fast.defects import _contact_field

    rig = small_rig(leds__air_gap_share=1.0, plate__edge_reflectance=0.0)
    y, x, found = _contact_field(rig, 1.0)
    light = rig_optics.edge_light(rig)
    theta, weights = angle_nodes(240, light.refractive_index)
    kernel = transmitted_irradiance_kernel(theta, weights, np.zeros(1), rig_optics.interface_of(rig))[0]
    nodes = [(1, 1), (2, 3)]
    px, py = (np.array([axis[node[k]] for node in nodes]) for axis, k in ((x, 1), (y, 0)))
    rays = azimuthal_radiance(light, px, py, theta, azimuths=5760, diffuse=np.zeros((4, 24))) @ kernel
    assert rays[0] / rays[1] == pytest.approx(found[nodes[0]] / found[nodes[1]], rel=0.015)
    assert abs(rays[0] / rays[1] - 1) > 0.05


# --- what is kept ----------------------------------------------------------------------------------------------------


def test_another_voltage_computes_nothing_anew(scene: Scene, fields: Fields, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError("computed anew")

    for name in ("compute_unit_sums", "compute_rig_fields"):
        monkeypatch.setattr(rig_fields, name, never)
    monkeypatch.setattr("evanesce.render.fast.fields._tables", never)
    dimmer = small_rig(leds__voltage_V=8.7, leds__edge={"top": {"offset_mm": 1.7, "voltage_V": 9.0}})
    dead = small_rig(leds__edge={"top": {"offset_mm": 1.7, "voltage_V": 9.0}, "left": {"relative_power": (1, 0, 1, 1)}})
    for other in (dimmer, dead):
        assert fields_of(other).modes.sum() < 0.999 * fields.modes.sum() or fields_of(other) is not fields
    assert fields_of(scene) is fields


def test_light_is_linear_in_the_leds(scene: Scene) -> None:
    state = hard_contact()
    edge = {"top": {"offset_mm": 1.7, "voltage_V": 9.0}}
    whole, dark = render_fast(scene, state).radiance, []
    for name, count in (("left", 4), ("right", 4), ("top", 5)):
        others = {n: {"relative_power": (0.0,) * c} for n, c in (("left", 4), ("right", 4), ("top", 5)) if n != name}
        merged = {n: edge.get(n, {}) | others.get(n, {}) for n in edge | others}
        assert count in (4, 5)
        dark.append(render_fast(small_rig(leds__edge=merged), state).radiance)
    np.testing.assert_allclose(sum(dark), whole, atol=2e-5 * whole.max())


def test_disk_gives_back_the_same_bytes_and_refuses_damaged_files(
    scene: Scene, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    light = rig_fields.unit_light(scene)
    monkeypatch.setenv("EVANESCE_CACHE", str(tmp_path))
    sums = rig_fields.compute_unit_sums(
        scene, dataclasses.replace(rig_optics.edge_light(scene), absorption_coefficient=0.0)
    )
    monkeypatch.setattr(rig_fields, "compute_unit_sums", lambda *_: sums)

    def same(other: rig_fields.UnitLight) -> bool:
        names = rig_fields.UnitLight.__dataclass_fields__
        return all(getattr(other, name).tobytes() == getattr(light, name).tobytes() for name in names)

    forget()
    assert same(rig_fields.unit_light(scene))
    (file,) = (tmp_path / "fields").iterdir()
    monkeypatch.setattr(rig_fields, "compute_unit_sums", lambda *_: pytest.fail("not read from disk"))
    forget()
    assert same(rig_fields.unit_light(scene))
    made = []
    monkeypatch.setattr(rig_fields, "compute_unit_sums", lambda *_: made.append(1) or sums)
    for damaged in (b"", b"PK\x03\x04 half a file", file.read_bytes()[:-1000]):
        file.write_bytes(damaged)
        forget()
        assert same(rig_fields.unit_light(scene))
    assert len(made) == 3
    forget()


def test_the_scenes_own_state_is_seen_where_it_is() -> None:
    """Tilted, rolled, off-centre camera: the light's centre of gravity is that of the contact's image."""
    tilted = small_rig(camera__tilt_x_deg=6.0, camera__tilt_y_deg=-9.0, camera__roll_deg=31.0)
    state = contact_state(tilted, 1.0)
    projection = Projection.of(tilted.camera, tilted.plate)
    view = projection.ideal_view()
    radiance = render_fast(tilted, state).radiance
    rows, cols = np.nonzero(radiance > 0.4 * radiance.max())
    u, v = projection.plate_to_ray(np.array(3.3), np.array(-2.1))
    assert cols.mean() == pytest.approx(float(u) * view.focal_px + view.principal_point[0], abs=0.2)
    assert rows.mean() == pytest.approx(float(v) * view.focal_px + view.principal_point[1], abs=0.2)


@pytest.mark.parametrize("position_mm", [(3.3, -2.1), (14.0, 0.0)], ids=["inside", "at the view's edge"])
def test_what_is_carried_of_a_view_is_all_that_is_seen(
    position_mm: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rays of the plate that were kept and the part of a view that sees a patch: as whole and anew."""
    looking = {"camera__tilt_x_deg": 6.0, "camera__tilt_y_deg": -9.0, "camera__roll_deg": 31.0}
    elsewhere, here = (small_rig(finger__position_mm=at, **looking) for at in ((0.0, 0.0), position_mm))
    view = Projection.of(here.camera, here.plate).ideal_view()
    view = dataclasses.replace(view, shape=(3 * view.shape[0], 3 * view.shape[1]), focal_px=3 * view.focal_px,
                               principal_point=tuple(3 * c + 1.0 for c in view.principal_point))  # fmt: skip
    forget()
    render_fast(elsewhere, contact_state(elsewhere, 1.0), view=view)
    state = contact_state(here, 1.0)
    kept = render_fast(here, state, view=view).radiance
    forget()
    monkeypatch.setattr(transport, "window", lambda maps, size: (slice(None), slice(None)))
    whole = render_fast(here, state, view=view).radiance
    assert whole.max() > 0
    np.testing.assert_array_equal(kept, whole)


# --- what moves, moves smoothly --------------------------------------------------------------------------------------


def test_the_flank_s_outline_keeps_its_area_wherever_the_finger_stands(scene: Scene) -> None:
    """Cells that the outline cuts count by their share: a finger moved by parts of a cell loses or wins none."""
    x, y = scene.finger.position_mm
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    u, v = view_rays(view, 4)
    areas = []
    for shift in np.linspace(0.0, 0.4, 9):
        finger = scene.finger.model_copy(update={"position_mm": (x + shift, y - 0.7 * shift)})
        share = table_position(scene.model_copy(update={"finger": finger}), u, v, 0.63)[2]
        assert share.max() == 1.0
        areas.append(float(share.sum()))
    # Parallax turns the outline a little; whole cells would make steps of 1 in some hundred.
    assert np.ptp(np.diff(areas)) < 1.5


def test_the_flank_s_light_grows_without_steps(scene: Scene, fields: Fields) -> None:
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    forces = np.linspace(0.9, 1.25, 15)
    seen = []
    for force in forces:
        state = contact_state(scene, float(force))
        patch = patch_light(fields, state, 1)
        seen.append(flank_image(scene, fields.flank, state, patch.taken, view, step=4))
    steps = np.array([np.abs(b - a).sum() for a, b in itertools.pairwise(seen)])
    assert steps.max() < 1.6 * np.median(steps)


def test_few_pixels_show_the_flank_as_many_do() -> None:
    """Rationale: every fourth of 12 pixels per mm was looked up, which blurred the outline."""
    few = {"camera.resolution_px": [400, 300], "camera.scale_px_per_mm": 11.674, "camera.pixel.pitch_um": 15.5}
    scene = load_scene("thesis", few)
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    state = contact_state(scene, 2.0)
    finer = render_fast(scene, state, view=view.finer(4), step=1).radiance
    true = finer.reshape(view.shape[0], 4, view.shape[1], 4).mean(axis=(1, 3))

    def off(step: int | None) -> float:
        found = render_fast(scene, state, view=view, step=step).radiance
        return float(np.sqrt(np.mean((found - true) ** 2)) / true.max())

    assert off(None) < 2.5e-4 < 0.5 * off(4)
