"""From irradiance to charge: photons, quantum efficiency, fixed pattern, dark current, shot noise, full well.

The linear camera model of EMVA Standard 1288, release 4.0 Linear (2021), section 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import c as LIGHT_SPEED
from scipy.constants import h as PLANCK

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FixedPattern:
    """The departures of one sensor's pixels from their mean, the same in every frame.

    Attributes
    ----------
    sensitivity : ndarray (rows, cols)
        Relative sensitivity, mean 1 [1].
    dark_e : ndarray (rows, cols)
        Departure of the dark signal from its mean [e-].
    dark_rate : ndarray (rows, cols), optional
        Dark current over its mean [1]; all 1 where left out.
    """

    sensitivity: Array
    dark_e: Array
    dark_rate: Array | None = None


def fixed_pattern(
    shape: tuple[int, int], prnu: float, dsnu_e: float, rng: np.random.Generator, dark_spread: float = 0.0
) -> FixedPattern | None:
    """Draw a sensor's fixed pattern; None where it has none.

    Dark currents follow a gamma distribution: positive, with a tail of hot pixels that grows with their spread.

    Parameters
    ----------
    shape : tuple of int
        (rows, cols).
    prnu : float
        Relative standard deviation of sensitivity [1].
    dsnu_e : float
        Standard deviation of the dark signal [e-].
    rng : numpy.random.Generator
        A stream of the sensor, not of the frame.
    dark_spread : float
        Relative standard deviation of dark current [1].
    """
    if prnu == 0.0 and dsnu_e == 0.0 and dark_spread == 0.0:
        return None
    sensitivity = np.clip(1.0 + prnu * rng.standard_normal(shape), 0.0, None)
    dark_e = dsnu_e * rng.standard_normal(shape)
    if dark_spread == 0.0:
        return FixedPattern(sensitivity, dark_e)
    return FixedPattern(sensitivity, dark_e, rng.standard_gamma(dark_spread**-2, shape) * dark_spread**2)


def photon_count(
    irradiance: NDArray[np.floating[Any]],
    *,
    pitch_um: float,
    fill_factor: float,
    exposure_s: float,
    wavelength_nm: float,
) -> Array:
    """Return the mean number of photons on each pixel: E A t lambda / (h c).

    Parameters
    ----------
    irradiance : ndarray
        [W mm^-2].
    pitch_um : float
        Pixel pitch [um].
    fill_factor : float
        Share of the pixel that gathers light [1].
    exposure_s : float
        [s].
    wavelength_nm : float
        [nm].
    """
    area_mm2 = (pitch_um * 1e-3) ** 2 * fill_factor
    energy_J = PLANCK * LIGHT_SPEED / (wavelength_nm * 1e-9)
    return np.asarray(irradiance, np.float64) * (area_mm2 * exposure_s / energy_J)


def mean_charge(
    photons: Array,
    *,
    quantum_efficiency: float,
    dark_current_e_per_s: float,
    exposure_s: float,
    pattern: FixedPattern | None = None,
) -> Array:
    """Return the mean charge of each pixel before shot noise: eta mu_p S + D t + pattern [e-], never below zero.

    Parameters
    ----------
    photons : ndarray (rows, cols)
        [1].
    quantum_efficiency : float
        eta [1].
    dark_current_e_per_s : float
        D [e-/s].
    exposure_s : float
        t [s].
    pattern : FixedPattern, optional

    Returns
    -------
    ndarray (rows, cols)
    """
    charge = photons * quantum_efficiency
    dark: float | Array = dark_current_e_per_s * exposure_s
    if pattern is not None:
        charge = charge * pattern.sensitivity + pattern.dark_e
        if pattern.dark_rate is not None:
            dark = dark * pattern.dark_rate
    return np.asarray(np.clip(charge + dark, 0.0, None))


def collect(mean_e: Array, full_well_capacity_e: float, rng: np.random.Generator | None) -> Array:
    """Return the charge of one exposure: Poisson about its mean, spilt above the full well [e-].

    ``rng=None`` gives the mean itself, without shot noise.

    Parameters
    ----------
    mean_e : ndarray
        [e-].
    full_well_capacity_e : float
        [e-].
    rng : numpy.random.Generator or None

    Returns
    -------
    ndarray
        Shape of ``mean_e``.
    """
    charge = mean_e if rng is None else rng.poisson(mean_e).astype(np.float64)
    return np.minimum(charge, full_well_capacity_e)
