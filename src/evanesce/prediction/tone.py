"""What a pixel shows on average, and how much it scatters: the mean and variance of its rounded 8-bit value.

A frame's values are rounded twice, to raw numbers and through the tone curve to 8 bits, after noise. Where the noise is
smaller than a step the mean value is a stair, not a line, so that a prediction without noise would be biased by up
to half a step: a critic that did not know would find a black level or a tone curve there.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from evanesce.prediction.views import BIN_PX
from evanesce.rig import Camera
from evanesce.sensor.tone import CURVES, relative_light

Array = NDArray[np.float64]

STEP_DN = 0.25
"""Least spacing of the tabulated signals [raw DN]."""

STEPS_PER_SD = 16
"""Spacing of the tabulated signals where the noise is wide: it smooths what lies between."""

BLOCK = 64
"""Signals at a time."""

REACH = 5.0
"""The noise is followed this many standard deviations out."""


@dataclass(frozen=True)
class ExpectedTone:
    """Moments of the 8-bit value as functions of the mean signal.

    Attributes
    ----------
    signal : ndarray (n,)
        Mean signal before quantisation, rising [raw DN].
    mean : ndarray (n,)
        Of the 8-bit value [DN].
    variance : ndarray (n,)
        Of the 8-bit value, rounding included [DN^2].
    black_DN : float
        Signal without light [raw DN].
    alike : ndarray (n,), optional
        Variance of the mean of many neighbours over that of as many independent pixels [1]; 1 by default.
    step_DN : float
        By which values are rounded [DN].
    full_DN : float
        The value of a full pixel [DN].
    pixels : int
        Along one of the model camera's.
    """

    signal: Array
    mean: Array
    variance: Array
    black_DN: float = 0.0
    alike: Array | None = None
    step_DN: float = 1.0
    full_DN: float = 255.0
    pixels: int = 1

    def mean_of(self, signal_DN: Array) -> Array:
        """Return the mean 8-bit value [DN] of mean signals [raw DN]."""
        return np.interp(signal_DN, self.signal, self.mean)

    def variance_at(self, level_DN: Array) -> Array:
        """Return the variance [DN^2] where the mean 8-bit value is ``level_DN``."""
        return self._at(level_DN, self.variance)

    def binned_variance_at(self, level_DN: Array) -> Array:
        """Return the variance of the mean of a bin's pixels [DN^2] where the mean 8-bit value is ``level_DN``."""
        whole = self.variance if self.alike is None else self.variance * self.alike
        return self._at(level_DN, whole) / (BIN_PX * self.pixels) ** 2

    def _at(self, level_DN: Array, values: Array) -> Array:
        rising = np.concatenate([[True], np.diff(self.mean) > 1e-9])
        return np.interp(level_DN, self.mean[rising], values[rising])

    def slope_by_light(self, level_DN: Array) -> Array:
        """Return what a relative change of light adds to the mean 8-bit value where that is ``level_DN`` [DN]."""
        slope = (self.signal - self.black_DN) * np.gradient(self.mean, self.signal)
        return self._at(level_DN, np.maximum(slope, 0.0))


@dataclass(frozen=True)
class SignalNoise:
    """Noise of single signals before quantisation (EMVA 1288: shot noise and read noise).

    Attributes
    ----------
    black_DN : float
        Signal without light [raw DN].
    e_per_DN : float
        Charge per raw number [e-/DN].
    read_noise_e, full_well_e : float
        [e-].
    scale : float
        Real over modelled standard deviation before the tone curve: a camera may smooth its noise [1].
    """

    black_DN: float
    e_per_DN: float
    read_noise_e: float
    full_well_e: float
    scale: float = 1.0

    @classmethod
    def of(cls, camera: Camera, scale: float = 1.0) -> SignalNoise:
        """Return a camera's own noise."""
        pixel = camera.pixel
        e_per_DN = pixel.conversion_gain_e_per_DN / camera.analogue_gain
        return cls(pixel.black_level_DN, e_per_DN, pixel.read_noise_e, pixel.full_well_capacity_e, round(scale, 5))

    def sd(self, signal_DN: Array | float) -> Array:
        """Return the standard deviation [raw DN] about mean signals [raw DN]."""
        charge = np.clip((np.asarray(signal_DN) - self.black_DN) * self.e_per_DN, 0.0, self.full_well_e)
        return np.asarray(self.scale * np.sqrt(charge + self.read_noise_e**2) / self.e_per_DN)


def expected_tone(camera: Camera, noise_scale: float = 1.0) -> ExpectedTone:
    """Return the moments for a camera's own noise, kept for the last few.

    Parameters
    ----------
    camera : Camera
        Monochrome; of a colour camera see :func:`evanesce.prediction.colour.expected_grey`.
    noise_scale : float
        As of :class:`SignalNoise`.
    """
    return _tabulate(camera.pixel.bits, camera.tone_curve, SignalNoise.of(camera, noise_scale))


@functools.lru_cache(maxsize=32)
def _tabulate(bits: int, curve: str, noise: SignalNoise) -> ExpectedTone:
    light = relative_light(np.arange(2**bits), black_level_DN=noise.black_DN, bits=bits)
    return moments(np.floor(255.0 * np.clip(CURVES[curve](light), 0.0, 1.0) + 0.5), noise)


def moments(table: Array, noise: SignalNoise) -> ExpectedTone:
    """Return the moments of what a table makes of raw numbers.

    Parameters
    ----------
    table : ndarray (2^bits,)
        Value of each raw number.
    noise : SignalNoise
    """
    codes = table.size
    nodes = [0.0]
    while nodes[-1] < codes - 1:
        nodes.append(min(nodes[-1] + max(STEP_DN, float(noise.sd(nodes[-1])) / STEPS_PER_SD), codes - 1.0))
    signal = np.array(nodes)
    sd = noise.sd(signal)
    mean, square = np.empty_like(signal), np.empty_like(signal)
    # In blocks of like width: only codes within reach of the noise are summed over.
    for first in range(0, signal.size, BLOCK):
        part = slice(first, min(first + BLOCK, signal.size))
        s, width = signal[part], np.maximum(sd[part], 1e-6)
        low = max(0, int(np.floor(s[0] - REACH * width.max())) - 1)
        high = min(codes - 1, int(np.ceil(s[-1] + REACH * width.max())) + 1)
        edges = np.arange(low, high) + 0.5
        below = ndtr((edges[None, :] - s[:, None]) / width[:, None])
        share = np.diff(below, axis=1, prepend=0.0, append=1.0)
        values = table[low : high + 1]
        mean[part], square[part] = share @ values, share @ values**2
    return ExpectedTone(signal, mean, np.maximum(square - mean**2, 0.0), noise.black_DN)
