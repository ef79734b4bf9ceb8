"""Physics of the path-traced plate: furnace, darkness, absorption, linearity, halo, and oracles that trace no path."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid
from evanesce.optics.emitters import led_table
from evanesce.optics.guide import contact_radiance, halo_irradiance, halo_radius
from evanesce.optics.interface import fresnel_reflectance, frustrated_transmittance
from evanesce.optics.led import led_powers
from evanesce.optics.projection import Projection
from evanesce.render.reference.bsdf import InterfaceOptics
from evanesce.render.reference.passes import Until, Welford, trace
from evanesce.render.reference.path import integrator_for, render
from evanesce.render.reference.scene import camera_dict, edge_spans, finger_mesh, interface_maps, plate_scene
from evanesce.render.reference.views import focus_window, scaled_view
from evanesce.render.variant import select
from support.rigs import hard_contact, need, small_rig, view_around

CENTRE = (3.3, -2.1)


def custom(scene, shapes, view, *, info, model=None, samples=64, passes=4, seed=3):
    """Trace shapes that no rig has; return mean and variance of all light."""
    sums = trace(
        shapes,
        camera_dict(Projection.of(scene.camera, scene.plate), view),
        integrator_for(scene, info, model, {}),
        samples=samples,
        until=Until(passes),
        seed=seed,
        name="test",
    )
    return sums.mean[..., 0], sums.variance_of_mean[..., 0]


def stippled(share: float, side: float = 44.0, centre=CENTRE) -> ContactState:
    """Return a plate with contact on a small, even share of its area: a dim screen that makes guided light visible."""
    grid = PlateGrid((16, 16), side / 16, centre)
    even = np.full(grid.shape, share)
    return ContactState(
        grid=grid,
        pressure=even,
        gap=np.full(grid.shape, 0.05),
        contact_mask=even,
        normal_force=0.1,
        nominal_contact_area=share * side**2,
        depth=-50.0,
        law="stipple",
    )


# --- geometry -------------------------------------------------------------------------------------------------------


def test_contact_appears_where_the_projection_says():
    """Tilted, rolled, off-centre camera: the lit pixels are those whose plate point is in contact."""
    need("llvm")
    scene = small_rig(
        camera__tilt_x_deg=6.0,
        camera__tilt_y_deg=-9.0,
        camera__roll_deg=31.0,
        camera__principal_point_offset_px=(5.0, -7.0),
    )
    projection, state = Projection.of(scene.camera, scene.plate), hard_contact()
    view = scaled_view(projection.ideal_view(), 1.5)
    light = render(scene, state, view=view, samples_per_pixel=64, passes=2, variant="llvm", focus=False)
    v, u = np.mgrid[: view.shape[0], : view.shape[1]]
    px, py = view.principal_point
    x, y = projection.ray_to_plate((u - px) / view.focal_px, (v - py) / view.focal_px)
    row, col = (np.round(i).astype(int) for i in state.grid.index(x, y))
    inside = (row >= 0) & (col >= 0) & (row < 256) & (col < 256)
    expected = np.zeros(view.shape, bool)
    expected[inside] = state.contact_mask[row[inside], col[inside]] > 0.5
    # Within the patch only: beyond it the finger's flank glimmers, in fireflies at this number of samples.
    near = inside & (np.hypot(x - 3.3, y + 2.1) < 3.2)
    lit = near & (light.radiance > 0.3 * np.median(light.radiance[expected]))
    # Boundary pixels are lit in part: a disc of radius 2.4 mm at 9 px/mm has 340 pixels, some 100 of them on the rim.
    assert expected.sum() > 300
    assert (lit & expected).sum() / (lit | expected).sum() > 0.88
    for a, b in zip(np.nonzero(lit), np.nonzero(expected), strict=True):
        assert a.mean() == pytest.approx(b.mean(), abs=0.25)


def test_edges_are_tiled_without_gap_or_overlap():
    lit, dark = edge_spans(47.0, 5.0, np.array([-16.0, 2.5, 9.0]), 4.0, 2.5)
    area = sum((a1 - a0) * (z1 - z0) for a0, a1, z0, z1 in lit + dark)
    assert area == pytest.approx(47.0 * 5.0)
    assert sum((a1 - a0) * (z1 - z0) for a0, a1, z0, z1 in lit) == pytest.approx(3 * 4.0 * 2.5)
    points = np.random.default_rng(2).uniform([-23.5, -5.0], [23.5, 0.0], (2000, 2))
    hits = sum(
        ((points[:, 0] > a0) & (points[:, 0] < a1) & (points[:, 1] > z0) & (points[:, 1] < z1)).astype(int)
        for a0, a1, z0, z1 in lit + dark
    )
    assert (hits == 1).all()


def test_finger_stands_on_the_glass():
    scene = small_rig()
    mesh = finger_mesh(scene.finger, 0.4)
    assert mesh.is_watertight
    assert mesh.bounds[0, 2] == pytest.approx(0.02)
    assert mesh.bounds[1, 2] == pytest.approx(scene.finger.length_mm - 0.4)
    np.testing.assert_allclose(mesh.bounds[:, 0].mean(), 3.3, atol=1e-6)
    # Half a ball and a cylinder, less the cap that the plate cuts off (polygons of 96 sides: 0.1 %).
    r, h = 7.5, 0.42
    volume = 2 / 3 * np.pi * r**3 + np.pi * r**2 * (25.0 - r) - np.pi * h**2 * (r - h / 3)
    assert mesh.volume == pytest.approx(volume, rel=3e-3)


def test_partial_cells_count_by_their_share():
    state = hard_contact(samples=64)
    share = np.array(state.contact_mask)
    share[30, 10] = 0.4  # a cell whose centre is in contact, but not all of it
    gap = np.array(state.gap)
    partial = ContactState(**{**state.__dict__, "contact_mask": share, "gap": gap})
    out_gap, out_share = interface_maps(partial, 0.0022)
    assert out_share[30, 10] == np.float32(0.4)
    assert out_gap[30, 10] > 0.002  # the rest of it stands off
    assert out_gap.max() <= 4 * 0.0022 + 1e-9
    rough = ContactState(**{**state.__dict__, "real_contact_fraction": np.full(share.shape, 0.25)})
    assert interface_maps(rough, 0.0022)[1].max() == np.float32(0.25)


# --- darkness, linearity, determinism -------------------------------------------------------------------------------


@pytest.mark.parametrize("family", ["llvm", "scalar"])
def test_no_contact_is_dark(family):
    """Nothing scatters in the field of view and guided light stays guided: black, not merely dim."""
    need(family)
    scene = small_rig()
    view = scaled_view(Projection.of(scene.camera, scene.plate).ideal_view(), 0.5)
    light = render(scene, None, variant=family, view=view, samples_per_pixel=64, passes=2)
    assert light.radiance.max() == 0.0
    assert light.variance.max() == 0.0


def test_brightness_is_linear_in_led_power():
    need("llvm")
    scene, state = small_rig(), hard_contact()
    view = view_around(scene, CENTRE, 16, 3.0)
    options = {"variant": "llvm", "view": view, "samples_per_pixel": 32, "passes": 2, "focus": False}
    powers = {"left": 0.011, "top": 0.004, "right": 0.02}
    once = render(scene, state, powers=powers, **options)
    more = render(scene, state, powers={k: 2.5 * v for k, v in powers.items()}, **options)
    np.testing.assert_allclose(more.radiance, 2.5 * once.radiance, rtol=1e-4)  # same paths, float32
    np.testing.assert_allclose(more.variance, 2.5**2 * once.variance, rtol=1e-3)


def test_the_lowest_led_power_is_still_linear():
    """1e-41 W is below 32-bit numbers; the light is what 1 W gives, scaled."""
    need("llvm")
    scene, state = small_rig(), hard_contact()
    options = {"variant": "llvm", "view": view_around(scene, CENTRE, 8, 2.0), "samples_per_pixel": 16, "passes": 2}
    bright = render(scene, state, powers={"left": 1.0, "top": 0.25}, **options)
    dim = render(scene, state, powers={"left": 1e-41, "top": 0.25e-41}, **options)
    assert bright.radiance.max() > 0
    np.testing.assert_allclose(dim.radiance, 1e-41 * bright.radiance, rtol=1e-4)
    assert render(scene, state, powers={"left": 0.0}, **options).radiance.max() == 0.0


def test_edges_add_up():
    need("llvm")
    scene, state = small_rig(), hard_contact()
    view = view_around(scene, CENTRE, 12, 3.0)
    options = {"variant": "llvm", "view": view, "samples_per_pixel": 1024, "passes": 4, "focus": False}
    together = render(scene, state, **options)
    apart = [render(scene, state, leds=edge, seed=k, **options) for k, edge in enumerate(("left", "top", "right"))]
    difference = together.radiance.sum() - sum(light.radiance.sum() for light in apart)
    spread = np.sqrt(together.variance.sum() + sum(light.variance.sum() for light in apart))
    assert abs(difference) < 4.5 * spread
    assert spread < 0.01 * together.radiance.sum()
    with pytest.raises(InputError, match="allowed: all, left, top, right"):
        render(scene, state, leds="bottom", **options)


def test_same_seed_same_bytes():
    need("llvm")
    scene, state = small_rig(), hard_contact()
    options = {"variant": "llvm", "view": view_around(scene, CENTRE, 24, 4.0), "samples_per_pixel": 8, "passes": 2}
    first, second = (render(scene, state, seed=5, **options) for _ in range(2))
    other = render(scene, state, seed=6, **options)
    assert first.radiance.tobytes() == second.radiance.tobytes()
    assert first.variance.tobytes() == second.variance.tobytes()
    assert first.radiance.tobytes() != other.radiance.tobytes()


def test_focus_changes_samples_not_light():
    need("llvm")
    scene, state = small_rig(), hard_contact(radius=1.2)
    projection = Projection.of(scene.camera, scene.plate)
    view = projection.ideal_view()
    window = focus_window(projection, view, state, 1.0)
    assert window is not None
    assert window.shape[0] < view.shape[0]
    options = {"variant": "llvm", "view": view, "samples_per_pixel": 512, "passes": 4}
    focused, even = render(scene, state, **options), render(scene, state, focus=False, **options)
    a, b = focused.radiance.sum(), even.radiance.sum()
    assert abs(a - b) < 4.5 * np.sqrt(focused.variance.sum() + even.variance.sum())
    assert focused.samples == 512


@pytest.mark.parametrize("wrong", [{"samples_per_pixel": 0}, {"passes": 1}, {"variant": "metal"}])
def test_bad_sampling_is_an_input_error(wrong):
    with pytest.raises(InputError):
        render(small_rig(), None, **wrong)


# --- energy ---------------------------------------------------------------------------------------------------------


def furnace(absorption: float):
    """Return a rig whose edges shine so that, with a uniform sky of radiance 1, all is in equilibrium."""
    rho, n = 0.35, 1.523
    rig = small_rig(
        plate__size_mm=(60.0, 40.0),
        plate__absorption_coefficient_per_mm=absorption,
        plate__edge_reflectance=rho,
        finger__diffuse_reflectance=1.0,
        leds__edges=("left", "right", "top", "bottom"),
        leds__edge={},
        leds__pitch_mm=10.0,
        leds__emitting_width_mm=10.0,
        leds__emitting_height_mm=5.0,
    )
    power = np.pi * 10.0 * 5.0 * (1 - rho) * n**2  # radiance in glass is n^2 times that in air
    return rig, dict.fromkeys(("left", "right", "top", "bottom"), power)


@pytest.mark.parametrize("connect", [True, False])
def test_furnace(connect):
    """White finger, any gaps, edges and sky in equilibrium: the camera sees the sky's radiance everywhere."""
    need("llvm")
    info = select("llvm")
    scene, powers = furnace(0.0)
    state = hard_contact()
    distance = np.hypot(*np.meshgrid(state.grid.x - 3.3, state.grid.y + 2.1))
    gap = np.where(state.contact_mask > 0, 0.0, 2e-3 * np.abs(distance - 1.5))  # from contact through all films to far
    state = ContactState(**{**state.__dict__, "gap": gap})
    model = plate_scene(scene, state, powers, jit=True)
    sums = trace(
        model.shapes | {"sky": {"type": "constant", "radiance": {"type": "uniform", "value": 1.0}}},
        camera_dict(Projection.of(scene.camera, scene.plate), view_around(scene, CENTRE, 32, 3.0)),
        integrator_for(scene, info, model, powers, connect=connect),
        samples=128,
        until=Until(8),
        seed=1,
        name="furnace",
    )
    error = np.sqrt(sums.variance_of_mean.sum()) / sums.mean.size
    # 1e-3: table of the internal reflectance (2e-4), seams between shapes (a ray's offset over their length)
    assert sums.mean.mean() == pytest.approx(1.0, abs=5 * error + 1e-3)
    assert error < 2e-3


def test_absorbing_furnace_is_darker():
    need("llvm")
    scene, powers = furnace(0.02)
    info = select("llvm")
    model = plate_scene(scene, hard_contact(), powers, jit=True)
    sky = {"type": "constant", "radiance": {"type": "uniform", "value": 1.0}}
    view = view_around(scene, CENTRE, 16, 3.0)
    seen, _ = custom(scene, model.shapes | {"sky": sky}, view, info=info, model=model)
    # A path crosses the plate at least once: exp(-0.02 * 5) = 0.905, and some are far longer.
    assert 0.3 < seen.mean() < 0.9


@pytest.mark.parametrize("family", ["llvm", "scalar"])
def test_absorption_is_beer_lambert(family):
    """A lamp seen through the plate: L = L0 T^2 a/(1 - R^2 a^2), a = exp(-mu t/cos), over all internal reflections."""
    need(family)
    import mitsuba as mi

    info = select(family)
    mu, thickness = 0.15, 5.0
    scene = small_rig(plate__absorption_coefficient_per_mm=mu)
    place = mi.ScalarTransform4f().translate([0, 0, 9.0]).rotate([1, 0, 0], 180).scale([300, 300, 1])
    emitter = {"type": "area", "radiance": {"type": "uniform", "value": 2.0}}
    shapes = plate_scene(scene, None, {}, info.is_jit).shapes
    shapes["lamp"] = {"type": "rectangle", "to_world": place, "emitter": emitter}
    view = view_around(scene, (2.5, -1.5), 3, 40.0)
    seen, variance = custom(scene, shapes, view, info=info, samples=20_000, passes=8)
    r = float(fresnel_reflectance(1.0, 1.523, 1.0))
    a = np.exp(-mu * thickness)
    expected = 2.0 * (1 - r) ** 2 * a / (1 - r**2 * a**2)
    error = np.sqrt(variance.sum()) / seen.size
    assert error < 3e-3 * expected
    # within 0.3 deg of the normal cos and R differ from their values there by 1e-5
    assert seen.mean() == pytest.approx(expected, abs=4.5 * error + 1e-4)


# --- oracles --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [0.0, 1.5e-4])
def test_small_contact_shines_as_the_image_sum_says(gap):
    """Edges black, contact of 0.5 mm radius: no light acts back, and the sum over mirror images is exact."""
    need("llvm")
    scene = small_rig(plate__edge_reflectance=0.0)
    state = hard_contact(radius=0.5, notch=False, side=1.6, samples=64)
    if gap:
        hovering = np.where(state.contact_mask > 0, gap, 0.05)
        state = ContactState(**{**state.__dict__, "gap": hovering, "contact_mask": np.zeros(state.grid.shape)})
    view = view_around(scene, CENTRE, 5, 8.0)  # 0.6 mm, all inside the contact
    light = render(scene, state, variant="llvm", view=view, samples_per_pixel=8192, passes=8, focus=False)
    leds = led_table(scene.plate, scene.leds, led_powers(scene.leds))
    expected = contact_radiance(
        *CENTRE,
        leds,
        5.0,
        1.523,
        1.41,
        0.6,
        scene.camera.wavelength_nm,
        0.002,
        gap=gap,
        nodes=32,
    )
    error = np.sqrt(light.variance.sum()) / light.variance.size
    assert error < 0.01 * expected
    # 0.5 %: the quadrature's cut at the critical angle, and the light that the contact itself sends back (0.2 %)
    assert light.radiance.mean() == pytest.approx(expected, abs=4.5 * error + 0.005 * expected)


def test_connections_change_noise_not_light():
    need("llvm")
    scene, state = small_rig(), hard_contact()
    options = {"variant": "llvm", "view": view_around(scene, CENTRE, 16, 3.0), "passes": 8, "focus": False}
    on = render(scene, state, samples_per_pixel=512, **options)
    off = render(scene, state, samples_per_pixel=2048, connect=False, seed=9, **options)
    a, b = on.radiance.sum(), off.radiance.sum()
    spread = np.sqrt(on.variance.sum() + off.variance.sum())
    assert spread < 0.01 * a
    assert abs(a - b) < 4.5 * spread
    assert on.variance.sum() * 512 < 0.5 * off.variance.sum() * 2048


def test_halo_of_one_contact():
    """An emitting spot in the top face, no LEDs, a dim even screen: what returns steps up at 2 t tan(theta_c)."""
    need("llvm")
    import mitsuba as mi

    info = select("llvm")
    scene = small_rig(plate__edge_reflectance=0.0, plate__absorption_coefficient_per_mm=0.0)
    spot, share, radius = (-9.0, -4.0), 0.02, 0.4
    model = plate_scene(scene, stippled(share), {}, jit=True)
    place = mi.ScalarTransform4f().translate([*spot, -2e-3]).rotate([1, 0, 0], 180).scale([radius, radius, 1])
    emitter = {"type": "area", "radiance": {"type": "uniform", "value": 1.0}}
    shapes = model.shapes | {"spot": {"type": "disk", "to_world": place, "emitter": emitter}}
    step = halo_radius(5.0, 1.523)
    optics = InterfaceOptics(1.523, 1.41, 0.6, scene.camera.wavelength_nm)

    def seen(distance):
        view = view_around(scene, (spot[0] + distance, spot[1]), 5, 10.0)  # 0.5 mm
        light, variance = custom(scene, shapes, view, info=info, model=model, samples=20_000, passes=4)
        return light.mean(), np.sqrt(variance.sum()) / light.size

    def expected(distance):
        cosine = 10.0 / np.hypot(10.0, distance)
        t = float(frustrated_transmittance(cosine, 0.0, 550.0, 1.523, 1.41))
        normal = float(frustrated_transmittance(1.0, 0.0, 550.0, 1.523, 1.41))
        irradiance = float(halo_irradiance(distance, np.pi * np.pi * radius**2, 5.0, 1.523))
        out = (1 - float(fresnel_reflectance(1.0, 1.523, 1.0))) / 1.523**2
        return share * float(optics.body_factor(np.zeros(1))[0]) * t * normal * irradiance * out

    inner, outer = step * 0.8, step * 1.12
    (low, low_error), (high, high_error) = seen(inner), seen(outer)
    assert high > 3 * low
    # 4 %: the 0.5 mm patch and the spot are not points, and the screen (2 %) loses and scatters a little itself
    assert high == pytest.approx(expected(outer), abs=4.5 * high_error + 0.04 * expected(outer))
    assert low == pytest.approx(expected(inner), abs=4.5 * low_error + 0.08 * expected(inner))


def test_both_processor_families_agree():
    """Path tracer of its own (llvm) and built-in plugins (scalar): no pixel differs more than noise allows.

    The contact is hard-edged, so that the blend of built-ins is exact. Pixels wholly inside the contact have one and
    the same noise, so that its variance is pooled over them; the largest of m standard normals stays below the Sidak
    bound with probability 1 - alpha.
    """
    need("llvm")
    need("scalar")
    scene, alpha = small_rig(plate__absorption_coefficient_per_mm=0.004), 1e-4
    state = hard_contact()
    view = view_around(scene, CENTRE, 14, 2.2)
    options = {"view": view, "passes": 8, "focus": False}
    a = render(scene, state, variant="llvm", samples_per_pixel=1024, **options)
    b = render(scene, state, variant="scalar", samples_per_pixel=4096, seed=77, **options)
    v, u = np.mgrid[:14, :14]
    x, y = ((u - 6.5) / 2.2, (v - 6.5) / 2.2)
    inside = (np.hypot(x, y) < 2.0) & ~((x > -0.1) & (y > 0.1))
    assert inside.sum() > 40
    difference = a.radiance - b.radiance
    z = difference[inside] / np.sqrt((a.variance + b.variance)[inside].mean())
    assert np.abs(z).max() < norm.ppf(1 - (1 - (1 - alpha) ** (1 / inside.sum())) / 2)
    spread = np.sqrt((a.variance + b.variance).sum())
    assert abs(difference.sum()) < norm.ppf(1 - alpha / 2) * spread
    assert spread < 0.015 * a.radiance.sum()


# --- statistics -----------------------------------------------------------------------------------------------------


def test_welford_is_the_two_pass_variance():
    data = np.random.default_rng(1).normal(5.0, 2.0, (9, 4, 3)) + 1e6
    sums = Welford((4, 3))
    for image in data:
        sums.add(image)
    np.testing.assert_allclose(sums.mean, data.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(sums.variance_of_mean, data.var(axis=0, ddof=1) / 9, rtol=1e-8)


def test_reported_variance_is_the_scatter_between_seeds():
    need("llvm")
    scene, state = small_rig(), hard_contact()
    options = {"variant": "llvm", "view": view_around(scene, CENTRE, 12, 3.0), "samples_per_pixel": 32, "passes": 4}
    runs = [render(scene, state, seed=k, focus=False, **options) for k in range(12)]
    between = np.var([light.radiance for light in runs], axis=0, ddof=1).mean()
    reported = np.mean([light.variance.mean() for light in runs])
    # About 60 lit pixels, 11 degrees of freedom each, heavy-tailed (kurtosis about 10): 12 % at 1 sigma; 3.3 of them.
    assert reported == pytest.approx(between, rel=0.4)


def test_scaled_view_sees_the_same_field():
    scene = small_rig()
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    half = scaled_view(view, 0.5)
    left, left_half = (-0.5 - v.principal_point[0] for v in (view, half))
    assert left / view.focal_px == pytest.approx(left_half / half.focal_px, rel=1e-12)
    with pytest.raises(ValueError, match="factor"):
        scaled_view(view, 0.0)
