"""Fits to dynamic mechanical analysis: Prony series of a sweep, activation energy of a master curve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares, nnls

from evanesce.materials.prony import PronySeries, arrhenius_shift

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PronyFit:
    """A fitted series and how well it fits.

    Attributes
    ----------
    series : PronySeries
    storage_rms, loss_rms : float
        RMS of the relative deviation of E' and E'' over the data.
    """

    series: PronySeries
    storage_rms: float
    loss_rms: float


def fit_prony(
    frequency: ArrayLike,
    storage: ArrayLike,
    loss_factor: ArrayLike,
    *,
    times: Sequence[float] | None = None,
    terms_per_decade: float = 3.0,
) -> PronyFit:
    """Fit a Prony series to storage modulus and loss factor by non-negative least squares.

    Relaxation times are fixed on a logarithmic grid that spans the measured band 1/(2 pi f) and half a decade beyond
    it on either side; moduli and equilibrium modulus follow from one linear non-negative problem in relative
    deviations of E' and E''. Terms that come out zero are dropped.

    Parameters
    ----------
    frequency : array_like (n,)
        [Hz], at one temperature or reduced to one.
    storage : array_like (n,)
        E' [MPa].
    loss_factor : array_like (n,)
        tan(delta).
    times : sequence of float, optional
        Relaxation times [s] instead of the grid.
    terms_per_decade : float
        Density of the grid.

    Returns
    -------
    PronyFit

    Raises
    ------
    ValueError
        If the data are not positive, finite and of one length, or fewer than 2.

    References
    ----------
    J. F. Clauser and W. G. Knauss, Trans. Soc. Rheol. 12 (1968) 143 (collocation on fixed times);
    C. L. Lawson and R. J. Hanson, Solving Least Squares Problems, 1974 (NNLS).
    """
    f, e1, tan = (np.asarray(a, dtype=float).ravel() for a in (frequency, storage, loss_factor))
    if not len(f) == len(e1) == len(tan) or len(f) < 2:
        raise ValueError(f"{len(f)} frequencies, {len(e1)} storage moduli, {len(tan)} loss factors; at least 2 of each")
    if not all(np.isfinite(a).all() for a in (f, e1, tan)) or min(f.min(), e1.min(), tan.min()) <= 0:
        raise ValueError("frequency, storage modulus and loss factor must be positive and finite")
    if times is None:
        slow, fast = np.log10(1.0 / (2 * np.pi * f.min())) + 0.5, np.log10(1.0 / (2 * np.pi * f.max())) - 0.5
        tau = np.logspace(fast, slow, max(2, int(np.ceil((slow - fast) * terms_per_decade)) + 1))
    else:
        tau = np.sort(np.asarray(times, dtype=float))
    s = 2j * np.pi * f[:, None] * tau
    kernel = np.hstack([np.ones((len(f), 1)), s / (1.0 + s)])
    e2 = e1 * tan
    matrix = np.vstack([kernel.real / e1[:, None], kernel.imag / e2[:, None]])
    solution, _ = nnls(matrix, np.ones(2 * len(f)))
    # A term below 1e-9 of the stiffness is rounding, and its retardation time would be noise.
    kept = solution[1:] > 1e-9 * solution.sum()
    series = PronySeries(float(solution[0]), tuple(solution[1:][kept].tolist()), tuple(tau[kept].tolist()))
    modulus = series.complex_modulus(f)
    return PronyFit(
        series,
        float(np.sqrt(np.mean((modulus.real / e1 - 1.0) ** 2))),
        float(np.sqrt(np.mean((modulus.imag / e2 - 1.0) ** 2))),
    )


@dataclass(frozen=True)
class ArrheniusMaster:
    """Master curve of a temperature and frequency sweep.

    Attributes
    ----------
    activation_energy_kJ_per_mol : float
    activation_energy_se : float
        Standard error [kJ/mol].
    reference : float
        [degC].
    reduced_frequency : ndarray (n,)
        f a_T [Hz].
    """

    activation_energy_kJ_per_mol: float
    activation_energy_se: float
    reference: float
    reduced_frequency: Floats


def fit_arrhenius(
    frequency: ArrayLike, temperature: ArrayLike, storage: ArrayLike, reference: float, degree: int = 3
) -> ArrheniusMaster:
    """Fit the activation energy that brings all storage moduli onto one smooth master curve.

    ln E' is a polynomial in ln(f a_T); its coefficients and the energy are fitted together, so the curves need not
    overlap in pairs.

    Parameters
    ----------
    frequency, temperature, storage : array_like (n,)
        [Hz], [degC], [MPa]; at least two temperatures.
    reference : float
        Temperature of the master curve [degC].
    degree : int
        Of the polynomial.

    Returns
    -------
    ArrheniusMaster

    Raises
    ------
    ValueError
        For one temperature only.
    """
    f, t, e1 = (np.asarray(a, dtype=float).ravel() for a in (frequency, temperature, storage))
    if np.ptp(t) == 0.0:
        raise ValueError("a shift needs at least two temperatures")
    unit = arrhenius_shift(t, reference, 1.0) * np.log(10.0)
    log_f, log_e = np.log(f), np.log(e1)

    def residual(q: Floats) -> Floats:
        return np.polyval(q[1:], log_f + q[0] * unit) - log_e

    start = np.concatenate([[50.0], np.polyfit(log_f, log_e, degree)])
    fit = least_squares(residual, start, method="lm")
    dof = max(1, len(f) - len(start))
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * 2.0 * fit.cost / dof
    energy = float(fit.x[0])
    return ArrheniusMaster(energy, float(np.sqrt(covariance[0, 0])), reference, f * np.exp(energy * unit))
