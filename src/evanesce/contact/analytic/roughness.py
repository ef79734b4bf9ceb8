"""Real contact on the scale of roughness: the share of nominal contact, after Persson."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf

Array = NDArray[np.float64]


def persson_contact_fraction(pressure: ArrayLike, modulus: float, rms_slope: float) -> Array:
    """Return real over nominal contact area, erf(sqrt(2) p/(E* h')).

    Persson's diffusion of the pressure gives erf(p/sqrt(2 V)), V the variance of the pressure in full contact. A wave
    of amplitude spectrum h(q) flattened takes the pressure E* q h(q)/2, so that V = E*^2 h'^2/4 with
    h'^2 = <|grad h|^2>: the mean square of the whole gradient, twice that of a profile's slope if isotropic.

    Parameters
    ----------
    pressure : array_like
        Nominal pressure [MPa]; tension makes no contact.
    modulus : float
        E* [MPa].
    rms_slope : float
        h' = sqrt(<|grad h|^2>) [1]; 0 is smooth.

    Returns
    -------
    ndarray
        0 to 1.

    Raises
    ------
    ValueError
        If the modulus is not positive or the slope negative.

    Notes
    -----
    Without adhesion and plasticity. At small load the share is sqrt(8/pi) p/(E* h'); numerical solutions find a
    factor nearer 2 than this 1.6 there, depending on the spectrum.

    References
    ----------
    B. N. J. Persson, J. Chem. Phys. 115 (2001) 3840; W. Manners, J. A. Greenwood, Wear 261 (2006) 600, for the form
    used here; V. A. Yastrebov, G. Anciaux, J.-F. Molinari, J. Mech. Phys. Solids 107 (2017) 469, for its range.
    """
    if not (modulus > 0 and rms_slope >= 0):
        raise ValueError(f"E* {modulus:g} MPa must be positive, rms slope {rms_slope:g} not negative")
    pushing = np.clip(np.asarray(pressure, dtype=float), 0.0, None)
    if rms_slope == 0:
        return np.where(pushing > 0, 1.0, 0.0)
    return erf(np.sqrt(2.0) * pushing / (modulus * rms_slope))


def rms_slope(heights: Array, pitch: float) -> float:
    """Return sqrt(<|grad h|^2>) of a periodic height map [mm] sampled at ``pitch`` [mm], by its spectrum.

    Parameters
    ----------
    heights : ndarray (rows, cols)
        [mm].
    pitch : float
        [mm].

    Returns
    -------
    float
        [1].
    """
    ky = 2.0 * np.pi * np.fft.fftfreq(heights.shape[0], pitch)[:, None]
    kx = 2.0 * np.pi * np.fft.fftfreq(heights.shape[1], pitch)[None, :]
    spectrum = np.fft.fft2(heights) / heights.size
    return float(np.sqrt(((kx**2 + ky**2) * np.abs(spectrum) ** 2).sum()))
