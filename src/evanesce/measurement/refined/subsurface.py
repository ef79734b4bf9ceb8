"""Inversion of subsurface scattering: from the light that leaves the silicone to the light that entered it.

What enters a scattering body at a contact leaves around it by a profile k, and what its surface reflects back inside
enters anew: J = A k * (E + R J), with the body's albedo A and R the reflectance of the surface from inside. The camera
sees J, attenuated slightly by a film of air in between. Inverted, E + (R - R_open) J = (k^-1 / A - R_open) J: zero
where the surface is open, however much scattered light leaves there, and positive in contact. The scattering length and
the product A R_open are not known; they are those that minimise the light outside the contact.

References
----------
P. H. Christensen and B. Burley, Approximate reflectance profiles for efficient subsurface scattering, Pixar technical
memo 15-04, 2015: the profile, whose transform over the plane has the closed form used here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.optimize import minimize

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

COARSE = 4
"""The two unknowns are looked for on a frame reduced by this."""


@dataclass(frozen=True)
class Scattering:
    """Subsurface scattering of the body.

    Attributes
    ----------
    length_px : float
        Scale d of the profile (exp(-r/d) + exp(-r/3d)) / (8 pi d r) [px]; 0: light leaves where it entered.
    returned : float
        A R_open, the share of the light at an open surface that is reflected back inside and returns [1].
    """

    length_px: float = 0.0
    returned: float = 0.0


def profile_transform(q: Floats, length: float) -> Floats:
    """Return the Fourier transform of the profile.

    Parameters
    ----------
    q : ndarray
        Spatial frequencies [rad/px].
    length : float
        Scale d of the profile [px].

    Returns
    -------
    ndarray
        1 at q = 0 [1].
    """
    x = (q * length) ** 2
    return np.asarray(0.25 / np.sqrt(1.0 + x) + 0.75 / np.sqrt(1.0 + 9.0 * x))


def entered(light: Floats, scattering: Scattering, smoothing_px: float) -> Floats:
    """Return the light that entered at each pixel, in units of the plateau it would make without scattering.

    Parameters
    ----------
    light : ndarray (rows, cols)
        Linear, background subtracted; about zero at the border.
    scattering : Scattering
    smoothing_px : float
        Standard deviation of a Gaussian against the noise that the inversion amplifies [px].

    Returns
    -------
    ndarray (rows, cols)
    """
    return _filtered(light, scattering, smoothing_px, inverse=True)


def spread(entering: Floats, scattering: Scattering, blur_px: float) -> Floats:
    """Return the light that a camera with a Gaussian blur sees of what entered: the inverse of :func:`entered`.

    Parameters
    ----------
    entering : ndarray (rows, cols)
        Linear light that enters.
    scattering : Scattering
    blur_px : float
        Standard deviation of the blur [px].

    Returns
    -------
    ndarray (rows, cols)
        In the same unit.
    """
    return _filtered(entering, scattering, blur_px, inverse=False)


def _filtered(image: Floats, scattering: Scattering, smoothing_px: float, *, inverse: bool) -> Floats:
    rows, cols = image.shape
    pad = int(4 * smoothing_px) + 8 + round(2 * scattering.length_px)
    shape = fft.next_fast_len(rows + 2 * pad, real=True), fft.next_fast_len(cols + 2 * pad, real=True)
    below, right = shape[0] - rows - pad, shape[1] - cols - pad
    # single precision: its rounding, amplified by the inversion, stays far below the noise of 8 bits
    wide = cv2.copyMakeBorder(image.astype(np.float32), pad, below, pad, right, cv2.BORDER_REPLICATE)
    ky = np.float32(2 * np.pi) * fft.fftfreq(shape[0])[:, None].astype(np.float32)
    kx = np.float32(2 * np.pi) * fft.rfftfreq(shape[1])[None, :].astype(np.float32)
    q2 = ky**2 + kx**2
    gain = (1.0 / profile_transform(np.sqrt(q2), scattering.length_px) - scattering.returned) / (
        1.0 - scattering.returned
    )
    smooth = np.exp(-0.5 * smoothing_px**2 * q2)
    found = fft.irfft2(fft.rfft2(wide) * (gain * smooth if inverse else smooth / gain), shape)
    return np.asarray(found[pad : pad + rows, pad : pad + cols], np.float64)


def find_scattering(light: Floats, mask: Mask, *, reach_px: float, apart_px: float = 6.0) -> Scattering:
    """Fit the scattering that minimises the light outside a mask relative to the light inside.

    Parameters
    ----------
    light : ndarray (rows, cols)
        Linear, background subtracted.
    mask : ndarray of bool
        Contact as far as known.
    reach_px : float
        How far outside light is looked at [px].
    apart_px : float
        Pixels nearer to the mask's border than this are left out [px].

    Returns
    -------
    Scattering
        Of length 0 where scattering explains the light outside no better, or by less than the reduced frame shows.
    """
    size = (light.shape[1] // COARSE, light.shape[0] // COARSE)
    small = np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_AREA))
    inside = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    out = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    around = (out > max(1.5, apart_px / COARSE)) & (out < reach_px / COARSE)
    within = cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if not within.any() or not around.any():
        return Scattering()

    def left_outside(x: Floats) -> float:
        found = entered(small, Scattering(float(np.exp(x[0])) / COARSE, float(x[1])), 1.0)
        return float(np.log(np.sqrt(np.mean(found[around] ** 2)) / abs(found[within].mean())))

    # no scattering at all, or a length of some tenths of a millimetre
    none = float(np.sqrt(np.mean(small[around] ** 2)) / small[within].mean())
    best = min((_minimum(left_outside, start, reach_px) for start in (5.0, 30.0)), key=lambda r: r.fun)
    if np.exp(best.fun) > 0.7 * none:
        return Scattering()
    length = float(np.exp(best.x[0]))
    # a shorter one does not show on the reduced frame, and is a blur of edges between narrow ridges
    return Scattering(length, float(best.x[1])) if length >= COARSE else Scattering()


def _minimum(function: Callable[[Floats], float], length_px: float, most_px: float) -> Any:
    """Minimise over the log of a length and a share that returns, from a length on.

    A larger length and a larger return have almost the same effect: the minimum lies in a valley across both, and a
    small first simplex with a coarse tolerance stops at its edge.
    """
    start = float(np.log(length_px))
    simplex = [[start, 0.1], [start + 0.4, 0.1], [start, 0.4]]
    return minimize(
        function, simplex[0], method="Nelder-Mead", bounds=[(0.0, np.log(most_px)), (0.0, 0.9)],
        options={"initial_simplex": simplex, "xatol": 5e-3, "fatol": 1e-5, "maxfev": 200},
    )  # fmt: skip
