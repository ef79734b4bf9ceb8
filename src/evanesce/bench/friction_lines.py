"""A line in the spectrum of friction: whether coloured noise makes it, and whether machine or interface sets it.

Background: noise that remembers (first-order autoregression, red) beside white noise,

    S(f) = a (1 - r)^2/(1 - 2 r cos(2 pi f/f_s) + r^2) + b,

fitted to the logarithm of the periodogram by least absolute deviations, which lines do not move. A bin of noise is
exponentially distributed about it, so that the largest of m independent bins exceeds q times the background with
probability 1 - (1 - exp(-q))^m.

A frequency of stick-slip grows with the speed of the drive, that of a vibrating machine does not.

References: M. E. Mann and J. M. Lees, Climatic Change 33 (1996) 409 (robust red background); F. P. Bowden and D. Tabor,
The Friction and Lubrication of Solids (1950), chapter 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.stats import t as student

from evanesce.bench.friction import between_bins, spectrum

Floats = NDArray[np.float64]

BINS_A_LINE = 1.5
"""Noise bandwidth of a Hann window [bins]: as many bins count as one."""
LEAST_CYCLES = 3.0
"""Cycles in the record from which a line is sought."""
MEDIAN = float(np.log(np.log(2.0)))
"""Logarithm of the median of exponentially distributed power over its mean."""
LEAST_SAMPLES = 64
"""Samples that a background of three coefficients needs."""
SIGNIFICANT = 0.01
"""p-value below which a line is one."""


@dataclass(frozen=True)
class Line:
    """Strongest line of a record above its background.

    Attributes
    ----------
    frequency, resolution : float
        [Hz].
    over_background : float
        Power over that of the background there [1].
    p_value : float
        Probability that noise alone makes one as large anywhere.
    background : ndarray (m,)
        Fitted density at the spectrum's frequencies.
    threshold : float
        Multiple of the background that noise alone exceeds anywhere with a probability of :data:`SIGNIFICANT`.
    """

    frequency: float
    resolution: float
    over_background: float
    p_value: float
    background: Floats
    threshold: float

    @property
    def found(self) -> bool:
        """Whether noise alone is unlikely."""
        return self.p_value < SIGNIFICANT


def line_of(time: ArrayLike, values: ArrayLike) -> Line:
    """Return the strongest line of a record that stands out against a background of coloured noise.

    Parameters
    ----------
    time : array_like (n,)
        [s], ascending.
    values : array_like (n,)

    Returns
    -------
    Line
        None is found in fewer than :data:`LEAST_SAMPLES`.
    """
    t, found = np.asarray(time, dtype=float), spectrum(time, values)
    frequency, density = found.frequency, found.density
    step = float(frequency[1])
    inner = np.s_[1 : frequency.size - 1]  # neither the mean nor Nyquist's bin, which has one degree of freedom
    bins = max((frequency.size - LEAST_CYCLES) / BINS_A_LINE, 1.0)
    threshold = float(-np.log(-np.expm1(np.log1p(-SIGNIFICANT) / bins)))
    if t.size < LEAST_SAMPLES or not np.all(density[inner] > 0.0):
        return Line(float("nan"), step, 0.0, 1.0, np.zeros_like(density), threshold)
    background = _background(frequency / (2.0 * float(frequency[-1])), density, inner)
    over = np.where(frequency * float(t[-1] - t[0]) >= LEAST_CYCLES, density / background, 0.0)
    # of several lines that stand out the strongest: its harmonics stand farther above a red background
    out = over[inner] > threshold
    top = int(np.argmax(np.where(out, density[inner], 0.0) if out.any() else over[inner])) + 1
    p_value = float(-np.expm1(bins * np.log1p(-np.exp(-max(float(over[top]), 1e-9)))))
    return Line(between_bins(frequency, density, top), step, float(over[top]), p_value, background, threshold)


def _background(frequency: Floats, density: Floats, inner: slice) -> Floats:
    """Return the density of red and white noise; frequency in cycles a sample."""
    log = np.log(density[inner])
    f = frequency[inner]

    def model(p: Floats, at: Floats) -> Floats:
        red, memory, white = np.exp(p[0]), 1.0 / (1.0 + np.exp(-p[1])), np.exp(p[2])
        shape = (1.0 - memory) ** 2 / (1.0 - 2.0 * memory * np.cos(2.0 * np.pi * at) + memory**2)
        return np.asarray(red * shape + white)

    def off(p: Floats) -> float:
        return float(np.abs(log - np.log(model(p, f)) - MEDIAN).mean())

    low, high = (float(np.median(part)) - MEDIAN for part in (log[: max(log.size // 20, 5)], log[log.size // 2 :]))
    starts = [np.array([low, memory, high - 1.0]) for memory in (1.0, 4.0)]
    best = min((minimize(off, start, method="Nelder-Mead") for start in starts), key=lambda one: float(one.fun))
    return model(np.asarray(best.x), frequency)


@dataclass(frozen=True)
class LineSource:
    """How the frequency of a line goes with the speed of the drive.

    Attributes
    ----------
    exponent, low, high : float
        Of the speed, with its 95 % interval: 1 of stick-slip of the interface, 0 of the machine's own vibration.
    speeds : int
        Different speeds.
    """

    exponent: float
    low: float
    high: float
    speeds: int

    @property
    def verdict(self) -> str:
        """``interface`` above a half, ``machine`` below, ``open`` where the interval holds it: inertia lowers the 1."""
        if self.low > 0.5:
            return "interface"
        return "machine" if self.high < 0.5 else "open"


def source_of(lines: Sequence[Line], speeds: ArrayLike) -> LineSource | None:
    """Return how the frequency of significant lines goes with speed; None with fewer than two speeds that have one.

    Parameters
    ----------
    lines : sequence of Line
        One for each slide.
    speeds : array_like (n,)
        Of the drive [mm/s].

    Returns
    -------
    LineSource or None

    Raises
    ------
    ValueError
        For speeds that are not positive.
    """
    v = np.asarray(speeds, dtype=float)
    if not np.all(v > 0.0):
        raise ValueError("speeds must be positive")
    kept = [k for k, line in enumerate(lines) if line.found]
    if np.unique(v[kept]).size < 2:
        return None
    x = np.log(v[kept])
    f = np.array([lines[k].frequency for k in kept])
    sigma = np.array([0.5 * lines[k].resolution for k in kept]) / f
    design = np.stack([np.ones_like(x), x], axis=1) / sigma[:, None]
    solution = np.linalg.lstsq(design, np.log(f) / sigma, rcond=None)[0]
    free = x.size - 2
    # lines may wander by more than the spectrum's resolution
    wander = float(np.sum((design @ solution - np.log(f) / sigma) ** 2)) / free if free else 1.0
    error = float(np.sqrt(np.linalg.inv(design.T @ design)[1, 1] * max(wander, 1.0)))
    half = error * float(student.ppf(0.975, free if free and wander > 1.0 else np.inf))
    return LineSource(float(solution[1]), float(solution[1]) - half, float(solution[1]) + half, np.unique(v[kept]).size)
