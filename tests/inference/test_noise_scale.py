"""The size of the noise before the tone curve, from frames made by drawing electrons one by one."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy import ndimage

from evanesce.prediction.noise_scale import noise_scale_of
from evanesce.prediction.observe import pixel_scatter
from evanesce.prediction.tone import expected_tone
from evanesce.rig import Camera, load_scene
from evanesce.rig.coarser import coarser_camera
from evanesce.sensor.tone import CURVES

SHAPE = (96, 128)


def dim_camera() -> Camera:
    scene = load_scene(
        "thesis",
        {
            "camera.pixel.conversion_gain_e_per_DN": 2.1,
            "camera.analogue_gain": 13.0,
            "camera.pixel.full_well_capacity_e": 8180.0,
        },
    )
    return scene.camera


def frames(
    camera: Camera, charge_e: np.ndarray, count: int, smooth_px: float, rng: np.random.Generator, black_DN: float = 0.0
) -> np.ndarray:
    """Poisson's electrons, read noise, a low-pass on the noise, a table for the tone."""
    pixel = camera.pixel
    gain = camera.analogue_gain / pixel.conversion_gain_e_per_DN
    top = 2**pixel.bits - 1
    light = np.clip((np.arange(top + 1) - pixel.black_level_DN) / (top - pixel.black_level_DN), 0, 1)
    table = np.floor(255 * CURVES[camera.tone_curve](light) + 0.5)
    found = []
    for _ in range(count):
        noise = rng.poisson(charge_e) - charge_e + pixel.read_noise_e * rng.standard_normal(charge_e.shape)
        if smooth_px:
            noise = ndimage.gaussian_filter(noise, smooth_px, mode="wrap")
        raw = np.floor(pixel.black_level_DN + black_DN + gain * (charge_e + noise) + 0.5)
        found.append(table[np.clip(raw, 0, top).astype(int)])
    return np.array(found)


def scatter(
    camera: Camera, smooth_px: float, seed: int, black_DN: float = 0.0
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    lit = np.linspace(0.0, 300.0, SHAPE[1])[None, :] * np.ones((SHAPE[0], 1))
    shots = {"replicate": (lit, 12), "lens_cap": (np.zeros(SHAPE), 4)}
    return {k: pixel_scatter(list(frames(camera, q, n, smooth_px, rng, black_DN)), 1) for k, (q, n) in shots.items()}


@pytest.mark.parametrize("smooth_px", [0.0, 0.55])
def test_noise_smoothed_on_the_sensor_is_found_by_its_scatter(smooth_px: float) -> None:
    camera = dim_camera()
    impulse = np.zeros((33, 33))
    impulse[16, 16] = 1.0
    kept = float(np.sqrt((ndimage.gaussian_filter(impulse, smooth_px) ** 2).sum())) if smooth_px else 1.0
    found = noise_scale_of(partial(expected_tone, camera), scatter(camera, smooth_px, 31))
    # 12 x 12288 pixels: the scatter is known to 0.2 %; the low-passed Poisson noise is nearly Gaussian, not quite.
    assert found.value == pytest.approx(kept, rel=0.015)
    assert not found.codec


@pytest.mark.parametrize("black_DN", [-9.0, 7.0])
def test_another_black_level_is_neither_another_noise_nor_a_codec(black_DN: float) -> None:
    camera = dim_camera()
    found = noise_scale_of(partial(expected_tone, camera), scatter(camera, 0.0, 47, black_DN))
    assert not found.codec
    assert found.value == pytest.approx(1.0, abs=0.015)
    # The mean of 4 x 12288 dark pixels, whose noise is some ten raw numbers wide, tells black to 0.1.
    assert found.black_DN == pytest.approx(black_DN, abs=0.6)


def test_noise_smoothed_after_the_curve_is_told_by_the_dark_level() -> None:
    """A codec takes scatter and leaves the mean: the size before the curve is still found, and the codec named."""
    camera = dim_camera()
    rng = np.random.default_rng(8)
    lit = np.linspace(0.0, 300.0, SHAPE[1])[None, :] * np.ones((SHAPE[0], 1))
    made = {}
    for kind, (charge, count) in {"replicate": (lit, 12), "lens_cap": (np.zeros(SHAPE), 4)}.items():
        sharp = frames(camera, charge, count, 0.0, rng)
        made[kind] = pixel_scatter([ndimage.gaussian_filter(f, 1.0, mode="nearest") for f in sharp], 1)
    found = noise_scale_of(partial(expected_tone, camera), made)
    assert found.codec
    assert found.value == pytest.approx(1.0, abs=0.02)
    # Noise without a trace of one is the camera's own, as small as it is seen to be.
    plain = noise_scale_of(partial(expected_tone, camera), made, coded=False)
    assert not plain.codec
    assert plain.value < 0.5


@pytest.mark.parametrize("covered", [True, False])
def test_next_to_no_scatter_is_a_codecs_work(covered: bool) -> None:
    """Rationale: frames from H.264 at a low rate repeat themselves to the bit; they passed for a camera's own."""
    camera = dim_camera()
    rng = np.random.default_rng(12)
    lit = np.linspace(0.0, 300.0, SHAPE[1])[None, :] * np.ones((SHAPE[0], 1))
    made = {}
    for kind, charge in (("replicate", lit), ("lens_cap", np.zeros(SHAPE))):
        if kind == "replicate" or covered:
            mean = frames(camera, charge, 40, 0.0, rng).mean(axis=0)
            made[kind] = mean, np.full_like(mean, 1e-4)
    found = noise_scale_of(partial(expected_tone, camera), made)
    assert found.codec
    assert found.silent
    assert found.value == pytest.approx(1.0, abs=0.05)


def test_without_held_states_nothing_is_claimed() -> None:
    found = noise_scale_of(partial(expected_tone, dim_camera()), {})
    assert (found.value, found.codec) == (1.0, False)
    assert found.deviation > 0.05


@pytest.mark.parametrize("factor", [5, 10])
def test_a_camera_quieter_than_its_rounding_is_no_codec(factor: int) -> None:
    """Frames of `simulate --camera-coarser` repeat themselves to the bit; they passed for JPEG of quality 97."""
    camera = coarser_camera(load_scene("thesis"), factor).camera
    lit = np.linspace(0.0, 200.0, SHAPE[1])[None, :] * np.ones((SHAPE[0], 1))
    made = {"replicate": (lit, np.zeros(SHAPE)), "lens_cap": (np.zeros(SHAPE), np.zeros(SHAPE))}
    found = noise_scale_of(partial(expected_tone, camera), made)
    assert (found.value, found.codec, found.silent) == (1.0, False, False)
    assert noise_scale_of(partial(expected_tone, load_scene("thesis").camera), made).codec
