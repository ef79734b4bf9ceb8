"""Wavelengths: spectra of LEDs, white light in bands with its luminous weight, the indices of soda-lime glass and PDMS.

References
----------
M. Rubin, "Optical properties of soda lime silica glasses", Solar Energy Materials 12 (1985) 275.
F. Schneider, J. Draheim, R. Kamberger and U. Wallrabe, "Process and material properties of polydimethylsiloxane (PDMS)
for optical MEMS", Sensors and Actuators A 151 (2009) 95.
Y. Ohno, "Spectral design considerations for white LED color rendering", Optical Engineering 44 (2005) 111302.
C. Wyman, P.-P. Sloan and P. Shirley, "Simple analytic approximations to the CIE XYZ color matching functions", Journal
of Computer Graphics Techniques 2(2) (2013) 1.
J. S. Blakemore, "Semiconducting and other major properties of gallium arsenide", Journal of Applied Physics 53 (1982)
R123.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.rig.leds import Leds
from evanesce.rig.spectrum_file import read_spectrum

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
    return np.asarray(_white_density()[1].reshape(BAND_NM.size, -1).sum(axis=1))


def _white_density() -> tuple[Array, Array]:
    """Return the middles of steps of 1 nm, and the share of a white LED's radiant power in each."""
    edges = np.append(BAND_NM - 10.0, BAND_NM[-1] + 10.0)
    fine = np.arange(edges[0] + 0.5, edges[-1], 1.0)
    g = np.exp(-(((fine - BLUE_PEAK_NM) / BLUE_WIDTH_NM) ** 2))
    chip = (g + 2.0 * g**5) / 3.0
    phosphor = np.exp(-4.0 * np.log(2.0) * ((fine - PHOSPHOR_PEAK_NM) / PHOSPHOR_WIDTH_NM) ** 2)
    return fine, (1.0 - PHOSPHOR_SHARE) * chip / chip.sum() + PHOSPHOR_SHARE * phosphor / phosphor.sum()


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
        In vacuum [nm]; the fit holds from 350 to 700 nm. Beyond, it is its one resonance continued.
    """
    um2 = (np.asarray(wavelength, float) * 1e-3) ** 2
    return np.asarray(np.sqrt(1.0 + 1.0093 * um2 / (um2 - 0.013185)))


@dataclass(frozen=True)
class Line:
    """Emission of a plain LED.

    Attributes
    ----------
    peak_nm : float
        At 300 K [nm].
    width_nm : float
        Full width at half height [nm].
    shift_nm_per_K : float
        Of the peak with the junction's temperature [nm/K].
    """

    peak_nm: float
    width_nm: float
    shift_nm_per_K: float


# Red: OSRAM LR T67F (data sheet 1.2, 2019), sold as 625 nm by its dominant wavelength: peak 634 nm, 19 nm, 0.14 nm/K.
# Infrared: Vishay VSMY1850 peaks at 850 nm; 30 to 45 nm wide by maker; 0.26 nm/K from the band gap of GaAs, which
# falls by 0.45 meV/K at 300 K (Blakemore 1982).
LINES: Mapping[str, Line] = MappingProxyType({"red": Line(634.0, 19.0, 0.14), "infrared": Line(850.0, 40.0, 0.26)})

_LINE_STEP_NM = 0.5
_HALF_HEIGHT = 0.46091
"""Distance at which :func:`led_line` has fallen to half, over its parameter: g + 2 g^5 = 3/2."""


def led_line(wavelength: ArrayLike, peak: float, width: float) -> Array:
    """Return the radiant power per nm of a plain LED over that at its peak, (g + 2 g^5)/3, g a Gaussian (Ohno 2005).

    Parameters
    ----------
    wavelength : array_like
        [nm].
    peak, width : float
        Full width at half height [nm].

    Returns
    -------
    ndarray
        Shape of ``wavelength`` [1].
    """
    g = np.exp(-(((np.asarray(wavelength, float) - peak) * (2.0 * _HALF_HEIGHT / width)) ** 2))
    return np.asarray((g + 2.0 * g**5) / 3.0)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Radiant power by wavelength, linear between the points.

    Attributes
    ----------
    wavelength_nm : ndarray (n,)
        Rising [nm].
    power : ndarray (n,)
        Per nm, in any unit; not negative.
    """

    wavelength_nm: Array
    power: Array

    @property
    def mean_wavelength_nm(self) -> float:
        """Mean by radiant power [nm]: so many photons per joule has light of this one wavelength."""
        total, first = self._cumulated()[:, -1]
        return float(first / total)

    def photon_mean(self, value: Callable[[Array], ArrayLike]) -> float:
        """Return the mean of a function of wavelength over the spectrum's photons.

        Parameters
        ----------
        value : callable
            Of wavelengths [nm] (m,), returning (m,).

        Returns
        -------
        float
            By the trapezoidal rule on the spectrum's points and whole multiples of 0.5 nm between them.
        """
        fine = self._fine()
        weight = np.interp(fine, self.wavelength_nm, self.power) * fine
        return float(np.trapezoid(weight * np.asarray(value(fine), float), fine) / np.trapezoid(weight, fine))

    def bands(self, count: int) -> tuple[Band, ...]:
        """Return the light in ``count`` bands of equal numbers of photons.

        Parameters
        ----------
        count : int
            1 or more.

        Returns
        -------
        tuple of Band
            Each with the mean wavelength of its photons.
        """
        fine = self._fine()
        photons = np.interp(fine, self.wavelength_nm, self.power) * fine
        cumulated = np.append(0.0, np.cumsum((photons[1:] + photons[:-1]) / 2 * np.diff(fine)))
        moments = photons * fine
        first = np.append(0.0, np.cumsum((moments[1:] + moments[:-1]) / 2 * np.diff(fine)))
        total = cumulated[-1]
        # where nothing is emitted the number does not rise, and has no inverse
        rising = np.append(True, np.diff(cumulated) > 0.0)
        ends = np.interp(np.linspace(0.0, total, count + 1), cumulated[rising], first[rising])
        return tuple(Band(float(m * count / total), 1.0 / count) for m in np.diff(ends))

    def _fine(self) -> Array:
        low, high = self.wavelength_nm[0], self.wavelength_nm[-1]
        steps = np.arange(np.ceil(low / _LINE_STEP_NM), np.floor(high / _LINE_STEP_NM) + 1.0) * _LINE_STEP_NM
        return np.unique(np.concatenate([self.wavelength_nm, steps]))

    def _cumulated(self) -> Array:
        """Return the integrals of power and of power times wavelength up to each point (2, n), exactly."""
        w, p = self.wavelength_nm, self.power
        step, w0, w1, p0, p1 = np.diff(w), w[:-1], w[1:], p[:-1], p[1:]
        parts = np.stack([(p0 + p1) / 2, (w0 * (2 * p0 + p1) + w1 * (p0 + 2 * p1)) / 6]) * step
        return np.concatenate([np.zeros((2, 1)), np.cumsum(parts, axis=1)], axis=1)


def spectrum_of(leds: Leds) -> Spectrum:
    """Return the spectrum of the strips, as warm as their junctions are.

    Parameters
    ----------
    leds : Leds
        ``spectrum``; ``circuit.warming_K`` shifts a plain LED's peak. A white LED's and a measured spectrum stay.

    Returns
    -------
    Spectrum

    Raises
    ------
    InputError
        If a measured spectrum's file is not the one that the scene was read with.
    """
    kind = leds.spectrum
    if kind in LINES:
        return _line_spectrum(LINES[kind], leds.circuit.warming_K)
    if kind == "white":
        return _white_spectrum()
    return Spectrum(*read_spectrum(kind, leds.spectrum_sha256))


@lru_cache(maxsize=64)
def _line_spectrum(line: Line, warming: float) -> Spectrum:
    peak = line.peak_nm + line.shift_nm_per_K * warming
    # symmetric about the peak, so that the mean is the peak
    reach = round(4.0 * line.width_nm / _LINE_STEP_NM)
    w: Array = peak + _LINE_STEP_NM * np.arange(-reach, reach + 1, dtype=np.float64)
    return Spectrum(w, led_line(w, peak, line.width_nm))


@lru_cache(maxsize=1)
def _white_spectrum() -> Spectrum:
    return Spectrum(*_white_density())


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
