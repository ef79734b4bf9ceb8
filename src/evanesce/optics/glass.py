"""Absorption of soda-lime glass by wavelength: iron, whose ferrous ions take the red and the near infrared.

References
----------
M. Rubin, "Optical properties of soda lime silica glasses", Solar Energy Materials 12 (1985) 275: extinction
coefficient k of clear window glass.
M. R. Vogt et al., "Measurement of the optical constants of soda-lime glasses in dependence of iron content", IEEE
Journal of Photovoltaics 6 (2016) 111: another clear glass, for the spread between glasses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

REFERENCE_NM = 550.0
"""Wavelength at which a scene's absorption coefficient holds [nm]."""

# k of Rubin's clear glass, 380 to 1100 nm.
_WAVELENGTH_NM = np.append(np.arange(380.0, 1001.0, 10.0), 1100.0)
_EXTINCTION = 1e-7 * np.array(
    [
        *(5.936, 2.828, 2.047, 2.182, 2.279, 2.397, 2.342, 1.925, 1.669, 1.7, 1.683, 1.554),
        *(1.492, 1.499, 1.582, 1.769, 1.988, 2.2, 2.529, 3.051, 3.563, 4.003, 4.548, 5.217),
        *(5.972, 6.913, 7.754, 8.371, 9.108, 10.09, 10.97, 11.59, 12.34, 13.49, 14.66, 15.85),
        *(17.06, 18.3, 19.56, 20.85, 22.14, 23.45, 24.77, 26.17, 27.55, 28.9, 30.22, 31.5),
        *(32.74, 33.94, 35.1, 36.21, 37.27, 38.17, 39.06, 39.95, 40.83, 41.7, 42.61, 43.49),
        *(44.33, 45.14, 45.91),
        51.11,
    ]
)


def soda_lime_absorption(wavelength: ArrayLike) -> Array:
    """Return the absorption coefficient of clear soda-lime glass over that at 550 nm, 4 pi k/wavelength (Rubin 1985).

    Clear float glass of about 0.1 % iron oxide has 0.005/mm at 550 nm. Another glass's ratio of Fe2+ to Fe3+ differs:
    Vogt's glass of 0.07 % iron oxide has 0.69 of this at 634 nm and 0.68 at 850 nm.

    Parameters
    ----------
    wavelength : array_like
        In vacuum [nm], 380 to 1100; beyond, the value at the end.

    Returns
    -------
    ndarray
        Shape of ``wavelength`` [1].
    """
    coefficient = _EXTINCTION / _WAVELENGTH_NM
    at = np.interp(np.asarray(wavelength, float), _WAVELENGTH_NM, coefficient)
    return np.asarray(at / np.interp(REFERENCE_NM, _WAVELENGTH_NM, coefficient))
