"""Noise from replicates: size, jitter, correlation, and the mean of rounded values, against direct simulation."""

import numpy as np
import pytest
from scipy import ndimage, stats

from evanesce.evaluation.agreement import coarser
from evanesce.prediction.correlation import of_fields
from evanesce.prediction.noise import jitter_of, noise_of
from evanesce.prediction.tone import expected_tone
from evanesce.prediction.views import binned
from evanesce.rig import load_scene
from evanesce.sensor.readout import quantise
from evanesce.sensor.tone import develop


@pytest.fixture(scope="module")
def camera():
    return load_scene("thesis", coarser(5)).camera


def test_mean_and_variance_of_rounded_values(camera):
    """Oracle: 200 000 pixels drawn, quantised and developed by the sensor's own functions."""
    rng, pixel, tone = np.random.default_rng(5), camera.pixel, expected_tone(camera)
    for signal in (256.05, 256.4, 300.0, 1234.3):
        charge = (signal - pixel.black_level_DN) * pixel.conversion_gain_e_per_DN
        noisy = rng.poisson(charge, 200_000) + pixel.read_noise_e * rng.standard_normal(200_000)
        raw = quantise(noisy / pixel.conversion_gain_e_per_DN + pixel.black_level_DN, pixel.bits)
        values = develop(raw, black_level_DN=pixel.black_level_DN, bits=pixel.bits, curve=camera.tone_curve).astype(
            float
        )
        mean = float(tone.mean_of(np.array([signal]))[0])
        error = np.sqrt(values.var() / values.size)
        # The charge is Poisson, the table Gaussian: at 2 e- they differ by some hundredths of a step.
        assert abs(mean - values.mean()) < 4 * error + 0.01
        assert np.interp(signal, tone.signal, tone.variance) == pytest.approx(values.var(), rel=0.05, abs=0.01)


def frames(rng, count, blur, flicker, level):
    """Return binned frames of Gaussian noise, ``blur`` bins correlated, on a patch of light."""
    rows, cols = level.shape
    noise = rng.standard_normal((count, rows, cols))
    if blur:
        noise = ndimage.gaussian_filter(noise, (0, blur, blur), mode="wrap")
        noise /= noise.std()
    gains = 1 + flicker * rng.standard_normal(count)
    return gains[:, None, None] * level + 0.4 * np.sqrt(level / 100) * noise


@pytest.fixture
def level():
    y, x = np.mgrid[0:75, 0:100]
    return np.where(np.hypot(y - 30, x - 57) < 22, 110.0, 0.0) + 40.0 + 0.1 * x


@pytest.mark.parametrize("blur", [0.0, 0.8])
def test_draws_have_unit_variance_and_the_correlation_of_the_replicates(camera, level, blur):
    rng = np.random.default_rng(8)
    found = noise_of(
        {"replicate": frames(rng, 24, blur, 0.0, level)}, expected_tone(camera), level.shape, floor_DN=1e-3, flicker=0.0
    )
    cubes = found.draws((3, 75, 100), 60, rng)
    neighbour = float((cubes[..., 1:] * cubes[..., :-1]).mean() / cubes.var())
    # Of Gaussian smoothing: exp(-1/(4 sigma^2)).
    expected = np.exp(-1 / (4 * blur**2)) if blur else 0.0
    assert cubes.var() == pytest.approx(1.0, abs=0.1)
    assert neighbour == pytest.approx(expected, abs=0.06)


def test_where_noise_is_nowhere_above_the_floor_draws_are_white_and_of_unit_variance(camera, level):
    """Rationale: frames of 2000 x 1500 pixels leave bins quieter than the floor; their draws were all zero.

    Any residual was then louder than each of them, and a rig with nothing wrong was called unknown.
    """
    rng = np.random.default_rng(5)
    found = noise_of(
        {"replicate": frames(rng, 12, 0.8, 0.0, level)}, expected_tone(camera), level.shape, floor_DN=3.0, flicker=0.0
    )
    cubes = found.draws((3, 75, 100), 60, rng)
    assert cubes.var() == pytest.approx(1.0, abs=0.1)
    assert abs(float((cubes[..., 1:] * cubes[..., :-1]).mean())) < 0.06


@pytest.mark.parametrize("lit", ["a small disc", "all of a few bins", "of one level"])
def test_few_bins_that_are_bright_enough_are_one_group(camera, lit):
    """Rationale: eight groups of 97 bins were all too small, and nothing was left to interpolate between."""
    rng = np.random.default_rng(6)
    y, x = np.mgrid[0:75, 0:100]
    level = np.where(np.hypot(y - 30, x - 57) < 5.5, 110.0 + 0.3 * x, 0.0)
    if lit != "a small disc":
        level = np.full((10, 12), 90.0) + (0.2 * x[:10, :12] if lit == "all of a few bins" else 0.0)
    stack = level + 0.4 * rng.standard_normal((12, *level.shape)) * (level > 50)
    found = noise_of({"replicate": stack}, expected_tone(camera), level.shape, floor_DN=0.05, flicker=0.0)
    expected = stack.var(axis=0, ddof=1)[level > 50].mean()
    assert found.variance(level)[level > 50].mean() == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize("blur", [0.0, 0.8])
def test_means_of_whole_views_are_drawn_as_loud_as_they_are(camera, level, blur):
    """Rationale: a null was called unknown by its view means: the fit of each replicate's light takes their noise.

    A sum over a view, from 2000 fields of the same noise; 24 replicates know a variance to 30 %.
    """
    rng, tone = np.random.default_rng(8), expected_tone(camera)
    light = 0.002 * rng.standard_normal(24)[:, None, None] * tone.slope_by_light(level)
    held = {"replicate": frames(rng, 24, blur, 0.0, level) + light}
    found = noise_of(held, tone, level.shape, floor_DN=1e-3, flicker=0.0)
    drawn = np.concatenate([found.draws((20, *level.shape), 20, rng).reshape(400, -1) for _ in range(3)])
    even = np.full_like(level, 100.0)
    real = (frames(rng, 2000, blur, 0.0, even) - even).reshape(2000, -1) / 0.4
    assert drawn.sum(1).std() == pytest.approx(real.sum(1).std(), rel=0.3)


def test_size_of_noise_is_found_beside_flicker(camera, level):
    rng = np.random.default_rng(3)
    stack = frames(rng, 24, 0.0, 0.004, level)
    found = noise_of({"replicate": stack}, expected_tone(camera), level.shape, floor_DN=1e-3, flicker=0.0)
    bright = level > 100
    expected = 0.4**2 * level[bright].mean() / 100
    assert found.variance(level)[bright].mean() == pytest.approx(expected, rel=0.1)
    assert found.variance(level, 4)[bright].mean() == pytest.approx(expected / 4, rel=0.1)


def test_without_replicates_nothing_is_claimed(camera, level):
    found = noise_of({}, expected_tone(camera), level.shape, floor_DN=0.05, flicker=0.002)
    assert not found.measured


def test_binned_keeps_the_mean():
    image = np.random.default_rng(1).random((13, 9))
    assert binned(image).shape == (3, 2)
    assert binned(image)[1, 1] == pytest.approx(image[4:8, 4:8].mean())


@pytest.mark.parametrize("curve", ["linear", "srgb", "libcamera"])
def test_flicker_is_that_of_light_whatever_the_tone_curve(curve):
    """Charges drawn by numpy with a known jitter pass the sensor's own quantisation and tone curve."""
    own = load_scene("thesis", {"camera.resolution_px": [160, 120], "camera.tone_curve": curve}).camera
    pixel, rng = own.pixel, np.random.default_rng(13)
    y, x = np.mgrid[0:120, 0:160]
    charge = 300.0 + 3500.0 * np.exp(-((x - 70.0) ** 2 + (y - 52.0) ** 2) / 1500.0)
    jitter = 0.004 * rng.standard_normal(40)
    stack = []
    for change in jitter:
        noisy = rng.poisson(charge * np.exp(change)) + pixel.read_noise_e * rng.standard_normal(charge.shape)
        raw = quantise(noisy / pixel.conversion_gain_e_per_DN + pixel.black_level_DN, pixel.bits)
        stack.append(binned(develop(raw, black_level_DN=pixel.black_level_DN, bits=pixel.bits, curve=curve)))
    found = noise_of({"replicate": np.array(stack)}, expected_tone(own), (30, 40), floor_DN=1e-3, flicker=0.0)
    # The scatter of these very draws; the frames' own noise adds 1 % of it at most.
    assert found.flicker == pytest.approx(jitter.std(ddof=1) * np.sqrt(39 / 37), rel=0.06)


def test_a_few_frames_know_the_jitter_as_student_does():
    """Oracle: the variance of Student's t with n - 1 degrees of freedom, scaled."""
    light = np.random.default_rng(4).standard_normal(9)
    assert jitter_of(light) == pytest.approx(light.std(ddof=1) * stats.t(8).std(), rel=1e-12)


def test_bins_that_err_together_are_made_white():
    """Fields low-passed by SciPy: fresh ones have a flat spectrum after it; white ones are left as they are.

    Rationale: smooth fields of such noise were called unknown in frames with nothing wrong.
    """
    rng = np.random.default_rng(6)

    def noise(count):
        smooth = ndimage.gaussian_filter(rng.standard_normal((count, 75, 100)), (0, 0.4, 0.4), mode="wrap")
        return smooth / smooth.std()

    assert of_fields(rng.standard_normal((11, 75, 100)), 3) is None
    found = of_fields(noise(11), 3)
    assert found is not None
    waves = [np.cos(np.pi * k * (np.arange(100) + 0.5) / 100) for k in range(1, 12)]
    fresh = noise(300).reshape(100, 3, 75, 100)
    low = [np.mean([(one.sum(axis=1) @ w) ** 2 / (75 * (w @ w)) for one in cubes for w in waves])
           for cubes in (fresh, np.array([found.whitened(one, [0, 1, 2]) for one in fresh]))]  # fmt: skip
    assert low[0] > 1.15
    assert low[1] == pytest.approx(1.0, abs=0.06)
