"""Effects of the camera against oracles: moments, the lens with other figures, quadrature, chance, a real codec."""

from __future__ import annotations

import io
import math
from typing import Any

import av
import numpy as np
import pytest
from scipy import integrate, ndimage
from scipy.special import erf

from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, Frame, PlateGrid, PlateLight, SensorLight
from evanesce.effects import Context, all_effects
from evanesce.effects.lens.defocus import discrete_gaussian
from evanesce.effects.lens.distortion_drift import Shift
from evanesce.effects.lens.rolling_shutter import mean_light
from evanesce.effects.lens.sensor_dust import obstructed_share
from evanesce.effects.readout.compression import quantised
from evanesce.effects.readout.saturation import overflow_kernel
from evanesce.optics.projection import Projection
from evanesce.rig import Scene, load_scene
from evanesce.sensor.blur import disc_mtf
from evanesce.sensor.expose import frame_of, signal_of
from evanesce.sensor.lens import form_image
from evanesce.sensor.tone import bt709, relative_light

COLS, ROWS, PITCH = 400, 300, 9.3


def rig(factor: int = 1, **more: object) -> Scene:
    """Return the thesis rig with 400 x 300 pixels of 9.3 um, or with a factor fewer and larger ones in their place."""
    return load_scene(
        "thesis",
        {
            "camera.resolution_px": [COLS // factor, ROWS // factor],
            "camera.scale_px_per_mm": 58.37 / 3 / factor,
            "camera.pixel.pitch_um": PITCH * factor,
            **more,
        },
    )


def acted(
    name: str, value: object, scene: Scene | None = None, *, time_s: float = 0.0, seed: int = 4, **values: float
) -> Any:
    """Return what an effect makes of a value."""
    effect = all_effects()[name]
    return effect.apply(value, effect.parameters(**values), Context(scene or rig(), seed, time_s))


def lit(name: str, image: np.ndarray, scene: Scene | None = None, **values: float) -> np.ndarray:
    return np.asarray(acted(name, SensorLight(irradiance=image), scene, **values).irradiance)


def binned(image: np.ndarray, factor: int) -> np.ndarray:
    rows, cols = image.shape
    return image.reshape(rows // factor, factor, cols // factor, factor).mean(axis=(1, 3))


def moments(image: np.ndarray) -> tuple[float, float, float, float, float]:
    """Return sum, mean (x, y) and variance (x, y) of an image of light."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    total = image.sum()
    x, y = (u * image).sum() / total, (v * image).sum() / total
    return total, x, y, ((u - x) ** 2 * image).sum() / total, ((v - y) ** 2 * image).sum() / total


# --- tone curve ------------------------------------------------------------------------------------------------------


def developed(light: np.ndarray, **values: float) -> np.ndarray:
    frame = Frame(data=255.0 * light, index=0)  # type: ignore[arg-type]
    return np.asarray(acted("tone_curve", frame, **values).data)


def test_tone_curve_keeps_ends_and_order_over_its_bounds() -> None:
    value = np.linspace(0.0, 1.0, 4001)[None]
    for gamma in (-0.6, -0.2, 2.0):
        for contrast in (-1.0, 0.37, 1.0):
            found = developed(value, gamma=gamma, contrast=contrast)[0]
            assert (found[0], found[-1]) == (0.0, pytest.approx(255.0))
            assert (np.diff(found) > -1e-9).all()


def test_contrast_is_odd_about_mid_grey_with_the_stated_slope() -> None:
    value = np.linspace(0.0, 1.0, 2001)[None]
    found = developed(value, contrast=0.43)[0] / 255
    np.testing.assert_allclose(found + found[::-1], 1.0, atol=1e-12)
    assert (found[1001] - found[999]) / 0.001 == pytest.approx(1 + 0.43 / 2, abs=1e-5)


def test_gammas_compose_and_a_square_root_is_one() -> None:
    value = np.random.default_rng(0).random((31, 17))
    twice = developed(developed(value, gamma=0.3) / 255, gamma=-0.25)
    np.testing.assert_allclose(twice, developed(value, gamma=1.3 * 0.75 - 1), rtol=1e-12)
    np.testing.assert_allclose(developed(value, gamma=-0.5), 255 * np.sqrt(value), rtol=1e-12)


def test_real_frames_are_developed_anew_from_the_raw_numbers() -> None:
    """One rounding only; a float prediction agrees to half a grey level; what acted before is kept."""
    scene = rig()
    raw = np.random.default_rng(1).uniform(200.0, 4095.0, (60, 80))
    frame = frame_of(raw, scene.camera)
    found = acted("tone_curve", frame, scene, gamma=0.21, contrast=-0.3)
    value = bt709(relative_light(frame.raw, black_level_DN=256, bits=12)) ** 1.21
    exact = 255 * (value - 0.3 * value * (1 - value) * (2 * value - 1))
    np.testing.assert_array_equal(found.data, np.floor(exact + 0.5))
    np.testing.assert_array_equal(found.raw, frame.raw)
    moved = Frame(data=np.minimum(frame.data, 200) + np.uint8(7), raw=frame.raw)
    kept = np.clip(moved.data + (found.data.astype(int) - frame.data), 0, 255)
    np.testing.assert_array_equal(acted("tone_curve", moved, scene, gamma=0.21, contrast=-0.3).data, kept)
    colour = Frame(data=np.repeat(frame.data[..., None], 3, axis=2), raw=frame.raw)
    of_colour = acted("tone_curve", colour, scene, gamma=0.21, contrast=-0.3).data[..., 1]
    assert np.abs(of_colour.astype(int) - found.data).max() <= 1  # rounded twice


# --- defocus ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("blur_um", [2.0, 9.3, 47.0])
def test_blur_has_the_stated_variance_however_narrow(blur_um: float) -> None:
    point = np.zeros((ROWS, COLS))
    point[131, 188] = 7.3
    total, x, y, var_x, var_y = moments(lit("defocus", point, blur_um=blur_um))
    assert (total, x, y) == (pytest.approx(7.3, rel=1e-12), pytest.approx(188), pytest.approx(131))
    # the kernel is cut beyond 4.5 standard deviations
    assert (var_x, var_y) == (pytest.approx((blur_um / PITCH) ** 2, rel=2e-3),) * 2


def test_a_wide_blur_is_gauss_and_narrow_ones_add() -> None:
    """Against the error function, pixel by pixel; kernels one after the other add their variances exactly."""
    step = np.zeros((40, 81))
    step[:, 40:] = 1.0
    found = lit("defocus", step, blur_um=3.0 * PITCH)[20]
    # A pixel's share of the edge; the discrete kernel departs from Gauss by 1/(8 variance) of its fourth moment.
    np.testing.assert_allclose(found, 0.5 * (1 + erf((np.arange(81) - 39.5) / (3 * math.sqrt(2)))), atol=5e-3)
    both, direct = np.convolve(discrete_gaussian(0.09), discrete_gaussian(0.16)), discrete_gaussian(0.25)
    middle = both.size // 2
    # up to what is cut off beyond 4.5 standard deviations
    np.testing.assert_allclose(both[middle : middle + 3], direct[direct.size // 2 :][:3], atol=1e-5)


def test_blur_is_the_same_at_any_pixel_size() -> None:
    rng = np.random.default_rng(3)
    image = ndimage.gaussian_filter(rng.random((ROWS, COLS)), 8.0)
    fine = binned(lit("defocus", image, blur_um=60.0), 4)
    coarse = lit("defocus", binned(image, 4), rig(4), blur_um=60.0)
    change = fine - binned(image, 4)
    np.testing.assert_allclose((coarse - fine)[8:-8, 8:-8], 0.0, atol=0.05 * np.abs(change).max())


def test_blur_grows_to_the_corners_as_stated_and_keeps_the_light() -> None:
    scene = rig(**{"camera.principal_point_offset_px": [11.0, -6.0]})
    axis = ((COLS - 1) / 2 + 11.0, (ROWS - 1) / 2 - 6.0)
    far = max(axis[0], COLS - 1 - axis[0]) ** 2 + max(axis[1], ROWS - 1 - axis[1]) ** 2
    for row, col in ((140, 205), (60, 320), (260, 40)):
        point = np.zeros((ROWS, COLS))
        point[row, col] = 1.0
        rho2 = ((col - axis[0]) ** 2 + (row - axis[1]) ** 2) / far
        total, _, _, var_x, _ = moments(lit("defocus", point, scene, blur_um=12.0, corner_blur_um=-40.0))
        assert total == pytest.approx(1.0, rel=1e-12)
        assert var_x == pytest.approx(((12.0 - 40.0 * rho2) / PITCH) ** 2, rel=3e-3)
    flat = lit("defocus", np.full((ROWS, COLS), 3.0), scene, blur_um=12.0, corner_blur_um=25.0)
    np.testing.assert_allclose(flat[30:-30, 30:-30], 3.0, rtol=0.02)  # wider outwards takes in more from inside


def test_blur_is_that_of_a_focus_shift_of_the_lens() -> None:
    """Against the transfer of the geometric disc |dz|/N, whose standard deviation is dz/(4 N), at low frequencies."""
    pitch, number, shift_um = 3.1, 6.62, 260.0
    sigma_px = shift_um / (4 * number) / pitch
    gauss = discrete_gaussian(sigma_px**2)
    offset = np.arange(gauss.size) - gauss.size // 2
    for cycles_per_px in (0.004, 0.01, 0.018):
        contrast = gauss @ np.cos(2 * np.pi * cycles_per_px * offset)
        # Disc and Gauss of one variance differ by the fourth power of 2 pi f sigma over 24, and less beyond; the
        # lattice adds 1/variance of that.
        fourth = (2 * np.pi * cycles_per_px * sigma_px) ** 4 / 24
        disc = float(disc_mtf(cycles_per_px / pitch, shift_um / number))
        assert 0.5 * fourth < contrast - disc < (1 + 1 / sigma_px**2) * fourth + 1e-5


# --- distortion ------------------------------------------------------------------------------------------------------

DRIFT = {"k1": 0.031, "k2": -0.06, "k3": 0.4, "p1": 0.0023, "p2": -0.0041, "centre_x_um": 23.0, "centre_y_um": -41.0}


def drifted(scene: Scene, **values: float) -> Scene:
    """Return the scene whose camera has the real figures: what the effect should amount to."""
    lens, pitch = scene.camera.lens, scene.camera.pixel.pitch_um
    old = lens.distortion
    real = old.model_copy(update={n: getattr(old, n) + values.get(n, 0.0) for n in ("k1", "k2", "k3", "p1", "p2")})
    dx, dy = scene.camera.principal_point_offset_px
    offset = (dx + values.get("centre_x_um", 0.0) / pitch, dy + values.get("centre_y_um", 0.0) / pitch)
    update = {"lens": lens.model_copy(update={"distortion": real}), "principal_point_offset_px": offset}
    return scene.model_copy(update={"camera": scene.camera.model_copy(update=update)})


def spots(scene: Scene, places: list[tuple[float, float]], width_px: float = 4.0) -> PlateLight:
    """Return soft spots of light at plate places, on a view that the drifted frame fits in, too."""
    view = Projection.of(scene.camera, scene.plate).ideal_view(40)
    v, u = np.mgrid[: view.shape[0], : view.shape[1]]
    radiance = np.zeros(view.shape)
    for x, y in places:
        a, b = Projection.of(scene.camera, scene.plate).plate_to_ray(np.array(x), np.array(y))
        px, py = view.principal_point
        r2 = (u - px - float(a) * view.focal_px) ** 2 + (v - py - float(b) * view.focal_px) ** 2
        radiance += np.exp(-r2 / (2 * width_px**2))
    return PlateLight(
        radiance=radiance, variance=radiance * 0, focal_px=view.focal_px, principal_point=view.principal_point
    )


def test_drift_puts_each_spot_where_the_real_lens_images_it() -> None:
    scene = rig()
    real = drifted(scene, **DRIFT)
    places = [(-0.7, 1.1), (7.6, -4.3), (-7.9, 4.4), (3.2, 5.9)]
    for place in places:
        light = spots(scene, [place])
        before = np.asarray(form_image(light, scene.camera, scene.plate).irradiance)
        after = lit("distortion_drift", before, scene, **DRIFT)
        rendered = np.asarray(form_image(light, real.camera, real.plate).irradiance)
        moved, wanted = moments(after), moments(rendered)
        u, v = Projection.of(real.camera, real.plate).to_image(*(np.array(p) for p in place))
        # The spot's middle is bent by the distortion's second derivative times its variance: some hundredths.
        assert (moved[1], moved[2]) == (pytest.approx(float(u), abs=0.06), pytest.approx(float(v), abs=0.06))
        # The lens's remap rounds places to 1/32 px.
        assert moved[1:3] == (pytest.approx(wanted[1], abs=0.02), pytest.approx(wanted[2], abs=0.02))
        # The pupil takes in the same light. The lens's bilinear remap keeps that of one spot to 0.5 %.
        assert moved[0] == pytest.approx(moments(before)[0], rel=1e-4)
        assert moved[0] == pytest.approx(wanted[0], rel=5e-3)
        shift = math.hypot(moved[1] - moments(before)[1], moved[2] - moments(before)[2])
        assert shift > 1.0
        # That remap's blur of up to 0.25 px^2 takes 1/64 off the top of a spot of 16 px^2.
        assert np.abs(after - rendered).max() < 0.02 * rendered.max()


def test_drift_has_a_derivative_at_nothing() -> None:
    """A hundredth of the drift does a hundredth: no steps of 1/32 px."""
    rng = np.random.default_rng(5)
    image = ndimage.gaussian_filter(rng.random((ROWS, COLS)), 4.0)
    small, smaller = (lit("distortion_drift", image, k1=k) - image for k in (2e-4, 2e-6))
    inside = np.s_[5:-5, 5:-5]
    np.testing.assert_allclose(100 * smaller[inside], small[inside], atol=0.05 * np.abs(small).max())


def test_shift_is_exact_for_quadratics_and_whole_pixels() -> None:
    v, u = np.mgrid[:40.0, :50.0]
    shift = 2.0 + 0.013 * u - 0.02 * v
    quadratic = 0.7 * (u - 3) ** 2 - 2.0 * u
    wanted = 0.7 * (u + shift - 3) ** 2 - 2.0 * (u + shift)
    np.testing.assert_allclose(Shift.of(shift, axis=1)(quadratic)[:, 2:-8], wanted[:, 2:-8], rtol=1e-10, atol=1e-9)
    plain = rig(**{"camera.lens.distortion": {"k1": 0.0, "k2": 0.0}})
    image = np.random.default_rng(6).random((ROWS, COLS))
    found = lit("distortion_drift", image, plain, centre_x_um=3 * PITCH, centre_y_um=-2 * PITCH)
    np.testing.assert_allclose(found[5:-5, 5:-5], image[7:-3, 2:-8], atol=1e-9)


def test_a_lens_that_folds_is_refused() -> None:
    wide = rig(**{"camera.lens.focal_length_mm": 3.0})
    with pytest.raises(InputError, match=r"effects\.distortion_drift.*fold.*allowed: coefficients"):
        lit("distortion_drift", np.ones((ROWS, COLS)), wide, k1=-0.3, k2=-1.0)


# --- rolling shutter -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("duty", [0.0, 0.27, 1.0])
def test_mean_light_is_the_waveform_integrated(duty: float) -> None:
    ripple, frequency, phase, exposure = 0.6, 137.0, 0.7, 6.3e-3

    def wave(t: float) -> float:
        cycles = frequency * t + phase / (2 * np.pi)
        if duty == 0.0:
            return 1 + ripple * np.cos(2 * np.pi * cycles)
        return 1 - ripple + ripple / duty * (cycles - np.floor(cycles) < duty)

    for t in (-0.011, 0.0, 0.0173):
        points = (np.arange(-4, 8) / 1 + np.array([[0.0], [duty]]) - phase / (2 * np.pi)).ravel() / frequency
        inside = points[np.abs(points - t) < exposure / 2]
        area, error = integrate.quad(wave, t - exposure / 2, t + exposure / 2, points=inside)
        found = mean_light(t, exposure, ripple=ripple, frequency_hz=frequency, phase_rad=phase, duty=duty)
        assert float(found) == pytest.approx(area / exposure, abs=10 * error / exposure + 1e-12)


def test_bands_are_as_many_as_cycles_and_none_if_an_exposure_is_whole_cycles() -> None:
    flat = np.full((ROWS, COLS), 2.5)
    found = lit("rolling_shutter", flat, ripple=0.1, frequency_hz=400.0, readout_ms=22.75, phase_deg=31.0)
    np.testing.assert_array_equal(found, found[:, :1] * np.ones(COLS))
    power = np.abs(np.fft.rfft(found[:, 0] - found[:, 0].mean()))
    assert power.argmax() == round(400.0 * 22.75e-3)
    # 6 ms are 3 cycles of 500 Hz
    whole = lit("rolling_shutter", flat, ripple=0.1, frequency_hz=500.0)
    np.testing.assert_allclose(whole, 2.5, rtol=1e-12)
    switched = lit("rolling_shutter", flat, ripple=1.0, frequency_hz=500.0, duty=0.13)
    np.testing.assert_allclose(switched, 2.5, rtol=1e-12)


def test_bands_wander_with_time_and_stand_in_fewer_rows() -> None:
    flat = SensorLight(irradiance=np.ones((ROWS, COLS)))
    values = {"ripple": 0.2, "frequency_hz": 100.0, "readout_ms": 20.0}
    early = acted("rolling_shutter", flat, time_s=0.0, **values).irradiance[:, 0]
    later = acted("rolling_shutter", flat, time_s=1e-3, **values).irradiance[:, 0]
    # 1 ms is 15 rows of 20 ms / 300
    np.testing.assert_allclose(later[:-15], early[15:], rtol=1e-12)
    few = acted("rolling_shutter", SensorLight(irradiance=np.ones((60, 80))), rig(5), **values).irradiance[:, 0]
    np.testing.assert_allclose(few, early[2::5], rtol=1e-12)


# --- a moving contact ------------------------------------------------------------------------------------------------


def disc(radius: float = 4.0, centre: tuple[float, float] = (0.6, -0.9)) -> ContactState:
    grid = PlateGrid((400, 400), 0.03, (0.3, -0.4))
    r = np.hypot(grid.x[None] - centre[0], grid.y[:, None] - centre[1])
    inside = np.clip((radius - r) / grid.pitch + 0.5, 0.0, 1.0)
    return ContactState(
        grid=grid,
        pressure=0.2 * inside,
        gap=np.maximum(r - radius, 0.0),
        contact_mask=inside,
        normal_force=2.0,
        nominal_contact_area=np.pi * radius**2,
        state=(2 * (inside > 0.5)).astype(np.uint8),
        law="disc",
    )


def undistorted(**more: object) -> Scene:
    return rig(**{"camera.lens.distortion": {"k1": 0.0, "k2": 0.0}, "finger.position_mm": [0.6, -0.9], **more})


@pytest.mark.parametrize("roll_deg", [0.0, 90.0])
def test_skew_puts_each_row_where_it_was(roll_deg: float) -> None:
    """A disc under a shear: rows' middles lie on a line of slope velocity times time per millimetre; area stays."""
    scene, state = undistorted(**{"camera.roll_deg": roll_deg}), disc()
    velocity = {"velocity_x_mm_per_s" if roll_deg == 0.0 else "velocity_y_mm_per_s": 60.0}
    found = acted("rolling_skew", state, scene, readout_ms=20.0, **velocity)
    # 300 rows in 20 ms at 58.37/3 px/mm, the camera looking at the plate's origin
    s_per_mm = 20e-3 / ROWS * 58.37 / 3
    mask, x, y = found.contact_mask, state.grid.x, state.grid.y
    if roll_deg == 90.0:
        # The camera's y points to the plate's -x: columns are late to the left.
        mask, x, y, s_per_mm = mask.T, y, x, -s_per_mm
    whole = mask.sum(axis=1) * 0.03 > 2.0
    middle = (mask * x).sum(axis=1)[whole] / mask.sum(axis=1)[whole]
    start = 0.6 if roll_deg == 0.0 else -0.9
    # Refraction's and the frame's half pixel: the row through the axis is late by half a row, 33 us.
    np.testing.assert_allclose(middle, start + 60.0 * s_per_mm * y[whole], atol=60.0 * 20e-3 / ROWS + 2e-3)
    assert mask.sum() == pytest.approx(state.contact_mask.sum(), rel=1e-3)
    assert found.nominal_contact_area == state.nominal_contact_area
    np.testing.assert_array_equal(np.unique(found.state), [0, 2])


def test_skew_stretches_along_the_rows_and_grows() -> None:
    scene, state = undistorted(), disc()
    s_per_mm = 20e-3 / ROWS * 58.37 / 3
    down = acted("rolling_skew", state, scene, readout_ms=20.0, velocity_y_mm_per_s=60.0)
    # The row at y sees what stood at y - v s y: lengths along y grow by 1/(1 - v s).
    assert down.contact_mask.sum() / state.contact_mask.sum() == pytest.approx(1 / (1 - 60.0 * s_per_mm), rel=1e-3)
    grown = acted("rolling_skew", state, scene, readout_ms=20.0, growth_per_s=10.0)
    column = grown.contact_mask[:, np.abs(state.grid.x - 0.6).argmin()]
    top, bottom = (state.grid.y[column > 0.5][i] for i in (0, -1))
    # The rim stands where |y + 0.9| (1 - g s y) = 4.
    for edge in (top, bottom):
        assert abs(edge + 0.9) * (1 - 10.0 * s_per_mm * edge) == pytest.approx(4.0, abs=0.03)
    assert bottom + 0.9 > 4.02 > 3.98 > -0.9 - top


# --- saturation ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("knee", [0.02, 0.07, 0.4])
def test_a_soft_ceiling_is_the_p_norm_of_charge_and_ceiling(knee: float) -> None:
    scene = load_scene("thesis", {"camera.resolution_px": [40, 30]})
    camera = scene.camera
    black = camera.pixel.black_level_DN
    ceiling = 0.45 * (4095 - 256)  # the converter is full a step before the well
    charge = np.linspace(0.05, 3.0, 17) * ceiling
    found = acted("saturation", (black + charge)[None, :], scene, well_loss=0.55, knee=knee)[0] - black
    # scipy's own p-norm of the two reciprocals.
    expected = [1.0 / np.linalg.norm([1.0 / c, 1.0 / ceiling], 1.0 / knee) for c in charge]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert (np.diff(found) >= 0).all()
    assert (found < np.minimum(charge, ceiling) * (1 + 1e-12)).all()


def test_a_smaller_well_is_that_of_a_camera_that_has_it() -> None:
    """The same shot noise, clipped where it is, bit by bit up to rounding."""
    scene = rig(**{"camera.pixel.read_noise_e": 0.0, "camera.analogue_gain": 1.7})
    # At this gain the converter is full first, at 3839 steps above black, or 4810 electrons.
    pixel = scene.camera.pixel.model_copy(update={"full_well_capacity_e": 3839 * 2.13 / 1.7 * 0.4})
    small = scene.camera.model_copy(update={"pixel": pixel})
    mean_e = np.random.default_rng(2).uniform(1200.0, 2600.0, (70, 90))
    signal, wanted = (signal_of(mean_e, camera, np.random.default_rng(8)) for camera in (scene.camera, small))
    found = acted("saturation", signal, scene, well_loss=0.6)
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    assert 0.1 < (found < signal).mean() < 0.9


def test_overflow_blooms_along_the_column_and_is_kept_where_there_is_room() -> None:
    scene = rig(**{"camera.pixel.pitch_um": 3.1})
    level = 256.0 + 0.5 * 3839.0
    signal = np.full((81, 20), 300.0)
    signal[40, 7] = level + 400.0
    found = acted("saturation", signal, scene, well_loss=0.5, bloom=0.6, bloom_length_um=25.0)
    gained = found - np.minimum(signal, level)
    assert not np.delete(gained, 7, axis=1).any()
    kernel = overflow_kernel(25.0 / 3.1)
    own = kernel[kernel.size // 2]
    # all of it less what falls back into the full pixel and what passes the border, exp(-40 * 3.1/25)
    assert gained.sum() == pytest.approx(0.6 * 400.0 * (1 - own), rel=math.exp(-40 * 3.1 / 25))
    assert found[40, 7] == level
    assert found.max() <= level


@pytest.mark.parametrize("length_px", [0.8, 6.0])
def test_overflow_goes_its_mean_distance(length_px: float) -> None:
    kernel = overflow_kernel(length_px)
    x = np.abs(np.arange(kernel.size) - kernel.size // 2)
    # Mean |x| of an exponential over whole pixels: sum over pixels of its integral, 1/(2 sinh(1/(2 length))).
    assert kernel.sum() == pytest.approx(1.0)
    assert (kernel * x).sum() == pytest.approx(0.5 / math.sinh(0.5 / length_px), rel=5e-3)


# --- dust ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("grain", "cone"), [(0.05, 0.15), (0.15, 0.05), (0.1, 0.1)])
def test_obstructed_share_is_what_points_in_the_cone_say(grain: float, cone: float) -> None:
    rng = np.random.default_rng(4)
    radius, angle = cone / 2 * np.sqrt(rng.random(200_000)), 2 * np.pi * rng.random(200_000)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    for distance in (0.0, 0.013, 0.049, 0.07, 0.0999, 0.12):
        stopped = (np.hypot(x + distance, y) < grain / 2).mean()
        expected = float(obstructed_share(distance, grain, cone))
        assert stopped == pytest.approx(
            expected, abs=5 * math.sqrt(max(expected * (1 - expected), 1e-9) / 200_000) + 1e-5
        )


def test_a_shadow_holds_the_grains_area() -> None:
    r = (np.arange(4000) + 0.5) * 2.5e-5
    area = (2 * np.pi * r * obstructed_share(r, 0.03, 0.151)).sum() * 2.5e-5
    assert area == pytest.approx(np.pi * 0.03**2 / 4, rel=1e-4)


@pytest.mark.parametrize("height_mm", [0.0, 1.3])
def test_dust_takes_the_light_that_its_grains_cover(height_mm: float) -> None:
    flat = np.full((ROWS, COLS), 4.0)
    values = {"per_cm2": 700.0, "median_diameter_um": 30.0, "log_spread": 0.3, "opacity": 0.4, "height_mm": height_mm}
    lost = np.mean([1 - lit("sensor_dust", flat, seed=s, **values).mean() / 4.0 for s in range(6)])
    mean_area = np.pi / 4 * (30e-4) ** 2 * math.exp(2 * 0.3**2)  # cm^2
    count = 700.0 * 6 * COLS * ROWS * (PITCH * 1e-4) ** 2
    spread = math.sqrt(math.exp(4 * 0.3**2) / count)
    # Grains may lie over one another: at most half the square of the covered share is counted once less.
    covered = 700.0 * mean_area
    assert lost == pytest.approx(0.4 * covered, rel=5 * spread + covered / 2 + 0.01)


def test_dust_stays_and_is_the_same_at_any_pixel_size() -> None:
    flat, values = np.ones((ROWS, COLS)), {"per_cm2": 100.0, "height_mm": 1.0}
    fine = lit("sensor_dust", flat, time_s=0.0, **values)
    np.testing.assert_array_equal(fine, lit("sensor_dust", flat, time_s=9.0, **values))
    assert (fine != lit("sensor_dust", flat, seed=5, **values)).any()
    coarse = lit("sensor_dust", np.ones((ROWS // 4, COLS // 4)), rig(4), **values)
    # Shadows 150 um wide on pixels of 62 um: means by sub-samples
    np.testing.assert_allclose(coarse, binned(fine, 4), atol=0.04 * (1 - fine.min()))
    more = lit("sensor_dust", flat, **{**values, "per_cm2": 300.0})
    assert (more <= fine).all()
    assert 1 - more.mean() > 1.5 * (1 - fine.mean())


# --- frame rate ------------------------------------------------------------------------------------------------------


def test_stamps_of_25_hz_believed_30() -> None:
    data = np.zeros((4, 5), np.uint8)
    stamps = [acted("frame_rate", Frame(data=data, time=i / 25, index=i), departure=0.2).time for i in range(60)]
    np.testing.assert_allclose(stamps, np.arange(60) / 30, rtol=1e-12, atol=0)


# --- compression -----------------------------------------------------------------------------------------------------


def test_fine_steps_leave_the_noise_of_rounding() -> None:
    """An orthonormal transform keeps variances: step^2/12 where the picture is rough against the step."""
    image = np.random.default_rng(7).normal(120.0, 30.0, (160, 240))
    n = image.size
    for block in (4, 8, 16):
        error = quantised(image, 5.0, block, 0.5) - image
        # a uniform variable's variance scatters by sqrt(4/5n)
        assert (error**2).mean() == pytest.approx(25 / 12, rel=5 * math.sqrt(0.8 / n) + 0.01)


def test_blocks_do_not_touch_one_another_and_odd_sides_are_kept() -> None:
    image = np.random.default_rng(7).integers(0, 255, (47, 61)).astype(np.uint8)
    other = image.copy()
    other[8:16, 24:32] = 90
    one, two = (acted("compression", Frame(data=d), step_DN=14.0).data for d in (image, other))
    assert one.shape == image.shape
    changed = one != two
    assert changed[8:16, 24:32].any()
    changed[8:16, 24:32] = False
    assert not changed.any()
    flat = np.full((47, 61), 96, np.uint8)
    np.testing.assert_array_equal(acted("compression", Frame(data=flat), step_DN=16.0).data, flat)
    colour = np.repeat(image[..., None], 3, axis=2)
    np.testing.assert_array_equal(acted("compression", Frame(data=colour), step_DN=14.0).data[..., 2], one)


def intra_h264(frames: list[np.ndarray], quantiser: int) -> list[np.ndarray]:
    """Return frames after libx264 with every frame intra at one quantiser."""
    buffer = io.BytesIO()
    with av.open(buffer, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.height, stream.width = frames[0].shape
        stream.pix_fmt = "yuv420p"
        stream.options = {"qp": str(quantiser), "bf": "0", "x264-params": "keyint=1:ipratio=1"}
        for frame in frames:
            picture = av.VideoFrame.from_ndarray(np.repeat(frame[..., None], 3, axis=2), format="rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    buffer.seek(0)
    with av.open(buffer) as container:
        return [f.to_ndarray(format="rgb24")[..., 1] for f in container.decode(video=0)]


@pytest.mark.parametrize("noise", [2.0, 5.0])
def test_error_is_that_of_a_real_codec(noise: float) -> None:
    """Its prediction, block sizes and loop filter are not in the model: a tenth of the error's size, found by trial."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:304, :400]
    r = np.hypot(u - 220, v - 140) / 70
    clean = ndimage.gaussian_filter(40 + 120 * (r < 1) * (1 - 0.5 * r**2), 1.0) + 0.05 * u
    frame = np.clip(clean + noise * rng.standard_normal(clean.shape), 0, 255).astype(np.uint8)
    for quantiser in (18, 24, 30):
        (decoded,) = intra_h264([frame], quantiser)
        step = 0.625 * 2 ** (quantiser / 6) * 255 / 219
        modelled = acted("compression", Frame(data=frame), step_DN=step).data
        real, model = (np.std(made.astype(float) - frame) for made in (decoded, modelled))
        assert model == pytest.approx(real, rel=0.12)


# --- what a fit may vary ---------------------------------------------------------------------------------------------

CAMERA_AND_LIGHT = [
    "black_level",
    "tone_curve",
    "vignetting",
    "defocus",
    "distortion_drift",
    "hot_pixels",
    "rolling_shutter",
    "rolling_skew",
    "saturation",
    "sensor_dust",
    "frame_rate",
    "compression",
    "ambient_light",
    "led_dead",
    "led_imbalance",
    "supply_sag",
    "led_warmup",
    "glass_absorption",
    "specks",
    "scratch",
    "residue_film",
    "lateral_glow",
    "led_bin",
    "led_droop",
    "led_spread",
    "led_air_gap",
    "glass_dispersion",
    "edge_finish",
    "led_edge_reflections",
    "real_contact",
]


@pytest.mark.parametrize("name", CAMERA_AND_LIGHT)
def test_each_says_how_it_scales_and_what_a_fit_may_vary(name: str) -> None:
    effect = all_effects()[name]
    found = {candidate.name: candidate for candidate in effect.candidate_parameters()}
    assert effect.scaling
    assert effect.needs
    assert set(effect.amplitudes) & set(found), "a fit can leave the null"
    for candidate in found.values():
        # A prior as wide as all that is allowed would say nothing.
        assert candidate.deviation <= 0.5 * (candidate.bounds[1] - candidate.bounds[0])
    # A point to start from is away from the null.
    starts = {c.name: c.start[0] for c in found.values() if c.start}
    assert not starts or not effect.is_null(effect.with_values(starts))
    away = {c.name: (c.start or (min(c.null + c.deviation, c.bounds[1]),))[0] for c in found.values()}
    assert not effect.is_null(effect.with_values(away))
