"""Automatic exposure and balance where the answer is a line of arithmetic; denoising, contrast and sharpening."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.rig import Camera
from evanesce.rig.colour import AutoExposure, Colour
from evanesce.sensor.automatic import BRIGHT_TARGET, MEAN_TARGET, STAGES, metering_weights, settle, stage_of
from evanesce.sensor.colour import ImageProcessor, channel_map, mosaic
from evanesce.sensor.enhance import denoised, sharpened, stretched
from evanesce.sensor.tone import CURVES
from evanesce.sensor.tuning import white_imx477

FULL_E = (4095 - 256) * 2.13  # charge at full scale, gain 1
RESPONSE = (1.0, 0.12, 0.04)


def camera(colour: Colour | None = None, **control: object) -> Camera:
    return Camera(
        resolution_px=(120, 90),
        exposure_ms=10.0,
        colour=colour,
        auto_exposure=AutoExposure(**control),
        tone_curve="linear",
    )


def flat(share: float) -> np.ndarray:
    """Return an even frame that gives ``share`` of full scale at 10 ms."""
    return np.full((90, 120), share * FULL_E)


@pytest.mark.parametrize("share", [0.02, 0.4, 3.0])
def test_an_even_grey_frame_settles_on_the_bright_target(share: float) -> None:
    # Both targets look at the same level: the higher decides.
    found, processor = settle(flat(share), camera())
    assert processor is None
    assert found.auto_exposure is None
    assert share * found.exposure_ms * found.analogue_gain / 10.0 == pytest.approx(
        max(BRIGHT_TARGET, MEAN_TARGET), rel=2e-3
    )


def test_a_small_bright_patch_lets_the_mean_decide() -> None:
    # Less than a tenth of the frame is bright, the rest dark: clipped or not, its mean never comes to 0.16, and the
    # control goes to its end.
    level, share = np.zeros((90, 120)), 28 * 36 / (90 * 120)
    level[30:58, 40:76] = FULL_E
    found, _ = settle(level, camera(metering="matrix"))
    assert (found.exposure_ms, found.analogue_gain) == STAGES["normal"][-1]
    # A ground of 0.01 is raised until the mean of both is right.
    found, _ = settle(np.maximum(level, 0.01 * FULL_E), camera(metering="matrix"))
    ground = 0.01 * found.exposure_ms * found.analogue_gain / 10.0
    assert share + (1 - share) * ground == pytest.approx(MEAN_TARGET - 0.001, abs=0.002)


def test_red_light_is_exposed_by_its_green() -> None:
    # Even red light: green is 0.12 of red, and the brightest 2 % of the green are to reach 0.3.
    colour = Colour(response=RESPONSE)
    charge = mosaic(flat(0.5), RESPONSE, "RGGB")
    found, processor = settle(charge, camera(colour, metering="matrix"))
    assert processor == ImageProcessor.of(camera(colour))
    total = found.exposure_ms * found.analogue_gain / 10.0
    assert 0.5 * 0.12 * total == pytest.approx(BRIGHT_TARGET, rel=2e-3)
    assert 0.5 * total > 1.2, "red is clipped"


def test_compensation_is_a_factor_on_the_targets() -> None:
    one, two = (settle(flat(0.3), camera(compensation=c))[0] for c in (1.0, 2.0))
    assert two.exposure_ms * two.analogue_gain == pytest.approx(2 * one.exposure_ms * one.analogue_gain, rel=2e-3)


@pytest.mark.parametrize("mode", sorted(STAGES))
def test_stages_share_a_total_without_jumps(mode: str) -> None:
    ends = [stage[0] * stage[1] for stage in STAGES[mode]]
    totals = np.geomspace(ends[0], ends[-1], 300)
    pairs = np.array([stage_of(total, mode) for total in totals])
    np.testing.assert_allclose(pairs.prod(axis=1), totals, rtol=1e-12)
    assert (np.diff(pairs, axis=0) >= -1e-12).all(), "neither exposure nor gain ever falls"
    for stage in STAGES[mode]:
        np.testing.assert_allclose(stage_of(stage[0] * stage[1], mode), stage)
    assert stage_of(10 * ends[-1], mode) == STAGES[mode][-1]


def test_metering_is_symmetric_and_heaviest_in_the_middle() -> None:
    for name in ("centre-weighted", "spot", "matrix"):
        weights = metering_weights(name)
        np.testing.assert_array_equal(weights, weights[::-1])
        np.testing.assert_array_equal(weights, weights[:, ::-1])
        assert weights.max() == weights[7, 7]
    assert metering_weights("centre-weighted").sum() == 374
    assert metering_weights("spot").sum() == 19


@pytest.mark.parametrize("temperature", [2700.0, 3250.0, 4660.0, 6125.0])
def test_white_light_is_balanced_at_its_own_temperature(temperature: float) -> None:
    # A card that this sensor sees 1/1.05 as red and blue as the one the curve was measured with.
    red, blue = white_imx477(temperature)
    colour = Colour(white_balance="automatic", response=(1.0, 1.0, 1.0))
    level = flat(0.5) * np.linspace(0.3, 1.0, 120)
    charge = level * np.array([red / 1.05, 1.0, blue / 1.05])[channel_map((90, 120), "RGGB")]
    _, processor = settle(charge, camera(colour))
    assert processor is not None
    assert processor.red_gain * red / 1.05 == pytest.approx(1.0, abs=0.02)
    assert processor.blue_gain * blue / 1.05 == pytest.approx(1.0, abs=0.02)


def test_red_light_leaves_the_balance_to_the_prior() -> None:
    # No temperature makes it grey: all cost the same, and dim light is likeliest warm.
    colour = Colour(white_balance="automatic", response=RESPONSE)
    _, processor = settle(mosaic(flat(0.2), RESPONSE, "RGGB"), camera(colour))
    assert processor is not None
    np.testing.assert_allclose(processor.red_gain, 1.05 / white_imx477(2500.0)[0], rtol=1e-9)


def test_a_dark_frame_keeps_the_set_balance() -> None:
    colour = Colour(white_balance="automatic", response=RESPONSE, temperature_K=4000.0)
    _, processor = settle(flat(0.0), camera(colour))
    assert processor == ImageProcessor.of(camera(colour))


def test_denoising_smooths_noise_keeps_edges_and_is_absent_at_zero() -> None:
    rng = np.random.default_rng(0)
    mean = np.full((80, 100), 1500.0)
    mean[:, 50:] = 3000.0
    noise = np.sqrt((mean - 256) / 2.13)
    raw = np.clip(mean + noise * rng.standard_normal(mean.shape), 0, 4095).round().astype(np.uint16)
    found = denoised(raw, 1.5, black_level_DN=256.0, bits=12).astype(float)
    left, right = found[4:-4, 4:44], found[4:-4, 56:-4]
    assert left.std() < 0.5 * raw[4:-4, 4:44].std()
    assert left.mean() == pytest.approx(1500.0, abs=3.0)
    assert right.mean() == pytest.approx(3000.0, abs=3.0)
    assert abs(found[10:-10, 49].mean() - 1500.0) < 10.0, "nothing crosses the edge"
    np.testing.assert_array_equal(denoised(raw, 0.0, black_level_DN=256.0, bits=12), raw)


def test_contrast_moves_the_ends_and_keeps_the_median() -> None:
    ramp = np.linspace(5000, 60000, 4001).round().astype(np.uint16)
    linear = np.repeat(ramp[None, :, None], 3, axis=2)
    plain = np.floor(255 * CURVES["bt709"](linear / 65535.0) + 0.5)
    found = stretched(linear, "bt709").astype(float)
    assert abs(found[0, 2000, 0] - plain[0, 2000, 0]) <= 1
    # the 1 % point (5550) lies beyond what may move: 1483 goes to 983, the 95 % point's 60260 to 62259
    level = np.interp(ramp, [0, 983.04 + 500, 32500, 60260, 65535], [0, 983.04, 32500, 62259.2, 65535])
    np.testing.assert_allclose(found[0, :, 0], 255 * CURVES["bt709"](level / 65535), atol=1.0)
    assert found[0, 0, 0] < plain[0, 0, 0]
    assert found[0, -1, 0] > plain[0, -1, 0]
    assert (np.diff(found[0, :, 0]) >= 0).all()


def test_sharpening_leaves_even_light_and_faint_noise_and_steepens_an_edge() -> None:
    rng = np.random.default_rng(1)
    frame = np.full((60, 80, 3), 90, np.uint8)
    frame[:, 40:] = 160
    noisy = (frame + rng.integers(-1, 2, frame.shape[:2])[..., None]).astype(np.uint8)
    np.testing.assert_array_equal(sharpened(noisy, 1.0)[:, :30], noisy[:, :30])
    found = sharpened(frame, 1.0).astype(int)
    assert found[30, 39, 1] < 90
    assert found[30, 40, 1] > 160
    np.testing.assert_array_equal(found[..., 0], found[..., 2])
