"""How large the noise is before the tone curve: that curve bends, so that less noise gives another mean.

Below black a tone curve shows nothing, so that what the noise makes of darkness is a level. A camera that smooths its
noise before the curve shows another one than its data sheet's; a codec, which smooths after it, shows the same level
with less scatter. So two figures tell both apart: the scatter of single pixels, and the mean of a covered lens. Where
they disagree because the black level is not where it is believed, scatter in the dark and in the light still agree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from evanesce.prediction import priors
from evanesce.prediction.tone import ExpectedTone

Array = NDArray[Any]
ToneOf = Callable[[float], ExpectedTone]

LOW, HIGH = 0.1, 3.0
AGREE = 0.05
"""Relative difference below which scatter and level tell of one noise."""

TOLD_STEPS = 0.2
"""The dark level tells of the noise's size if a fifth more of it changes it by so many steps of rounding."""

LIT_SHARE = 40.0 / 255.0
"""Of a full pixel's level, from which on the place of black makes no difference to the scatter."""

QUIET = 3.0 / 12.0
"""Variance in the light, three times that of rounding itself, below which noise is seldom seen [steps^2]."""

CLOSE, LOOSE = priors.SCALE_CLOSE, priors.SCALE_LOOSE
"""Prior standard deviations of the logarithm: both figures agree, or one alone is there."""


@dataclass(frozen=True)
class NoiseScale:
    """Real over modelled noise before the tone curve.

    Attributes
    ----------
    value : float
    deviation : float
        Prior standard deviation of its logarithm.
    codec : bool
        Whether the noise was smoothed after the tone curve.
    black_DN : float
        Where a fit of the black level may start, less the believed one [raw DN].
    silent : bool
        Whether next to no noise outlived the codec, so that nothing tells what it made of the frames from what it kept.
    """

    value: float = 1.0
    deviation: float = LOOSE
    codec: bool = False
    black_DN: float = 0.0
    silent: bool = False


def noise_scale_of(tone_of: ToneOf, scatter: Mapping[str, tuple[Array, Array]], *, coded: bool = True) -> NoiseScale:
    """Return the size of the noise that held states and a covered lens show.

    Parameters
    ----------
    tone_of : callable
        ``tone_of(scale) -> ExpectedTone`` of the real pixels, by noise so many times as large.
    scatter : mapping of str to tuple of ndarray
        By kind of shot, level [DN] and variance of single pixels [DN^2] in bins.
    coded : bool
        Whether a codec may have smoothed it: noise that shows no trace of one was not.
    """
    if _too_quiet(tone_of, scatter):
        return NoiseScale()
    spread = _by_scatter(tone_of, scatter)
    dark = _by_level(tone_of, scatter)
    if spread == LOW:  # hardly any scatter is left: no camera is so quiet, a codec makes it so
        return NoiseScale(1.0 if dark is None else dark, LOOSE, codec=True, silent=True)
    if dark is None:
        return NoiseScale(1.0, LOOSE) if spread is None else NoiseScale(spread, 2 * CLOSE)
    if spread is None:
        return NoiseScale(dark, LOOSE)
    if abs(np.log(spread / dark)) < AGREE:
        return NoiseScale(spread, CLOSE)
    found = _of_displaced_black(tone_of, scatter) or NoiseScale(dark, LOOSE, codec=spread < dark)
    # Without a codec darkness is off by another tone curve or black level.
    return NoiseScale(spread, 2 * CLOSE) if found.codec and not coded else found


def _too_quiet(tone_of: ToneOf, scatter: Mapping[str, tuple[Array, Array]]) -> bool:
    """Tell whether the believed camera's noise is lost in its rounding: its scatter tells of no codec then."""
    levels = np.concatenate([np.ravel(part[0]) for part in scatter.values()] or [np.zeros(0)])
    tone = tone_of(1.0)
    lit = levels[levels > LIT_SHARE * tone.full_DN]
    return bool(lit.size and np.mean(tone.variance_at(lit)) < QUIET * tone.step_DN**2)


def _of_displaced_black(tone_of: ToneOf, scatter: Mapping[str, tuple[Array, Array]]) -> NoiseScale | None:
    """Return the noise of a camera with another black level, if one explains scatter in the light and in the dark.

    A codec smooths after the curve has cut off what lies below black, so that no level goes with its scatter.
    """
    scale = _by_scatter(tone_of, scatter, LIT_SHARE * tone_of(1.0).full_DN)
    if scale is None or "lens_cap" not in scatter:
        return None
    tone, (level, variance) = tone_of(scale), scatter["lens_cap"]
    if abs(np.log(float(tone.variance_at(level).mean()) / float(np.mean(variance)))) > 2 * AGREE:
        return None
    signal = float(np.interp(np.mean(level), tone.mean, tone.signal))
    return NoiseScale(scale, CLOSE, black_DN=signal - tone.black_DN)


def _by_scatter(tone_of: ToneOf, scatter: Mapping[str, tuple[Array, Array]], least_DN: float = -np.inf) -> float | None:
    """Return the scale whose variance, over all bins of some level at least, is the measured one; at least ``LOW``."""
    if not scatter:
        return None
    level = np.concatenate([np.ravel(part[0]) for part in scatter.values()])
    chosen = level > least_DN
    if not chosen.any():
        return None
    level = level[chosen]
    variance = float(np.concatenate([np.ravel(part[1]) for part in scatter.values()])[chosen].mean())

    def surplus(scale: float) -> float:
        return float(tone_of(scale).variance_at(level).mean()) - variance

    return LOW if surplus(LOW) >= 0 else _root(surplus)


def _by_level(tone_of: ToneOf, scatter: Mapping[str, tuple[Array, Array]]) -> float | None:
    """Return the scale whose mean at the black level is that of a covered lens."""
    if "lens_cap" not in scatter:
        return None
    nominal = tone_of(1.0)
    black = np.array(nominal.black_DN)

    def dark(scale: float) -> float:
        return float(tone_of(scale).mean_of(black))

    if dark(1.2) - dark(1.0) < TOLD_STEPS * nominal.step_DN:
        return None
    level = float(np.mean(scatter["lens_cap"][0]))
    return _root(lambda scale: dark(scale) - level)


def _root(surplus: Callable[[float], float]) -> float | None:
    if surplus(LOW) >= 0 or surplus(HIGH) <= 0:
        return None
    return float(brentq(surplus, LOW, HIGH, xtol=1e-4))
