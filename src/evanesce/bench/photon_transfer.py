"""Photon transfer: variance against mean signal -> conversion gain, read noise, PRNU, saturation, linearity.

The terms are those of EMVA Standard 1288, release 4.0 Linear (2021), sections 2 and 6 to 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.core.errors import WorkError

Floats = NDArray[np.float64]

QUANTISATION_DN2 = 1.0 / 12.0
"""Variance of rounding to whole numbers [DN^2]."""
USED_SHARE = 0.7
"""Share of the saturation signal up to which EMVA 1288 fits the photon transfer curve."""
LINEARITY_RANGE = (0.05, 0.95)
"""Share of the saturation signal over which EMVA 1288 states the linearity error."""
LEAST_ROWS = 6
"""A parabola has three coefficients; as many rows again say how well it fits."""


@dataclass(frozen=True)
class PhotonTransfer:
    """Figures of one photon transfer curve, with standard errors.

    Attributes
    ----------
    gain_e_per_DN, gain_se : float
        Conversion gain K [e-/DN].
    read_noise_e, read_noise_se : float
        Square root of the variance that is left without light, less that of rounding, times K [e-]; NaN where
        nothing is left. In variances over the pixels of one frame the dark signal's non-uniformity is part of it.
    offset_DN2, offset_se : float
        Variance without light [DN^2].
    prnu, prnu_se : float
        Square root of the quadratic coefficient [1]: photo response non-uniformity, and what the light itself
        varies by over the pixels; NaN where the coefficient is not positive, 0 where it was not fitted.
    residual : float
        Root mean square of measured over fitted variance, less 1 [1].
    autocorrelation : float
        Of the residuals from row to row in order of signal [1]; the standard errors are widened by it.
    rows : int
        Rows that were fitted.
    saturation_DN : float or None
        Signal at which the variance has its maximum [DN]; None where it only grows.
    limit_DN : float
        Largest signal that was fitted [DN].
    """

    gain_e_per_DN: float
    gain_se: float
    read_noise_e: float
    read_noise_se: float
    offset_DN2: float
    offset_se: float
    prnu: float
    prnu_se: float
    residual: float
    autocorrelation: float
    rows: int
    saturation_DN: float | None
    limit_DN: float

    @property
    def saturation_e(self) -> float | None:
        """Saturation capacity [e-]."""
        return None if self.saturation_DN is None else self.saturation_DN * self.gain_e_per_DN

    def variance(self, signal_DN: ArrayLike) -> Floats:
        """Return the fitted variance at signals above the black level [DN^2].

        Parameters
        ----------
        signal_DN : array_like (n,)
            [DN].
        """
        signal = np.asarray(signal_DN, float)
        return self.offset_DN2 + signal / self.gain_e_per_DN + (np.nan_to_num(self.prnu) * signal) ** 2


def saturation_signal(signal_DN: ArrayLike, variance_DN2: ArrayLike) -> float | None:
    """Return the signal of the largest variance, where the variance falls to less than half of it above.

    A maximum with too few rows below it for a fit is none: such a table never was a photon transfer curve.

    Parameters
    ----------
    signal_DN : array_like (n,)
        Above the black level [DN].
    variance_DN2 : array_like (n,)
        [DN^2].

    Returns
    -------
    float or None
        [DN]; None where no row lies in saturation.

    References
    ----------
    EMVA Standard 1288, release 4.0 Linear (2021), section 6.7.
    """
    signal, variance = np.asarray(signal_DN, float), np.asarray(variance_DN2, float)
    top = int(np.argmax(variance))
    falls = bool(np.any((signal > signal[top]) & (variance < 0.5 * variance[top])))
    enough = int(np.sum(signal <= USED_SHARE * signal[top])) >= LEAST_ROWS
    return float(signal[top]) if falls and enough else None


def fit_photon_transfer(
    signal_DN: ArrayLike, variance_DN2: ArrayLike, *, quadratic: bool = True, limit_DN: float | None = None
) -> PhotonTransfer:
    """Fit variance = offset + signal / K + (prnu signal)^2, each row by its relative error.

    The standard errors come from the scatter about the fit, widened by sqrt((1 + r)/(1 - r)) for residuals that are
    correlated by r from row to row.

    Parameters
    ----------
    signal_DN : array_like (n,)
        Mean above the black level [DN].
    variance_DN2 : array_like (n,)
        [DN^2].
    quadratic : bool
        False for temporal variances (of differences of two frames), which have no quadratic term.
    limit_DN : float, optional
        Largest signal to fit [DN]; 70 % of the saturation signal by default, all rows where none saturates.

    Returns
    -------
    PhotonTransfer

    Raises
    ------
    WorkError
        For fewer than six rows, or a variance that does not grow with the signal.

    References
    ----------
    EMVA Standard 1288, release 4.0 Linear (2021), sections 6.6 and 8. J. R. Janesick, Photon Transfer (SPIE, 2007).
    """
    signal, variance = np.asarray(signal_DN, float), np.asarray(variance_DN2, float)
    saturation = saturation_signal(signal, variance) if signal.size else None
    limit = limit_DN if limit_DN is not None else np.inf if saturation is None else USED_SHARE * saturation
    used = (signal <= limit) & (variance > 0.0)
    if used.sum() < LEAST_ROWS:
        raise WorkError(f"{int(used.sum())} rows below saturation; a photon transfer curve needs at least {LEAST_ROWS}")
    order = np.argsort(signal[used])
    x, v = signal[used][order], variance[used][order]
    design = np.stack([np.ones_like(x), x, x**2][: 3 if quadratic else 2], axis=1)
    fitted = v
    for _ in range(20):  # weights of the fitted and not of the measured variance, which would pull the fit down
        weighted = design / fitted[:, None]
        coefficients, _, rank, _ = np.linalg.lstsq(weighted, v / fitted, rcond=None)
        fitted = np.maximum(design @ coefficients, 1e-3 * v)
    if rank < design.shape[1] or not coefficients[1] > 0.0:
        raise WorkError("the variance does not grow with the signal: no conversion gain")
    residual = v / (design @ coefficients) - 1.0
    scatter = float(np.sum(residual**2)) / (x.size - design.shape[1])
    tied = _autocorrelation(residual)
    covariance = scatter * (1.0 + tied) / (1.0 - tied) * np.linalg.inv(weighted.T @ weighted)
    return _figures(coefficients, covariance, residual, tied, saturation, float(x[-1]))


def _figures(
    coefficients: Floats, covariance: Floats, residual: Floats, tied: float, saturation: float | None, limit: float
) -> PhotonTransfer:
    """Return gain, read noise and PRNU of the coefficients, their errors by first-order propagation."""
    offset, slope = float(coefficients[0]), float(coefficients[1])
    error = np.sqrt(np.diag(covariance))
    gain = 1.0 / slope
    noise, noise_se = float("nan"), float("nan")
    left = offset - QUANTISATION_DN2
    if left > 0.0:
        noise = gain * np.sqrt(left)
        gradient = np.array([gain / (2.0 * np.sqrt(left)), -noise * gain])
        noise_se = float(np.sqrt(gradient @ covariance[:2, :2] @ gradient))
    prnu, prnu_se = 0.0, 0.0
    if coefficients.size == 3:
        prnu = float(np.sqrt(coefficients[2])) if coefficients[2] > 0.0 else float("nan")
        prnu_se = float(error[2] / (2.0 * prnu))
    return PhotonTransfer(
        gain, float(gain**2 * error[1]), float(noise), noise_se, offset, float(error[0]), prnu, prnu_se,
        float(np.sqrt(np.mean(residual**2))), tied, residual.size, saturation, limit,
    )  # fmt: skip


def _autocorrelation(residual: Floats) -> float:
    """Return the lag-1 autocorrelation of residuals, 0 to 0.9: a negative one does not narrow errors."""
    power = float(np.sum(residual**2))
    if power == 0.0:
        return 0.0
    return float(np.clip(np.sum(residual[1:] * residual[:-1]) / power, 0.0, 0.9))


@dataclass(frozen=True)
class Linearity:
    """Departure of the mean signal from a straight line in the exposure.

    Attributes
    ----------
    responsivity : float
        Slope [DN per unit of exposure].
    error : float
        Linearity error: mean absolute relative deviation [1].
    worst : float
        Relative deviation of largest magnitude, with its sign [1].
    worst_DN : float
        Signal at which it occurs [DN].
    rows : int
    """

    responsivity: float
    error: float
    worst: float
    worst_DN: float
    rows: int


def linearity(exposure: ArrayLike, signal_DN: ArrayLike, saturation_DN: float | None = None) -> Linearity:
    """Return the linearity error of EMVA 1288: a line by relative deviations from 5 to 95 % of saturation.

    Parameters
    ----------
    exposure : array_like (n,)
        Radiant exposure in any unit: exposure time times the light's relative level.
    signal_DN : array_like (n,)
        Above the dark signal [DN].
    saturation_DN : float, optional
        Saturation signal [DN]; the largest signal where it is not known.

    Returns
    -------
    Linearity

    Raises
    ------
    WorkError
        For fewer than four different exposures in the range.

    References
    ----------
    EMVA Standard 1288, release 4.0 Linear (2021), section 7.
    """
    x, y = np.asarray(exposure, float), np.asarray(signal_DN, float)
    top = float(y.max()) if saturation_DN is None else saturation_DN
    used = (y >= LINEARITY_RANGE[0] * top) & (y <= LINEARITY_RANGE[1] * top)
    x, y = x[used], y[used]
    if np.unique(x).size < 4:
        raise WorkError(f"{np.unique(x).size} exposures between 5 and 95 % of saturation; linearity needs at least 4")
    design = np.stack([np.ones_like(x), x], axis=1)
    line, *_ = np.linalg.lstsq(design / y[:, None], np.ones_like(y), rcond=None)
    deviation = y / (design @ line) - 1.0
    worst = int(np.argmax(np.abs(deviation)))
    return Linearity(
        float(line[1]), float(np.mean(np.abs(deviation))), float(deviation[worst]), float(y[worst]), x.size
    )
