"""Linear viscoelasticity: Prony series, their exact creep compliance, time-temperature shift."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
        """Return E(t) [MPa] at times >= 0 [s], any shape.

        Parameters
        ----------
        time : array_like
            [s].

        Returns
        -------
        ndarray
            [MPa].
        """
        t = np.asarray(time, dtype=float)[..., None]
        return self.equilibrium + (np.exp(-t / np.array(self.times)) * np.array(self.moduli)).sum(-1)

    def relaxation_integral(self, time: ArrayLike) -> Floats:
        """Return the integral of E from 0 to t [MPa s], any shape.

        Parameters
        ----------
        time : array_like
            [s], not negative.

        Returns
        -------
        ndarray
            [MPa s].
        """
        t, tau = np.asarray(time, dtype=float), np.array(self.times)
        return self.equilibrium * t - (np.expm1(-t[..., None] / tau) * np.array(self.moduli) * tau).sum(-1)

    def complex_modulus(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Return E' + i E'' [MPa] at frequencies [Hz], any shape.

        Parameters
        ----------
        frequency : array_like
            [Hz].

        Returns
        -------
        ndarray
            Complex [MPa].
        """
        s = 2j * np.pi * np.asarray(frequency, dtype=float)[..., None] * np.array(self.times)
        return self.equilibrium + (np.array(self.moduli) * s / (1.0 + s)).sum(-1)

    def storage(self, frequency: ArrayLike) -> Floats:
        """Return the storage modulus E' [MPa].

        Parameters
        ----------
        frequency : array_like
            [Hz].

        Returns
        -------
        ndarray
            [MPa].
        """
        return self.complex_modulus(frequency).real

    def loss_factor(self, frequency: ArrayLike) -> Floats:
        """Return tan(delta) = E''/E'.

        Parameters
        ----------
        frequency : array_like
            [Hz].

        Returns
        -------
        ndarray
        """
        modulus = self.complex_modulus(frequency)
        return modulus.imag / modulus.real

    def shifted(self, shift_factor: float) -> PronySeries:
        """Return the series at another temperature: every time multiplied by the shift factor a_T.

        Parameters
        ----------
        shift_factor : float
            a_T.

        Returns
        -------
        PronySeries
        """
        return PronySeries(self.equilibrium, self.moduli, tuple(t * shift_factor for t in self.times))

    def scaled(self, factor: float) -> PronySeries:
        """Return the series with every modulus multiplied.

        Parameters
        ----------
        factor : float

        Returns
        -------
        PronySeries
        """
        return PronySeries(self.equilibrium * factor, tuple(m * factor for m in self.moduli), self.times)

    def creep(self) -> CreepSeries:
        """Return the creep compliance that belongs to this relaxation modulus, exactly.

        In the Laplace domain s^2 E(s) D(s) = 1. The compliance has one retardation time per relaxation time; the
        retardation rates are the zeros of s E(s), which interlace the relaxation rates and are found by bracketing.

        Returns
        -------
        CreepSeries
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
        """Return D(t) [1/MPa] at times >= 0 [s], any shape.

        Parameters
        ----------
        time : array_like
            [s].

        Returns
        -------
        ndarray
            [1/MPa].
        """
        t = np.asarray(time, dtype=float)
        grown = (np.array(self.compliances) * -np.expm1(-t[..., None] / np.array(self.times))).sum(-1)
        return self.instantaneous + grown + self.fluidity * t

    def creep_integral(self, time: ArrayLike) -> Floats:
        """Return the integral of D from 0 to t [s/MPa], any shape.

        Parameters
        ----------
        time : array_like
            [s], not negative.

        Returns
        -------
        ndarray
            [s/MPa].
        """
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


def wlf_shift(temperature: ArrayLike, reference: float, c1: float, c2: float) -> Floats:
    """Return log10 a_T = -c1 (T - T_ref)/(c2 + T - T_ref) of Williams, Landel and Ferry.

    Parameters
    ----------
    temperature : array_like
        T [degC].
    reference : float
        T_ref [degC].
    c1, c2 : float
        [1], [K].

    Returns
    -------
    ndarray

    Raises
    ------
    ValueError
        At or below T_ref - c2, where the form diverges.

    References
    ----------
    M. L. Williams, R. F. Landel and J. D. Ferry, J. Am. Chem. Soc. 77 (1955) 3701.
    """
    rise = np.asarray(temperature, dtype=float) - reference
    if np.any(c2 + rise <= 0):
        raise ValueError(f"the WLF form diverges at {reference - c2:g} degC; a temperature lies at or below it")
    return -c1 * rise / (c2 + rise)


def arrhenius_shift(temperature: ArrayLike, reference: float, activation_energy_kJ_per_mol: float) -> Floats:
    """Return log10 a_T = E_a/(R ln 10) (1/T - 1/T_ref) of Arrhenius.

    Parameters
    ----------
    temperature : array_like
        T [degC].
    reference : float
        T_ref [degC].
    activation_energy_kJ_per_mol : float

    Returns
    -------
    ndarray
    """
    kelvin = np.asarray(temperature, dtype=float) + 273.15
    factor = activation_energy_kJ_per_mol * 1e3 / (GAS_CONSTANT * np.log(10.0))
    return factor * (1.0 / kelvin - 1.0 / (reference + 273.15))
