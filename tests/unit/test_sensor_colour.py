"""A colour camera against closed forms: mosaics, white cards, clipped red light, photon transfer."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.sensor.colour import (
    ImageProcessor,
    channel_map,
    colour_of_level,
    develop_colour,
    level_bounds,
    mosaic,
)
from evanesce.sensor.pixel import collect
from evanesce.sensor.readout import amplify, quantise

PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
PLAIN = ImageProcessor(1.0, 1.0, IDENTITY, "linear")
LUMA = np.array([0.2125, 0.7154, 0.0721])


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("demosaicing", ["bilinear", "edge-aware"])
def test_even_colour_survives_every_mosaic(pattern: str, demosaicing: str) -> None:
    # Unequal channels: swapped patterns, rows or columns show.
    share = (0.8, 0.45, 0.15)
    raw = quantise(mosaic(np.full((14, 18), 4095.0), share, pattern), 12)
    processor = ImageProcessor(1.0, 1.0, IDENTITY, "linear", demosaicing)
    frame = develop_colour(raw, processor, pattern=pattern, black_level_DN=0.0, bits=12)
    np.testing.assert_allclose(frame, np.broadcast_to(np.array(share) * 255, frame.shape), atol=0.6)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_bilinear_demosaicing_keeps_a_plane(pattern: str) -> None:
    # A plane is its own bilinear interpolation, away from the border.
    rows, cols = np.indices((20, 30))
    plane = 400.0 + 60.0 * rows + 30.0 * cols
    frame = develop_colour(quantise(plane, 12), PLAIN, pattern=pattern, black_level_DN=0.0, bits=12)
    inner = (slice(2, -2), slice(2, -2))
    expected = np.repeat((plane * 255 / 4095)[..., None], 3, axis=2)
    np.testing.assert_allclose(frame[inner], expected[inner], atol=0.6)


def test_one_red_pixel_reaches_its_neighbours_as_bilinear_weights() -> None:
    raw = np.zeros((9, 9), np.uint16)
    raw[4, 4] = 4000  # a red place of RGGB
    frame = develop_colour(raw, PLAIN, pattern="RGGB", black_level_DN=0.0, bits=12)
    kernel = np.outer([0.5, 1.0, 0.5], [0.5, 1.0, 0.5]) * 4000 * 255 / 4095
    np.testing.assert_allclose(frame[3:6, 3:6, 0], kernel, atol=0.6)
    assert not frame[..., 1:].any()
    frame[3:6, 3:6] = 0
    assert not frame.any()


@pytest.mark.parametrize("temperature", [2360.0, 2848.0, 3643.0, 5579.0, 9505.0])
def test_a_white_card_of_the_tunings_temperature_is_grey(temperature: float) -> None:
    # Rows of a colour matrix that keeps white sum to 1; the published ones do to 1e-5.
    processor = ImageProcessor.imx477(temperature)
    card = 0.4 / processor.gains
    frame = colour_of_level([0.2, 0.5, 1.0], tuple(card), processor)
    assert np.abs(np.diff(frame.astype(int), axis=1)).max() <= 1
    assert np.all(np.diff(frame[:, 1].astype(int)) > 20)


def test_published_points_of_the_tuning() -> None:
    processor = ImageProcessor.imx477(2848.0)
    assert processor.red_gain == pytest.approx(1 / 0.5071)
    assert processor.blue_gain == pytest.approx(1 / 0.4)
    np.testing.assert_allclose(ImageProcessor.imx477(2400.0).matrix[1], (-0.43521, 2.09769, -0.66248))
    with pytest.raises(ValueError, match="2360 to 9505 K"):
        ImageProcessor.imx477(2000.0)


@pytest.mark.parametrize("shares", [(0.08, 0.03), (0.12, 0.04), (0.15, 0.06)])
@pytest.mark.parametrize("temperature", [2500.0, 3250.0])
def test_green_of_red_light_appears_where_the_matrix_says(shares: tuple[float, float], temperature: float) -> None:
    # With red clipped and blue not: green = m0 + (m1 g + m2 b_gain b) x, which is 0 at x = -m0 / (m1 g + m2 b_gain b).
    processor = ImageProcessor.imx477(temperature)
    green, blue = shares
    m = processor.matrix[1]
    onset = -m[0] / (m[1] * green + m[2] * processor.blue_gain * blue)
    assert 1.0 / processor.red_gain < onset < 1.0 / (processor.blue_gain * blue)
    levels = onset * np.array([0.98, 1.1])
    frame = colour_of_level(levels, (1.0, green, blue), processor)
    assert frame[0, 1] == 0
    assert frame[1, 1] > 0


def test_clipped_red_light_is_pure_red_and_its_grey_the_luma_weight_of_red() -> None:
    # From where red is full to where blue rises, grey stays at red's weight: a narrow peak of any histogram.
    frame = colour_of_level(np.geomspace(0.4, 0.6, 30), (1.0, 0.12, 0.04), ImageProcessor.imx477(2500.0))
    assert np.all(frame[:, 0] == 255)
    assert not frame[:, 1].any()
    grey = frame @ LUMA / 255
    assert np.all((grey >= 0.2125 - 1e-9) & (grey < 0.2125 + 0.0721 * 40 / 255))


def test_each_raw_channel_obeys_photon_transfer() -> None:
    # Shot noise: variance over gain is the mean; read noise adds (EMVA 1288). Clipping is of each channel by itself.
    gain_e, read_e, black, share = 2.13, 3.0, 256.0, (1.0, 0.3, 0.1)
    rng = np.random.default_rng(11)
    charge = mosaic(np.full((600, 800), 5000.0), share, "GBRG")
    signal = amplify(
        collect(charge, 8180.0, rng),
        conversion_gain_e_per_DN=gain_e,
        analogue_gain=1.0,
        read_noise_e=read_e,
        black_level_DN=black,
        rng=rng,
    )
    raw = quantise(signal, 12).astype(float)
    for channel, filter_share in enumerate(share):
        values = raw[channel_map(raw.shape, "GBRG") == channel]
        mean_e = 5000.0 * filter_share
        variance = (mean_e + read_e**2) / gain_e**2 + 1 / 12
        n = values.size
        assert values.mean() - black == pytest.approx(mean_e / gain_e, abs=5 * np.sqrt(variance / n))
        assert values.var() == pytest.approx(variance, rel=5 * np.sqrt(2 / n))


def test_level_is_read_back_from_colour_within_its_bounds() -> None:
    processor, response = ImageProcessor.imx477(3250.0), (1.0, 0.12, 0.04)
    levels = np.geomspace(1e-3, 1e2, 4000)
    true = np.geomspace(0.01, 60.0, 80).reshape(8, 10)
    colour = colour_of_level(true, response, processor)
    low, high = level_bounds(colour, response, processor, tolerance_DN=1.0, levels=levels)
    step = levels[1] / levels[0]
    assert np.all(low <= true * step)
    assert np.all(high >= true / step)
    # Narrow where a channel is neither cut nor clipped; open upwards where all are full.
    assert np.median(high / low) < 1.3
    assert high[-1, -1] == levels[-1]


def test_a_colour_that_no_level_gives_is_nan() -> None:
    green = np.array([[[0, 200, 0]]], np.uint8)
    low, high = level_bounds(
        green, (1.0, 0.1, 0.04), ImageProcessor.imx477(2850.0), tolerance_DN=3.0, levels=np.geomspace(1e-3, 1e2, 500)
    )
    assert np.isnan(low).all()
    assert np.isnan(high).all()
