"""A colour sensor and its image processor: filter mosaic, white balance, demosaicing, colour matrix, tone curve.

The order is that of the Raspberry Pi's image processor: black level, white balance on the raw mosaic, demosaicing,
colour matrix, tone curve. Light of one narrow spectrum, such as a red LED's, reaches the three filters in fixed shares
(its ``response``); the developed colour is then a function of one number, the light's level, and can be read backwards
(:func:`level_bounds`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.sensor.tone import CURVES, Curve, relative_light

Array = NDArray[np.float64]
Pattern = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
CHANNELS = "RGB"

# "rpi.awb" ct_curve and "rpi.ccm" of the tuning file src/ipa/rpi/vc4/data/imx477.json in the libcamera sources
# (github.com/raspberrypi/libcamera, commit 26bfadc66e8d7f727a993fe58174217b8a96f7f9).
# Colour temperature [K], red and blue raw values of a white card over its green one.
_WHITE_IMX477 = np.array(
    [
        (2360, 0.6009, 0.3093),
        (2848, 0.5071, 0.4),
        (2903, 0.4905, 0.4392),
        (3628, 0.4261, 0.5564),
        (3643, 0.4228, 0.5623),
        (4660, 0.3529, 0.68),
        (5579, 0.3227, 0.7),
        (6125, 0.3129, 0.71),
        (6671, 0.3065, 0.72),
        (7217, 0.3014, 0.73),
        (7763, 0.295, 0.74),
        (9505, 0.2524, 0.7856),
    ]
)
# Colour temperature [K], and the matrix from balanced camera colour to linear sRGB, row by row.
_MATRICES_IMX477 = np.array(
    [
        (2850, 1.97469, -0.71439, -0.26031, -0.43521, 2.09769, -0.66248, -0.04826, -0.84642, 1.89468),
        (2960, 2.12952, -0.91185, -0.21768, -0.38018, 1.90789, -0.52771, 0.03988, -1.10079, 2.06092),
        (3580, 2.03422, -0.80048, -0.23374, -0.39089, 1.97221, -0.58132, -0.08969, -0.61439, 1.70408),
        (4559, 2.15423, -0.98143, -0.17279, -0.38131, 2.14763, -0.76632, -0.10069, -0.54383, 1.64452),
        (5881, 2.18464, -0.95493, -0.22971, -0.36826, 2.00298, -0.63471, -0.15219, -0.38055, 1.53274),
        (7600, 2.30687, -0.97295, -0.33392, -0.30872, 2.32779, -1.01908, -0.17761, -0.55891, 1.73651),
    ]
)

# OpenCV names a mosaic by the colours of its second row and column.
_DEMOSAIC: dict[tuple[Pattern, str], int] = {
    ("RGGB", "bilinear"): cv2.COLOR_BayerBG2RGB,
    ("BGGR", "bilinear"): cv2.COLOR_BayerRG2RGB,
    ("GRBG", "bilinear"): cv2.COLOR_BayerGB2RGB,
    ("GBRG", "bilinear"): cv2.COLOR_BayerGR2RGB,
    ("RGGB", "edge-aware"): cv2.COLOR_BayerBG2RGB_EA,
    ("BGGR", "edge-aware"): cv2.COLOR_BayerRG2RGB_EA,
    ("GRBG", "edge-aware"): cv2.COLOR_BayerGB2RGB_EA,
    ("GBRG", "edge-aware"): cv2.COLOR_BayerGR2RGB_EA,
}


@dataclass(frozen=True)
class ImageProcessor:
    """Settings of an image processor.

    Attributes
    ----------
    red_gain, blue_gain : float
        White balance; green has 1 [1].
    matrix : tuple of 3 x 3 float
        From balanced camera colour to linear output, row by row [1].
    curve : {"linear", "bt709", "srgb", "libcamera"}
    demosaicing : {"bilinear", "edge-aware"}
        OpenCV's; which one the Raspberry Pi's processor has is not published.
    """

    red_gain: float
    blue_gain: float
    matrix: tuple[tuple[float, float, float], ...]
    curve: Curve = "libcamera"
    demosaicing: Literal["bilinear", "edge-aware"] = "bilinear"

    @classmethod
    def imx477(cls, temperature_K: float, **other: Any) -> ImageProcessor:
        """Return libcamera's published tuning of the IMX477 for a colour temperature.

        Parameters
        ----------
        temperature_K : float
            At which white balance and matrix are taken; 2360 to 9505, the ends of the published curve [K]. Under light
            of one narrow spectrum automatic white balance has no white to find: the temperature is then unknown.
        **other
            Further attributes.

        Returns
        -------
        ImageProcessor

        Raises
        ------
        ValueError
            If the temperature lies outside.
        """
        low, high = _WHITE_IMX477[0, 0], _WHITE_IMX477[-1, 0]
        if not low <= temperature_K <= high:
            raise ValueError(f"colour temperature {temperature_K:g} K; must be from {low:g} to {high:g} K")
        red, blue = (np.interp(temperature_K, _WHITE_IMX477[:, 0], _WHITE_IMX477[:, k]) for k in (1, 2))
        # outside the calibrated temperatures libcamera keeps the nearest matrix, as np.interp does
        terms = [np.interp(temperature_K, _MATRICES_IMX477[:, 0], column) for column in _MATRICES_IMX477[:, 1:].T]
        a, b, c, d, e, f, g, h, i = (float(term) for term in terms)
        return cls(float(1 / red), float(1 / blue), ((a, b, c), (d, e, f), (g, h, i)), **other)

    @property
    def gains(self) -> Array:
        """White balance of red, green and blue (3,) [1]."""
        return np.array([self.red_gain, 1.0, self.blue_gain])

    def finished(self, balanced: ArrayLike) -> NDArray[np.uint8]:
        """Return 8-bit colour of balanced camera colour: matrix, clipping to 0 to 1, tone curve.

        Parameters
        ----------
        balanced : array_like (..., 3)
            After white balance, 1 at full scale [1].

        Returns
        -------
        ndarray of uint8 (..., 3)
            [DN].
        """
        linear = np.clip(np.asarray(balanced, np.float64) @ np.array(self.matrix).T, 0.0, 1.0)
        return np.floor(255.0 * CURVES[self.curve](linear) + 0.5).astype(np.uint8)


def channel_map(shape: tuple[int, int], pattern: Pattern) -> NDArray[np.int64]:
    """Return which filter each pixel has: 0 red, 1 green, 2 blue.

    Parameters
    ----------
    shape : tuple of int
        (rows, cols).
    pattern : {"RGGB", "BGGR", "GRBG", "GBRG"}
        The first 2 x 2 pixels, row by row.

    Returns
    -------
    ndarray of int (rows, cols)
    """
    cell = np.array([CHANNELS.index(letter) for letter in pattern]).reshape(2, 2)
    rows, cols = np.indices(shape)
    return np.asarray(cell[rows % 2, cols % 2])


def mosaic(light: ArrayLike, response: Sequence[float], pattern: Pattern) -> Array:
    """Return what the filters of a mosaic let through of light of one spectrum.

    Parameters
    ----------
    light : array_like (rows, cols)
        Of each pixel, before its filter [any unit].
    response : sequence of 3 float
        Share that a red, green and blue filter let through [1].
    pattern : {"RGGB", "BGGR", "GRBG", "GBRG"}

    Returns
    -------
    ndarray (rows, cols)
        In the unit of ``light``.
    """
    light = np.asarray(light, np.float64)
    rows, cols = light.shape
    return light * np.asarray(response, np.float64)[channel_map((rows, cols), pattern)]


def develop_colour(
    raw: NDArray[np.uint16],
    processor: ImageProcessor,
    *,
    pattern: Pattern,
    black_level_DN: float,
    bits: int,
) -> NDArray[np.uint8]:
    """Return the 8-bit colour frame of a raw mosaic.

    Black level off; white balance, cut at full scale; demosaicing on 16 bits; colour matrix, cut at 0 and full scale;
    tone curve.

    Parameters
    ----------
    raw : ndarray of uint16 (rows, cols)
        Mosaic, at least 2 x 2 [DN].
    processor : ImageProcessor
    pattern : {"RGGB", "BGGR", "GRBG", "GBRG"}
        Of the mosaic.
    black_level_DN : float
        [DN].
    bits : int
        Of the raw numbers.

    Returns
    -------
    ndarray of uint8 (rows, cols, 3)
        Red, green, blue [DN].
    """
    rows, cols = raw.shape
    light = relative_light(raw, black_level_DN=black_level_DN, bits=bits)
    balanced = np.minimum(light * processor.gains[channel_map((rows, cols), pattern)], 1.0)
    sixteen = np.floor(65535.0 * balanced + 0.5).astype(np.uint16)
    colour = cv2.cvtColor(sixteen, _DEMOSAIC[pattern, processor.demosaicing])
    return processor.finished(np.asarray(colour, np.float64) / 65535.0)


def colour_of_level(level: ArrayLike, response: Sequence[float], processor: ImageProcessor) -> NDArray[np.uint8]:
    """Return the developed colour of an even patch of light of one spectrum, without noise.

    Parameters
    ----------
    level : array_like (...)
        1 fills the raw value of a pixel whose filter has response 1 [1].
    response : sequence of 3 float
        As for :func:`mosaic`.
    processor : ImageProcessor

    Returns
    -------
    ndarray of uint8 (..., 3)
        Red, green, blue [DN].
    """
    raw = np.minimum(np.asarray(level, np.float64)[..., None] * np.asarray(response, np.float64), 1.0)
    return processor.finished(np.minimum(raw * processor.gains, 1.0))


def level_bounds(
    colour: NDArray[np.uint8],
    response: Sequence[float],
    processor: ImageProcessor,
    *,
    tolerance_DN: float,
    levels: Array,
) -> tuple[Array, Array]:
    """Return the lowest and highest light level whose developed colour agrees with each pixel's.

    A clipped channel bounds the level from one side, a channel cut to 0 from the other; only the channels together
    determine it. The answer is NaN where no level gives the colour: then response or processor are not
    those of the frame.

    Parameters
    ----------
    colour : ndarray of uint8 (..., 3)
        [DN].
    response : sequence of 3 float
        As for :func:`mosaic`.
    processor : ImageProcessor
    tolerance_DN : float
        Largest difference in every channel that still agrees [DN].
    levels : ndarray (n,)
        Levels to compare with, rising [1].

    Returns
    -------
    low, high : ndarray (...)
        [1].
    """
    pixels = colour.reshape(-1, 3).astype(np.float64)
    distinct, back = np.unique(pixels, axis=0, return_inverse=True)
    expected = colour_of_level(levels, response, processor).astype(np.float64)
    bounds = np.full((2, len(distinct)), np.nan)
    for k, pixel in enumerate(distinct):
        agrees = np.flatnonzero((np.abs(expected - pixel) <= tolerance_DN).all(axis=1))
        if agrees.size:
            bounds[:, k] = levels[agrees[0]], levels[agrees[-1]]
    low, high = bounds[:, back.ravel()].reshape(2, *colour.shape[:-1])
    return low, high
