"""Effects whose places cannot be known beforehand: they predict how grey values scatter, not where.

Each pixel departs from its mean with a small probability, which may be another one where its left neighbour has
departed (a blurred speck covers several pixels, a hot pixel one). The law of the departure is the
effect's own: its code is run once and the pixels that it changes are counted.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from evanesce.core.states import SensorLight
from evanesce.criticism.photograph_light import LightModel, Values
from evanesce.effects import all_effects
from evanesce.sensor.tone import CURVES, Curve

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FREEDOM = 4.0
"""Of the core's t law: heavy enough that a speck in the fit weighs nothing (Lange, Little & Taylor, JASA 84 (1989))."""

_T_PEAK = float(stats.t.logpdf(0.0, FREEDOM))

CUT = 3.0
"""Departures below this many deviations are the core's: there the tail counts as nothing, against the candidate."""

NEIGHBOUR_CUT = 4.0
LOCAL_BINS, ROWS_AT_ONCE = 3, 16
"""Half the window of a local level; how many rows of windows are looked at together."""

RUN_BINS = 8.0
"""Longest run of pixels along a row that one speck or grain covers."""

TAILS = ("hot_pixels", "sensor_dust", "specks")
SPECK_QUANTILES = 12
FAINTEST = 0.03  # of a speck's peak: what is fainter is not counted as covered by it
DUST_BINS = 24
TABLE = 8192


@dataclass(frozen=True)
class Seen:
    """Residuals of some pixels, with what a tail's law needs to know.

    Attributes
    ----------
    residual, deviation : ndarray (n,)
        Photograph minus mean, and the core's deviation [DN].
    excess : ndarray (n,)
        Light beyond the mean's [1 = full scale].
    mean_light : ndarray (n,)
    slope : ndarray (n,)
        Light per grey value at the pixel's own value [1/DN].
    neighbour_high, neighbour_low : ndarray of bool (n,)
        Whether the pixel to the left stands out, upwards or downwards.
    """

    residual: Array
    deviation: Array
    excess: Array
    mean_light: Array
    slope: Array
    neighbour_high: Mask
    neighbour_low: Mask

    def some(self, which: Mask) -> Seen:
        """Return a part."""
        return Seen(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


Law = Callable[[Seen, Array], Array]


@dataclass(frozen=True)
class Tail:
    """A fitted law of departures.

    Attributes
    ----------
    id : str
    theta : ndarray
        Logit of the share of pixels, of that beside a departed one, then the law's own numbers.
    """

    id: str
    theta: Array

    def weight(self, seen: Seen) -> Array:
        """Return each pixel's probability of departing (n,)."""
        beside = seen.neighbour_low if self.id == "sensor_dust" else seen.neighbour_high
        return 1.0 / (1.0 + np.exp(-np.where(beside, self.theta[1], self.theta[0])))


def core_log_density(residual: Array, deviation: Array) -> Array:
    """Return the core's log density [nats per DN]."""
    return np.asarray(_T_PEAK - (FREEDOM + 1) / 2 * np.log1p((residual / deviation) ** 2 / FREEDOM) - np.log(deviation))


def log_density(seen: Seen, tails: tuple[Tail, ...], laws: dict[str, Law]) -> Array:
    """Return the log density of each pixel under core and tails (n,) [nats per DN]."""
    core = core_log_density(seen.residual, seen.deviation)
    if not tails:
        return core
    weights = [tail.weight(seen) for tail in tails]
    total = np.maximum(1.0 - sum(weights), 1e-9) * np.exp(core)
    out = np.abs(seen.residual) > CUT * seen.deviation
    some = seen.some(out)
    for tail, weight in zip(tails, weights, strict=True):
        total[out] += weight[out] * laws[tail.id](some, tail.theta[2:])
    return np.asarray(np.log(total))


def core_share(seen: Seen, tails: tuple[Tail, ...], laws: dict[str, Law]) -> Array:
    """Return the probability that each pixel belongs to the core, which the fit of the mean weighs it with."""
    if not tails:
        return np.ones(seen.residual.shape)
    weights = sum(tail.weight(seen) for tail in tails)
    core = np.log(np.maximum(1.0 - weights, 1e-9)) + core_log_density(seen.residual, seen.deviation)
    return np.asarray(np.exp(np.minimum(core - log_density(seen, tails, laws), 0.0)))


def law_of(name: str, model: LightModel, values: Values) -> Law:
    """Return an effect's density of departures [1/DN] as a function of pixels and the law's own numbers."""
    if name == "hot_pixels":
        return _hot
    if name == "sensor_dust":
        return _dust(model)
    return _speck(model, values)


START = {"hot_pixels": (-5.0, -5.0, -3.0), "sensor_dust": (-5.0, -1.0), "specks": (-5.0, -1.0, -8.6, 0.4)}
"""Logits, then: log of the mean extra light; nothing; log of the median's mm^2 and log of its spread."""

# A speck as bright as 0.4 mm^2 of paper is a blot; one law of sizes spreads by a tenth at least.
LOW = {"hot_pixels": (-14.0, -14.0, -9.0), "sensor_dust": (-14.0, -14.0), "specks": (-14.0, -14.0, -14.0, -2.5)}
HIGH = {"hot_pixels": (-1.0, -1.0, 2.0), "sensor_dust": (-1.0, 3.0), "specks": (-1.0, 3.0, -1.0, 1.0)}


def fit_tail(name: str, seen: Seen, others: tuple[Tail, ...], laws: dict[str, Law], start: Tail | None = None) -> Tail:
    """Fit one tail by maximum likelihood, the others held.

    Parameters
    ----------
    name : str
    seen : Seen
        Pixels that may be fitted.
    others : tuple of Tail
    laws : dict of str to Law
    start : Tail, optional
        To start from, with fewer steps.
    """
    low, high = np.array(LOW[name]), np.array(HIGH[name])
    other = sum((tail.weight(seen) for tail in others), np.zeros(seen.residual.shape))
    core = core_log_density(seen.residual, seen.deviation)
    out = np.abs(seen.residual) > CUT * seen.deviation
    far = seen.some(out)
    fixed = sum((t.weight(far) * laws[t.id](far, t.theta[2:]) for t in others), np.zeros(far.residual.shape))
    inner = replace(Tail(name, low), theta=low)
    beside = (seen.neighbour_low if name == "sensor_dust" else seen.neighbour_high)[~out]
    counts = [
        (float(np.mean(other[~out][beside == b])) if (beside == b).any() else 0.0, (beside == b).sum()) for b in (0, 1)
    ]

    followed = float(np.mean(seen.neighbour_low if name == "sensor_dust" else seen.neighbour_high))

    def tied(theta: Array) -> Array:
        theta = np.clip(theta, low, high)
        if name == "hot_pixels":
            return np.array([theta[0], theta[0], *theta[2:]])
        # Each run of departed pixels begins somewhere: one in so many has a neighbour that has not departed.
        least = followed / (RUN_BINS * (1.0 + np.exp(-theta[1])))
        return np.array([max(theta[0], np.log(max(least, 1e-6))), *theta[1:]])

    def miss(theta: Array) -> float:
        tail = replace(inner, theta=tied(theta))
        share = [1.0 / (1.0 + np.exp(-t)) for t in tail.theta[:2]]
        near = sum(n * np.log(max(1.0 - o - w, 1e-9)) for (o, n), w in zip(counts, share, strict=True))
        weight = tail.weight(far)
        mixed = np.maximum(1.0 - other[out] - weight, 1e-9) * np.exp(core[out]) + fixed
        return -float(near + np.log(mixed + weight * laws[name](far, tail.theta[2:])).sum())

    first = np.array(START[name]) if start is None else start.theta
    solved = optimize.minimize(
        miss,
        first,
        method="Nelder-Mead",
        options={"maxfev": 120 if start is not None else 400, "xatol": 0.02, "fatol": 0.2},
    )
    return Tail(name, tied(solved.x))


@dataclass(frozen=True)
class Inverse:
    """A tone curve turned round, and a photograph's own light by it.

    Attributes
    ----------
    table : ndarray (n,)
        Light of evenly spaced grey values from 0 to 255.
    light, slope : ndarray (rows, cols)
        Of the photograph: relative light, and its rise by grey value [1/DN].
    """

    table: Array
    light: Array
    slope: Array

    @classmethod
    def of(cls, data: Array, curve: Curve) -> Inverse:
        """Turn a curve round for grey values (rows, cols) [DN]."""
        light = np.linspace(0.0, 1.0, 8192)
        grey = np.linspace(0.0, 255.0, TABLE)
        table = np.interp(grey, 255.0 * CURVES[curve](light), light)
        slope = np.gradient(table, grey)
        return cls(table, np.interp(data, grey, table), np.interp(data, grey, slope))

    def __call__(self, grey: Array) -> Array:
        """Return the light of grey values."""
        return self.table[np.clip(np.rint(grey * ((TABLE - 1) / 255.0)), 0, TABLE - 1).astype(np.int64)]


def local_level(residual: Array, which: Mask, half: int = LOCAL_BINS) -> Array:
    """Return the median of a residual's neighbourhood (rows, cols), of the bins that count; 0 where there are none.

    What a smooth model of light gets wrong is alike over some bins, and is no point.

    Parameters
    ----------
    residual : ndarray (rows, cols)
    which : ndarray of bool (rows, cols)
        Bins that may be looked at.
    half : int
        Bins to each side.
    """
    size = 2 * half + 1
    padded = np.pad(np.where(which, residual, np.nan), half, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size))
    found = np.zeros(residual.shape)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "All-NaN slice")
        for row in range(0, len(residual), ROWS_AT_ONCE):
            part = windows[row : row + ROWS_AT_ONCE]
            found[row : row + ROWS_AT_ONCE] = np.nanmedian(part.reshape(*part.shape[:2], -1), axis=2)
    return np.nan_to_num(found)


def seen_of(data: Array, mean: Array, deviation: Array, inverse: Inverse, which: NDArray[np.int64]) -> Seen:
    """Return what a tail's law needs of some bins.

    Parameters
    ----------
    data, mean : ndarray (rows, cols)
        Photograph and model [DN].
    deviation : ndarray (rows, cols)
        Of the core [DN].
    inverse : Inverse
    which : ndarray of int (n,)
        Flat indices.
    """
    residual = (data - mean).ravel()
    z = residual / deviation.ravel()
    left = np.where(which % data.shape[1] > 0, z[which - 1], 0.0)
    expected = inverse(mean.ravel()[which])
    return Seen(
        residual[which],
        deviation.ravel()[which],
        inverse.light.ravel()[which] - expected,
        expected,
        inverse.slope.ravel()[which],
        left > NEIGHBOUR_CUT,
        left < -NEIGHBOUR_CUT,
    )


def _hot(seen: Seen, own: Array) -> Array:
    """Exponential in charge: the effect's own law."""
    mean = np.exp(own[0])
    return np.where(seen.excess > 0, np.exp(-np.maximum(seen.excess, 0.0) / mean) / mean * seen.slope, 0.0)


def _dust(model: LightModel) -> Law:
    """Share of light stopped, counted over the frame from the effect's grains at their default size."""
    effect = all_effects()["sensor_dust"]
    flat = SensorLight(irradiance=np.ones(model.photograph.data.shape))
    dusty = effect.apply(flat, effect.with_values({"per_cm2": 300.0}), model.photograph.context)
    stopped = 1.0 - dusty.irradiance.ravel()
    counts, edges = np.histogram(stopped[stopped > 0.02], bins=DUST_BINS, range=(0.02, 1.0), density=True)

    def law(seen: Seen, own: Array) -> Array:
        share = -seen.excess / np.maximum(seen.mean_light, 1e-6)
        place = np.clip(((share - edges[0]) / (edges[1] - edges[0])).astype(int), 0, DUST_BINS - 1)
        inside = (share > edges[0]) & (share < edges[-1])
        return np.where(inside, counts[place] / np.maximum(seen.mean_light, 1e-6) * seen.slope, 0.0)

    return law


def speck_pattern(model: LightModel, values: Values) -> tuple[Array, float]:
    """Return light per area of paper [1/mm^2] in the pixels that a speck covers (quantiles), and how many they are."""
    per_cm2, area = 60.0, 1e-3
    table = {"per_cm2": per_cm2, "log_spread": 0.0, "median_light_mm2": area, "paper_over_contact": 1.0}
    lit = model.plate_field("specks", table) / model.contact() / area
    seen = model.spread(lit, values)
    covered = seen[seen > FAINTEST * seen.max()]
    camera = model.photograph.scene.camera
    specks = per_cm2 / 100.0 * seen.size / camera.scale_px_per_mm**2
    return np.quantile(covered, (np.arange(SPECK_QUANTILES) + 0.5) / SPECK_QUANTILES), covered.size / specks


def _speck(model: LightModel, values: Values) -> Law:
    """Log-normal light spread by the lens over the pixels of each speck."""
    pattern, _ = speck_pattern(model, values)
    per_area = np.log(values["light.bright"] * pattern)

    def law(seen: Seen, own: Array) -> Array:
        median, spread = own[0], np.exp(own[1])
        log_excess = np.log(np.maximum(seen.excess, 1e-12))
        z = (log_excess[:, None] - median - per_area) / spread
        density = np.exp(-0.5 * z * z).mean(axis=1) / (spread * np.sqrt(2 * np.pi))
        return np.where(seen.excess > 0, density / np.maximum(seen.excess, 1e-12) * seen.slope, 0.0)

    return law
