"""From raw numbers to the 8-bit frame: black level off, digital gain, tone curve."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Curve = Literal["linear", "bt709", "srgb", "libcamera"]

# "rpi.contrast" gamma_curve of the tuning file src/ipa/rpi/vc4/data/imx477.json in the libcamera sources
# (github.com/raspberrypi/libcamera, commit 10e4e5ba1e230d44d2b88cd4fe20572738b484bd): input, output of 65535.
# The adaptive contrast enhancement that the same file switches on moves with each image's histogram; it is not here.
_LIBCAMERA_IMX477 = (
    np.fromstring(
        """
        0 0  1024 5040  2048 9338  3072 12356  4096 15312  5120 18051  6144 20790  7168 23193  8192 25744  9216 27942
        10240 30035  11264 32005  12288 33975  13312 35815  14336 37600  15360 39168  16384 40642  18432 43379
        20480 45749  22528 47753  24576 49621  26624 51253  28672 52698  30720 53796  32768 54876  36864 57012
        40960 58656  45056 59954  49152 61183  53248 62355  57344 63419  61440 64476  65535 65535
        """,
        sep=" ",
    ).reshape(-1, 2)
    / 65535.0
)


def linear(light: ArrayLike) -> Array:
    """Return the light itself, 0 to 1.

    Parameters
    ----------
    light : array_like
        Relative, 0 to 1 [1].

    Returns
    -------
    ndarray
        Shape of ``light``, 0 to 1 [1].
    """
    return np.asarray(light, np.float64)


def bt709(light: ArrayLike) -> Array:
    """Return the camera curve of ITU-R BT.709-6 (2015), item 1.2: 1.099 L^0.45 - 0.099, linear below 0.018.

    Parameters
    ----------
    light : array_like
        Relative, 0 to 1 [1].

    Returns
    -------
    ndarray
        Shape of ``light``, 0 to 1 [1].
    """
    light = np.asarray(light, np.float64)
    return np.where(light < 0.018, 4.5 * light, 1.099 * np.maximum(light, 0.018) ** 0.45 - 0.099)


def srgb(light: ArrayLike) -> Array:
    """Return the curve of IEC 61966-2-1:1999: 1.055 L^(1/2.4) - 0.055, linear below 0.0031308.

    Parameters
    ----------
    light : array_like
        Relative, 0 to 1 [1].

    Returns
    -------
    ndarray
        Shape of ``light``, 0 to 1 [1].
    """
    light = np.asarray(light, np.float64)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055)


def libcamera(light: ArrayLike) -> Array:
    """Return libcamera's default contrast curve of the IMX477, straight between its published points.

    Parameters
    ----------
    light : array_like
        Relative, 0 to 1 [1].

    Returns
    -------
    ndarray
        Shape of ``light``, 0 to 1 [1].
    """
    return np.interp(np.asarray(light, np.float64), *_LIBCAMERA_IMX477.T)


CURVES: dict[str, Callable[[ArrayLike], Array]] = {
    "linear": linear,
    "bt709": bt709,
    "srgb": srgb,
    "libcamera": libcamera,
}


def relative_light(raw: NDArray[Any], *, black_level_DN: float, bits: int, digital_gain: float = 1.0) -> Array:
    """Return linear light of raw numbers, 0 at the black level and 1 at the top of the range, clipped to both.

    Parameters
    ----------
    raw : ndarray
        [DN].
    black_level_DN : float
        [DN].
    bits : int
        Of the raw numbers.
    digital_gain : float
        [1].

    Returns
    -------
    ndarray
        Shape of ``raw`` [1].
    """
    top = 2**bits - 1
    return np.clip((np.asarray(raw, np.float64) - black_level_DN) * (digital_gain / (top - black_level_DN)), 0.0, 1.0)


def develop(
    raw: NDArray[np.uint16], *, black_level_DN: float, bits: int, curve: Curve, digital_gain: float = 1.0
) -> NDArray[np.uint8]:
    """Return the 8-bit grey frame of raw numbers.

    Parameters
    ----------
    raw : ndarray of uint16 (rows, cols)
        [DN].
    black_level_DN : float
        Taken off first [DN].
    bits : int
        Of the raw numbers.
    curve : {"linear", "bt709", "srgb", "libcamera"}
    digital_gain : float
        Applied to linear light, before the curve [1].
    """
    every = np.arange(2**bits)
    light = relative_light(every, black_level_DN=black_level_DN, bits=bits, digital_gain=digital_gain)
    table = np.floor(255.0 * CURVES[curve](light) + 0.5).astype(np.uint8)
    return np.asarray(table[raw])


def undevelop(frame: NDArray[np.uint8], *, curve: Curve) -> Array:
    """Return the linear light, 0 to 1, whose 8-bit value is nearest to that of each pixel: the curve's inverse.

    Parameters
    ----------
    frame : ndarray of uint8
    curve : {"linear", "bt709", "srgb", "libcamera"}

    Returns
    -------
    ndarray
        Shape of ``frame`` [1].
    """
    light = np.linspace(0.0, 1.0, 65536)
    return np.asarray(np.interp(np.arange(256) / 255.0, CURVES[curve](light), light)[frame])
