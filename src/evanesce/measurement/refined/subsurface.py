"""Light that wandered inside the silicone, taken back to where it entered: contact parted from the glow in grooves.

What enters a scattering body at a contact leaves around it by a profile k, and what its surface sends back inside
enters anew: J = A k * (E + R J), with the body's albedo A and R the reflectance of the surface from inside. The camera
sees J, dimmed a little where a film of air lies on the way. Turned round, E + (R - R_open) J = (k^-1 / A - R_open) J:
zero where the surface is open, however bright the glow, and positive in contact. The length of the walk and the product
A R_open are not known; they are those that leave the least light outside the contact.

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
class Walk:
    """How far light goes inside the body.

    Attributes
    ----------
    length_px : float
        Scale d of the profile (exp(-r/d) + exp(-r/3d)) / (8 pi d r) [px]; 0: light leaves where it entered.
    returned : float
        A R_open, the share that comes back to an open surface, is sent in again and so on [1].
    """

    length_px: float = 0.0
    returned: float = 0.0


def profile_transform(q: Floats, length: float) -> Floats:
    """Return the transform of the profile at spatial frequencies q [rad/px], 1 at q = 0."""
    x = (q * length) ** 2
    return np.asarray(0.25 / np.sqrt(1.0 + x) + 0.75 / np.sqrt(1.0 + 9.0 * x))


def entered(light: Floats, walk: Walk, smoothing_px: float) -> Floats:
    """Return the light that entered at each pixel, in units of the plateau it would make without a walk.

    Parameters
    ----------
    light : ndarray (rows, cols)
        Linear, background taken off; it should have died away at the border.
    walk : Walk
    smoothing_px : float
        Standard deviation of a Gaussian against the noise that the inversion raises [px].
    """
    return _filtered(light, walk, smoothing_px, inverse=True)


def spread(entering: Floats, walk: Walk, blur_px: float) -> Floats:
    """Return the light that a camera with a Gaussian blur sees of what entered: :func:`entered` turned round."""
    return _filtered(entering, walk, blur_px, inverse=False)


def _filtered(image: Floats, walk: Walk, smoothing_px: float, *, inverse: bool) -> Floats:
    rows, cols = image.shape
    pad = int(4 * smoothing_px) + 8 + round(2 * walk.length_px)
    shape = fft.next_fast_len(rows + 2 * pad, real=True), fft.next_fast_len(cols + 2 * pad, real=True)
    below, right = shape[0] - rows - pad, shape[1] - cols - pad
    # single precision: its rounding, raised by the inversion, stays far below the noise of 8 bits
    wide = cv2.copyMakeBorder(image.astype(np.float32), pad, below, pad, right, cv2.BORDER_REPLICATE)
    ky = np.float32(2 * np.pi) * fft.fftfreq(shape[0])[:, None].astype(np.float32)
    kx = np.float32(2 * np.pi) * fft.rfftfreq(shape[1])[None, :].astype(np.float32)
    q2 = ky**2 + kx**2
    gain = (1.0 / profile_transform(np.sqrt(q2), walk.length_px) - walk.returned) / (1.0 - walk.returned)
    smooth = np.exp(-0.5 * smoothing_px**2 * q2)
    found = fft.irfft2(fft.rfft2(wide) * (gain * smooth if inverse else smooth / gain), shape)
    return np.asarray(found[pad : pad + rows, pad : pad + cols], np.float64)


def find_walk(light: Floats, mask: Mask, *, reach_px: float, apart_px: float = 6.0) -> Walk:
    """Find the walk that leaves the least light outside a mask, for the light it leaves inside.

    Parameters
    ----------
    light : ndarray (rows, cols)
        Background taken off.
    mask : ndarray of bool
        Contact as far as known.
    reach_px : float
        How far outside light is looked at [px].
    apart_px : float
        Pixels nearer to the mask's border than this are left out.
    """
    size = (light.shape[1] // COARSE, light.shape[0] // COARSE)
    small = np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_AREA))
    inside = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    out = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    around = (out > max(1.5, apart_px / COARSE)) & (out < reach_px / COARSE)
    within = cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if not within.any() or not around.any():
        return Walk()

    def left_outside(x: Floats) -> float:
        found = entered(small, Walk(float(np.exp(x[0])) / COARSE, float(x[1])), 1.0)
        return float(np.log(np.sqrt(np.mean(found[around] ** 2)) / abs(found[within].mean())))

    # no walk at all, or one of some tenths of a millimetre
    none = float(np.sqrt(np.mean(small[around] ** 2)) / small[within].mean())
    best = min((_least(left_outside, start, reach_px) for start in (5.0, 30.0)), key=lambda r: r.fun)
    if np.exp(best.fun) > 0.7 * none:
        return Walk()
    return Walk(float(np.exp(best.x[0])), float(best.x[1]))


def _least(function: Callable[[Floats], float], length_px: float, most_px: float) -> Any:
    """Minimise over the log of a length and a share that returns, from a length on.

    A longer walk and more that returns look almost alike: the least lies in a valley across both, and a small first
    simplex with a coarse tolerance stops at its edge.
    """
    start = float(np.log(length_px))
    simplex = [[start, 0.1], [start + 0.4, 0.1], [start, 0.4]]
    return minimize(
        function, simplex[0], method="Nelder-Mead", bounds=[(0.0, np.log(most_px)), (0.0, 0.9)],
        options={"initial_simplex": simplex, "xatol": 5e-3, "fatol": 1e-5, "maxfev": 200},
    )  # fmt: skip
