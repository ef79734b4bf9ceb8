"""Wavelengths: a white LED as power per band, its luminous weight, and the indices of soda-lime glass and PDMS.

References
----------
M. Rubin, "Optical properties of soda lime silica glasses", Solar Energy Materials 12 (1985) 275.
F. Schneider, J. Draheim, R. Kamberger and U. Wallrabe, "Process and material properties of polydimethylsiloxane (PDMS)
for optical MEMS", Sensors and Actuators A 151 (2009) 95.
Y. Ohno, "Spectral design considerations for white LED color rendering", Optical Engineering 44 (2005) 111302.
C. Wyman, P.-P. Sloan and P. Shirley, "Simple analytic approximations to the CIE XYZ color matching functions", Journal
of Computer Graphics Techniques 2(2) (2013) 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SODIUM_NM = 589.3
BAND_NM = np.arange(430.0, 710.0, 20.0)
"""Centres of the bands [nm], each 20 nm wide."""

BLUE_PEAK_NM, BLUE_WIDTH_NM = 450.0, 22.0
"""Peak and full width at half height of the chip's line; usual for phosphor-converted white LEDs."""

PHOSPHOR_PEAK_NM, PHOSPHOR_WIDTH_NM = 562.0, 130.0
PHOSPHOR_SHARE = 0.73
"""Peak, full width and share of radiant power of the phosphor: a cool white of about 6500 K. The rig's is not known."""


def soda_lime_index(wavelength: ArrayLike) -> Array:
    """Return the index of clear soda-lime glass, n = 1.5130 - 0.003169 L^2 + 0.003962/L^2, L in um (Rubin 1985).

    Parameters
    ----------
    wavelength : array_like
        In vacuum [nm]; the fit holds in the visible and near infrared.
    """
    um2 = (np.asarray(wavelength, float) * 1e-3) ** 2
    return np.asarray(1.5130 - 0.003169 * um2 + 0.003962 / um2)


def white_led_power() -> Array:
    """Return the share of a white LED's radiant power in each of ``BAND_NM``; they sum to 1.

    Two lines, chip and phosphor; the chip's by Ohno's form (g + 2 g^5)/3, g a Gaussian.
    """
    edges = np.append(BAND_NM - 10.0, BAND_NM[-1] + 10.0)
    fine = np.arange(edges[0] + 0.5, edges[-1], 1.0)
    g = np.exp(-(((fine - BLUE_PEAK_NM) / BLUE_WIDTH_NM) ** 2))
    chip = (g + 2.0 * g**5) / 3.0
    phosphor = np.exp(-4.0 * np.log(2.0) * ((fine - PHOSPHOR_PEAK_NM) / PHOSPHOR_WIDTH_NM) ** 2)
    density = (1.0 - PHOSPHOR_SHARE) * chip / chip.sum() + PHOSPHOR_SHARE * phosphor / phosphor.sum()
    return np.asarray(density.reshape(BAND_NM.size, -1).sum(axis=1))


def luminous_efficiency(wavelength: ArrayLike) -> Array:
    """Return the eye's relative sensitivity, which luma approximates (single-lobe fit of Wyman et al. 2013).

    Parameters
    ----------
    wavelength : array_like
        In vacuum [nm].

    Returns
    -------
    ndarray
        Shape of ``wavelength`` [1].
    """
    return np.asarray(1.014 * np.exp(-0.5 * (np.log(np.asarray(wavelength, float) / 556.1) / 0.075) ** 2))


def mean_over_bands(value: Callable[[Array], Array]) -> float:
    """Return the mean of a function of wavelength [nm] over the white LED's light as a grey frame weighs it.

    Parameters
    ----------
    value : callable
        Of wavelengths [nm] (bands,).
    """
    weight = white_led_power() * luminous_efficiency(BAND_NM)
    return float(np.sum(weight * value(BAND_NM)) / weight.sum())


def pdms_index(wavelength: ArrayLike) -> Array:
    """Return the index of PDMS (Sylgard 184), n^2 = 1 + 1.0093 L^2/(L^2 - 0.013185), L in um (Schneider et al. 2009).

    Parameters
    ----------
    wavelength : array_like
        In vacuum [nm]; the fit holds from 350 to 700 nm.
    """
    um2 = (np.asarray(wavelength, float) * 1e-3) ** 2
    return np.asarray(np.sqrt(1.0 + 1.0093 * um2 / (um2 - 0.013185)))


@dataclass(frozen=True)
class Band:
    """Part of the white light.

    Attributes
    ----------
    wavelength : float
        Mean, as a grey frame weighs it [nm].
    weight : float
        Share of what a grey frame sees; those of all bands sum to 1.
    """

    wavelength: float
    weight: float


def white_bands(count: int) -> tuple[Band, ...]:
    """Return a white LED's light in ``count`` bands of equal weight in a grey frame.

    Parameters
    ----------
    count : int
        1 to 14.
    """
    if not 1 <= count <= BAND_NM.size:
        raise ValueError(f"{count} bands, not 1 to {BAND_NM.size}")
    fine = np.arange(BAND_NM[0] - 10.0, BAND_NM[-1] + 10.0) + 0.5
    density = np.repeat(white_led_power() / 20.0, 20) * luminous_efficiency(fine)
    cumulated = np.append(0.0, np.cumsum(density) / density.sum())
    first = np.append(0.0, np.cumsum(density * fine) / density.sum())
    # Both integrals between the wavelengths at which the weight passes k/count.
    at = np.linspace(0.0, 1.0, count + 1)
    edges = np.interp(at, cumulated, np.arange(fine.size + 1.0))
    moment = np.interp(edges, np.arange(fine.size + 1.0), first)
    return tuple(Band(float(m * count), 1.0 / count) for m in np.diff(moment))
