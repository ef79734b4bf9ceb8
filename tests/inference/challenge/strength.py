"""How strong a hidden cause is: the whitened norm of what it changes, nuisances taken off.

Means and variances are those of the injector's own camera, on bins of 4 x 4 pixels, over all auxiliary shots and the
press frames that a critic does not hold back. Nuisances are marginalised with their prior widths (a ridge), so that a
flicker of 0.2 % hides only so much. Marks (specks, hot pixels, dust, scratches, films, bands) are measured on full
pixels: to the norm of the bins comes that of what changes within them, against which no nuisance stands. What a codec
leaves of a strength is measured on drawn frames (:mod:`make`).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .camera import BIN, CORRELATED, binned, noisy_frame
from .chain import Causes, Nuisances, curve_of, development, expose, rig_of
from .hidden import Hidden, Rig
from .rig import BaseLight, View, power

PRIOR = {
    "light": 0.3, "black": 0.3, "pose_x": 1.0, "pose_y": 1.0, "flicker": 0.002, "force": 0.003, "card_x": 1.0,
    "card_y": 1.0, "turn": 0.035, "card_light": 1.0, "slope_x": 0.1, "slope_y": 0.1,
}  # fmt: skip
GLOBAL = ("light", "black", "pose_x", "pose_y")
JITTER = ("flicker", "force")
LEAST_VARIANCE = 1e-4
SPECTRA, RINGS = 6, 32
"""Frames drawn for a spectrum of noise, and rings of frequency in it."""
BENT, ROUNDS = 20.0, 3
"""A change so many times larger than what is left of it is looked at with the exposure refitted, so often."""


def levels(rig: Rig, causes: Causes, nuisances: Nuisances | None = None, *, side: int = 1) -> np.ndarray:
    """Return mean pictures (views, rows / side, cols / side) [DN], of blocks of ``side`` pixels to each side."""
    nuisances = nuisances or Nuisances()
    table = development(rig, causes)
    kept: dict[object, np.ndarray] = {}
    found = []
    for view in rig.views:
        still = all(c.still for c, _ in causes)
        kind = "press" if view.touches else view.kind
        same = (kind, view.shot.force_N, view.shot.voltage_V) if still and not nuisances.flicker else view
        if same not in kept:
            picture = expose(rig, view, causes, nuisances).level(table)
            kept[same] = binned(picture, side) if side > 1 else picture
        found.append(kept[same])
    return np.array(found)


def means(rig: Rig, causes: Causes, nuisances: Nuisances | None = None) -> np.ndarray:
    """Return binned mean pictures (views, bin rows, bin cols) [DN]."""
    return levels(rig, causes, nuisances, side=BIN)


@functools.lru_cache(maxsize=2)
def base_levels(name: str, pose: int) -> np.ndarray:
    """Return mean pictures (views, rows, cols) with nothing hidden [DN]."""
    return levels(rig_of(name, pose), ())


@dataclass(frozen=True)
class Ruler:
    """Measures changes of the binned pictures of one rig.

    Attributes
    ----------
    base : ndarray (views, bin rows, bin cols)
        Mean pictures with nothing hidden [DN].
    weight : ndarray (views, bin rows, bin cols)
        One over the variance; 0 for views that are held back.
    columns : list of (names, ndarray (n, bin rows, bin cols))
        Derivatives by the nuisances, by view.
    names : tuple of str
        Of all nuisances.
    hat : ndarray
        Inverse of information plus prior.
    """

    base: np.ndarray
    weight: np.ndarray
    columns: list[tuple[tuple[int, ...], np.ndarray]]
    names: tuple[str, ...]
    hat: np.ndarray

    def _onto(self, signal: np.ndarray) -> np.ndarray:
        onto = np.zeros(len(self.names))
        for k, (places, columns) in enumerate(self.columns):
            np.add.at(onto, np.array(places, int), np.tensordot(columns, self.weight[k] * signal[k], 2))
        return onto

    def inner(self, one: np.ndarray, other: np.ndarray) -> float:
        """Return the whitened product of two changes (views, bin rows, bin cols), nuisances taken off."""
        return float((self.weight * one * other).sum() - self._onto(one) @ self.hat @ self._onto(other))

    def norm(self, signal: np.ndarray) -> float:
        """Return the signal-to-noise ratio of a change."""
        return float(np.sqrt(max(self.inner(signal, signal), 0.0)))

    def nuisance(self, name: str, signal: np.ndarray) -> float:
        """Return a nuisance's most probable value [its unit], given a change."""
        return float(self.hat[self.names.index(name)] @ self._onto(signal))

    def left(self, signal: np.ndarray) -> np.ndarray:
        """Return what a change leaves of itself once all nuisances are fitted to the frames that count."""
        values = self.hat @ self._onto(signal)
        own = [np.tensordot(values[list(places)], columns, 1) for places, columns in self.columns]
        return np.asarray(signal - np.array(own))

    def without(self, kinds: Sequence[str], views: Sequence[View]) -> Ruler:
        """Return the ruler of a bundle that lacks some auxiliary shots."""
        weight = self.weight.copy()
        for k, view in enumerate(views):
            if view.kind in kinds:
                weight[k] = 0.0
        return _ruler(self.base, weight, self.columns, self.names)

    def held_back(self, views: Sequence[View], variance: np.ndarray) -> Ruler:
        """Return the ruler of the press frames that are held back, of whose nuisances their own jitter alone is new."""
        keep = np.array([view.kind == "press" and view.spare for view in views])
        names = tuple(n for n in self.names if n.partition("[")[0] in JITTER)
        columns = []
        for places, own in self.columns:
            chosen = [k for k, place in enumerate(places) if self.names[place] in names]
            columns.append((tuple(names.index(self.names[places[k]]) for k in chosen), own[chosen]))
        return _ruler(self.base, keep[:, None, None] / variance, columns, names)


def _ruler(
    base: np.ndarray,
    weight: np.ndarray,
    columns: list[tuple[tuple[int, ...], np.ndarray]],
    names: tuple[str, ...],
) -> Ruler:
    information = np.diag([1.0 / PRIOR[name.partition("[")[0]] ** 2 for name in names])
    for k, (places, own) in enumerate(columns):
        flat = own.reshape(len(places), weight[k].size)
        information[np.ix_(places, places)] += (flat * weight[k].ravel()) @ flat.T
    return Ruler(base, weight, columns, names, np.linalg.inv(information))


@functools.lru_cache(maxsize=4)
def ruler(name: str, pose: int) -> Ruler:
    """Return the ruler of a set's rig at one pose."""
    rig = rig_of(name, pose)
    table = development(rig, ())
    base, variance, local = [], [], []
    for view in rig.views:
        charge = expose(rig, view, (), Nuisances()).charge_e
        base.append(binned(table.level(charge)))
        variance.append(binned(table.spread(charge)) / 16 / view.frames)
        local.append(_derivatives(rig, view, charge, table.by_charge(charge), table.by_offset(charge)))
    names: list[str] = list(GLOBAL)
    columns = []
    for k, found in enumerate(local):
        places = []
        for parameter in found:
            label = parameter if parameter in GLOBAL else f"{parameter}[{k}]"
            if label not in names:
                names.append(label)
            places.append(names.index(label))
        columns.append((tuple(places), np.array([binned(d) for d in found.values()])))
    weight = 1.0 / np.maximum(variance, LEAST_VARIANCE)
    weight[[k for k, view in enumerate(rig.views) if view.spare]] = 0.0
    return _ruler(np.array(base), weight, columns, tuple(names))


def variances(name: str, pose: int) -> np.ndarray:
    """Return the variance of the binned pictures (views, bin rows, bin cols) [DN^2]."""
    rig = rig_of(name, pose)
    table = development(rig, ())
    charges = [expose(rig, view, (), Nuisances()).charge_e for view in rig.views]
    found = [binned(table.spread(c)) / 16 / v.frames for c, v in zip(charges, rig.views, strict=True)]
    return np.maximum(found, LEAST_VARIANCE)


def _derivatives(
    rig: Rig, view: View, charge: np.ndarray, slope: np.ndarray, by_offset: np.ndarray
) -> dict[str, np.ndarray]:
    """Return derivatives of a mean picture by its nuisances [DN per unit]."""
    e, base = rig.electronics, rig.base
    found = {"black": by_offset}
    lit = slope * charge
    if view.touches:
        k = base.force_index(view.shot.force_N)
        light = power(rig.name, view.shot.voltage_V) * e.e_per_irradiance
        gv, gu = np.gradient(base.press[k].astype(float))
        per_mm = light / rig.at.mm_per_px
        found |= {
            "light": lit,
            "pose_x": -slope * per_mm * binned(gu, 2),
            "pose_y": -slope * per_mm * binned(gv, 2),
            "flicker": lit,
            "force": slope * light * binned(base.by_log_force[k].astype(float), 2),
        }
    if view.is_card:
        found |= _card_derivatives(rig, base, view, lit, slope)
    return found


def _card_derivatives(
    rig: Rig, base: BaseLight, view: View, lit: np.ndarray, slope: np.ndarray
) -> dict[str, np.ndarray]:
    e, at = rig.electronics, rig.at
    gain = e.e_per_irradiance
    gv, gu = np.gradient(base.cards[view.kind].astype(float))
    turned = (-at.y * gu + at.x * gv) / at.mm_per_px
    return {
        "card_x": -slope * gain * binned(gu, 2) / at.mm_per_px,
        "card_y": -slope * gain * binned(gv, 2) / at.mm_per_px,
        "turn": -slope * gain * binned(turned, 2),
        "card_light": lit,
        "slope_x": lit * binned(at.u, 2),
        "slope_y": lit * binned(at.v, 2),
    }


def departure(rig: Rig, measure: Ruler, causes: Causes) -> np.ndarray:
    """Return what causes change (views, bin rows, bin cols) [DN], the exposure set to what hides most of it.

    Nuisances are taken off as straight lines. A plate that takes a fifth of all light moves so far along the exposure
    that the tone curve's bend alone would pass for a strength of 20, which whoever fits the exposure never sees.
    """
    light = 0.0
    change = means(rig, causes) - measure.base
    for _ in range(ROUNDS):
        if float((measure.weight * change**2).sum()) < (BENT * measure.norm(change)) ** 2:
            break
        light -= measure.nuisance("light", change)
        change = means(rig, causes, Nuisances(log_light=light)) - measure.base
    return change


@functools.lru_cache(maxsize=4)
def spectra(name: str, pose: int, noise: str) -> tuple[np.ndarray, ...]:
    """Return the power of a pixel's noise over frequency in each view, 1 for independent pixels (rfft2's layout).

    Of drawn frames, as means over rings of frequency: a low-pass before black is clipped leaves more at high
    frequencies than its own transfer.
    """
    rig, rng = rig_of(name, pose), np.random.default_rng([5, pose])
    table, curve, found = development(rig, ()), curve_of(rig, ()), []
    rows, cols = rig.shape
    f = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols)[None, :])
    ring = np.minimum((f / f.max() * RINGS).astype(int), RINGS - 1)
    for view in rig.views:
        charge = expose(rig, view, (), Nuisances()).charge_e
        level, deviation = table.level(charge), np.sqrt(np.maximum(table.spread(charge), LEAST_VARIANCE))
        power_of = np.zeros(f.shape)
        for _ in range(SPECTRA):
            frame = noisy_frame(rig.electronics, charge, 0.0, curve, rng, correlated=CORRELATED[noise])
            power_of += np.abs(np.fft.rfft2((frame - level) / deviation)) ** 2 / frame.size / SPECTRA
        mean = np.bincount(ring.ravel(), power_of.ravel()) / np.bincount(ring.ravel())
        found.append(np.maximum(mean, LEAST_VARIANCE)[ring])
    return tuple(found)


def within_bins(rig: Rig, measure: Ruler, change: np.ndarray, noise: str) -> float:
    """Return the squared norm of what a change (views, rows, cols) [DN] has within the bins.

    The matched filter in noise that the sensor has low-passed weighs frequencies by its inverse power.
    """
    if noise not in CORRELATED:
        return float((measure.weight * (binned(change * change) - binned(change) ** 2)).sum())
    twice = np.full(rig.shape[1] // 2 + 1, 2.0)
    twice[[0, -1]] = 1.0
    block, total = np.ones((BIN, BIN)), 0.0
    for own, weight, spectrum in zip(change, measure.weight, spectra(rig.name, rig.pose, noise), strict=True):
        if weight.any():
            whitened = (own - np.kron(binned(own), block)) * np.sqrt(np.kron(weight, block)) / BIN
            total += float((twice * np.abs(np.fft.rfft2(whitened)) ** 2 / spectrum).sum()) / whitened.size
    return total


def strength_of(rig: Rig, measure: Ruler, causes: Causes, noise: str = "plain") -> float:
    """Return the strength of causes together, marks on full pixels."""
    change = departure(rig, measure, causes)
    squared = measure.inner(change, change)
    if any(cause.mark for cause, _ in causes):
        whole = levels(rig, causes) - base_levels(rig.name, rig.pose)
        squared += within_bins(rig, measure, whole, noise)
    return float(np.sqrt(max(squared, 0.0)))


class OutOfReach(Exception):
    """A cause cannot be made as strong as asked for within its limits: the nuisances absorb it."""


def amplitude_for(
    rig: Rig, measure: Ruler, cause: Hidden, strength: float, tolerance: float = 0.01, noise: str = "plain"
) -> float:
    """Return the amplitude at which a cause alone has the strength asked for.

    Raises
    ------
    OutOfReach
        If even its largest amplitude does not reach it.
    """
    a = cause.start
    low: tuple[float, float] = (0.0, 0.0)
    high: tuple[float, float] | None = None
    for _ in range(40):
        found = strength_of(rig, measure, [(cause, a)], noise)
        if abs(found / strength - 1) < tolerance:
            return a
        if found < strength:
            low = (a, found)
            if a >= 0.999 * cause.limit:
                break
        else:
            high = (a, found)
        if high is None:
            a = min(a * min(max(strength / max(found, 1e-9), 1.2), 8.0), cause.limit)
        elif low[1] > 0.05 * strength or (low[0] == 0.0 and high[1] < 20 * strength):
            # Strength is close to a power of the amplitude; from nothing, to the amplitude itself.
            power_law = np.log(high[1] / low[1]) / np.log(high[0] / low[0]) if low[1] > 0 else 1.0
            a = float(high[0] * (strength / high[1]) ** (1.0 / power_law))
            wide = high[0] - low[0]
            a = min(max(a, low[0] + 0.02 * wide), high[0] - 0.02 * wide)
        else:
            a = 0.5 * (low[0] + high[0])
    raise OutOfReach(f"{cause.id}: {low[1]:.2f} at {low[0]:.3g} {cause.unit}, asked for {strength:g}")
