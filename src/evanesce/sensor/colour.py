"""A colour sensor and its image processor: filter mosaic, white balance, demosaicing, colour matrix, tone curve.

The order is that of the Raspberry Pi's image processor: black level, white balance on the raw mosaic, demosaicing,
colour matrix, tone curve. Light of one narrow spectrum, such as a red LED's, reaches the three filters in fixed shares
(its ``response``); the developed colour is then a function of one number, the light's level, and can be read backwards
(:func:`level_bounds`).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.core.threads import in_threads
from evanesce.rig import Camera
from evanesce.rig.colour import Mosaic as Pattern
from evanesce.sensor.enhance import denoised, sharpened, stretched
from evanesce.sensor.tone import CURVES, Curve, relative_light
from evanesce.sensor.tuning import matrix_imx477, white_imx477

Array = NDArray[np.float64]
CHANNELS = "RGB"

# OpenCV names a mosaic by the colours of its second row and column.
DEMOSAIC: dict[tuple[Pattern, str], int] = {
    ("RGGB", "bilinear"): cv2.COLOR_BayerBG2RGB,
    ("BGGR", "bilinear"): cv2.COLOR_BayerRG2RGB,
    ("GRBG", "bilinear"): cv2.COLOR_BayerGB2RGB,
    ("GBRG", "bilinear"): cv2.COLOR_BayerGR2RGB,
    ("RGGB", "edge-aware"): cv2.COLOR_BayerBG2RGB_EA,
    ("BGGR", "edge-aware"): cv2.COLOR_BayerRG2RGB_EA,
    ("GRBG", "edge-aware"): cv2.COLOR_BayerGB2RGB_EA,
    ("GBRG", "edge-aware"): cv2.COLOR_BayerGR2RGB_EA,
}


_ROWS = 60  # of a block that a thread works on: what fits into a core's cache; even


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
    contrast_enhancement : bool
        Whether the tone curve is stretched by the frame's histogram (:func:`~evanesce.sensor.enhance.stretched`).
    sharpening, denoising : float
        Strengths; 0: none (:func:`~evanesce.sensor.enhance.sharpened`, :func:`~evanesce.sensor.enhance.denoised`).
    """

    red_gain: float
    blue_gain: float
    matrix: tuple[tuple[float, float, float], ...]
    curve: Curve = "libcamera"
    demosaicing: Literal["bilinear", "edge-aware"] = "bilinear"
    contrast_enhancement: bool = False
    sharpening: float = 0.0
    denoising: float = 0.0

    @classmethod
    def imx477(cls, temperature_K: float, **other: Any) -> ImageProcessor:
        """Return libcamera's published tuning of the IMX477 for a colour temperature.

        Parameters
        ----------
        temperature_K : float
            At which white balance and matrix are taken; 2360 to 9505, the ends of the published curve [K]. Under light
            of one narrow spectrum automatic white balance has no white to find: the temperature is then unknown.
        **other
            Further attributes; ``red_gain`` and ``blue_gain`` in place of the tuning's.

        Returns
        -------
        ImageProcessor

        Raises
        ------
        ValueError
            If the temperature lies outside.
        """
        red, blue = white_imx477(temperature_K)
        gains = {"red_gain": float(1 / red), "blue_gain": float(1 / blue)}
        return cls(**{**gains, "matrix": matrix_imx477(temperature_K), **other})

    @classmethod
    def of(cls, camera: Camera) -> ImageProcessor:
        """Return the processor of a colour camera, white balance fixed.

        Parameters
        ----------
        camera : Camera
            With a table ``colour``.

        Returns
        -------
        ImageProcessor
        """
        colour = camera.colour
        if colour is None:
            raise ValueError("a monochrome camera has no colour processor")
        given = {"red_gain": colour.red_gain, "blue_gain": colour.blue_gain}
        return cls.imx477(
            colour.temperature_K,
            curve=camera.tone_curve,
            demosaicing=colour.demosaicing,
            contrast_enhancement=colour.contrast_enhancement,
            sharpening=colour.sharpening,
            denoising=colour.denoising,
            **{name: gain for name, gain in given.items() if gain is not None},
        )

    @property
    def gains(self) -> Array:
        """White balance of red, green and blue (3,) [1]."""
        return np.array([self.red_gain, 1.0, self.blue_gain])

    def linear(self, balanced: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Return linear output of balanced camera colour: the matrix, cut at 0 and full scale.

        Parameters
        ----------
        balanced : ndarray of uint16 (rows, cols, 3)
            After white balance; 65535 is full scale.

        Returns
        -------
        ndarray of uint16 (rows, cols, 3)
        """
        return np.asarray(cv2.transform(balanced, np.array(self.matrix)), np.uint16)

    def finished(self, balanced: ArrayLike) -> NDArray[np.uint8]:
        """Return 8-bit colour of balanced camera colour: matrix, clipping to 0 to 1, tone curve.

        What depends on neighbours or on the whole frame (contrast, sharpening, denoising) is left out.

        Parameters
        ----------
        balanced : array_like (..., 3)
            After white balance, 1 at full scale [1].

        Returns
        -------
        ndarray of uint8 (..., 3)
            [DN].
        """
        balanced = np.asarray(balanced, np.float64)
        sixteen = _sixteen(np.clip(balanced, 0.0, 1.0)).reshape(-1, 1, 3)
        return np.asarray(tone_table(self.curve)[self.linear(sixteen)].reshape(balanced.shape))


def _sixteen(light: Array) -> NDArray[np.uint16]:
    """Return light from 0 to 1 on 16 bits."""
    return np.floor(65535.0 * light + 0.5).astype(np.uint16)


@functools.lru_cache(maxsize=8)
def tone_table(curve: Curve) -> NDArray[np.uint8]:
    """Return the 8-bit value of each 16-bit linear one (65536,) [DN].

    Parameters
    ----------
    curve : {"linear", "bt709", "srgb", "libcamera"}
    """
    return np.floor(255.0 * CURVES[curve](np.arange(65536) / 65535.0) + 0.5).astype(np.uint8)


@functools.lru_cache(maxsize=8)
def balance_table(processor: ImageProcessor, black_level_DN: float, bits: int) -> NDArray[np.uint16]:
    """Return the 16-bit balanced value of each raw number of a red, green and blue pixel (3, 2^bits).

    Black level off, white balance, cut at full scale.

    Parameters
    ----------
    processor : ImageProcessor
    black_level_DN : float
        [DN].
    bits : int
    """
    light = relative_light(np.arange(2**bits), black_level_DN=black_level_DN, bits=bits)
    return _sixteen(np.minimum(light * processor.gains[:, None], 1.0))


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

    Denoising on the raw mosaic; black level off; white balance, cut at full scale; demosaicing on 16 bits; colour
    matrix, cut at 0 and full scale; tone curve; sharpening.

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
    if processor.denoising > 0.0:
        raw = denoised(raw, processor.denoising, black_level_DN=black_level_DN, bits=bits)
    return finish_mosaic(
        balanced_mosaic(raw, balance_table(processor, black_level_DN, bits), pattern), processor, pattern
    )


def balanced_mosaic(raw: NDArray[np.uint16], table: NDArray[np.uint16], pattern: Pattern) -> NDArray[np.uint16]:
    """Return a mosaic after black level and white balance.

    Parameters
    ----------
    raw : ndarray of uint16 (rows, cols)
        [DN].
    table : ndarray of uint16 (3, 2^bits)
        :func:`balance_table`.
    pattern : {"RGGB", "BGGR", "GRBG", "GBRG"}

    Returns
    -------
    ndarray of uint16 (rows, cols)
        65535 is full scale.
    """
    balanced = np.empty_like(raw)
    for place, letter in enumerate(pattern):
        here = np.s_[place // 2 :: 2, place % 2 :: 2]
        balanced[here] = table[CHANNELS.index(letter)].take(raw[here])
    return balanced


def finish_mosaic(balanced: NDArray[np.uint16], processor: ImageProcessor, pattern: Pattern) -> NDArray[np.uint8]:
    """Return the 8-bit colour frame of a balanced mosaic: demosaicing, matrix, tone curve, sharpening.

    Parameters
    ----------
    balanced : ndarray of uint16 (rows, cols)
        :func:`balanced_mosaic`.
    processor : ImageProcessor
    pattern : {"RGGB", "BGGR", "GRBG", "GBRG"}

    Returns
    -------
    ndarray of uint8 (rows, cols, 3)
        Red, green, blue [DN].
    """
    rows, cols = balanced.shape
    tone, linear = tone_table(processor.curve), np.empty((rows, cols, 3), np.uint16)
    frame = np.empty((rows, cols, 3), np.uint8)

    def work(block: range) -> None:
        # Demosaicing looks two rows up and down; an even first row keeps the mosaic's pattern.
        first, last = max(0, block.start - 2), min(rows, block.stop + 2)
        colour = np.asarray(cv2.cvtColor(balanced[first:last], DEMOSAIC[pattern, processor.demosaicing]), np.uint16)
        here = slice(block.start, block.stop)
        linear[here] = processor.linear(colour[block.start - first : block.stop - first])
        if not processor.contrast_enhancement:
            np.take(tone, linear[here], out=frame[here], mode="clip")  # half the time of mode "raise"

    in_threads(work, rows, _ROWS)
    if processor.contrast_enhancement:
        frame = stretched(linear, processor.curve)
    return sharpened(frame, processor.sharpening) if processor.sharpening > 0.0 else frame


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
    return processor.finished(_balanced_level(level, response, processor))


def exact_colour_of_level(level: ArrayLike, response: Sequence[float], processor: ImageProcessor) -> Array:
    """Return the same before it is rounded to 16 and 8 bits, for fits that need derivatives.

    Parameters
    ----------
    level : array_like (...)
        As for :func:`colour_of_level`.
    response : sequence of 3 float
    processor : ImageProcessor

    Returns
    -------
    ndarray (..., 3)
        Red, green, blue [DN].
    """
    linear = np.clip(_balanced_level(level, response, processor) @ np.array(processor.matrix).T, 0.0, 1.0)
    return np.asarray(255.0 * CURVES[processor.curve](linear))


def _balanced_level(level: ArrayLike, response: Sequence[float], processor: ImageProcessor) -> Array:
    raw = np.minimum(np.asarray(level, np.float64)[..., None] * np.asarray(response, np.float64), 1.0)
    return np.asarray(np.minimum(raw * processor.gains, 1.0))


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
