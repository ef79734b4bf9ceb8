"""Spill, haze and backdrop against closed forms, Monte Carlo drawn here, and the path tracer."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from evanesce.chain.fast import FastCamera
from evanesce.chain.fast_optics import charge_per_irradiance
from evanesce.chain.simulate import solve_contact
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState
from evanesce.effects import Context, all_effects
from evanesce.optics.edge_rays import EdgeLight, stacked_radiances
from evanesce.optics.flank.irradiance import mirrored_exchange
from evanesce.optics.flank.pressed import PressedFinger
from evanesce.optics.guided_field import azimuthal_radiance, edge_radiance
from evanesce.optics.haze import clouds, haze_radiance, hazy_floor
from evanesce.optics.led import each_led_power
from evanesce.optics.projection import Projection
from evanesce.optics.spill import spilled_irradiance
from evanesce.render.fast import surroundings
from evanesce.render.fast.defects import guided_irradiance, plate_points
from evanesce.render.fast.rig_optics import edge_light
from evanesce.render.fast.surroundings import backdrop_irradiance
from evanesce.render.fast.transport import render_fast
from evanesce.render.kept import forget
from evanesce.rig import Backdrop, Haze, Scene, Spill, Surroundings, dump_scene, load_scene
from evanesce.rig.coarser import coarser_camera
from evanesce.sensor.lens import form_image

UGLY = {
    "plate.size_mm": [74.0, 58.0],
    "plate.thickness_mm": 4.0,
    "finger.position_mm": [3.1, -2.3],
    "leds.edges": ["left", "right", "top"],
    "leds.edge": {"left": {"voltage_V": 9.6}},
}
NORMAL_DOWN = np.array([[0.0, 0.0, -1.0]])


def rig(surroundings: Surroundings | None = None, **more: Any) -> Scene:
    scene = coarser_camera(load_scene("thesis", {**UGLY, **more}), 10, key="factor")
    return scene.model_copy(update={"surroundings": surroundings})


def pressed(scene: Scene, force_N: float = 5.0) -> ContactState:
    state = solve_contact(scene, force_N, seed=1)[1]
    assert state is not None
    return state


def test_flank_exchanges_light_with_the_plate_alike_wherever_the_finger_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """One solution for all places; light that comes from haze is the same at each."""
    made = []

    def counted(*arguments: Any) -> Any:
        made.append(1)
        return mirrored_exchange(*arguments)

    monkeypatch.setattr(surroundings, "mirrored_exchange", counted)
    forget()
    scene = rig(Surroundings(haze=Haze(top_share=1e-3)))
    finger = surroundings.pressed_finger(scene, 0.3)
    here, there = (surroundings._haze_table(scene, replace(finger, centre=c)) for c in ((0.0, 0.0), (7.0, -3.0)))
    assert len(made) == 1
    np.testing.assert_array_equal(here, there)
    points = replace(finger, centre=(7.0, -3.0)).points(surroundings._azimuths())
    n = scene.plate.refractive_index
    own = mirrored_exchange(*points, scene.finger.diffuse_reflectance, n)
    moved = replace(finger, centre=(0.0, 0.0)).points(surroundings._azimuths())
    np.testing.assert_allclose(own, mirrored_exchange(*moved, scene.finger.diffuse_reflectance, n), atol=1e-9)


def one_led(size: tuple[float, float] = (40.0, 30.0), index: float = 1.523, at: float = 2.5) -> EdgeLight:
    """A plate with one LED on its right edge."""
    none = np.zeros(0)
    positions = {"left": none, "right": np.array([at]), "top": none, "bottom": none}
    return EdgeLight(size, 5.0, index, 0.0, 0.0, positions, positions, (2.0, 1.6))


# --- null and composition ---------------------------------------------------------------------------------------------


def test_surroundings_at_their_nulls_change_no_byte() -> None:
    scene = rig()
    state = pressed(scene)
    plain = render_fast(scene, state)
    null = render_fast(scene.model_copy(update={"surroundings": Surroundings()}), state)
    assert plain.radiance.tobytes() == null.radiance.tobytes()
    assert "surroundings" not in dump_scene(scene)


@pytest.mark.parametrize("supply", [0.0, 0.3, 3.0])
def test_surroundings_of_a_supply_that_is_off_are_finite(supply: float) -> None:
    """Currents of 1e-50 A are nothing in single precision, in which fields are divided by the level of the light."""
    off = {"leds.voltage_V": supply, "leds.edge": {}, "leds.circuit.ideality": 1.0}
    scene = rig(Surroundings(haze=Haze(top_share=0.01), backdrop=Backdrop(reflectance=0.3)), **off)
    assert np.isfinite(render_fast(scene, None).radiance).all()


def test_light_of_all_causes_adds_and_the_contact_gets_none_of_the_spill() -> None:
    """Spill, haze on either face and scattering in the silicone add up; in contact only the bottom haze is seen."""
    glow = {"finger.scattering_length_mm": 0.6}
    bare = rig(**glow)
    state = pressed(bare)
    parts = [
        Surroundings(spill=Spill(share=0.3)),
        Surroundings(haze=Haze(top_share=0.004)),
        Surroundings(haze=Haze(bottom_share=0.001)),
    ]
    whole = Surroundings(spill=Spill(share=0.3), haze=Haze(top_share=0.004, bottom_share=0.001))

    def light(surroundings: Surroundings | None) -> Any:
        return render_fast(rig(surroundings, **glow), state).radiance.astype(float)

    plain = light(None)
    added = [light(part) - plain for part in parts]
    np.testing.assert_allclose(light(whole) - plain, sum(added), atol=2e-6 * plain.max())
    x, y = plate_points(bare, render_fast(bare, state))
    inside = np.hypot(x - 3.1, y + 2.3) < 0.8 * np.sqrt(state.nominal_contact_area / np.pi)
    assert np.abs(added[0][inside]).max() < 1e-6 * plain.max()
    assert np.abs(added[1][inside]).max() < 1e-6 * plain.max()
    assert added[2][inside].min() > 1e-4 * plain.max()


def test_effects_set_the_scene_and_the_fast_camera_takes_it() -> None:
    scene = rig()
    for name, values in (
        ("led_spill", {"share": 0.2, "height_mm": 1.7}),
        ("plate_haze", {"top_share": 0.01}),
        ("backdrop", {"reflectance": 0.3}),
    ):
        effect = all_effects()[name]
        scene = effect.apply(scene, effect.parameters(**values), Context(scene, seed=4))
    found = scene.surroundings
    assert found is not None
    assert (found.spill.share, found.spill.height_mm) == (0.2, 1.7)
    assert (found.haze.top_share, found.backdrop.reflectance) == (0.01, 0.3)
    assert found.haze.pattern > 0
    assert not FastCamera(scene, "numpy").falls_back
    again = FastCamera(scene, "numpy").frame(None, seed=3)
    assert again.data.max() > again.data.min(), "the empty plate is not black"


def test_fast_frames_have_the_general_chains_light_beside_the_contact() -> None:
    """Charge added by spill, haze and backdrop: that of the general chain, hidden where the contact hides it."""
    around = Surroundings(
        spill=Spill(share=0.3), haze=Haze(top_share=0.004, bottom_share=0.002), backdrop=Backdrop(reflectance=0.3)
    )
    scene, bare = rig(around), rig()
    # the fast camera takes the flank at tenths of a millimetre
    state = replace(pressed(scene), depth=round(pressed(scene).depth, 1))

    def general(one: Scene, contact: ContactState | None) -> np.ndarray:
        irradiance = form_image(render_fast(one, contact), one.camera, one.plate).irradiance
        return np.asarray(irradiance * charge_per_irradiance(one))

    def fast(one: Scene) -> np.ndarray:
        box = FastCamera(one, "numpy").mean_charge(state)
        found = np.zeros(one.camera.resolution_px[::-1])
        found[box.row : box.row + box.charge.shape[0], box.col : box.col + box.charge.shape[1]] = box.charge
        return found

    added, expected = fast(scene) - fast(bare), general(scene, state) - general(bare, state)
    difference = np.abs(added - expected) / expected.max()
    light = general(bare, state)
    edge = cv2.dilate(light, np.ones((7, 7))) - cv2.erode(light, np.ones((7, 7))) > 0.3 * light.max()
    assert difference[~edge].max() < 2e-3
    # pixels of 0.17 mm that the contact covers in part; the bare frame's differ by as much
    assert difference.max() < 0.15
    assert np.sqrt((difference**2).mean()) < 5e-3
    assert expected.min() < 0.3 * expected.max()
    empty = FastCamera(scene, "numpy").frame(None, seed=3).data
    level = general(scene, None)
    assert np.corrcoef(empty.ravel(), level.ravel())[0, 1] > 0.5
    again = [FastCamera(scene, "numpy").frame(state, seed=3).data.tobytes() for _ in range(2)]
    assert again[0] == again[1]


def test_scalar_path_tracers_refuse_haze() -> None:
    from evanesce.render.reference.path import require_traceable

    hazy = rig(Surroundings(haze=Haze(bottom_share=0.01)))
    require_traceable(hazy)
    require_traceable(rig(Surroundings(spill=Spill(share=0.2), backdrop=Backdrop(reflectance=0.3))), jit=False)
    with pytest.raises(InputError, match=r"surroundings\.haze\.bottom_share"):
        require_traceable(hazy, jit=False)


# --- spill ------------------------------------------------------------------------------------------------------------


def test_spill_far_away_is_a_lambertian_point_over_a_plane_and_its_image() -> None:
    """E = I cos(source) cos(plane)/r^2 with I = P/pi; the image's light by Fresnel's equations written out here."""
    light, height = one_led(), 0.9
    point = np.array([[-140.0, 55.0, 90.0]])
    width, face = light.emitter_size
    power = np.pi * width * face  # of radiance 1
    n, expected = 1.523, 0.0
    for z in (height / 2, -height / 2):
        way = point[0] - np.array([20.0, 2.5, z])
        r = np.linalg.norm(way)
        one = power / np.pi * (-way[0] / r) * (way[2] / r) / r**2
        if z < 0:
            cosine = way[2] / r
            inner = np.sqrt(1 - (1 - cosine**2) / n**2)
            s, p = (cosine - n * inner) / (cosine + n * inner), (n * cosine - inner) / (n * cosine + inner)
            face_r = 0.5 * (s**2 + p**2)
            one *= 2 * face_r / (1 + face_r)
        expected += one
    found = spilled_irradiance(light, point, NORMAL_DOWN, height)
    assert found.shape == (1, 1)
    assert found[0, 0] == pytest.approx(expected, rel=2e-4)  # (width/r)^2


def test_spilled_power_is_conserved() -> None:
    """Through a large dome goes what the band sends upwards, half of its power; over a mirror all."""
    light, radius = one_led(index=1.0), 4000.0
    u, w = np.polynomial.legendre.leggauss(40)
    cosine, weight = (u + 1) / 2, w / 2
    phi = (np.arange(180) + 0.5) * 2 * np.pi / 180
    z, around = np.meshgrid(cosine, phi, indexing="ij")
    sine = np.sqrt(1 - z**2)
    outward = np.stack([sine * np.cos(around), sine * np.sin(around), z], axis=-1).reshape(-1, 3)
    width, face = light.emitter_size
    power = np.pi * width * face
    for index, share in ((1.0, 0.5), (1e4, 1.0)):
        one = replace(light, refractive_index=index)
        irradiance = spilled_irradiance(one, outward * radius, -outward, 1.3)[0].reshape(z.shape)
        total = (irradiance.mean(axis=1) @ weight) * 2 * np.pi * radius**2
        # Forty nodes over the kink at the horizon of the source: some 1e-3; the mirror is 0.1 % short of perfect.
        assert total == pytest.approx(share * power, rel=5e-3)


def test_spill_on_a_sphere_is_what_rays_from_the_band_bring() -> None:
    """Rays drawn from the Lambertian band meet a sphere or miss it: power by ring, shading included."""
    light, height, radius = one_led(size=(44.0, 30.0), index=1.0), 1.1, 7.5
    rng = np.random.default_rng(8)
    n = 1_500_000
    origin = np.stack([np.full(n, 22.0), 2.5 + 2.0 * (rng.random(n) - 0.5), height * rng.random(n)], axis=1)
    sine, around = np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    way = np.stack([-np.sqrt(1 - sine**2), sine * np.cos(around), sine * np.sin(around)], axis=1)
    centre = np.array([0.0, 0.0, radius])
    b = ((origin - centre) * way).sum(axis=1)
    root = b**2 - ((origin - centre) ** 2).sum(axis=1) + radius**2
    run = -b - np.sqrt(np.where(root > 0, root, np.nan))
    hit = (origin + run[:, None] * way)[(root > 0) & (run > 0)]
    hit = hit[(hit[:, 2] > 0) & (hit[:, 2] < radius)]  # the lower half, above the plate
    polar = np.arccos(1 - hit[:, 2] / radius)
    edges = np.deg2rad([15, 35, 55, 75, 90])
    counts = np.histogram(polar, edges)[0]
    finger = PressedFinger((0.0, 0.0), radius, radius, 25.0, 0.0)
    mid = np.deg2rad(np.linspace(15, 90, 301))
    azimuth = np.arange(180) * 2 * np.pi / 180
    beta, phi = np.meshgrid(mid, azimuth, indexing="ij")
    normal = np.stack([np.sin(beta) * np.cos(phi), np.sin(beta) * np.sin(phi), -np.cos(beta)], axis=-1).reshape(-1, 3)
    found = spilled_irradiance(light, centre + radius * normal, normal, height)[0].reshape(beta.shape).mean(axis=1)
    width, face = light.emitter_size
    rings = found * 2 * np.pi * radius**2 * np.sin(mid) / (np.pi * width * face) * n
    for k in range(4):
        some = (mid >= edges[k] - 1e-9) & (mid <= edges[k + 1] + 1e-9)
        expected = np.trapezoid(rings[some], mid[some])
        assert counts[k] == pytest.approx(expected, abs=5 * np.sqrt(expected) + 2e-3 * expected)
    assert finger.contact_radius == 0.0
    np.testing.assert_allclose(finger.height(np.array([3.0])), radius - np.sqrt(radius**2 - 9.0))


def test_far_spill_on_the_sphere_goes_with_the_distance_from_the_axis() -> None:
    """Light from far away at the horizon, from all sides alike: irradiance proportional to r/R."""
    along = np.linspace(-900.0, 900.0, 61)
    edges = {name: along for name in ("left", "right", "top", "bottom")}
    light = EdgeLight((2000.0, 2000.0), 5.0, 1.0, 0.0, 0.0, edges, edges, (2.0, 1.6))
    beta = np.deg2rad([30.0, 50.0, 70.0, 89.0])
    azimuth = np.arange(24) * 2 * np.pi / 24
    b, phi = np.meshgrid(beta, azimuth, indexing="ij")
    normal = np.stack([np.sin(b) * np.cos(phi), np.sin(b) * np.sin(phi), -np.cos(b)], axis=-1).reshape(-1, 3)
    points = 7.5 * (normal + np.array([0.0, 0.0, 1.0]))
    found = spilled_irradiance(light, points, normal, 1.0).sum(axis=0).reshape(b.shape).mean(axis=1)
    np.testing.assert_allclose(found / found[-1], np.sin(beta) / np.sin(beta[-1]), rtol=0.02)  # 7.5 mm in 1000 mm


def test_the_fingers_shadow_on_the_backdrop_is_where_straight_lines_meet_it() -> None:
    light, shadow = one_led(), (3.0, 1.0, 4.0)
    points = np.array([[x, y, 30.0] for x in np.linspace(-30, 18, 25) for y in np.linspace(-20, 20, 21)])
    normals = np.tile(NORMAL_DOWN, (len(points), 1))
    free = spilled_irradiance(light, points, normals, 1.0)[0]
    shaded = spilled_irradiance(light, points, normals, 1.0, shadow)[0]
    t = np.linspace(0, 1, 4001)[None, :, None]
    line = np.array([20.0, 2.5]) + t * (points[:, None, :2] - np.array([20.0, 2.5]))
    nearest = np.hypot(line[..., 0] - 3.0, line[..., 1] - 1.0).min(axis=1)
    clear = np.abs(nearest - 4.0) > 1.2  # a half-shadow as wide as the LED lies between
    assert (shaded[clear & (nearest < 4)] == 0).all()
    np.testing.assert_array_equal(shaded[clear & (nearest > 4)], free[clear & (nearest > 4)])
    assert (nearest < 4).sum() > 20


# --- the surface beside the contact -----------------------------------------------------------------------------------


def test_a_moved_finger_and_other_leds_are_not_answered_by_what_was_kept() -> None:
    """Each rig once after another, and alone: bytes are the same, and differ from rig to rig."""
    lit = Surroundings(spill=Spill(share=0.3), backdrop=Backdrop(distance_mm=30.0, reflectance=0.6))
    scene = rig(lit)
    moved = scene.model_copy(update={"finger": scene.finger.model_copy(update={"position_mm": (-4.0, 6.0)})})
    higher = scene.model_copy(
        update={"surroundings": lit.model_copy(update={"spill": Spill(share=0.3, height_mm=4.0)})}
    )
    dimmer = scene.model_copy(update={"leds": scene.leds.model_copy(update={"voltage_V": 8.5})})
    x, y = np.meshgrid(np.linspace(-30, 30, 25), np.linspace(-20, 20, 19))

    def seen(one: Scene, finger: bool) -> bytes:
        return backdrop_irradiance(one, x, y, stacked_radiances(edge_light(one)), finger=finger).tobytes()

    every = [(one, finger) for one in (scene, moved, higher, dimmer) for finger in (True, False)]
    after = [seen(*one) for one in every]
    alone = []
    for one in every:
        forget()
        alone.append(seen(*one))
    assert after == alone
    # Without a finger it does not matter where it is.
    assert len(set(alone)) == len(every) - 1


def test_the_pressed_surface_is_hertzs() -> None:
    """Slope is the height's derivative; far away the surface is lifted by F/(pi E* r) = 4 a^3/(3 pi R r)."""
    finger = PressedFinger((1.0, 2.0), 40.0, 38.0, 60.0, 0.12)
    a = finger.contact_radius
    assert a == pytest.approx(np.sqrt(40.0 * 0.12))
    r = np.array([1.02, 1.3, 2.0, 4.0, 9.0]) * a
    step = 1e-5
    numeric = (finger.height(r + step) - finger.height(r - step)) / (2 * step)
    np.testing.assert_allclose(finger.slope(r), numeric, rtol=1e-4, atol=1e-7)
    assert finger.height(np.array([0.5 * a, a])).max() == 0.0
    sphere = 40.0 - np.sqrt(40.0**2 - r**2)
    lifted = finger.height(r) - (sphere - 0.12)
    np.testing.assert_allclose(lifted[-1], 4 * a**3 / (3 * np.pi * 40.0 * r[-1]), rtol=0.02)
    station = finger.stations()
    assert (np.diff(station) > 0).all()


# --- haze -------------------------------------------------------------------------------------------------------------


def test_haze_sends_to_the_lens_what_particles_scatter() -> None:
    """Scattered rays drawn evenly over projected solid angle, a half each way; those that leave within 15 degrees."""
    n, share, irradiance = 1.523, 0.01, 3.0
    rng = np.random.default_rng(3)
    count = 2_000_000
    sine = np.sqrt(rng.random(count))
    cap = np.sin(np.deg2rad(15.0))
    # From the bottom face into air.
    inside = float((sine < cap).mean()) * share * irradiance / 2 / (np.pi * cap**2)
    error = np.sqrt(cap**2 / count) * share * irradiance / 2 / (np.pi * cap**2)
    assert inside == pytest.approx(float(haze_radiance(share, irradiance)), abs=5 * error)
    # From the top face through the bottom one: refracted, a part reflected.
    out = n * sine
    ci, co = np.sqrt(1 - sine**2), np.sqrt(np.maximum(1 - out**2, 0.0))
    s, p = (n * ci - co) / (n * ci + co), (ci - n * co) / (ci + n * co)
    leaves = (out < cap) & (rng.random(count) > 0.5 * (s**2 + p**2))
    through = float(leaves.mean()) * share * irradiance / 2 / (np.pi * cap**2)
    expected = float(haze_radiance(share, irradiance)) * (1 - ((n - 1) / (n + 1)) ** 2) / n**2
    error = np.sqrt(leaves.mean() / count) * share * irradiance / 2 / (np.pi * cap**2)
    assert through == pytest.approx(expected, abs=5 * error + 2e-4 * expected)


def test_a_hazy_floor_lights_as_a_plane_with_a_hole() -> None:
    polar, up = np.deg2rad([0.0, 25.0, 60.0, 90.0, 140.0]), np.full(5, 2.0)
    found = hazy_floor(np.zeros(5), up, polar, 0.0, directions=1 << 16)
    np.testing.assert_allclose(found, (1 + np.cos(polar)) / 2, atol=2e-3)
    # On the axis, facing down: all but what the disc fills, a^2/(a^2 + h^2).
    heights = np.array([0.5, 2.0, 7.0])
    found = hazy_floor(np.zeros(3), heights, np.zeros(3), 3.0, directions=1 << 16)
    np.testing.assert_allclose(found, 1 - 9.0 / (9.0 + heights**2), atol=1e-3)
    assert hazy_floor(np.ones(1), np.zeros(1), np.zeros(1), 0.5)[0] == 0.0


def test_clouds_have_the_stated_mean_contrast_and_correlation() -> None:
    contrast, length = 0.5, 2.0
    fields = [clouds((60.0, 40.0), contrast, length, k, "top") for k in range(40)]
    values = np.array([f.factor for f in fields], float)
    # Each picture has some 60 x 40/(2 pi length^2) independent places.
    independent = len(fields) * 60 * 40 / (2 * np.pi * length**2)
    assert values.mean() == pytest.approx(1.0, abs=5 * contrast / np.sqrt(independent))
    sigma2 = np.log(1 + contrast**2)
    normal = np.log(values)
    spread = normal - normal.mean()
    assert spread.var() == pytest.approx(sigma2, rel=5 * np.sqrt(2 / independent) + 0.01)
    step = round(length / fields[0].pitch)
    at_length = (spread[:, :, step:] * spread[:, :, :-step]).mean() / spread.var()
    assert at_length == pytest.approx(np.exp(-0.5), abs=5 / np.sqrt(independent))
    same = clouds((60.0, 40.0), contrast, length, 3, "top").factor
    np.testing.assert_array_equal(same, fields[3].factor)
    assert (same != clouds((60.0, 40.0), contrast, length, 3, "bottom").factor).any()


def test_guided_irradiance_is_the_integral_of_guided_radiance() -> None:
    scene = rig()
    light = edge_light(scene)
    n = scene.plate.refractive_index
    critical = np.arcsin(1 / n)
    u, w = np.polynomial.legendre.leggauss(64)
    theta = critical + (np.pi / 2 - critical) * (u + 1) / 2
    weight = w * (np.pi / 2 - critical) / 2
    x, y = np.array([3.1, -9.0]), np.array([-2.3, 7.0])
    radiance = azimuthal_radiance(light, x, y, theta, diffuse=edge_radiance(light))
    expected = 2 * np.pi * (radiance * np.cos(theta) * np.sin(theta)) @ weight
    # A spline through noisy nodes 10 mm apart, and 64 angles over the comb of images.
    np.testing.assert_allclose(guided_irradiance(scene, x, y), expected, rtol=0.03)


# --- path tracer ------------------------------------------------------------------------------------------------------


def means(image: Any, where: list[Any]) -> np.ndarray:
    return np.array([image[mask].mean() for mask in where])


def test_spill_agrees_with_the_path_tracer_on_flank_and_backdrop() -> None:
    """Flank by ring and quadrant, backdrop by quadrant, of a rig lit unevenly from three sides."""
    from evanesce.render.reference.surroundings import render_spill

    spill = Spill(share=0.7, height_mm=6.0)
    scene = rig(Surroundings(spill=spill, backdrop=Backdrop(reflectance=0.05, distance_mm=30.0)))
    unlit = rig(Surroundings(backdrop=Backdrop(reflectance=0.05, distance_mm=30.0)))
    state = pressed(scene)
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    fast = (render_fast(scene, state, view=view).radiance - render_fast(unlit, state, view=view).radiance).astype(float)
    powers = each_led_power(scene.plate, scene.leds)
    traced = render_spill(scene, state, powers, view, samples_per_pixel=96, passes=8, seed=3)
    x, y = plate_points(scene, traced)
    r, azimuth = np.hypot(x - 3.1, y + 2.3), np.rad2deg(np.arctan2(y + 2.3, x - 3.1)) % 360
    quadrants = [(azimuth >= a) & (azimuth < a + 90) for a in (0, 90, 180, 270)]
    flank = [q & (r > low) & (r < high) for q in quadrants for low, high in ((3.6, 4.4), (4.4, 5.3), (5.3, 6.2))]
    beyond = [q & (r > 8.5) & (r < 13) for q in quadrants]
    for where, model in ((flank, 0.06), (beyond, 0.08)):
        # Left out: what goes on from the finger to the backdrop, and specular paths of second order.
        found, expected = means(fast, where), means(traced.radiance, where)
        error = np.array([np.sqrt(traced.variance[m].sum()) / m.sum() for m in where])
        assert (np.abs(found - expected) < 5 * error + model * expected).all(), found / expected
        assert np.abs(found / expected - 1).mean() < 0.08
    contact = r < 0.8 * np.sqrt(state.nominal_contact_area / np.pi)
    assert traced.radiance[contact].mean() < 0.01 * means(traced.radiance, flank).min()


def test_the_plates_own_light_on_a_backdrop_agrees_with_the_path_tracer() -> None:
    from evanesce.render.reference.path import render

    scene = rig(Surroundings(backdrop=Backdrop(reflectance=0.4, distance_mm=30.0)))
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    fast = render_fast(scene, None, view=view).radiance.astype(float)
    traced = render(scene, None, view=view, samples_per_pixel=64, passes=8, seed=5)
    error = float(np.sqrt(traced.variance.sum()) / traced.variance.size)
    # 0.4 of what the plate mirrors of the backdrop's own light, 0.15 of it, is left out.
    assert fast.mean() == pytest.approx(traced.radiance.mean(), abs=5 * error + 0.07 * fast.mean())
    assert error < 0.06 * fast.mean()


@pytest.mark.parametrize("inside", [True, False])
def test_a_traced_hazy_face_scatters_its_share_half_each_way_evenly(inside: bool) -> None:
    """Means over drawn directions: share s in all, s/2 to a side, of it sin^2 of a cone's angle within the cone."""
    from evanesce.render.reference.haze import hazy
    from evanesce.render.variant import select

    select("llvm")
    import drjit as dr
    import mitsuba as mi

    share, count, n = 0.1, 400_000, 1.523
    scene = rig(Surroundings(haze=Haze(top_share=share, contrast=0.0)))
    glass = {"type": "dielectric", "int_ior": n, "ext_ior": 1.0}
    bsdf = hazy(scene, "top", glass, glass_front=False, contact=None)
    rng = np.random.default_rng(4)
    for cosine in (0.95, 0.5):
        si = dr.zeros(mi.SurfaceInteraction3f, count)
        si.wi = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0.0, -cosine if inside else cosine)
        u = [mi.Float(rng.random(count).astype(np.float32)) for _ in range(3)]
        bs, weight = bsdf.sample(mi.BSDFContext(), si, u[0], mi.Point2f(u[1], u[2]), mi.Bool(True))
        scattered = np.array(bs.sampled_component) == 2
        value, z = np.array(weight.x), np.array(bs.wo.z)
        for part, expected in (
            (scattered, share),
            (scattered & (z > 0), share / 2),
            (scattered & (z < 0), share / 2),
            (scattered & (z > np.cos(0.4)), share / 2 * np.sin(0.4) ** 2),
        ):
            sample = value * part
            assert sample.mean() == pytest.approx(expected, abs=5 * sample.std() / np.sqrt(count))
        # radiance that crosses the face is scaled by n^2; what is mirrored is not
        mirrored = ~scattered & (z * np.array(si.wi.z) > 0)
        ci = cosine
        s2 = (1 - ci**2) * (n**2 if inside else n**-2)
        co = np.sqrt(max(1 - s2, 0.0))
        a, b = (n, 1.0) if inside else (1.0, n)
        r = (
            1.0
            if s2 >= 1
            else 0.5 * (((a * ci - b * co) / (a * ci + b * co)) ** 2 + ((a * co - b * ci) / (a * co + b * ci)) ** 2)
        )
        sample = value * mirrored
        assert sample.mean() == pytest.approx((1 - share) * r, abs=5 * sample.std() / np.sqrt(count))


@pytest.mark.slow  # two scenes, 10 s
@pytest.mark.parametrize("face", ["top", "bottom"])
def test_haze_on_the_empty_plate_agrees_with_the_path_tracer(face: str) -> None:
    """By quadrant, of a cloudy face of a rig that is lit unevenly from three sides; and cloud by cloud."""
    from evanesce.render.reference.path import render

    scene = rig(Surroundings(haze=Haze(**{f"{face}_share": 0.003}, contrast=0.5, pattern=3)))
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    fast = render_fast(scene, None, view=view).radiance.astype(float)
    traced = render(scene, None, view=view, samples_per_pixel=64, passes=8, seed=5)
    rows, cols = (n // 8 * 8 for n in view.shape)

    def blocks(image: Any, size: int = 8) -> np.ndarray:
        return image[:rows, :cols].reshape(rows // size, size, cols // size, size).mean(axis=(1, 3))

    half = view.shape[0] // 2, view.shape[1] // 2
    for part in (np.s_[: half[0], : half[1]], np.s_[: half[0], half[1] :], np.s_[half[0] :, : half[1]],
                 np.s_[half[0] :, half[1] :]):  # fmt: skip
        error = np.sqrt(traced.variance[part].sum()) / traced.variance[part].size
        # 3 %: the field of guided irradiance (above); 0.4 % of the light is lost for each tenth of a per cent of share
        assert fast[part].mean() == pytest.approx(
            traced.radiance[part].mean(), abs=5 * error + 0.04 * fast[part].mean()
        )
    found, expected = blocks(traced.radiance), blocks(fast)
    deviation = (found / expected - (found / expected).mean()) / (np.sqrt(blocks(traced.variance) / 64) / expected)
    assert deviation.std() < 1.3, "clouds are where the fast renderer has them"
    assert expected.std() > 3 * np.sqrt(blocks(traced.variance).mean() / 64)


@pytest.mark.slow  # 40 s
def test_haze_around_a_contact_agrees_with_the_path_tracer_and_its_connections_change_no_mean() -> None:
    """Ground and flank in the light of haze on the top face, and what haze takes from the contact."""
    from evanesce.render.reference.path import render

    hazy = rig(Surroundings(haze=Haze(top_share=0.006, bottom_share=0.003, contrast=0.0)))
    bare, state = rig(), pressed(rig())
    view = Projection.of(bare.camera, bare.plate).ideal_view()
    options: dict[str, Any] = {"view": view, "passes": 8, "focus": False}
    traced = render(hazy, state, samples_per_pixel=80, seed=5, **options)
    plain = render(bare, state, samples_per_pixel=64, seed=6, **options)
    chance = render(hazy, state, samples_per_pixel=80, seed=7, connect=False, **options)
    added = (render_fast(hazy, state, view=view).radiance - render_fast(bare, state, view=view).radiance).astype(float)
    x, y = plate_points(bare, traced)
    r, radius = np.hypot(x - 3.1, y + 2.3), np.sqrt(state.nominal_contact_area / np.pi)
    inside, ground = r < 0.85 * radius, r > 9.0

    def mean(light: Any, where: Any) -> tuple[float, float]:
        return float(light.radiance[where].mean()), float(np.sqrt(light.variance[where].sum()) / where.sum())

    for where in (inside, ground):
        (one, e1), (other, e2) = mean(traced, where), mean(chance, where)
        assert one == pytest.approx(other, abs=5 * np.hypot(e1, e2))
    light, error = mean(traced, ground)
    # what the finger takes and what haze takes: 4 %
    assert added[ground].mean() == pytest.approx(light, abs=5 * error + 0.07 * light)
    # the tracer's finger is a flattened sphere: beside the contact, up to 1.41 radii, it shades itself
    flank = (r > 1.15 * radius) & (r < 1.4 * radius)
    (one, e1), (other, e2) = mean(traced, flank), mean(plain, flank)
    assert added[flank].mean() == pytest.approx(one - other, abs=5 * np.hypot(e1, e2) + 0.1 * (one - other))
    (one, e1), (other, e2) = mean(traced, inside), mean(plain, inside)
    assert 0.94 < one / other < 0.99 - 5 * np.hypot(e1, e2) / other + 0.03


def test_backdrop_irradiance_falls_with_distance() -> None:
    """Far above, spill goes as 1/distance^3: cos(source) ~ 1/h, cos(plane) ~ 1, 1/h^2."""
    x = y = np.array([[0.0, 1.0], [2.0, 3.0]])
    found = []
    for distance in (2000.0, 4000.0):
        scene = rig(Surroundings(spill=Spill(share=1.0), backdrop=Backdrop(reflectance=0.1, distance_mm=distance)))
        bare = rig(Surroundings(backdrop=Backdrop(reflectance=0.1, distance_mm=distance)))
        radiances = stacked_radiances(edge_light(scene))
        every = [backdrop_irradiance(s, x, y.T, radiances, finger=False)[0, 0] for s in (scene, bare)]
        found.append(every[0] - every[1])
    assert found[0] / found[1] == pytest.approx(8.0, rel=0.02)
