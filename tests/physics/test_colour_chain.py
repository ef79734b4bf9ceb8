"""The colour camera in the whole chain: photon transfer per channel, the fast renderer, cards, files, errors."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.chain.fast import FastCamera
from evanesce.chain.simulate import expose, expose_light, simulate, solve_contact
from evanesce.core.states import SensorLight
from evanesce.optics.seen import seen_at
from evanesce.render.fast.operators import operators
from evanesce.render.fast.operators_llvm import llvm_works
from evanesce.render.fast.readout import ChargeBox, Readout
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene, load_scene
from evanesce.sensor.colour import ImageProcessor, channel_map, develop_colour

RESPONSE = [0.9, 0.12, 0.04]
SMALL = {"camera.resolution_px": [240, 180], "camera.scale_px_per_mm": 11.0, "grid.samples": 256}


def red(**changes: object) -> Scene:
    table = {"camera.colour": {"response": RESPONSE, "temperature_K": 3250.0, "mosaic": "GRBG"}}
    return load_scene("thesis_ridged", SMALL | {"camera.tone_curve": "libcamera"} | table | changes)


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_photon_transfer_of_each_channel(channel: int) -> None:
    """EMVA 1288: variance over mean of the raw values, dark level off, is the conversion gain, whatever the filter."""
    scene = red()
    camera, pixel = scene.camera, scene.camera.pixel
    here = channel_map((180, 240), "GRBG") == channel
    # even light that fills two thirds of a channel of response 1 without clipping
    full_e = (4095 - pixel.black_level_DN) * pixel.conversion_gain_e_per_DN
    photon_J = 6.62607015e-34 * 299792458.0 / (camera.wavelength_nm * 1e-9)
    area = (pixel.pitch_um * 1e-3) ** 2
    photons = 0.6 * full_e / (pixel.quantum_efficiency * RESPONSE[0])
    irradiance = photons * photon_J / (area * camera.exposure_ms * 1e-3)
    light = SensorLight(irradiance=np.full((180, 240), irradiance))
    a, b = (expose_light(scene, light, seed=3, index=i).raw[here].astype(float) for i in (0, 1))
    signal = (a + b).mean() / 2 - pixel.black_level_DN
    mean_e = photons * pixel.quantum_efficiency * RESPONSE[channel]
    assert signal == pytest.approx(mean_e / pixel.conversion_gain_e_per_DN, abs=4 * np.sqrt(mean_e / 2.0 / here.sum()))
    variance = ((a - b) ** 2).mean() / 2
    expected = (mean_e + pixel.read_noise_e**2) / pixel.conversion_gain_e_per_DN**2 + 1 / 12
    assert variance == pytest.approx(expected, rel=5 * np.sqrt(2 / here.sum()))


def test_fast_frames_are_those_of_the_chain() -> None:
    scene = red(**{"camera.exposure_ms": 120.0})
    fast = FastCamera(scene)
    assert fast.falls_back == ""
    general = simulate(scene, 5.0, seed=2, render=render_fast)
    found = fast.frame(general.state, seed=2, with_raw=True)
    assert found.data.shape == (180, 240, 3)
    # Noise is drawn otherwise, and the fast flank's rim is rounded to a tenth of a millimetre: means of regions.
    rows, cols = np.indices((180, 240))
    radius_mm = np.hypot(rows - 89.5, cols - 119.5) / 11.0
    channels = channel_map((180, 240), "GRBG")
    for region, tolerance in ((radius_mm < 2.5, 0.005), ((radius_mm > 4.0) & (radius_mm < 6.5), 0.02)):
        for channel in range(3):
            here = region & (channels == channel)
            a, b = (f.raw[here].astype(float) - 256.0 for f in (found, general.frame))
            assert a.mean() == pytest.approx(b.mean(), rel=tolerance, abs=4 * np.sqrt(2 * b.var() / here.sum()))
    processor = ImageProcessor.of(scene.camera)
    developed = develop_colour(found.raw, processor, pattern="GRBG", black_level_DN=256.0, bits=12)
    np.testing.assert_array_equal(developed, found.data)
    np.testing.assert_array_equal(fast.frame(general.state, seed=2).data, found.data)


def test_both_backends_give_the_same_colour_frame() -> None:
    scene = red(**{"camera.exposure_ms": 60.0})
    contact = simulate(scene, 2.0, seed=1, render=render_fast).state
    llvm = FastCamera(scene)
    if llvm.backend != "llvm":
        pytest.skip("Dr.Jit's LLVM backend does not work here")
    one, other = (camera.frame(contact, seed=4).data.astype(int) for camera in (llvm, FastCamera(scene, "numpy")))
    assert np.mean(one != other) < 1e-3
    assert np.abs(one - other).max() <= 2


def test_contact_is_white_and_flank_red_where_the_exposure_is_long() -> None:
    frame = FastCamera(red(**{"camera.exposure_ms": 150.0})).press(5.0, seed=1).data
    assert frame[85:95, 115:125].min() > 250
    ring = frame[90, 120 + 60]  # 5.5 mm from the axis: flank
    assert ring[0] > 60
    assert ring[1] == 0
    assert ring[2] < 40
    assert frame[5, 5].max() < 20


def test_automatic_exposure_reaches_the_frame_and_goes_through_the_general_chain() -> None:
    scene = red(**{"camera.auto_exposure": {"metering": "spot"}})
    camera = FastCamera(scene)
    assert "automatic" in camera.falls_back
    frame = camera.press(5.0, seed=1)
    assert frame.exposure_ms is not None
    assert frame.analogue_gain is not None
    total = frame.exposure_ms * frame.analogue_gain
    fixed = red(**{"camera.exposure_ms": frame.exposure_ms, "camera.analogue_gain": frame.analogue_gain})
    np.testing.assert_array_equal(simulate(fixed, 5.0, seed=1, render=render_fast).frame.data, frame.data)
    brighter = FastCamera(red(**{"camera.auto_exposure": {"metering": "spot"}, "leds.voltage_V": 12.0})).press(
        5.0, seed=1
    )
    assert brighter.exposure_ms is not None
    assert brighter.analogue_gain is not None
    assert brighter.exposure_ms * brighter.analogue_gain < total


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("tone_curve", {"gamma": 1.2}),
        ("compression", {"step_DN": 8.0}),
        ("black_level", {"offset_DN": 20.0}),
        ("saturation", {"well_loss": 0.8}),
        ("hot_pixels", {"fraction": 0.01}),
        ("vignetting", {"k": 0.4}),
        ("ambient_light", {"radiance_W_per_mm2_sr": 1e-8}),
    ],
)
def test_effects_act_on_colour_frames(effect: str, values: dict[str, float]) -> None:
    bright = {"camera.exposure_ms": 20.0}
    plain = simulate(red(**bright), 3.0, seed=1, render=render_fast).frame.data.astype(int)
    found = simulate(red(**bright, effects={effect: values}), 3.0, seed=1, render=render_fast).frame.data
    assert found.shape == plain.shape
    assert found.dtype == np.uint8
    assert np.abs(found - plain).max() > 3


@pytest.mark.parametrize("backend", ["llvm", "numpy"])
def test_a_box_of_light_that_begins_at_an_odd_pixel_meets_the_right_filters(backend: str) -> None:
    """Behind filters that differ by place, even light gives each place its own share, wherever its box begins."""
    if backend == "llvm" and not llvm_works():
        pytest.skip("Dr.Jit's LLVM backend does not work here")
    share, values = (1.0, 0.5, 0.25, 0.125), np.tile(np.arange(4096, dtype=np.uint16), (4, 1))
    readout = Readout((40, 50), 0.0, 8180.0, 3.0, 1 / 2.13, 256.0, values, share)
    lit = ChargeBox(7, 13, np.full((21, 26), 4000.0, np.float32))
    data, _ = operators(backend).exposure(readout, (1, 2), False).finish(lit)  # type: ignore[arg-type]
    inside = np.zeros((40, 50), bool)
    inside[7:28, 13:39] = True
    for place, part in enumerate(share):
        here = inside.copy()
        here[(np.indices(here.shape)[0] % 2 != place // 2) | (np.indices(here.shape)[1] % 2 != place % 2)] = False
        expected = 4000.0 * part / 2.13 + 256.0
        assert data[here].mean() == pytest.approx(expected, abs=5 * np.sqrt(4000.0 * part) / 2.13 / np.sqrt(here.sum()))
    assert abs(data[~inside].mean() - 256.0) < 1.0


def test_exposing_a_red_scene_sees_it_at_its_lights_wavelength() -> None:
    """Light rendered elsewhere is counted in photons of the LEDs' wavelength, whether or not the scene was moved."""
    scene = load_scene("thesis_ridged_red", SMALL)
    rig, state = solve_contact(scene, 3.0, seed=1)
    light = render_fast(rig, state)
    as_read, moved = (expose(s, light, seed=1, without=("noise",))[1].raw for s in (scene, seen_at(scene)))
    np.testing.assert_array_equal(as_read, moved)
