"""Dark signal: variance and mean of covered frames against exposure and temperature -> dark current and its law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from evanesce.core.arrhenius import activation_energy
from evanesce.core.errors import WorkError

Floats = NDArray[np.float64]

LEAST_ROWS = 5


@dataclass(frozen=True)
class DarkSeries:
    """Covered frames at one temperature.

    Attributes
    ----------
    name : str
        Of its pixels, such as a colour of the mosaic.
    temperature_C : float
        [degC].
    exposure_s : ndarray (n,)
        [s], ascending.
    variance_DN2 : ndarray (n,)
        [DN^2].
    mean_DN : ndarray (n,), optional
        [DN].
    spatial_DN2 : ndarray (n,), optional
        Variance over the pixels of the mean frame, where ``variance_DN2`` is that in time alone [DN^2].
    analogue_gain : float
        At which it was filmed [1].
    """

    name: str
    temperature_C: float
    exposure_s: Floats
    variance_DN2: Floats
    mean_DN: Floats | None = None
    spatial_DN2: Floats | None = None
    analogue_gain: float = 1.0


@dataclass(frozen=True)
class DarkFit:
    """Dark figures of one series.

    Attributes
    ----------
    offset_DN2 : float
        Variance at no exposure [DN^2].
    shot_DN2_per_s : float
        Linear coefficient of the variance [DN^2/s]: shot noise of the dark current, D / K^2.
    nonuniformity_DN_per_s : float
        Square root of the quadratic coefficient [DN/s]: standard deviation of the dark current over the pixels.
    exponent : float
        Of exposure in the excess variance over that at no exposure, c t^exponent [1]: 1 for shot noise alone, 2 for
        non-uniformity alone.
    residual : float
        Root mean square of measured over fitted variance, less 1 [1].
    current_DN_per_s, current_se : float
        Slope of the mean [DN/s]; NaN without means.
    rows : int
    """

    offset_DN2: float
    shot_DN2_per_s: float
    nonuniformity_DN_per_s: float
    exponent: float
    residual: float
    current_DN_per_s: float
    current_se: float
    rows: int


def fit_dark(series: DarkSeries) -> DarkFit:
    """Fit variance = offset + a t + b t^2 with no coefficient below 0, and a line to the mean.

    Where spatial and temporal variance are separate, b is of the spatial and a of the temporal one.

    Parameters
    ----------
    series : DarkSeries

    Returns
    -------
    DarkFit

    Raises
    ------
    WorkError
        For fewer than five rows.

    References
    ----------
    EMVA Standard 1288, release 4.0 Linear (2021), section 7.3 (dark current from mean and from variance).
    """
    t, v = series.exposure_s, series.variance_DN2
    if t.size < LEAST_ROWS:
        raise WorkError(f"{t.size} dark rows at {series.temperature_C:g} degC; a dark series needs {LEAST_ROWS}")
    separate = series.spatial_DN2 is not None  # variance in time has no part that grows with the exposure's square
    (offset, linear, square), fitted = _parabola(t, v, 2 if separate else 3)
    if series.spatial_DN2 is not None:
        (_, _, square), _ = _parabola(t, np.maximum(series.spatial_DN2, 1e-6), 3)
    current, current_se = np.nan, np.nan
    if series.mean_DN is not None:
        line = stats.linregress(t, series.mean_DN)
        current, current_se = float(line.slope), float(line.stderr)
    excess = v - v[0]
    grown = (t > 0.0) & (excess > 0.1 * v[0])
    exponent = float(np.polyfit(np.log(t[grown]), np.log(excess[grown]), 1)[0]) if grown.sum() > 2 else float("nan")
    residual = float(np.sqrt(np.mean((v / fitted - 1.0) ** 2)))
    return DarkFit(
        float(offset), float(linear), float(np.sqrt(square)), exponent, residual, current, current_se, t.size
    )


def _parabola(t: Floats, v: Floats, terms: int) -> tuple[Floats, Floats]:
    """Return the coefficients of 1, t, t^2, none below 0, and the fitted values; rows by their relative error."""
    design = np.stack([np.ones_like(t), t, t**2], axis=1)[:, :terms]
    scale = np.maximum(design.max(axis=0), 1e-300)
    fitted = v
    for _ in range(20):
        found, _ = optimize.nnls(design / scale / fitted[:, None], v / fitted)
        fitted = np.maximum(design / scale @ found, 1e-3 * v)
    return np.append(found / scale, np.zeros(3 - terms)), fitted


@dataclass(frozen=True)
class Acceleration:
    """How much faster the dark signal grows at the higher of two temperatures.

    Attributes
    ----------
    name : str
        Of the pixels.
    low_C, high_C : float
        [degC].
    factor : float
        Exposure at the lower temperature over that at the higher for one and the same excess variance [1].
    scatter : float
        Standard deviation of its logarithm over the levels of excess variance [1]: 0 where one factor holds for all.
    levels : int
    """

    name: str
    low_C: float
    high_C: float
    factor: float
    scatter: float
    levels: int

    @property
    def activation_energy_eV(self) -> float:
        """E of rate = c exp(-E / (k T)) [eV]."""
        return activation_energy(self.factor, self.low_C, self.high_C)

    @property
    def doubling_K(self) -> float:
        """Rise of temperature that doubles the dark current between the two [K]."""
        return float((self.high_C - self.low_C) * np.log(2.0) / np.log(self.factor))


def acceleration(low: DarkSeries, high: DarkSeries) -> Acceleration:
    """Return the factor on exposure by which two temperatures' excess variances agree.

    It assumes no law in the exposure: shot noise, non-uniformity and saturated hot pixels all depend on dark current
    times exposure alone, if every pixel's dark current has the same temperature law.

    Parameters
    ----------
    low, high : DarkSeries
        Of the same pixels, ``high`` at the higher temperature.

    Returns
    -------
    Acceleration

    Raises
    ------
    WorkError
        If the two series share no level of excess variance, or the warmer does not grow faster.
    """
    at_low, at_high = (one.variance_DN2 / one.analogue_gain**2 for one in (low, high))
    excess_low = at_low[1:] - at_low[0]
    excess_high = np.maximum.accumulate(at_high[1:] - at_high[0])
    # Levels below a tenth of the variance without exposure are within its own error.
    shared = (excess_low > max(0.1 * at_low[0], excess_high[0])) & (excess_low < excess_high[-1])
    if shared.sum() < 3:
        pair = f"{low.temperature_C:g} and {high.temperature_C:g} degC"
        raise WorkError(f"{low.name}: {pair} share no levels of dark variance")
    warm = np.interp(excess_low[shared], excess_high, high.exposure_s[1:])
    ratio = np.log(low.exposure_s[1:][shared] / warm)
    if not ratio.mean() > 0.0:
        raise WorkError(f"{low.name}: the dark variance grows no faster at {high.temperature_C:g} degC")
    return Acceleration(
        low.name, low.temperature_C, high.temperature_C, float(np.exp(ratio.mean())), float(ratio.std(ddof=1)),
        int(shared.sum()),
    )  # fmt: skip


@dataclass(frozen=True)
class TemperatureLaw:
    """Arrhenius' law of the dark current.

    Attributes
    ----------
    activation_energy_eV, activation_energy_se : float
        [eV]; the error is NaN where two temperatures of one kind of pixels fix the energy without any left over.
    low_eV, high_eV : float
        95 % confidence interval by Student's t [eV].
    estimates : int
    """

    activation_energy_eV: float
    activation_energy_se: float
    low_eV: float
    high_eV: float
    estimates: int


def temperature_law(found: Sequence[Acceleration]) -> TemperatureLaw:
    """Return the mean activation energy of several kinds of pixels or pairs of temperatures, with its interval.

    Parameters
    ----------
    found : sequence of Acceleration

    Returns
    -------
    TemperatureLaw
    """
    energy = np.array([a.activation_energy_eV for a in found])
    if energy.size == 0:
        raise WorkError("a temperature law needs dark series at two temperatures")
    mean = float(energy.mean())
    if energy.size < 2:
        return TemperatureLaw(mean, np.nan, np.nan, np.nan, 1)
    error = float(energy.std(ddof=1) / np.sqrt(energy.size))
    reach = float(stats.t.ppf(0.975, energy.size - 1)) * error
    return TemperatureLaw(mean, error, mean - reach, mean + reach, energy.size)
