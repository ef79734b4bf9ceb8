"""What an image processor adds for the eye: denoising, contrast by the histogram, sharpening.

Settings and the rule of the contrast curve are those of the libcamera sources (src/ipa/rpi/controller/rpi and
src/ipa/rpi/vc4/data/imx477.json; github.com/raspberrypi/libcamera, commit 26bfadc66e8d7f727a993fe58174217b8a96f7f9).
The filters behind denoising and sharpening are in silicon and not published: those here are stand-ins of the same
kind, with the published settings.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.sensor.tone import CURVES, Curve, relative_light

Array = NDArray[np.float64]

NOISE_SLOPE = 2.767
"""Standard deviation over the square root of the signal, both of 16-bit linear light: "rpi.noise" of the tuning."""

LOW_SHARE, LOW_LEVEL, LOW_MOST = 0.01, 0.015, 500.0
HIGH_SHARE, HIGH_LEVEL, HIGH_MOST = 0.95, 0.95, 2000.0
"""Share of the histogram, level to which it is moved [1], and by how much at most [of 65536]: defaults of
"rpi.contrast"."""

SHARPEN_THRESHOLD, SHARPEN_STRENGTH, SHARPEN_LIMIT = 0.75, 1.0, 0.5
""""rpi.sharpen" of the tuning."""

_LUMA = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601, which the processor's statistics and YCbCr have
_DETAIL_SIGMA_PX = 1.0  # assumed
_DETAIL_NOISE_DN = 4.0  # assumed: what a threshold of 1 means in 8-bit luma
_DETAIL_LIMIT_DN = 128.0  # assumed: what a limit of 1 means


def denoised(raw: NDArray[np.uint16], strength: float, *, black_level_DN: float, bits: int) -> NDArray[np.uint16]:
    """Return a raw mosaic smoothed where neighbours of the same colour differ by no more than noise does.

    A sigma filter (J.-S. Lee, Computer Vision, Graphics, and Image Processing 24 (1983) 255) over the eight nearest
    pixels of the same colour, within ``2 strength`` standard deviations of the tuning's noise model.

    Parameters
    ----------
    raw : ndarray of uint16 (rows, cols)
        [DN].
    strength : float
        0 leaves the mosaic as it is [1].
    black_level_DN : float
        [DN].
    bits : int

    Returns
    -------
    ndarray of uint16 (rows, cols)
        [DN].
    """
    light = relative_light(raw, black_level_DN=black_level_DN, bits=bits)
    relative = (2.0 * strength * NOISE_SLOPE / 256.0) * np.sqrt(np.maximum(light, 1e-4))
    reach, value = (relative * (2**bits - 1 - black_level_DN)).astype(np.float32), raw.astype(np.float32)
    padded = np.pad(value, 2, mode="reflect")
    total, count = value.copy(), np.ones_like(value)
    rows, cols = raw.shape
    for down in (0, 2, 4):
        for across in (0, 2, 4):
            if (down, across) == (2, 2):
                continue
            other = padded[down : down + rows, across : across + cols]
            taken = np.abs(other - value) <= reach
            total += np.where(taken, other, np.float32(0))
            count += taken
    return np.floor(total / count + np.float32(0.5)).astype(np.uint16)


def stretched(linear: NDArray[np.uint16], curve: Curve) -> NDArray[np.uint8]:
    """Return the 8-bit frame by a tone curve that is stretched to the frame's own histogram.

    The 1 % point of the luma's histogram goes down to 0.015 of full scale, by 500 of 65536 at the most, the 95 % point
    up to 0.95, by 2000 at the most; the median stays.

    Parameters
    ----------
    linear : ndarray of uint16 (rows, cols, 3)
        After the colour matrix; 65535 is full scale.
    curve : {"linear", "bt709", "srgb", "libcamera"}

    Returns
    -------
    ndarray of uint8 (rows, cols, 3)
        [DN].
    """
    luma = linear.astype(np.float32) @ _LUMA.astype(np.float32)
    low, middle, high = np.quantile(luma, (LOW_SHARE, 0.5, HIGH_SHARE))
    low_to, high_to = LOW_LEVEL * 65536, HIGH_LEVEL * 65536
    low = max(low_to, min(65535.0, low, low_to + LOW_MOST))
    high = min(high_to, max(0.0, high, high_to - HIGH_MOST))
    # Points of the processor's curve in its own order: they need not rise where the frame is dark or bright all over.
    points = [(0.0, 0.0), (low, low_to), (middle, middle), (high, high_to), (65535.0, 65535.0)]
    rising = [points[0]]
    for x, y in points[1:]:
        if x > rising[-1][0]:
            rising.append((x, y))
    level = np.interp(np.arange(65536), *np.array(rising).T)
    table = np.floor(255.0 * CURVES[curve](np.clip(level / 65535.0, 0.0, 1.0)) + 0.5).astype(np.uint8)
    return np.asarray(table.take(linear))


def sharpened(frame: NDArray[np.uint8], strength: float) -> NDArray[np.uint8]:
    """Return a frame with its luma's fine detail raised: an unsharp mask with threshold and limit.

    Parameters
    ----------
    frame : ndarray of uint8 (rows, cols, 3)
        [DN].
    strength : float
        0 leaves the frame as it is; 1 is the tuning's [1].

    Returns
    -------
    ndarray of uint8 (rows, cols, 3)
        [DN].
    """
    luma = frame.astype(np.float32) @ _LUMA.astype(np.float32)
    detail = luma - cv2.GaussianBlur(luma, (0, 0), _DETAIL_SIGMA_PX)
    root = float(np.sqrt(strength))
    threshold = SHARPEN_THRESHOLD / max(0.01, root) * _DETAIL_NOISE_DN
    limit = SHARPEN_LIMIT * root * _DETAIL_LIMIT_DN
    above = np.sign(detail) * np.maximum(np.abs(detail) - np.float32(threshold), 0)
    change = np.clip(SHARPEN_STRENGTH * strength * above, -limit, limit)
    return np.clip(np.floor(frame + change[..., None] + 0.5), 0, 255).astype(np.uint8)
