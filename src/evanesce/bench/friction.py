"""Friction traces -> static and dynamic coefficient, stick-slip frequency, interfacial rheology."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from evanesce.core.columns import Column, read_columns
from evanesce.core.errors import InputError, WorkError

Floats = NDArray[np.float64]

COLUMNS = (
    Column("time", ("t",), "time"),
    Column("fx", ("force_x", "tangential_force", "tangential", "friction_force", "f_t"), "force"),
    Column("fy", ("force_y",), "force", required=False),
    Column("fz", ("force_z", "normal_force", "normal", "load", "f_n"), "force"),
)


@dataclass(frozen=True)
class FrictionTrace:
    """Forces of one slide.

    Attributes
    ----------
    time : ndarray (n,)
        [s], ascending.
    fx, fy, fz : ndarray (n,)
        Forces on the finger [N]; fz is the normal force, positive when pressed.
    """

    time: Floats
    fx: Floats
    fy: Floats
    fz: Floats

    @property
    def sampling_rate(self) -> float:
        """Median sampling rate [Hz]."""
        return float(1.0 / np.median(np.diff(self.time)))


def read_trace(path: Path) -> FrictionTrace:
    """Read ``time_s, Fx_N, Fy_N, Fz_N`` (Fy optional) from a CSV file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    FrictionTrace

    Raises
    ------
    InputError
        For missing columns or units, time that does not ascend, fewer than 50 samples, or no normal force.
    """
    data = read_columns(path, COLUMNS)
    time = data["time"]
    if len(time) < 50:
        raise InputError(f"{len(time)} samples", file=path, allowed="at least 50")
    stuck = np.flatnonzero(np.diff(time) <= 0.0)
    if len(stuck):
        raise InputError(f"row {stuck[0] + 3}: time does not ascend", file=path, key="time")
    fz = data["fz"] * (np.sign(np.median(data["fz"])) or 1.0)
    if np.max(fz) <= 0.0:
        raise InputError("the normal force is zero throughout", file=path, key="fz", allowed="above 0 N while sliding")
    return FrictionTrace(time, data["fx"], data.get("fy", np.zeros_like(time)), fz)


def coefficient_of_friction(trace: FrictionTrace, minimum_normal_force: float = 0.02) -> Floats:
    """Return sqrt(Fx^2 + Fy^2)/Fz at each sample (thesis, eqs 4.1, 4.2); NaN below the minimum normal force [N].

    Parameters
    ----------
    trace : FrictionTrace
    minimum_normal_force : float
        [N].

    Returns
    -------
    ndarray (n,)
    """
    friction = np.hypot(trace.fx, trace.fy)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(trace.fz > minimum_normal_force, friction / trace.fz, np.nan)


@dataclass(frozen=True)
class FrictionResult:
    """Coefficients of one slide.

    Attributes
    ----------
    static : float
        Peak of the smoothed coefficient before the stable region (thesis, eq 4.3).
    dynamic : float
        Median over the stable region.
    dynamic_spread : float
        Robust standard deviation (1.4826 MAD) over the stable region.
    noise : float
        Standard deviation of a sample's coefficient, from second differences: sensor noise without the slow course.
    smoothing_s : float
        Window of the smoothing.
    peak_time : float
        [s].
    stable : tuple of float
        Start and end of the stable region [s].
    """

    static: float
    dynamic: float
    dynamic_spread: float
    noise: float
    smoothing_s: float
    peak_time: float
    stable: tuple[float, float]


def analyse(
    trace: FrictionTrace, *, smoothing_s: float | None = None, stable: tuple[float, float] | None = None
) -> FrictionResult:
    """Find the static peak and the dynamic median of a slide.

    The trace is smoothed by a quadratic Savitzky-Golay filter, which keeps the height of a peak wider than its window.
    Sliding lasts from the first to the last sample whose smoothed coefficient exceeds half the upper level. The static
    coefficient is the first peak within 2 % of the largest smoothed value in the first half of it; the stable region is
    the rest after a quarter of the time that remains behind that peak.

    Parameters
    ----------
    trace : FrictionTrace
    smoothing_s : float, optional
        Window [s]; 1 % of the record by default.
    stable : tuple of float, optional
        Stable region [s] chosen by hand.

    Returns
    -------
    FrictionResult

    Raises
    ------
    WorkError
        If no sliding is found.
    """
    coefficient = coefficient_of_friction(trace)
    known = np.isfinite(coefficient)
    if known.sum() < 50:
        raise WorkError(f"only {int(known.sum())} samples carry a normal force; at least 50 are needed")
    filled = np.interp(trace.time, trace.time[known], coefficient[known])
    duration = trace.time[-1] - trace.time[0]
    window = max(5, round((smoothing_s or 0.01 * duration) * trace.sampling_rate) | 1)
    window = min(window, (len(filled) - 1) | 1)
    smooth = signal.savgol_filter(filled, window, 2)
    level = float(np.percentile(smooth[known], 75))
    sliding = np.flatnonzero((smooth > 0.5 * level) & known)
    if level <= 0.0 or len(sliding) < 20:
        raise WorkError("no sliding found: the coefficient of friction never stays up")
    # The longest unbroken stretch: contact at a vanishing load can spike.
    runs = np.split(sliding, np.flatnonzero(np.diff(sliding) > window) + 1)
    run = max(runs, key=len)
    first, last = int(run[0]), int(run[-1])
    # Under stick-slip every turn has its peak; the first that comes within 2 % of the highest is the first break-away.
    early = smooth[first : (first + last) // 2 + 1]
    reached = int(np.flatnonzero(early >= 0.98 * early.max())[0])
    peak = first + reached + int(np.argmax(early[reached : reached + window]))
    if stable is None:
        start, stop = peak + (last - peak) // 4, last
    else:
        start, stop = (int(np.searchsorted(trace.time, t)) for t in stable)
    region = coefficient[start:stop]
    region = region[np.isfinite(region)]
    if len(region) < 10:
        raise WorkError(f"the stable region holds {len(region)} samples; at least 10 are needed")
    dynamic = float(np.median(region))
    noise = float(1.4826 * np.median(np.abs(np.diff(region, 2))) / np.sqrt(6.0))
    return FrictionResult(
        static=max(float(smooth[peak]), dynamic),
        dynamic=dynamic,
        dynamic_spread=float(1.4826 * np.median(np.abs(region - dynamic))),
        noise=noise,
        smoothing_s=window / trace.sampling_rate,
        peak_time=float(trace.time[peak]),
        stable=(float(trace.time[start]), float(trace.time[min(stop, len(trace.time) - 1)])),
    )


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral density.

    Attributes
    ----------
    frequency : ndarray (m,)
        [Hz].
    density : ndarray (m,)
        Unit of the signal squared per Hz.
    peak : float
        Frequency of the largest peak [Hz].
    peak_share : float
        Share of all power within one resolution (three bins) of that peak.
    """

    frequency: Floats
    density: Floats
    peak: float
    peak_share: float


def spectrum(time: ArrayLike, values: ArrayLike) -> Spectrum:
    """Return the spectrum of a record, evenly resampled and detrended (Hann window), its peak between bins.

    Parameters
    ----------
    time : array_like (n,)
        [s], ascending.
    values : array_like (n,)

    Returns
    -------
    Spectrum
    """
    t, v = np.asarray(time, dtype=float), np.asarray(values, dtype=float)
    if len(t) < 16:
        raise ValueError(f"{len(t)} samples; a spectrum needs at least 16")
    even = np.linspace(t[0], t[-1], len(t))
    rate = (len(t) - 1) / (t[-1] - t[0])
    frequency, density = signal.periodogram(np.interp(even, t, v), rate, window="hann", detrend="linear")
    if not np.any(density[1:] > 0.0):
        return Spectrum(frequency, density, float("nan"), 0.0)
    top = 1 + int(np.argmax(density[1:]))
    share = float(density[max(1, top - 2) : top + 3].sum() / density[1:].sum())
    return Spectrum(frequency, density, between_bins(frequency, density, top), share)


def between_bins(frequency: Floats, density: Floats, top: int) -> float:
    """Return the frequency [Hz] of a Hann-windowed line at a bin: it is close to a parabola in the logarithm.

    Parameters
    ----------
    frequency, density : ndarray (m,)
    top : int
        The bin that is larger than its neighbours.
    """
    near = density[max(top - 1, 0) : top + 2]
    if not 1 < top < len(density) - 1 or near.min() <= 0.0 or near[1] < max(near[0], near[2]):
        return float(frequency[top])
    a, b, c = np.log(near)
    return float(frequency[top] + 0.5 * (a - c) / (a - 2 * b + c) * (frequency[1] - frequency[0]))


@dataclass(frozen=True)
class InterfacialRheology:
    """mu_s = tau0/p + alpha.

    Attributes
    ----------
    tau0 : float
        Interfacial shear strength at zero pressure [MPa].
    alpha : float
        Pressure coefficient.
    tau0_se, alpha_se : float
        Standard errors.

    References
    ----------
    B. J. Briscoe and D. Tabor, J. Adhesion 9 (1978) 145.
    """

    tau0: float
    alpha: float
    tau0_se: float
    alpha_se: float


def fit_interfacial_rheology(mean_pressure: ArrayLike, static_coefficient: ArrayLike) -> InterfacialRheology:
    """Fit tau0 and alpha to coefficients at mean pressures [MPa] by least squares in 1/p.

    Parameters
    ----------
    mean_pressure : array_like (n,)
        [MPa].
    static_coefficient : array_like (n,)

    Returns
    -------
    InterfacialRheology
    """
    p, mu = (np.asarray(a, dtype=float).ravel() for a in (mean_pressure, static_coefficient))
    if len(p) != len(mu) or len(p) < 3 or np.any(p <= 0.0) or np.ptp(p) == 0.0:
        raise ValueError("at least 3 coefficients at different positive pressures are needed")
    design = np.stack([1.0 / p, np.ones_like(p)], axis=1)
    solution, *_ = np.linalg.lstsq(design, mu, rcond=None)
    variance = float(np.sum((design @ solution - mu) ** 2)) / (len(p) - 2)
    error = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * variance)
    return InterfacialRheology(float(solution[0]), float(solution[1]), float(error[0]), float(error[1]))


def hysteresis_coefficient(pressure: float, reduced_modulus: float, loss_fraction: float) -> float:
    """Return Greenwood and Tabor's deformation part of rolling or lubricated friction of a hard sphere on rubber.

    The work a sphere does on the rubber ahead of it is 3/16 W a/R per unit of path, of which a share is lost:
    mu_h = (3/16) beta a/R, and by Hertz a/R = (3 pi/4) p/E*.

    Parameters
    ----------
    pressure : float
        Mean pressure [MPa].
    reduced_modulus : float
        [MPa].
    loss_fraction : float
        Share of the deformation energy lost per cycle, 0 to 1.

    Returns
    -------
    float

    References
    ----------
    J. A. Greenwood and D. Tabor, Proc. Phys. Soc. 71 (1958) 989.
    """
    return loss_fraction * 3.0 / 16.0 * (3.0 * np.pi / 4.0) * pressure / reduced_modulus
