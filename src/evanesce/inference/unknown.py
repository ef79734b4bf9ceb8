"""Something that no cause of the library makes: a random field over the frame, and what it looks like where found."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize, stats

from evanesce.inference.constants import LEFT, STRENGTHS, UNKNOWN_WAVES
from evanesce.inference.data import DataVector
from evanesce.inference.single_effects import UNKNOWN
from evanesce.prediction.views import View

Array = NDArray[Any]

PROFILES = ("force_N", "voltage_V", "time_s")
"""Of a view, with which an unknown field may grow."""
KINDS = {
    "light": "a smooth field of the light",
    "level": "a smooth field beside the light",
    "edges": "a moved or blurred picture",
    "series": "a smooth function in a series",
}
"""Of unknown fields, in words."""
LIT = 0.05
"""Of the largest level, below which there is hardly any light."""
LEAST_POWER = 1e-3
"""Of the largest: bins of less light say nothing of a field that follows it."""


def waves(shape: tuple[int, int], count: int, *, constant: bool = False) -> Array:
    """Return products of cosines (n, rows, cols) with up to count - 1 half waves along the longer side.

    Their amplitudes fall as one over the number of half waves: a random sum of them has as much power in each octave.

    Parameters
    ----------
    shape : tuple of int
        (rows, cols).
    count : int
    constant : bool
        Whether what is even over the frame is one of them, as large as one half wave.
    """
    rows, cols = shape
    longer = max(rows, cols)
    found = []
    for i in range(count):
        for j in range(count):
            # As many half waves to a millimetre either way: a field that has no preferred direction.
            number = float(np.hypot(i * longer / rows, j * longer / cols))
            if (constant or number > 0) and number < count:
                down = np.cos(np.pi * i * (np.arange(rows) + 0.5) / rows)
                right = np.cos(np.pi * j * (np.arange(cols) + 0.5) / cols)
                found.append(np.outer(down, right) / max(number, 1.0))
    return np.array(found).reshape(-1, rows, cols)


def at_largest_strength(rows: Array) -> Array:
    """Return whitened rows (k, d) times one factor: squared norms add up to that of the largest strength."""
    size = float(np.sqrt(np.sum([float(row @ row) for row in rows])))
    return np.asarray(rows * (STRENGTHS[-1] / size if size > 0 else 0.0), np.float32)


def profiles(views: Sequence[View]) -> dict[str, Array]:
    """Return how a field may go from view to view of the contact: a number (views,) for each, 0 where none is seen.

    ``alike`` in all, or with the distance of force, voltage or time from its mean, in standard deviations; what is the
    same in all views is left out.

    Parameters
    ----------
    views : sequence of View
    """
    touching = np.array([view.kind in ("press", "replicate") for view in views])
    found = {"alike": touching.astype(float)}
    for name in PROFILES:
        value = np.array([float(getattr(view, name) or 0.0) for view in views])
        away = np.where(touching, value - value[touching].mean(), 0.0) if touching.any() else np.zeros(len(views))
        spread = float(np.sqrt(np.mean(away[touching] ** 2))) if touching.any() else 0.0
        if spread > 0:
            found[name.partition("_")[0]] = away / spread
    return found


def told_fields(blocks: Iterable[str]) -> str:
    """Return what blocks of something unknown are, in words.

    Parameters
    ----------
    blocks : iterable of str
        Names, as those of :func:`unknown_blocks`.
    """
    words = ["something that no cause of the library makes"]
    for block in blocks:
        _, kind, *profile = block.split()
        how = "".join(", alike in all views" if name == "alike" else f" that goes with {name}" for name in profile)
        words.append(KINDS[kind] + how)
    return "; ".join(words)


def unknown_blocks(data: DataVector, nominal: Array) -> dict[str, Array]:
    """Return whitened rows (k, bins) by block: fields that follow the light, and fields that do not.

    Either are alike in all views of the contact, or go with force, voltage or time, in half as many waves: those of
    the light over the part of the frame where there is light. So may displacement, scale and blur of the picture.

    Parameters
    ----------
    data : DataVector
    nominal : ndarray (views, rows, cols)
        Prediction [DN].
    """
    shape = nominal.shape[1:]
    # Light and level that are even in all views are nuisances.
    whole, few = waves(shape, UNKNOWN_WAVES), waves(shape, UNKNOWN_WAVES // 2, constant=True)
    lit = _where_lit(nominal, UNKNOWN_WAVES // 2)
    valid = data.valid[list(data.open)]
    found = {}
    for name, profile in profiles(data.views).items():
        own = (whole, whole) if name == "alike" else (lit, few)
        for kind, basis, cube in zip(("light", "level"), own, (nominal, np.ones_like(nominal)), strict=True):
            over = data.over_noise(cube * profile[:, None, None])
            rows = np.array([(wave * over)[valid].astype(np.float32) for wave in basis])
            found[f"{UNKNOWN} {kind} {name}"] = at_largest_strength(rows)
        if name != "alike":
            rows = np.array([data.over_noise(cube * profile[:, None, None])[valid] for cube in _moved(nominal)])
            found[f"{UNKNOWN} edges {name}"] = at_largest_strength(rows)
    return found


def _moved(nominal: Array) -> list[Array]:
    """Return what frames (views, rows, cols) change by if they are displaced along either axis, scaled, or blurred."""
    down, right = np.gradient(nominal, axis=(1, 2))
    rows, cols = nominal.shape[1:]
    y, x = (np.arange(rows) - (rows - 1) / 2)[:, None], np.arange(cols) - (cols - 1) / 2
    return [down, right, x * right + y * down, np.array([ndimage.laplace(one) for one in nominal])]


def _where_lit(nominal: Array, count: int) -> Array:
    """Return waves (n, rows, cols) over the rectangle outside of which there is hardly any light, 0 there."""
    light = np.abs(nominal).max(axis=0)
    bright = light > LIT * light.max()
    rows, cols = (np.flatnonzero(bright.any(axis=axis)) for axis in (1, 0))
    down, right = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
    basis = waves(light[down, right].shape, count, constant=True)
    found = np.zeros((len(basis), *light.shape))
    found[:, down, right] = basis
    return found


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

    @property
    def found(self) -> bool:
        """Whether it is more than noise."""
        return min(self.p_value, self.periodic.p_value) < LEFT

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form, without the maps."""
        names = [n for n in self.__dataclass_fields__ if n not in ("map", "sd", "periodic")]
        found = {name: getattr(self, name) for name in names}
        found = {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in found.items()}
        return found | {"found": self.found, "place_mm": list(self.place_mm), "periodic": vars(self.periodic)}

    def sentence(self) -> str:
        """Return what it looks like."""
        wave = self.periodic
        unit = "of the light" if self.follows == "light" else "DN"
        size = 100 * wave.amplitude if self.follows == "light" else wave.amplitude
        words = [f"something that no cause of the library makes, the same share of the {self.follows} in all views"]
        if wave.p_value < LEFT:
            percent = " %" if self.follows == "light" else ""
            words.append(
                f"stripes of {wave.period_mm:.2f} mm period across {wave.direction_deg:.0f} deg,"
                f" {size:.2g}{percent} {unit} in amplitude"
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
        usual = [np.nansum(((weight * one).sum(axis=0) * scale) ** 2) for one in cubes]
        p = _p_value(square, int(known.sum()), np.array(usual))
        wave = _periodic(np.nan_to_num(standard * scale), scale, mm_per_bin)
        # Noise has one for each bin, of which light shows in fewer.
        fields.append((-min(p, wave.p_value), square - known.sum(), follows, standard, scale, weight, p, wave))
    _, _, follows, standard, sd, weight, p, wave = max(fields, key=lambda one: one[:2])
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
        wave,
    )  # fmt: skip


def _p_value(square: float, count: int, usual: Array) -> float:
    """Return the probability of a larger sum of squares: of independent noise, or of noise that has left some sums.

    Sums of squares of noise that hangs together are distributed nearly as a gamma law of their mean and variance.
    """
    if len(usual) < 2:
        return float(stats.chi2.sf(square, count))
    # A mean of as many draws was taken off each, and stands in for the mean of the noise in the data.
    usual = usual * (len(usual) + 1) / (len(usual) - 1)
    mean, variance = max(float(usual.mean()), count), float(usual.var(ddof=1))
    shape = mean**2 / max(variance, 2.0 * mean)
    return float(stats.gamma.sf(square, shape, scale=mean / shape))


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


def _periodic(field: Array, sd: Array, mm_per_bin: float) -> Periodic:
    """Return the strongest plane wave of a field, by the spectrum of what each bin says times how well it is known."""
    weight = np.where(np.isfinite(sd), 1.0 / np.nan_to_num(sd, nan=1.0), 0.0)
    spectrum = np.abs(np.fft.rfft2(field * weight**2)) ** 2
    spectrum[0, 0] = 0.0
    down = np.fft.fftfreq(field.shape[0])[:, None]
    right = np.fft.rfftfreq(field.shape[1])[None, :]
    # Longer waves are what smooth causes leave; shorter ones are no stripes.
    spectrum[np.hypot(down, right) < 3.0 / max(field.shape)] = 0.0
    looked_at = spectrum[spectrum > 0]
    # Half the waves are below ln 2 of the mean: a peak does not raise that.
    mean = float(np.median(looked_at) / np.log(2.0))
    peak = np.unravel_index(int(np.argmax(spectrum)), spectrum.shape)
    p = float(-np.expm1(len(looked_at) * np.log1p(-np.exp(-min(float(spectrum[peak]) / mean, 700.0)))))
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
