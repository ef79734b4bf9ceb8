"""What an extended model leaves, all open views of the contact together, and what it looks like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize, stats

from evanesce.inference.constants import LEFT
from evanesce.inference.data import DataVector

Array = NDArray[Any]

LEAST_POWER = 1e-3
"""Of the largest: bins of less light say nothing of a field that follows it."""
LONGER = 3
"""Waves over the frame's longer side; what varies as slowly or more slowly is no stripes and no bands."""


@dataclass(frozen=True)
class Periodic:
    """The strongest plane wave in what is left.

    Attributes
    ----------
    period_mm, direction_deg : float
        On the plate; of the wave vector, from +x towards +y.
    amplitude : float
        Over the light (or in DN, of a field that does not follow it), blur by the bins undone.
    p_value : float
        Against noise without structure, the number of waves that were looked at counted.
    """

    period_mm: float
    direction_deg: float
    amplitude: float
    p_value: float


@dataclass(frozen=True)
class Bands:
    """What whole rows, or columns, of the sensor have in common in what is left.

    Attributes
    ----------
    along : str
        ``rows`` or ``columns``.
    amplitude : float
        Root mean square of their mean beyond what noise makes, over the light or in DN.
    share : float
        Of the map's structure, as far as that is more than noise.
    p_value : float
        Against noise without structure, both counted.
    """

    along: str
    amplitude: float
    share: float
    p_value: float


@dataclass(frozen=True)
class Left:
    """What an extended model leaves, seen in all open views of the contact together.

    Attributes
    ----------
    follows : str
        ``light`` or ``level``: whether it grows with the light of the view or is the same in each.
    map, sd : ndarray (rows, cols)
        Estimate and standard deviation at each bin: relative to the light, or [DN]; NaN where nothing is known.
    chi2 : float
        Mean square of map over sd; 1 for noise.
    p_value : float
        Of chi2, for noise that is independent from bin to bin.
    radial : float
        Share of the map's structure that depends on the distance from the contact's middle alone.
    concentrated : float
        Share of the structure that the fiftieth part of the bins holds that shows most of it: 1 for a few spots, a few
        hundredths for what is spread.
    place_mm : tuple of float
        Middle of the structure on the sensor, from the frame's middle, in millimetres on the plate.
    with_voltage, with_force, with_time : float
        Correlation of its amplitude in single views with these; NaN where views do not differ.
    periodic : Periodic
    bands : Bands
    """

    follows: str
    map: Array
    sd: Array
    chi2: float
    p_value: float
    radial: float
    concentrated: float
    place_mm: tuple[float, float]
    with_voltage: float
    with_force: float
    with_time: float
    periodic: Periodic
    bands: Bands

    @property
    def found(self) -> bool:
        """Whether it is more than noise."""
        return min(self.p_value, self.periodic.p_value, self.bands.p_value) < LEFT

    @property
    def size(self) -> float:
        """Root mean square of what is more than noise, or the amplitude of stripes or bands; over the light or [DN]."""
        known = np.isfinite(self.map) & np.isfinite(self.sd) & (self.sd > 0)
        weight = self.sd[known] ** -2.0
        square = float(np.sum(weight * self.map[known] ** 2 - 1.0) / np.sum(weight)) if weight.size else 0.0
        parts = [float(np.sqrt(max(square, 0.0)))]
        parts += [part.amplitude for part in (self.periodic, self.bands) if part.p_value < LEFT]
        return max(parts)

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form, without the maps."""
        names = [n for n in self.__dataclass_fields__ if n not in ("map", "sd", "periodic", "bands")]
        found = {name: getattr(self, name) for name in names}
        found = {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in found.items()}
        structures = {"periodic": vars(self.periodic), "bands": vars(self.bands)}
        return found | {"found": self.found, "size": self.size, "place_mm": list(self.place_mm)} | structures

    def sentence(self) -> str:
        """Return what it looks like."""
        wave, bands = self.periodic, self.bands
        unit, times = ("% of the light", 100) if self.follows == "light" else ("DN", 1)
        words = [f"something that no cause of the library makes, the same share of the {self.follows} in all views"]
        if bands.p_value < LEFT and bands.share > 0.5:
            words.append(f"{bands.along} of the sensor by themselves, {times * bands.amplitude:.2g} {unit} rms")
        elif wave.p_value < LEFT:
            words.append(
                f"stripes of {wave.period_mm:.2f} mm period across {round(wave.direction_deg)} deg,"
                f" {times * wave.amplitude:.2g} {unit} in amplitude"
            )
        if self.concentrated > 0.5:
            words.append("in a few spots")
        if self.radial > 0.5:
            words.append("round about the contact")
        for name, value in (("voltage", self.with_voltage), ("force", self.with_force), ("time", self.with_time)):
            if abs(value) > 0.7:
                words.append(f"{'growing' if value > 0 else 'falling'} with {name}")
        return ", ".join(words)


def left_of(data: DataVector, residual: Array, by_light: Array, mm_per_bin: float, draws: Array | None = None) -> Left:
    """Return what is left in the open views of the contact.

    Parameters
    ----------
    data : DataVector
    residual : ndarray (bins,)
        Whitened, what nuisances explain taken off.
    by_light : ndarray (views, rows, cols)
        Change of the prediction per relative change of the light [DN].
    mm_per_bin : float
        On the plate.
    draws : ndarray (draws, bins), optional
        Of the noise less their mean, whitened as the residual: what is left is compared with what they leave, and else
        with independent noise.
    """
    opened = list(data.open)
    touching = [n for n, k in enumerate(opened) if data.views[k].touches]
    cube = data.unwhitened(residual)[touching]
    chosen = [opened[n] for n in touching]
    valid, seen = data.valid[chosen], np.array([view.touches for view in data.views])[:, None, None]
    cubes = [] if draws is None else [data.unwhitened(one)[touching] for one in draws]
    fields = []
    for follows, shape in (("light", by_light), ("level", np.ones_like(by_light))):
        weight = np.where(valid, data.over_noise(shape * seen)[touching], 0.0)
        power = (weight**2).sum(axis=0)
        known = power > LEAST_POWER * power.max()
        scale = np.where(known, 1.0 / np.sqrt(np.where(known, power, 1.0)), np.nan)
        standard = (weight * cube).sum(axis=0) * scale
        square = float(np.nansum(standard**2))
        noise = np.array([(weight * one).sum(axis=0) * scale for one in cubes]).reshape(-1, *standard.shape)
        p = _p_value(square, int(known.sum()), np.nansum(noise**2, axis=(1, 2)))
        maps = np.nan_to_num(noise * scale)
        wave = _periodic(np.nan_to_num(standard * scale), scale, mm_per_bin, maps)
        bands = _bands(np.nan_to_num(standard * scale), scale, maps)
        # Noise has one for each bin, of which light shows in fewer.
        least, gained = min(p, wave.p_value, bands.p_value), square - known.sum()
        fields.append((-least, gained, follows, standard, scale, weight, p, wave, bands))
    _, _, follows, standard, sd, weight, p, wave, bands = max(fields, key=lambda one: one[:2])
    field, known = standard * sd, np.isfinite(standard)
    standard = np.nan_to_num(standard)
    amplitudes = _amplitudes(cube, weight, np.nan_to_num(field))
    views = [data.views[k] for k in chosen]
    middle, radial = _around(standard, np.abs(by_light[chosen]).sum(axis=0))
    rows, cols = field.shape
    return Left(
        follows, field, sd, float((standard**2).sum() / known.sum()), p, radial, _concentrated(standard[known] ** 2),
        ((middle[1] - (cols - 1) / 2) * mm_per_bin, (middle[0] - (rows - 1) / 2) * mm_per_bin),
        _correlation(amplitudes, [v.voltage_V for v in views]),
        _correlation(amplitudes, [v.force_N or 0.0 for v in views]),
        _correlation(amplitudes, [v.time_s for v in views]),
        wave, bands,
    )  # fmt: skip


def _p_value(square: float, count: int, usual: Array) -> float:
    """Return the probability of a larger sum of squares: of independent noise, or of noise that has left some sums.

    Sums of squares of noise that hangs together are distributed nearly as a gamma law of their mean and variance.
    """
    if len(usual) < 2:
        return float(stats.chi2.sf(square, count))
    usual = usual * _as_data(len(usual))
    mean, variance = max(float(usual.mean()), count), float(usual.var(ddof=1))
    shape = mean**2 / max(variance, 2.0 * mean)
    return float(stats.gamma.sf(square, shape, scale=mean / shape))


def _as_data(draws: int) -> float:
    """Return the variance of data over that of so many draws: their mean was taken off each, and stands in for it."""
    return (draws + 1) / (draws - 1)


def _concentrated(squares: Array) -> float:
    """Return the share of squares (n,), less what noise has of them, that their fiftieth part holds."""
    ordered = np.sort(squares)[::-1]
    few = max(len(ordered) // 50, 1)
    # E(z^2; z^2 > q) = P(chi^2 of 3 degrees > q): what noise has in its largest fiftieth.
    expected = few * float(stats.chi2(3).sf(stats.chi2(1).isf(0.02)) / 0.02)
    excess = float(ordered.sum()) - len(ordered)
    return float(np.clip((ordered[:few].sum() - expected) / max(excess, 1e-12), 0.0, 1.0)) if excess > 0 else 0.0


def _amplitudes(cube: Array, weight: Array, field: Array) -> Array:
    """Return how strongly each view shows the common field (views,)."""
    shape = weight * field
    return np.asarray((cube * shape).sum(axis=(1, 2)) / np.maximum((shape**2).sum(axis=(1, 2)), 1e-12))


def _correlation(amplitudes: Array, with_what: Sequence[float]) -> float:
    if np.ptp(with_what) == 0 or np.ptp(amplitudes) == 0:
        return float("nan")
    return float(np.corrcoef(amplitudes, with_what)[0, 1])


def _around(standard: Array, light: Array) -> tuple[tuple[float, float], float]:
    """Return the middle (row, col) of a map's structure, and its share that depends on the distance from the light."""
    energy = ndimage.gaussian_filter(standard**2, 1.0)
    middle = ndimage.center_of_mass(np.maximum(energy - np.median(energy), 0.0) + 1e-12)
    bright = ndimage.center_of_mass(light + 1e-12)
    y, x = np.indices(standard.shape)
    ring = np.hypot(y - bright[0], x - bright[1]).astype(int)
    mean = ndimage.mean(standard, ring, np.arange(ring.max() + 1))
    counts = np.bincount(ring.ravel(), minlength=ring.max() + 1)
    # Means of noise have a square of one over the number of bins in the ring.
    explained = float((counts * mean**2).sum() - len(counts))
    return (float(middle[0]), float(middle[1])), max(explained, 0.0) / max(float((standard**2).sum()), 1e-12)


def _bands(field: Array, sd: Array, noise: Array) -> Bands:
    """Return what whole rows, or columns, have in common, of both what noise (draws, ...) makes less probably."""
    weight = np.where(np.isfinite(sd), 1.0 / np.nan_to_num(sd, nan=1.0) ** 2, 0.0)
    found, every = [], float((field**2 * weight).sum() - (weight > 0).sum())
    for axis, along in ((1, "rows"), (0, "columns")):
        power = weight.sum(axis=axis)
        seen = power > LEAST_POWER * power.max()
        size = np.sqrt(power[seen])
        standard = (np.concatenate([field[None], noise]) * weight).sum(axis=axis + 1)[:, seen].T / size[:, None]
        # Longer waves are what smooth causes leave.
        place = np.flatnonzero(seen) / (len(seen) - 1.0)
        smooth = np.polynomial.legendre.legvander(2.0 * place - 1.0, 2 * LONGER) * size[:, None]
        standard = standard - smooth @ np.linalg.lstsq(smooth, standard, rcond=None)[0]
        free = len(standard) - smooth.shape[1]
        if free > 0:
            square, *usual = (float(one) for one in (standard**2).sum(axis=0))
            expected = max(_as_data(len(usual)) * float(np.mean(usual)), free) if len(usual) > 1 else free
            more, p = max(square - expected, 0.0), min(2.0 * _p_value(square, free, np.array(usual)), 1.0)
            found.append(Bands(along, float(np.sqrt(more / power.sum())), more / max(every, more, 1e-12), p))
    return min(found, key=lambda one: one.p_value, default=Bands("rows", 0.0, 0.0, 1.0))


def _periodic(field: Array, sd: Array, mm_per_bin: float, noise: Array) -> Periodic:
    """Return the least probable plane wave of a field, by the spectrum of what bins say times how well each is known.

    Of independent noise all waves have one mean power; else each has that of the noise's draws (draws, rows, cols).
    """
    weight = np.where(np.isfinite(sd), 1.0 / np.nan_to_num(sd, nan=1.0), 0.0)
    spectrum = np.abs(np.fft.rfft2(field * weight**2)) ** 2
    down = np.fft.fftfreq(field.shape[0])[:, None]
    right = np.fft.rfftfreq(field.shape[1])[None, :]
    # Longer waves are what smooth causes leave; shorter ones are no stripes.
    looked_at = np.hypot(down, right) >= LONGER / max(field.shape)
    # Half the waves are below ln 2 of the mean: a peak does not raise that.
    over = spectrum / float(np.median(spectrum[looked_at]) / np.log(2.0))
    log_p = -over
    if (draws := len(noise)) > 1:
        usual = _as_data(draws) * (np.abs(np.fft.rfft2(noise * weight**2)) ** 2).mean(axis=0)
        # Of a power over a mean of others as many, each distributed exponentially: Fisher's law.
        log_p = np.maximum(log_p, (1 - draws) * np.log1p(spectrum / np.maximum(usual, 1e-300) / (draws - 1)))
    log_p[~looked_at] = 0.0
    peak = np.unravel_index(int(np.argmin(log_p)), spectrum.shape)
    p = float(-np.expm1(looked_at.sum() * np.log1p(-np.exp(max(float(log_p[peak]), -700.0)))))
    y, x = np.indices(field.shape)

    def fitted(at: Array) -> tuple[float, float]:
        """Return what a wave of frequency (down, right) leaves, and its amplitude."""
        phase = 2.0 * np.pi * (at[0] * y + at[1] * x)
        rows = np.array([(np.cos(phase) * weight).ravel(), (np.sin(phase) * weight).ravel()])
        target = (field * weight).ravel()
        amounts = np.linalg.lstsq(rows.T, target, rcond=None)[0]
        return float(((target - amounts @ rows) ** 2).sum()), float(np.hypot(*amounts))

    start = np.array([float(down[peak[0], 0]), float(right[0, peak[1]])])
    simplex = start + np.array([[0.0, 0.0], [0.3 / field.shape[0], 0.0], [0.0, 0.3 / field.shape[1]]])
    found = optimize.minimize(
        lambda at: fitted(at)[0], start, method="Nelder-Mead", options={"initial_simplex": simplex}
    )
    at = found.x
    frequency = float(np.hypot(*at))
    kept = float(np.sinc(at[0]) * np.sinc(at[1]))
    direction = float(np.degrees(np.arctan2(at[0], at[1])))
    return Periodic(mm_per_bin / max(frequency, 1e-9), direction, fitted(at)[1] / max(abs(kept), 0.1), p)
