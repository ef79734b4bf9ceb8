"""Pixel and readout against EMVA 1288: photon transfer, saturation, fixed pattern, and exact nulls."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evanesce.core import rng
from evanesce.core.states import PlateLight, SensorLight
from evanesce.optics.projection import Projection
from evanesce.rig import Camera, Distortion, Plate
from evanesce.rig.camera import Lens, Pixel
from evanesce.sensor.expose import charge_of, expose
from evanesce.sensor.lens import form_image
from evanesce.sensor.pixel import fixed_pattern, photon_count
from evanesce.sensor.readout import quantise

PLATE = Plate(size_mm=(120.0, 80.0), thickness_mm=5.3, refractive_index=1.471)
HC = 1.98644586e-25  # Planck's constant times the speed of light [J m], CODATA 2018


def camera(exposure_ms: float = 7.0, **pixel: float) -> Camera:
    values = {
        "pitch_um": 3.7,
        "quantum_efficiency": 0.47,
        "full_well_capacity_e": 8000.0,
        "conversion_gain_e_per_DN": 4.1,
        "read_noise_e": 5.2,
        "black_level_DN": 233.0,
    } | pixel
    return Camera(
        resolution_px=(901, 640),
        scale_px_per_mm=21.0,
        exposure_ms=exposure_ms,
        analogue_gain=1.7,
        wavelength_nm=531.0,
        lens=Lens(distortion=Distortion(k1=-0.2)),
        pixel=Pixel(**values),
    )


def flat(electrons: float, cam: Camera) -> SensorLight:
    """Light that gives a mean charge, worked backwards by hand."""
    photons = electrons / cam.pixel.quantum_efficiency
    area = (cam.pixel.pitch_um * 1e-3) ** 2
    power = photons * HC / 531e-9 / (cam.exposure_ms * 1e-3)
    return SensorLight(irradiance=np.full((640, 901), power / area))


def test_one_watt_of_green_light() -> None:
    # 555 nm: 3.579e-19 J a photon, so 1 W/mm^2 on 1 mm^2 for 1 s brings 2.794e18 of them.
    got = photon_count(np.array(1.0), pitch_um=1000.0, fill_factor=1.0, exposure_s=1.0, wavelength_nm=555.0)
    assert float(got) == pytest.approx(555e-9 / HC, rel=1e-8)
    assert float(got) == pytest.approx(2.794e18, rel=1e-3)


def test_photon_transfer_on_rendered_flat_fields_returns_gain_and_read_noise() -> None:
    """EMVA 1288, sections 2.6 and 6.6: variance of pairs against mean; slope is the gain, intercept the read noise."""
    view = Projection.of(camera(), PLATE).ideal_view()
    means, variances = [], []
    for step, exposure_ms in enumerate(np.linspace(0.0, 1.0, 9) * 9.3 + 0.001):
        cam = camera(exposure_ms=float(exposure_ms))
        light = PlateLight(
            radiance=np.full(view.shape, 3.1e-7 if step else 0.0),
            variance=np.zeros(view.shape),
            focal_px=view.focal_px,
            principal_point=view.principal_point,
        )
        image = form_image(light, cam, PLATE)
        a, b = (expose(image, cam, rng=rng.generator(11, "pair", step, i)).raw for i in (0, 1))
        assert a is not None
        assert b is not None
        # Differences of pairs drop all that is fixed in space: cos^4, vignetting, pattern.
        means.append((a.mean() + b.mean()) / 2 - 233.0)
        variances.append((a.astype(float) - b).var(ddof=1) / 2)
    assert 1000 < max(means) < 3000  # a good part of the range, and no pixel saturates
    gain, intercept = np.polyfit(means, variances, 1, w=1 / np.asarray(variances))
    print(f"photon transfer: gain {gain:.4f} DN/e-, put in {1.7 / 4.1:.4f};", end=" ")
    # n = 577,000 pixels: a variance is known to sqrt(2/n) = 0.2 %, the slope a little better.
    assert gain == pytest.approx(1.7 / 4.1, rel=0.02)
    read_noise_DN = np.sqrt(variances[0] - 1 / 12)  # quantisation adds 1/12 DN^2
    print(f"read noise {read_noise_DN / gain:.3f} e-, put in 5.2")
    assert read_noise_DN / gain == pytest.approx(5.2, rel=0.02)
    assert np.sqrt(intercept - 1 / 12) / gain == pytest.approx(5.2, rel=0.02)


def test_shot_noise_is_poisson() -> None:
    cam = camera(read_noise_e=0.0)
    raw = expose(flat(1234.0, cam), cam, rng=np.random.default_rng(1)).raw
    assert raw is not None
    electrons = (raw - 233.0) * 4.1 / 1.7
    n = raw.size
    assert electrons.mean() == pytest.approx(1234.0, abs=5 * np.sqrt(1234.0 / n))
    quantisation = (4.1 / 1.7) ** 2 / 12
    assert electrons.var() == pytest.approx(1234.0 + quantisation, rel=5 * np.sqrt(2 / n))


def test_without_noise_the_raw_number_is_exact() -> None:
    cam = camera(dark_current_e_per_s=2000.0)
    frame = expose(flat(1500.0, cam), cam, rng=None)
    expected = np.floor((1500.0 + 2000.0 * 7e-3) * 1.7 / 4.1 + 233.0 + 0.5)
    np.testing.assert_array_equal(frame.raw, expected)
    dark = expose(SensorLight(irradiance=np.zeros((640, 901))), camera(), rng=None)
    np.testing.assert_array_equal(dark.raw, 233)
    np.testing.assert_array_equal(dark.data, 0)


def test_null_noise_with_a_generator_is_still_exact_in_the_dark() -> None:
    cam = camera(read_noise_e=0.0)
    dark = expose(SensorLight(irradiance=np.zeros((640, 901))), cam, rng=np.random.default_rng(2))
    np.testing.assert_array_equal(dark.raw, 233)


def test_full_well_clips_charge_before_gain() -> None:
    cam = camera(read_noise_e=0.0, full_well_capacity_e=3000.0)
    frame = expose(flat(9000.0, cam), cam, rng=np.random.default_rng(2))
    np.testing.assert_array_equal(frame.raw, round(3000.0 * 1.7 / 4.1 + 233.0))


def test_converter_clips_at_its_top() -> None:
    cam = camera(full_well_capacity_e=1e6)
    frame = expose(flat(5e5, cam), cam, rng=np.random.default_rng(2))
    np.testing.assert_array_equal(frame.raw, 4095)
    np.testing.assert_array_equal(frame.data, 255)


def test_fixed_pattern_has_the_spread_asked_for_and_stays() -> None:
    cam = camera(read_noise_e=0.0)
    pattern = fixed_pattern((640, 901), 0.013, 6.1, rng.generator(4, "sensor"))
    assert pattern is not None
    stack = [
        [expose(flat(e, cam), cam, rng=None, pattern=pattern).raw.astype(float) for _ in range(2)]  # type: ignore[union-attr]
        for e in (100.0, 6000.0)
    ]
    np.testing.assert_array_equal(stack[0][0], stack[0][1])
    to_e = 4.1 / 1.7
    n = 640 * 901
    low, high = (np.var(pair[0]) * to_e**2 - to_e**2 / 12 for pair in stack)
    # Variance over the sensor: DSNU^2 + (PRNU mean)^2; each known to 5 sqrt(2/n) = 0.9 %, halved by the root.
    assert np.sqrt((high - low) / (6000.0**2 - 100.0**2)) == pytest.approx(0.013, rel=0.01)
    assert np.sqrt(low - (0.013 * 100.0) ** 2) == pytest.approx(6.1, rel=0.01)
    again = fixed_pattern((640, 901), 0.013, 6.1, rng.generator(4, "sensor"))
    assert again is not None
    np.testing.assert_array_equal(pattern.dark_e, again.dark_e)
    assert n == pattern.dark_e.size


def test_no_pattern_where_none_is_asked_for() -> None:
    assert fixed_pattern((4, 5), 0.0, 0.0, np.random.default_rng(0)) is None


def test_same_stream_same_bytes_another_stream_another_noise() -> None:
    cam = camera()
    light = flat(700.0, cam)
    one, two, other = (expose(light, cam, rng=rng.generator(9, "exposure", i)).raw for i in (3, 3, 4))
    np.testing.assert_array_equal(one, two)
    assert (one != other).mean() > 0.5


@given(st.floats(-1e6, 1e6), st.integers(8, 16))
def test_quantisation_is_within_half_a_step_or_at_a_stop(value: float, bits: int) -> None:
    got = int(quantise(np.array([value]), bits)[0])
    top = 2**bits - 1
    assert 0 <= got <= top
    if -0.5 <= value < top + 0.5:
        assert abs(got - value) <= 0.5
    else:
        assert got == (0 if value < 0 else top)


def test_dark_current_follows_arrhenius_and_is_constant_without_an_energy() -> None:
    kelvin, boltzmann = 273.15, 8.617333262e-5
    hot = Pixel(dark_current_e_per_s=7.0, dark_activation_energy_eV=0.6, dark_reference_C=20.0, temperature_C=45.0)
    ratio = np.exp(0.6 / boltzmann * (1 / (20 + kelvin) - 1 / (45 + kelvin)))
    assert hot.dark_rate_e_per_s == pytest.approx(7.0 * ratio, rel=1e-6)
    assert Pixel(dark_current_e_per_s=7.0, temperature_C=45.0).dark_rate_e_per_s == 7.0


def test_dark_nonuniformity_grows_with_exposure_and_leaves_the_rest_of_the_pattern() -> None:
    """Spatial spread of the mean charge is sigma_D t; sensitivity and DSNU are those drawn without it."""
    plain = fixed_pattern((400, 500), 0.01, 2.0, rng.generator(3, "sensor"))
    spread = fixed_pattern((400, 500), 0.01, 2.0, rng.generator(3, "sensor"), 0.4)
    assert plain is not None
    assert spread is not None
    np.testing.assert_array_equal(plain.sensitivity, spread.sensitivity)
    np.testing.assert_array_equal(plain.dark_e, spread.dark_e)
    dark = SensorLight(irradiance=np.zeros((640, 901)))
    for exposure_ms in (1000.0, 4000.0):
        cam = camera(exposure_ms, dark_current_e_per_s=50.0, dark_nonuniformity_e_per_s=20.0)
        own = fixed_pattern((640, 901), 0.0, 0.0, rng.generator(3, "sensor"), cam.pixel.dark_spread)
        charge = charge_of(dark, cam, own)
        # Standard deviation of a gamma's sample deviation, kurtosis 3 + 6 x 0.16: below 0.1 % of 576,640 pixels.
        assert charge.mean() == pytest.approx(50.0 * exposure_ms * 1e-3, rel=0.003)
        assert charge.std() == pytest.approx(20.0 * exposure_ms * 1e-3, rel=0.005)


def test_nonuniformity_of_no_dark_current_is_refused() -> None:
    with pytest.raises(ValueError, match="dark_nonuniformity_e_per_s"):
        Pixel(dark_nonuniformity_e_per_s=1.0)


def test_a_scene_with_spread_dark_current_takes_the_general_chain() -> None:
    from evanesce.chain.fast import _why_general
    from evanesce.rig import load_scene

    scene = load_scene("thesis")
    pixel = scene.camera.pixel.model_copy(update={"dark_current_e_per_s": 5.0, "dark_nonuniformity_e_per_s": 2.0})
    changed = scene.model_copy(update={"camera": scene.camera.model_copy(update={"pixel": pixel})})
    assert _why_general(scene, []) == ""
    assert _why_general(changed, []) == "camera.pixel: fixed pattern"
