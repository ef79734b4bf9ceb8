"""Blur by defocus and diffraction: the point spread function, and kernels that vary over the field."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import j1

Array = NDArray[np.float64]

# The kernel reaches this many lambda*N beyond the geometric disc. The 2/(pi^2 * 8) = 2.5 % of an Airy pattern that
# falls outside is spread evenly within, so that no light is lost; stray light farther out is not modelled.
_DIFFRACTION_REACH = 8.0
_MAX_TRANSFORM = 4096  # finest grid of a kernel's transform; only discs far larger than the Airy pattern meet it
_ZONE_STEP_PX = 1.0  # disc diameters of neighbouring blur zones differ by at most this, unless there are too many
_MAX_ZONES = 10


# --- point spread function -------------------------------------------------------------------------------------------


def diffraction_mtf(frequency: ArrayLike, wavelength_um: float, f_number: float) -> Array:
    """Return the modulation transfer of a perfect lens with a round pupil in incoherent light.

    Parameters
    ----------
    frequency : array_like
        Spatial frequency on the sensor [1/um].
    wavelength_um : float
        [um].
    f_number : float
        Working f-number [1]; the cut-off is 1/(lambda N).

    References
    ----------
    Goodman, "Introduction to Fourier Optics", 3rd ed. (2005), section 6.3.
    """
    s = np.clip(np.abs(np.asarray(frequency, float)) * wavelength_um * f_number, 0.0, 1.0)
    return np.asarray((2 / math.pi) * (np.arccos(s) - s * np.sqrt(1 - s * s)))


def disc_mtf(frequency: ArrayLike, diameter_um: float) -> Array:
    """Return the transfer (signed) of a uniform disc of light, the geometric image of a defocused point [1].

    Parameters
    ----------
    frequency : array_like
        Spatial frequency on the sensor [1/um].
    diameter_um : float
        [um].
    """
    argument = math.pi * diameter_um * np.abs(np.asarray(frequency, float))
    return np.divide(2 * j1(argument), argument, out=np.ones_like(argument), where=argument > 1e-12)


def defocus_disc(defocus_um: ArrayLike, f_number: float) -> Array:
    """Return the diameter [um] of a defocused point: the image-side cone of working f-number N, cut off focus.

    Parameters
    ----------
    defocus_um : array_like
        [um].
    f_number : float
        [1].
    """
    return np.asarray(np.abs(np.asarray(defocus_um, float)) / f_number)


def psf_kernel(*, pitch_um: float, wavelength_um: float, f_number: float, disc_um: float) -> Array:
    """Return the light that a point at a pixel's centre sends into each pixel around it.

    The geometric disc and the Airy pattern are folded (their transfers multiplied), which is exact in either limit;
    between them the exact defocused pupil (Hopkins 1955) differs from the product by some hundredths of contrast.

    Parameters
    ----------
    pitch_um : float
        Pixel pitch [um].
    wavelength_um, f_number : float
        Of the diffraction: wavelength [um], working f-number [1].
    disc_um : float
        Diameter of the geometric disc [um].

    Returns
    -------
    ndarray (k, k), k odd
        Non-negative, sum 1.

    Notes
    -----
    The reach is a length on the sensor, whatever the pixels: an Airy pattern's variance grows with the reach, and a
    reach in whole pixels would make the same lens softer on coarser ones.

    References
    ----------
    Hopkins, "The frequency response of a defocused optical system", Proc. R. Soc. A 231 (1955) 91.
    """
    airy_um = wavelength_um * f_number
    reach_um = disc_um / 2 + _DIFFRACTION_REACH * airy_um
    half = math.ceil(reach_um / pitch_um + 0.5)
    size = 2 * half + 1
    fine = max(1, min(math.ceil(2 * pitch_um / airy_um), _MAX_TRANSFORM // size))  # reaches the diffraction cut-off
    f = np.fft.fftfreq(size * fine, d=pitch_um / fine)
    radial = np.hypot(f[:, None], f[None, :])
    spread = np.fft.ifft2(diffraction_mtf(radial, wavelength_um, f_number) * disc_mtf(radial, disc_um)).real
    offset = np.fft.fftfreq(size * fine, d=1.0 / (size * pitch_um))
    within = np.hypot(offset[:, None], offset[None, :]) <= reach_um
    spread = np.where(within, spread + (1.0 - spread[within].sum()) / within.sum(), 0.0)
    cell = np.sinc(f * pitch_um)  # integral over each receiving pixel
    gathered = np.fft.ifft2(np.fft.fft2(spread) * cell[:, None] * cell).real
    index = np.arange(-half, half + 1) * fine
    kernel = np.clip(gathered[np.ix_(index, index)], 0.0, None)  # rounding leaves -1e-19
    return np.asarray(kernel / kernel.sum())


# --- blur that varies over the field ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class FieldBlur:
    """Kernels of a few blur zones, and where each pixel stands among them.

    Attributes
    ----------
    kernels : tuple of ndarray
        Each non-negative, symmetric, sum 1.
    position : ndarray of float32 (rows, cols) or None
        i + w: shares 1 - w of kernel i and w of kernel i + 1; None where one kernel serves all.
    """

    kernels: tuple[Array, ...]
    position: NDArray[np.float32] | None = None


def field_blur(disc_px: Array, kernel_of: Callable[[float], Array]) -> FieldBlur:
    """Choose a few kernels and shares that reproduce the second moment of each pixel's own disc.

    A disc of diameter c has the variance c^2/16, so shares that are linear in c^2 blend two neighbouring kernels into
    one of exactly the right width.

    Parameters
    ----------
    disc_px : ndarray (rows, cols)
        Geometric disc of each pixel [px].
    kernel_of : callable
        Diameter [px] -> kernel.
    """
    low, high = float(disc_px.min()), float(disc_px.max())
    if high - low < 1e-9:
        return FieldBlur((kernel_of(high),))
    count = min(_MAX_ZONES, math.ceil((high - low) / _ZONE_STEP_PX) + 1)
    knots = np.linspace(low, high, count)
    position = np.interp(disc_px**2, knots**2, np.arange(knots.size)).astype(np.float32)
    return FieldBlur(tuple(kernel_of(float(knot)) for knot in knots), position)


def blur(image: Array, spread: FieldBlur) -> Array:
    """Spread each pixel's light by the kernel of its own position; light is conserved.

    Beyond the border the image is continued by its outermost pixels, so that a flat field stays flat.

    Parameters
    ----------
    image : ndarray (rows, cols)
    spread : FieldBlur

    Returns
    -------
    ndarray (rows, cols)
    """
    reach = max(kernel.shape[0] // 2 for kernel in spread.kernels)
    result = np.zeros_like(image)
    for i, kernel in enumerate(spread.kernels):
        part = image
        if spread.position is not None:
            part = image * np.clip(1.0 - np.abs(spread.position.astype(np.float64) - i), 0.0, None)
        padded = cv2.copyMakeBorder(part, reach, reach, reach, reach, cv2.BORDER_REPLICATE)
        # Kernels are symmetric, so correlation is convolution.
        result += cv2.filter2D(padded, cv2.CV_64F, kernel, borderType=cv2.BORDER_REPLICATE)[reach:-reach, reach:-reach]
    return result
