"""Spectra of lamps and daylight by colour temperature, under which a white card is seen.

References
----------
CIE 15:2018, Colorimetry, 4th edition: the components of daylight, and their weights by colour temperature.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evanesce.optics.spectrum import Spectrum

Array = NDArray[np.float64]

SECOND_RADIATION_NM_K = 1.438776877e7  # hc/k, CODATA 2018

_WAVELENGTH_NM = np.arange(400.0, 701.0, 10.0)
_S0 = np.array(
    [
        *(94.8, 104.8, 105.9, 96.8, 113.9, 125.6, 125.5, 121.3, 121.3, 113.5, 113.1, 110.8, 106.5, 108.8, 105.3, 104.4),
        *(100.0, 96.0, 95.1, 89.1, 90.5, 90.3, 88.4, 84.0, 85.1, 81.9, 82.6, 84.9, 81.3, 71.9, 74.3),
    ]
)
_S1 = np.array(
    [
        *(43.4, 46.3, 43.9, 37.1, 36.7, 35.9, 32.6, 27.9, 24.3, 20.1, 16.2, 13.2, 8.6, 6.1, 4.2, 1.9),
        *(0.0, -1.6, -3.5, -3.5, -5.8, -7.2, -8.6, -9.5, -10.9, -10.7, -12.0, -14.0, -13.6, -12.0, -13.3),
    ]
)
_S2 = np.array(
    [
        *(-1.1, -0.5, -0.7, -1.2, -2.6, -2.9, -2.8, -2.6, -2.6, -1.8, -1.5, -1.3, -1.2, -1.0, -0.5, -0.3),
        *(0.0, 0.2, 0.5, 2.1, 3.2, 4.1, 4.7, 5.1, 6.7, 7.3, 8.6, 9.8, 10.2, 8.3, 9.6),
    ]
)


def black_body(temperature_K: float, wavelength_nm: Array | None = None) -> Spectrum:
    """Return the light of a black body, such as a filament nearly is (Planck's law, power per nm).

    Parameters
    ----------
    temperature_K : float
        [K].
    wavelength_nm : ndarray (n,), optional
        Rising [nm]; 400 to 700 nm in steps of 10 nm by default.

    Returns
    -------
    Spectrum
    """
    w = _WAVELENGTH_NM if wavelength_nm is None else wavelength_nm
    return Spectrum(w, (w / 560.0) ** -5 / np.expm1(SECOND_RADIATION_NM_K / (w * temperature_K)))


def daylight(temperature_K: float) -> Spectrum:
    """Return a phase of daylight (CIE 15), 400 to 700 nm.

    Parameters
    ----------
    temperature_K : float
        Correlated colour temperature, 4000 to 25000 [K].

    Returns
    -------
    Spectrum
        100 at 560 nm.

    Raises
    ------
    ValueError
        If the temperature lies outside.
    """
    if not 4000.0 <= temperature_K <= 25000.0:
        raise ValueError(f"colour temperature {temperature_K:g} K; daylight has 4000 to 25000 K")
    t = 1e3 / temperature_K
    cubic = (-4.6070, 2.9678, 0.09911, 0.244063) if temperature_K <= 7000.0 else (-2.0064, 1.9018, 0.24748, 0.237040)
    x = np.polyval(cubic, t)
    y = -3.0 * x * x + 2.870 * x - 0.275
    under = 0.0241 + 0.2562 * x - 0.7341 * y
    m1 = (-1.3515 - 1.7703 * x + 5.9114 * y) / under
    m2 = (0.0300 - 31.4424 * x + 30.0717 * y) / under
    return Spectrum(_WAVELENGTH_NM, _S0 + m1 * _S1 + m2 * _S2)
