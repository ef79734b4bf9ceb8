"""The chain as a whole, with a contact and a light that need neither solver nor renderer."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.chain.simulate import expose, simulate
from evanesce.core import rng
from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field
from evanesce.core.states import ContactState, PlateGrid, PlateLight
from evanesce.effects import Effect, Stage, all_effects
from evanesce.optics.projection import Projection
from evanesce.rig import Camera, Distortion, Plate, Scene, load_scene
from evanesce.rig.camera import Lens, Pixel
from evanesce.sensor.expose import expose as expose_sensor
from evanesce.sensor.lens import form_image

CENTRE = (1.7, -0.9)


def ugly_scene(**effects: dict[str, object]) -> Scene:
    camera = Camera(
        resolution_px=(420, 310),
        scale_px_per_mm=19.3,
        centre_mm=(0.8, -0.3),
        principal_point_offset_px=(6.0, -11.0),
        tilt_x_deg=2.0,
        roll_deg=11.0,
        exposure_ms=3.0,
        lens=Lens(focal_length_mm=2.6, defocus_um=30.0, distortion=Distortion(k1=-0.22, k2=0.03)),
        pixel=Pixel(prnu=0.01, dsnu_e=2.0, dark_current_e_per_s=30.0),
    )
    plate = Plate(size_mm=(90.0, 70.0), thickness_mm=5.3, refractive_index=1.48)
    return load_scene("thesis").model_copy(update={"camera": camera, "plate": plate, "effects": effects})


def contact(scene: Scene, force_N: float, *, time_s: float = 0.0) -> ContactState:
    """A disc whose radius grows with the cube root of force."""
    grid = PlateGrid((300, 300), 0.04, CENTRE)
    radius = 2.1 * force_N ** (1 / 3)
    r = np.hypot(grid.x[None, :] - CENTRE[0], grid.y[:, None] - CENTRE[1])
    mask = np.clip((radius - r) / grid.pitch + 0.5, 0, 1)
    return ContactState(
        grid=grid,
        pressure=force_N / (np.pi * radius**2) * mask,
        gap=np.clip(r - radius, 0, None) ** 1.5 / 7,
        contact_mask=mask,
        normal_force=force_N,
        nominal_contact_area=np.pi * radius**2,
        law="disc",
        time=time_s,
    )


def render(scene: Scene, state: ContactState | None, *, seed: int, level: float = 4e-7) -> PlateLight:
    """Radiance of a bright disc on a dim plate, at the pinhole's own pixels."""
    projection = Projection.of(scene.camera, scene.plate)
    view = projection.ideal_view()
    px, py = view.principal_point
    u, v = np.meshgrid(np.arange(view.shape[1]) - px, np.arange(view.shape[0]) - py)
    x, y = projection.ray_to_plate(u / view.focal_px, v / view.focal_px)
    radiance = np.full(view.shape, level / 40)
    if state is not None:
        radius = np.sqrt(state.nominal_contact_area / np.pi)
        radiance += level * np.clip((radius - np.hypot(x - CENTRE[0], y - CENTRE[1])) * 19.3 + 0.5, 0, 1)
    return PlateLight(
        radiance=radiance, variance=0 * radiance, focal_px=view.focal_px, principal_point=view.principal_point
    )


def test_chain_without_effects_is_the_camera_alone() -> None:
    """The page that spells the chain out gives the bytes of the plain path."""
    scene = ugly_scene()
    got = simulate(scene, 1.3, seed=7, time_s=0.2, index=4, contact=contact, render=render)
    assert got.state is not None
    light = form_image(render(scene, got.state, seed=0), scene.camera, scene.plate)
    np.testing.assert_array_equal(got.sensor_light.irradiance, light.irradiance)
    pattern_rng = rng.generator(7, "sensor")
    from evanesce.sensor.pixel import fixed_pattern

    pattern = fixed_pattern((310, 420), 0.01, 2.0, pattern_rng)
    plain = expose_sensor(light, scene.camera, rng=rng.generator(7, "exposure", 4), pattern=pattern)
    np.testing.assert_array_equal(got.frame.raw, plain.raw)
    np.testing.assert_array_equal(got.frame.data, plain.data)
    assert (got.frame.time, got.frame.index, got.state.time) == (0.2, 4, 0.2)


def test_null_effects_change_no_byte() -> None:
    plain = simulate(ugly_scene(), 1.3, seed=7, contact=contact, render=render).frame
    nulls: dict[str, dict[str, object]] = {name: {} for name in all_effects()}
    nulled = simulate(ugly_scene(**nulls), 1.3, seed=7, contact=contact, render=render).frame
    assert plain.raw is not None
    assert nulled.raw is not None
    assert plain.raw.tobytes() == nulled.raw.tobytes()
    assert plain.data.tobytes() == nulled.data.tobytes()


def test_same_seed_same_bytes_other_frame_other_noise() -> None:
    frames = [
        simulate(ugly_scene(), 1.3, seed=s, index=i, contact=contact, render=render).frame.raw
        for s, i in ((7, 0), (7, 0), (7, 1), (8, 0))
    ]
    np.testing.assert_array_equal(frames[0], frames[1])
    for other in frames[2:]:
        assert (frames[0] != other).mean() > 0.3


def test_fixed_pattern_is_the_sensors_and_noise_the_frames() -> None:
    """Pairs of frames share PRNU and DSNU: their correlation is the pattern's share of the variance."""
    scene = ugly_scene()
    flat = render(scene, None, seed=0, level=1.6e-5)
    a, b = (expose(scene, flat, seed=7, index=i)[1].raw for i in (0, 1))
    smooth = expose(scene, flat, seed=7, without={"noise"})[1].raw
    assert a is not None
    assert b is not None
    assert smooth is not None
    da, db = (frame.astype(float) - smooth for frame in (a, b))
    electrons = (smooth - 256.0).mean() * 2.13
    fixed = (0.01 * electrons) ** 2 + 2.0**2
    temporal = electrons + 3.0**2
    expected = fixed / (fixed + temporal + 2.13**2 / 6)  # quantised twice: here and in the smooth frame
    # A correlation of n = 130,000 pixels is known to 1/sqrt(n) = 0.003; the field's fall-off of some tenths enters
    # through the mean of squares.
    assert np.corrcoef(da.ravel(), db.ravel())[0, 1] == pytest.approx(expected, abs=0.03)


def test_no_force_is_a_frame_without_contact() -> None:
    got = simulate(ugly_scene(), None, seed=7, contact=contact, render=render)
    assert got.state is None
    assert got.plate_light.radiance.max() == pytest.approx(1e-8)


def test_contact_is_seen_where_the_geometry_says() -> None:
    scene = ugly_scene()
    got = simulate(scene, 0.6, seed=7, contact=contact, render=render)
    # Half of the range between plate and contact, in linear light.
    raw = got.frame.raw
    assert raw is not None
    mask = raw > (np.percentile(raw, 2) + np.percentile(raw, 99.5)) / 2
    v, u = np.nonzero(mask)
    x, y = Projection.of(scene.camera, scene.plate).to_plate(u.astype(float), v.astype(float))
    assert got.state is not None
    area = mask.sum() / 19.3**2
    # Centroid of 2,800 pixels' rim: far below the pixel of 0.05 mm; perspective and distortion move it by less.
    assert (x.mean(), y.mean()) == pytest.approx(CENTRE, abs=0.05)
    # Distortion shrinks areas by some percent off the axis; it must be no more.
    assert area == pytest.approx(got.state.nominal_contact_area, rel=0.06)


def test_leaving_parts_of_the_camera_out() -> None:
    scene = ugly_scene()
    plate_light = render(scene, contact(scene, 1.0), seed=0)
    full, frame = expose(scene, plate_light, seed=7)
    sharp, _ = expose(scene, plate_light, seed=7, without={"blur"})
    straight, _ = expose(scene, plate_light, seed=7, without={"distortion"})
    noiseless = expose(scene, plate_light, seed=7, without={"noise"})
    assert np.abs(np.diff(sharp.irradiance)).max() > 1.5 * np.abs(np.diff(full.irradiance)).max()
    assert (straight.irradiance != full.irradiance).any()
    np.testing.assert_array_equal(noiseless[0].irradiance, full.irradiance)
    assert noiseless[1].raw is not None
    np.testing.assert_array_equal(noiseless[1].raw, expose_sensor(full, scene.camera, rng=None).raw)
    assert frame.raw is not None
    assert (frame.raw != noiseless[1].raw).mean() > 0.3
    with pytest.raises(ValueError, match="cannot leave out"):
        expose(scene, plate_light, seed=7, without={"gravity"})  # type: ignore[arg-type]


def test_a_wrong_effect_is_refused_before_any_work() -> None:
    def never(*args: object, **options: object) -> PlateLight:
        raise AssertionError("worked before checking")

    with pytest.raises(InputError, match=r"nearest: hot_pixels"):
        simulate(ugly_scene(hot_pixel={}), 1.0, seed=0, contact=contact, render=never, file="my.toml")


def test_each_stage_is_reached_in_physical_order(monkeypatch: pytest.MonkeyPatch) -> None:
    class Size(Strict):
        size: float = field(0.0, unit="1", bounds=(0.0, 1.0), null=0.0)

    seen: list[Stage] = []

    def effect_at(stage: Stage) -> Effect:
        def apply(value: object, parameters: object, context: object) -> object:
            seen.append(stage)
            return value

        return Effect(id=stage.value, stage=stage, parameters=Size, amplitudes=("size",), apply=apply)

    fakes = {stage.value: effect_at(stage) for stage in Stage}
    monkeypatch.setattr("evanesce.effects.all_effects", lambda: fakes)
    scrambled = {stage.value: {"size": 0.5} for stage in reversed(Stage)}
    simulate(ugly_scene(**scrambled), 1.0, seed=0, contact=contact, render=render)
    assert seen == list(Stage)


def test_render_options_reach_the_renderer() -> None:
    dim = simulate(ugly_scene(), 1.0, seed=0, contact=contact, render=render, level=1e-7)
    bright = simulate(ugly_scene(), 1.0, seed=0, contact=contact, render=render, level=2e-7)
    np.testing.assert_allclose(bright.plate_light.radiance, 2 * dim.plate_light.radiance, rtol=1e-12)
