"""Linear viscoelasticity: Prony series, their exact creep counterpart, fits to dynamic data, time-temperature shift."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares, nnls

GAS_CONSTANT = 8.314462618  # J/(mol K), CODATA 2018
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PronySeries:
    """Relaxation modulus E(t) = E_inf + sum_i E_i exp(-t / tau_i).

    Attributes
    ----------
    equilibrium : float
        E_inf [MPa], >= 0.
    moduli : tuple of float
        E_i [MPa], > 0.
    times : tuple of float
        tau_i [s], > 0, in ascending order.

    References
    ----------
    R. M. Christensen, Theory of Viscoelasticity, 2nd ed., Academic Press 1982, chapters 1 and 3.
    """

    equilibrium: float
    moduli: tuple[float, ...]
    times: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.moduli) != len(self.times):
            raise ValueError(f"{len(self.moduli)} moduli, {len(self.times)} times")
        if self.equilibrium < 0 or any(m <= 0 for m in self.moduli) or any(t <= 0 for t in self.times):
            raise ValueError("moduli and times of a Prony series must be positive")
        if list(self.times) != sorted(set(self.times)):
            raise ValueError("relaxation times must ascend")
        if self.instantaneous <= 0:
            raise ValueError("a Prony series needs some stiffness")

    @property
    def instantaneous(self) -> float:
        """Glassy modulus E(0) [MPa]."""
        return self.equilibrium + float(sum(self.moduli))

    def relaxation(self, time: ArrayLike) -> Floats:
        """Return E(t) [MPa] at times >= 0 [s], any shape."""
        t = np.asarray(time, dtype=float)[..., None]
        return self.equilibrium + (np.exp(-t / np.array(self.times)) * np.array(self.moduli)).sum(-1)

    def relaxation_integral(self, time: ArrayLike) -> Floats:
        """Return the integral of E from 0 to t [MPa s], any shape."""
        t, tau = np.asarray(time, dtype=float), np.array(self.times)
        return self.equilibrium * t - (np.expm1(-t[..., None] / tau) * np.array(self.moduli) * tau).sum(-1)

    def complex_modulus(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Return E' + i E'' [MPa] at frequencies [Hz], any shape."""
        s = 2j * np.pi * np.asarray(frequency, dtype=float)[..., None] * np.array(self.times)
        return self.equilibrium + (np.array(self.moduli) * s / (1.0 + s)).sum(-1)

    def storage(self, frequency: ArrayLike) -> Floats:
        """Return the storage modulus E' [MPa]."""
        return self.complex_modulus(frequency).real

    def loss_factor(self, frequency: ArrayLike) -> Floats:
        """Return tan(delta) = E''/E'."""
        modulus = self.complex_modulus(frequency)
        return modulus.imag / modulus.real

    def shifted(self, shift_factor: float) -> PronySeries:
        """Return the series at another temperature: every time multiplied by the shift factor a_T."""
        return PronySeries(self.equilibrium, self.moduli, tuple(t * shift_factor for t in self.times))

    def scaled(self, factor: float) -> PronySeries:
        """Return the series with every modulus multiplied."""
        return PronySeries(self.equilibrium * factor, tuple(m * factor for m in self.moduli), self.times)

    def creep(self) -> CreepSeries:
        """Return the creep compliance that belongs to this relaxation modulus, exactly.

        In the Laplace domain s^2 E(s) D(s) = 1. The compliance has one retardation time per relaxation time; the
        retardation rates are the zeros of s E(s), which interlace the relaxation rates and are found by bracketing.
        """
        return _interconvert(self)


@dataclass(frozen=True)
class CreepSeries:
    """Creep compliance D(t) = D_0 + sum_j D_j (1 - exp(-t / lambda_j)) + t * fluidity.

    Attributes
    ----------
    instantaneous : float
        D_0 [1/MPa].
    compliances, times : tuple of float
        D_j [1/MPa] and retardation times lambda_j [s].
    fluidity : float
        [1/(MPa s)]; 0 for a solid (equilibrium modulus above 0).
    """

    instantaneous: float
    compliances: tuple[float, ...]
    times: tuple[float, ...]
    fluidity: float = 0.0

    def creep(self, time: ArrayLike) -> Floats:
        """Return D(t) [1/MPa] at times >= 0 [s], any shape."""
        t = np.asarray(time, dtype=float)
        grown = (np.array(self.compliances) * -np.expm1(-t[..., None] / np.array(self.times))).sum(-1)
        return self.instantaneous + grown + self.fluidity * t

    def creep_integral(self, time: ArrayLike) -> Floats:
        """Return the integral of D from 0 to t [s/MPa], any shape."""
        t, lam = np.asarray(time, dtype=float), np.array(self.times)
        late = (np.array(self.compliances) * (t[..., None] + lam * np.expm1(-t[..., None] / lam))).sum(-1)
        return self.instantaneous * t + late + 0.5 * self.fluidity * t**2


def _interconvert(series: PronySeries) -> CreepSeries:
    """Exact interconversion by the zeros of the Carson transform (Tschoegl 1989, section 4.1)."""
    rates = 1.0 / np.array(series.times[::-1])  # ascending
    moduli = np.array(series.moduli[::-1])
    glassy = series.instantaneous
    if len(rates) == 0:
        return CreepSeries(1.0 / glassy, (), ())

    def carson_sum(s: float) -> float:
        return series.equilibrium + float((moduli * s / (s + rates)).sum())

    # s E(s) falls from +inf to -inf between neighbouring poles -rate, so each gap holds exactly one zero.
    edges = np.concatenate([[0.0], rates])
    zeros = []
    for low, high in pairwise(edges):
        if low == 0.0 and series.equilibrium == 0.0:
            continue  # the zero at s = 0 is the flow of a liquid
        zeros.append(_bisect(carson_sum, low, high))
    compliances, times = [], []
    for rate in zeros:
        slope = float((moduli * rates / (rates - rate) ** 2).sum())  # d(sE)/ds at s = -rate
        compliances.append(float(1.0 / (rate * slope)))
        times.append(float(1.0 / rate))
    viscosity = float((moduli / rates).sum())
    fluidity = 1.0 / viscosity if series.equilibrium == 0.0 else 0.0
    return CreepSeries(1.0 / glassy, tuple(compliances[::-1]), tuple(times[::-1]), fluidity)


def _bisect(function: Callable[[float], float], low: float, high: float) -> float:
    """Return the rate in (low, high) where the Carson modulus at s = -rate is zero; it falls with the rate there."""
    a, b = low, high
    for _ in range(200):
        middle = 0.5 * (a + b)
        if middle in (a, b):
            break
        if function(-middle) > 0:
            a = middle
        else:
            b = middle
    return 0.5 * (a + b)


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


def wlf_shift(temperature: ArrayLike, reference: float, c1: float, c2: float) -> Floats:
    """Return log10 a_T = -c1 (T - T_ref) / (c2 + T - T_ref); temperatures in degC, c2 in K.

    References
    ----------
    M. L. Williams, R. F. Landel and J. D. Ferry, J. Am. Chem. Soc. 77 (1955) 3701.
    """
    rise = np.asarray(temperature, dtype=float) - reference
    if np.any(c2 + rise <= 0):
        raise ValueError(f"the WLF form diverges at {reference - c2:g} degC; a temperature lies at or below it")
    return -c1 * rise / (c2 + rise)


def arrhenius_shift(temperature: ArrayLike, reference: float, activation_energy_kJ_per_mol: float) -> Floats:
    """Return log10 a_T = E_a / (R ln 10) (1/T - 1/T_ref); temperatures in degC."""
    kelvin = np.asarray(temperature, dtype=float) + 273.15
    factor = activation_energy_kJ_per_mol * 1e3 / (GAS_CONSTANT * np.log(10.0))
    return factor * (1.0 / kelvin - 1.0 / (reference + 273.15))


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
    """Find the activation energy that lays all storage moduli on one smooth curve.

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
