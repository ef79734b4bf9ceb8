"""How much and how the data scatter, from frames of states that were held still.

Nothing of the noise is believed without a look: its size by level, its correlation between neighbours and the jitter of
the light as a whole come from differences of replicates. Where there are none, the camera's own model has to serve and
the answer says that false alarms are not controlled.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from evanesce.bundle.layout import MIN_REPLICATES
from evanesce.prediction.tone import ExpectedTone
from evanesce.prediction.views import BIN_PX

Array = NDArray[Any]

SHIFT_BINS = 8 // BIN_PX
"""Fields of noise are shifted by whole blocks of 8 px, so that JPEG's grid stays where it is, borders aside."""

LEVEL_GROUPS = 8
LEAST_BINS = 20
"""Of a group of like level."""
REACH_BINS = 6
LOW_WAVES = 4
"""Cosines each way that tell how loud noise is at low frequencies."""


@dataclass(frozen=True)
class Noise:
    """Scatter of one frame's bins.

    Attributes
    ----------
    tone : ExpectedTone
        The camera's own model of a pixel.
    levels, ratio : ndarray (groups,)
        Level [DN], and measured over modelled variance of a bin there.
    flicker : float
        Standard deviation of the light's logarithm from frame to frame [1].
    fields : ndarray (fields, rows, cols)
        Independent fields of noise of unit variance.
    measured : bool
        Whether replicates gave all this.
    floor_DN : float
        Standard deviation below which nothing is believed [DN].
    lamp : ExpectedTone, optional
        As ``tone``, of cards under a white lamp, where a colour camera sees that otherwise than the LEDs' light.
    """

    tone: ExpectedTone
    levels: Array
    ratio: Array
    flicker: float
    fields: Array
    measured: bool
    floor_DN: float
    lamp: ExpectedTone | None = None

    def variance(self, level_DN: Array, frames: Array | int = 1, card: Array | bool = False) -> Array:
        """Return the variance [DN^2] of a bin of the mean of some frames, at predicted levels, of cards or not."""
        pixel = self.tone.binned_variance_at(level_DN)
        ratio = np.interp(level_DN, self.levels, self.ratio)
        if self.lamp is not None:  # replicates tell nothing of another light
            pixel = np.where(card, self.lamp.binned_variance_at(level_DN), pixel)
            ratio = np.where(card, 1.0, ratio)
        return np.asarray(pixel * ratio / frames + self.floor_DN**2)

    def full_DN(self, card: Array | bool = False) -> Array:
        """Return the level of full pixels [DN], of cards or not."""
        return np.where(card, (self.lamp or self.tone).full_DN, self.tone.full_DN)

    def draws(self, shape: tuple[int, int, int], count: int, rng: np.random.Generator) -> Array:
        """Return ``count`` cubes (views, rows, cols) of pure noise of unit variance, correlated as it was measured.

        Each view of each cube is another random mixture of the measured fields, with another shift.
        """
        views, rows, cols = shape
        kept = self.fields.shape[0]
        weights = rng.standard_normal((count * views, kept)).astype(np.float32)
        weights /= np.sqrt(kept)
        cubes = (weights @ self.fields.reshape(kept, -1).astype(np.float32)).reshape(-1, rows, cols)
        down = rng.integers(0, rows // SHIFT_BINS, len(cubes)) * SHIFT_BINS
        right = rng.integers(0, cols // SHIFT_BINS, len(cubes)) * SHIFT_BINS
        for k in range(len(cubes)):
            cubes[k] = np.roll(cubes[k], (down[k], right[k]), axis=(0, 1))
        return cubes.reshape(count, views, rows, cols)


def noise_of(
    held: Mapping[str, Array],
    tone: ExpectedTone,
    shape: tuple[int, int],
    *,
    floor_DN: float,
    flicker: float,
    seed: int = 0,
) -> Noise:
    """Return the noise that held states show.

    Parameters
    ----------
    held : mapping of str to ndarray (frames, rows, cols)
        Binned frames [DN].
    tone : ExpectedTone
    shape : tuple of int
        (rows, cols) of the bins.
    floor_DN : float
        See :class:`Noise`.
    flicker : float
        Believed where it cannot be measured.
    seed : int
        Of the noise that fills what is too dark to be measured.
    """
    rng = np.random.default_rng(seed)
    stacks = {kind: np.asarray(s, float) for kind, s in held.items() if len(s) >= MIN_REPLICATES}
    bright = stacks.get("replicate")
    if bright is None:
        white = rng.standard_normal((12, *shape))
        return Noise(tone, np.array([0.0, 255.0]), np.ones(2), flicker, white, False, floor_DN)
    parts = {kind: _departures(stack, tone) for kind, stack in stacks.items()}
    levels, ratio = _by_level(list(parts.values()), tone, floor_DN)
    mean, light, contrasts = parts["replicate"]
    found = Noise(tone, levels, ratio, jitter_of(light), np.zeros((0, *shape)), True, floor_DN)
    sd = np.sqrt(found.variance(mean))
    lit = tone.binned_variance_at(mean) > 4 * floor_DN**2
    fields = _filled(_with_light(contrasts / sd, tone.slope_by_light(mean) / sd, lit, rng), lit, rng)
    return Noise(tone, levels, ratio, found.flicker, fields, True, floor_DN)


def jitter_of(light: Array) -> float:
    """Return the standard deviation to expect of the next state's light, from those of some frames.

    A few frames know it badly: Student's law is wider than the scatter they show by sqrt((n - 1)/(n - 3)); of
    three, where that has no variance, twice as wide is a choice.
    """
    count = len(light)
    wider = np.sqrt((count - 1) / (count - 3)) if count > 3 else 2.0
    return float(np.std(light, ddof=1) * wider)


def _departures(stack: Array, tone: ExpectedTone) -> tuple[Array, Array, Array]:
    """Return a stack's mean, each frame's relative light, and orthonormal contrasts of what else changed."""
    mean = stack.mean(axis=0)
    # Light is bent by the tone curve: a gain of the 8-bit values would be half of it or less.
    slope = tone.slope_by_light(mean)
    power = float((slope**2).sum())
    light = np.tensordot(stack - mean, slope, 2) / power if power > 1.0 else np.zeros(len(stack))
    left = stack - mean - light[:, None, None] * slope
    helmert = linalg.helmert(len(stack))
    return mean, light, np.tensordot(helmert, left, 1)


def _with_light(fields: Array, light: Array, lit: NDArray[np.bool_], rng: np.random.Generator) -> Array:
    """Return whitened contrasts (n, rows, cols), noise of a frame's light and mean put back.

    The fit of each frame's light takes its jitter and with it the noise of that shape, so that views seem to be known
    better than they are. The mean is the one pattern that shifts of the fields leave as it is: as few fields as there
    are replicates would say how loud it is, with an error of a third. So both get what the lowest frequencies beside
    them show, which are many.

    Parameters
    ----------
    fields : ndarray (n, rows, cols)
    light : ndarray (rows, cols)
        Whitened change by the light.
    lit : ndarray of bool (rows, cols)
    rng : numpy.random.Generator
    """
    shapes = np.array([np.where(lit, light, 0.0), lit.astype(float)]).reshape(2, -1)
    if not lit.any() or not shapes[0].any():
        return fields
    basis, upper = linalg.qr(shapes.T, mode="economic")
    basis = basis.T[np.abs(np.diag(upper)) > 1e-6 * np.abs(upper).max()].reshape(-1, *lit.shape)
    waves = [np.cos(np.pi * k * (np.arange(n) + 0.5) / n) for n in lit.shape for k in range(LOW_WAVES)]
    down, right = waves[:LOW_WAVES], waves[LOW_WAVES:]
    low = [np.outer(d, r) * lit for i, d in enumerate(down) for j, r in enumerate(right) if i + j > 0]
    seen = [np.tensordot(fields, wave, 2) ** 2 / max(float((wave**2).sum()), 1e-12) for wave in low]
    white = float((fields**2)[:, lit].mean()) if lit.any() else 1.0
    louder = max(float(np.mean(seen)) / max(white, 1e-12), 1.0)
    mixed = rng.standard_normal((len(fields), len(basis)))
    mixed *= np.sqrt(louder / (mixed**2).mean(axis=0))
    taken = np.tensordot(fields, basis, ([1, 2], [1, 2]))
    return np.asarray(fields + np.tensordot(mixed - taken, basis, 1))


def _by_level(parts: list[tuple[Array, Array, Array]], tone: ExpectedTone, floor_DN: float) -> tuple[Array, Array]:
    """Return measured over modelled variance in groups of like level."""
    level = np.concatenate([mean.ravel() for mean, _, _ in parts])
    measured = np.concatenate([(contrasts**2).mean(axis=0).ravel() for _, _, contrasts in parts])
    modelled = tone.binned_variance_at(level)
    use = modelled > floor_DN**2
    if use.sum() < 50:
        return np.array([0.0, 255.0]), np.ones(2)
    level, measured, modelled = level[use], measured[use], modelled[use]
    groups = min(LEVEL_GROUPS, level.size // LEAST_BINS)
    borders = np.unique(np.quantile(level, np.linspace(0, 1, groups + 1)))
    group = np.clip(np.searchsorted(borders, level, side="right") - 1, 0, max(borders.size - 2, 0))
    count = np.bincount(group)
    # Levels that many bins share leave other groups nearly empty; the largest of all has what it needs.
    kept = count >= min(LEAST_BINS, count.max())
    centre = np.bincount(group, level)[kept] / count[kept]
    ratio = np.bincount(group, measured)[kept] / np.maximum(np.bincount(group, modelled)[kept], 1e-12)
    return centre, np.maximum(ratio, 0.05)


def _filled(fields: Array, lit: NDArray[np.bool_], rng: np.random.Generator) -> Array:
    """Return the fields with what was too dark filled by stationary noise of the same correlation, unit variance."""
    whole = np.where(lit, fields, 0.0)
    size = np.sqrt(max(float((whole**2).sum()) / max(lit.sum() * len(fields), 1), 1e-12))
    whole /= size
    spectrum = correlation_spectrum(whole, lit)
    white = np.fft.fft2(rng.standard_normal(fields.shape))
    other = np.fft.ifft2(white * np.sqrt(spectrum)).real
    return np.where(lit, whole, other)


def correlation_spectrum(fields: Array, lit: NDArray[np.bool_]) -> Array:
    """Return the power spectrum of stationary noise seen only where ``lit``: pairs within a few bins, mean power 1.

    Where no noise is seen, as of a camera that is quieter than what is believed of any, it is white.
    """
    rows, cols = lit.shape
    padded = (2 * rows, 2 * cols)
    power = (np.abs(np.fft.fft2(np.where(lit, fields, 0.0), padded)) ** 2).sum(axis=0)
    pairs = np.fft.ifft2(np.abs(np.fft.fft2(lit.astype(float), padded)) ** 2).real * len(fields)
    lag_y, lag_x = (np.minimum(np.arange(n), n - np.arange(n)) for n in padded)
    products = np.fft.ifft2(power).real
    known = pairs > 50
    if not (known[0, 0] and products[0, 0] > 0.0):
        return np.ones((rows, cols))
    found = np.where(known, products / np.maximum(pairs, 1.0), 0.0)
    taper_y, taper_x = (np.clip(2 * (1 - lag / (REACH_BINS + 1)), 0, 1) for lag in (lag_y, lag_x))
    window = taper_y[:, None] * taper_x
    found = found * window
    wrapped = np.zeros((rows, cols))
    for y in range(-REACH_BINS, REACH_BINS + 1):
        for x in range(-REACH_BINS, REACH_BINS + 1):
            wrapped[y % rows, x % cols] += found[y % padded[0], x % padded[1]]
    spectrum = np.maximum(np.fft.fft2(wrapped).real, 0.0)
    return np.asarray(spectrum / max(spectrum.mean(), 1e-12))


def chunks(total: int, size: int) -> Iterator[int]:
    """Yield sizes that add up to ``total``."""
    while total > 0:
        yield min(size, total)
        total -= size
