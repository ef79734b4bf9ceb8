"""Tone curves against published points and another implementation of sRGB."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.color import rgb2xyz

from evanesce.sensor.tone import CURVES, develop, undevelop


@pytest.mark.parametrize("name", CURVES)
def test_curve_runs_from_0_to_1_and_rises(name: str) -> None:
    light = np.linspace(0, 1, 5001)
    value = CURVES[name](light)
    assert value[0] == 0.0
    assert value[-1] == pytest.approx(1.0, abs=1e-12)
    assert np.all(np.diff(value) > 0)


def test_srgb_is_undone_by_scikit_image() -> None:
    light = np.linspace(0, 1, 257)
    grey = np.repeat(CURVES["srgb"](light)[:, None], 3, axis=1)
    # The luminance row of the matrix sums to 1 to 1e-7; the two segments of the standard meet to 1e-7.
    np.testing.assert_allclose(rgb2xyz(grey[None])[0, :, 1], light, atol=1e-6)


def test_bt709_at_its_published_points() -> None:
    # Break at L = 0.018 -> 0.081; the two branches meet there to the rounding of the standard's constants, 2e-4.
    np.testing.assert_allclose(CURVES["bt709"]([0.018 - 1e-9, 0.018 + 1e-9]), 0.081, atol=3e-4)
    assert float(CURVES["bt709"](0.18)) == pytest.approx(0.409, abs=5e-4)


def test_libcamera_lifts_shadows_more_than_bt709() -> None:
    # Quarter light: 40642/65535 in the tuning file.
    assert float(CURVES["libcamera"](16384 / 65535)) == pytest.approx(40642 / 65535, abs=1e-12)
    light = np.linspace(0.03, 0.9, 50)
    assert np.all(CURVES["libcamera"](light) > CURVES["bt709"](light))


def test_linear_frame_is_scaled_raw() -> None:
    raw = np.array([[0, 200, 256, 257], [1000, 2175, 4094, 4095]], dtype=np.uint16)
    got = develop(raw, black_level_DN=256.0, bits=12, curve="linear")
    np.testing.assert_array_equal(got, [[0, 0, 0, 0], [49, 127, 255, 255]])
    # Digital gain acts on linear light: (1000 - 256) * 2 / 3839 * 255 = 98.8
    doubled = develop(raw, black_level_DN=256.0, bits=12, curve="linear", digital_gain=2.0)
    np.testing.assert_array_equal(doubled, [[0, 0, 0, 0], [99, 255, 255, 255]])


@pytest.mark.parametrize("name", CURVES)
@pytest.mark.parametrize("bits", [8, 12, 16])
def test_undeveloped_light_develops_to_the_same_frame(name: str, bits: int) -> None:
    raw = np.arange(2**bits, dtype=np.uint16)[None]
    frame = develop(raw, black_level_DN=7.0, bits=bits, curve=name)  # type: ignore[arg-type]
    light = undevelop(frame, curve=name)  # type: ignore[arg-type]
    again = np.floor(255 * CURVES[name](light) + 0.5)
    np.testing.assert_array_equal(again, frame)
    # Half an 8-bit step over the curve's slope, plus half a raw step.
    truth = np.clip((raw - 7.0) / (2**bits - 8.0), 0, 1)
    steepest = np.diff(CURVES[name](np.linspace(0, 1, 2001))).min() * 2000
    assert np.abs(light - truth).max() <= 0.5 / 255 / steepest + 1e-4
