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
_WAVELENGTH_NM = np.append(np.arange(380.0, 1001.0, 20.0), 1100.0)
_EXTINCTION = 1e-7 * np.array(
    [
        *(5.936, 2.047, 2.279, 2.342, 1.669, 1.683, 1.492, 1.582, 1.988, 2.529, 3.563, 4.548, 5.972, 7.754, 9.108),
        *(10.97, 12.34, 14.66, 17.06, 19.56, 22.14, 24.77, 27.55, 30.22, 32.74, 35.10, 37.27, 39.06, 40.83, 42.61),
        *(44.33, 45.91, 51.11),
    ]
)


def soda_lime_absorption(wavelength: ArrayLike) -> Array:
    """Return the absorption coefficient of clear soda-lime glass over that at 550 nm, 4 pi k/wavelength (Rubin 1985).

    Clear float glass of about 0.1 % iron oxide has 0.005/mm at 550 nm. Another glass's ratio of Fe2+ to Fe3+ differs:
    Vogt's has 0.70 of this at 634 nm and 0.68 at 850 nm.

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
