"""What noise makes of developed colour on average: the moments of demosaiced, balanced, mixed and curved values.

Where a filter hardly sees the light, black cuts its noise off; what is left has a mean, goes through the matrix into
the other colours, and is raised by a curve that is steep there. A prediction without noise would be grey levels off.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from evanesce.measurement.reference.segment import LUMA
from evanesce.prediction.tone import ExpectedTone, SignalNoise, moments
from evanesce.prediction.views import BIN_PX
from evanesce.rig import Camera
from evanesce.rig.colour import Demosaicing, Mosaic
from evanesce.sensor.colour import DEMOSAIC, ImageProcessor, balance_table, channel_map, tone_table
from evanesce.sensor.tone import Curve

Array = NDArray[np.float64]

GREY = np.array(LUMA) / sum(LUMA)
"""Weights of red, green and blue in the segmentation's grey [1]."""


class Site(NamedTuple):
    """A kind of pixel of the mosaic: its share of all, and the variance of demosaiced red, green and blue there.

    Over that of their own pixels: they are means of one, two or four of them.
    """

    share: float
    noise: tuple[float, float, float]


SITES = {
    "red": Site(0.25, (1.0, 0.25, 0.25)), "green": Site(0.5, (0.5, 1.0, 0.5)), "blue": Site(0.25, (0.25, 0.25, 1.0)),
}  # fmt: skip

STEPS_SD = np.linspace(-4.0, 4.0, 26)
"""Noise of a pixel's own filter that is followed [standard deviations]."""
WEIGHTS = np.exp(-0.5 * STEPS_SD**2) / np.exp(-0.5 * STEPS_SD**2).sum()

MEAN_SITE = np.sum([site.share * np.array(site.noise) for site in SITES.values()], axis=0)

STEP_SD = 0.2
"""Of derivatives of the developed value by the linear one [standard deviations of that]."""

LEVELS, SPREADS = 2048, 96
"""Nodes of the tone curve after noise: linear value, and logarithm of the noise's standard deviation."""
LOW, HIGH, NEAR = -0.25, 1.25, 0.005
"""Of the linear value, full scale 1: nodes stand dense within the last of nothing, in equal ratios beyond."""
_ENDS = np.arcsinh(LOW / NEAR), np.arcsinh(HIGH / NEAR)
LEAST_SPREAD, MOST_SPREAD = 1e-4, 0.5
"""Of its standard deviation."""


@dataclass(frozen=True)
class ExpectedColour:
    """What noise makes of the way from raw signals to developed colour, on average.

    A demosaiced pixel holds one filter's own noise and means of its neighbours'. The first is followed as it is, cut
    off at black and at full; the means are taken for normal.

    Attributes
    ----------
    filters : tuple of ExpectedTone
        Balanced value, full scale 1, of a red, green and blue pixel's signal [raw DN].
    gains : ndarray (3,)
        Balanced value of a filter's light of full scale 1.
    noise_of : callable
        Standard deviation of a signal [raw DN].
    full_DN : float
        Range of the raw numbers above black [raw DN].
    matrix : ndarray (3, 3)
        From balanced to linear output.
    demosaicing : {"bilinear", "edge-aware"}
    developed, squares : ndarray (SPREADS, LEVELS)
        Mean 8-bit value [DN], and mean of its square, by the logarithm of the linear value's standard deviation and by
        the value.
    """

    filters: tuple[ExpectedTone, ...]
    gains: Array
    noise_of: Callable[[Array], Array]
    full_DN: float
    matrix: Array
    demosaicing: Demosaicing
    developed: Array
    squares: Array

    def mean_of(self, signals: Array) -> Array:
        """Return the mean developed colour (rows, cols, 3) [DN] of filters' mean signals (3, rows, cols) [raw DN]."""
        total: Any = 0.0
        for kind, site in SITES.items():
            for weight, linear, covariance, skew in self._own_noise(signals, kind):
                spread = np.sqrt(np.einsum("kk...->k...", covariance))
                mean = self._developed(self.developed, linear, spread) + skew / 6.0 * self._third(linear, spread)
                total = total + site.share * weight * mean
        return np.moveaxis(np.asarray(total), 0, -1)

    def nearly(self, signals: Array, pattern: Mosaic | None = None) -> Array:
        """Return :meth:`mean_of` with all noise taken for normal and alike in all pixels: a hundred times as fast.

        Parameters
        ----------
        signals : ndarray (3, rows, cols)
            [raw DN].
        pattern : {"RGGB", "BGGR", "GRBG", "GBRG"}, optional
            Each pixel has but the signal of its own filter, and is demosaiced as the camera does it.
        """
        balanced = self.balanced(signals)
        if pattern is not None:
            own = channel_map((balanced.shape[1], balanced.shape[2]), pattern)
            whole = demosaiced(np.take_along_axis(balanced, own[None], 0)[0], pattern, self.demosaicing)
            balanced = np.moveaxis(whole, -1, 0)
        linear = np.tensordot(self.matrix, balanced, 1)
        return np.moveaxis(self.developed_at(linear, self.spread(signals)), 0, -1)

    def spread(self, signals: Array) -> Array:
        """Return the standard deviation of linear output (3, rows, cols), full scale 1, in the mean over the mosaic."""
        return np.sqrt(np.einsum("kk...->k...", self._covariance(self._noise(signals), MEAN_SITE)))

    def developed_at(self, linear: Array, spread: Array) -> Array:
        """Return the mean 8-bit value [DN] of linear output with normal noise."""
        return self._developed(self.developed, linear, spread)

    def grey_noise(self, signals: Array, side: int = BIN_PX) -> tuple[Array, Array]:
        """Return the variance of the grey of a pixel, and of a bin times its pixels, (rows, cols) each [DN^2].

        Parameters
        ----------
        signals : ndarray (3, rows, cols)
            [raw DN].
        side : int
            Of a bin [px].
        """
        first: Any = 0.0
        second: Any = 0.0
        for kind, site in SITES.items():
            for weight, linear, covariance, _ in self._own_noise(signals, kind):
                spread = np.sqrt(np.einsum("kk...->k...", covariance))
                mean = self._developed(self.developed, linear, spread)
                own = self._developed(self.squares, linear, spread) - mean**2
                # How far one colour's noise goes with another's: by the mean slopes of both.
                slope = self._slope(linear, spread)
                both = np.einsum(
                    "k,l,k...,l...,kl...->...",
                    GREY,
                    GREY,
                    slope,
                    slope,
                    covariance * (1.0 - np.eye(3))[..., None, None],
                )
                grey = np.tensordot(GREY, mean, 1)
                first = first + site.share * weight * grey
                second = second + site.share * weight * (grey**2 + np.tensordot(GREY**2, own, 1) + both)
        variance = np.maximum(second - first**2, 1e-12)
        # Neighbours share a filter's noise as far as it goes through in proportion; what a cut makes of it they share
        # less: taken for the root, half-way between all of it and none.
        noise = self._noise(signals)
        covariance = self._covariance(noise, MEAN_SITE)
        slope = self._slope(self._linear(signals), self.spread(signals))
        one, many = (
            np.einsum("k,l,k...,l...,kl...->...", GREY, GREY, slope, slope, part)
            for part in (
                covariance,
                self._covariance(noise, np.array([_together(channel, side) for channel in range(3)])),
            )
        )
        return variance, many + np.maximum(variance - one, 0.0) * np.sqrt(many / np.maximum(one, 1e-30))

    def _own_noise(self, signals: Array, kind: str) -> Iterator[tuple[float, Array, Array, Array]]:
        """Yield, by noise of the pixel's own filter, its probability, linear output, covariance, third cumulant.

        Output and the third cumulant are (3, rows, cols), the covariance (3, 3, rows, cols), of full scale 1.
        """
        own, noise = list(SITES).index(kind), self._noise(signals) * np.array(SITES[kind].noise)[:, None, None]
        noise[own] = 0.0
        covariance = self._covariance(noise, np.ones(3))
        away = self._away(signals)
        third = np.tensordot(WEIGHTS, away**3, 1) * (np.array(SITES[kind].noise) ** 2)[:, None, None]
        third[own] = 0.0
        skew = np.tensordot(self.matrix**3, third, 1)
        linear = self._linear(signals)
        for weight, value in zip(WEIGHTS, away[:, own], strict=True):
            yield float(weight), linear + np.multiply.outer(self.matrix[:, own], value), covariance, skew

    def _away(self, signals: Array) -> Array:
        """Return balanced values less their means (steps, 3, rows, cols), full scale 1, at :data:`STEPS_SD`."""
        sd, gain = np.sqrt(self.noise_of(signals) ** 2 + 1.0 / 12.0), self.gains[:, None, None] / self.full_DN
        light = signals + STEPS_SD[:, None, None, None] * sd - self.filters[0].black_DN
        values = np.clip(gain * light, 0.0, 1.0)
        return np.asarray(values - np.tensordot(WEIGHTS, values, 1))

    def _third(self, linear: Array, spread: Array) -> Array:
        """Return the third derivative of the mean 8-bit value by the linear one [DN]: what skewed noise adds by."""
        step = STEP_SD * np.maximum(spread, LEAST_SPREAD)

        def odd(k: int) -> Array:
            ends = [self._developed(self.developed, linear + sign * k * step, spread) for sign in (1, -1)]
            return ends[0] - ends[1]

        far, near = odd(2), odd(1)
        return np.asarray((far - 2.0 * near) / (2.0 * step**3))

    def _linear(self, signals: Array) -> Array:
        """Return mean linear output (3, rows, cols), full scale 1."""
        return np.tensordot(self.matrix, self.balanced(signals), 1)

    def balanced(self, signals: Array) -> Array:
        """Return filters' mean balanced values (3, rows, cols), full scale 1."""
        return np.array([np.interp(s, f.signal, f.mean) for f, s in zip(self.filters, signals, strict=True)])

    def _noise(self, signals: Array) -> Array:
        """Return the variance of filters' own pixels (3, rows, cols), full scale 1."""
        return np.array([np.interp(s, f.signal, f.variance) for f, s in zip(self.filters, signals, strict=True)])

    def _covariance(self, noise: Array, shares: Array) -> Array:
        """Return the covariance (3, 3, rows, cols) of linear output, by the share of each filter's variance."""
        return np.asarray(np.einsum("kc,lc,c,c...->kl...", self.matrix, self.matrix, shares, noise))

    def _slope(self, linear: Array, spread: Array) -> Array:
        """Return the slope of the mean 8-bit value by the linear one [DN]."""
        step = STEP_SD * np.maximum(spread, LEAST_SPREAD)
        ends = [self._developed(self.developed, linear + off, spread) for off in (step, -step)]
        return np.asarray((ends[0] - ends[1]) / (2.0 * step))

    def _developed(self, table: Array, linear: Array, spread: Array) -> Array:
        """Return mean 8-bit values [DN], linear between the table's nodes."""
        across = (np.arcsinh(linear / NEAR) - _ENDS[0]) * ((LEVELS - 1) / (_ENDS[1] - _ENDS[0]))
        across = np.clip(across, 0.0, LEVELS - 1.001)
        down = np.log(np.clip(spread, LEAST_SPREAD, MOST_SPREAD) / LEAST_SPREAD)
        down = np.minimum(down * ((SPREADS - 1) / np.log(MOST_SPREAD / LEAST_SPREAD)), SPREADS - 1.001)
        col, row = across.astype(np.intp), down.astype(np.intp)
        right, below = across - col, down - row
        flat, first = table.ravel(), row * LEVELS + col
        above = flat[first] * (1.0 - right) + flat[first + 1] * right
        first = first + LEVELS
        return np.asarray(above * (1.0 - below) + (flat[first] * (1.0 - right) + flat[first + 1] * right) * below)


def expected_colour(camera: Camera, noise_scale: float = 1.0) -> ExpectedColour:
    """Return the moments of a colour camera, kept for the last few.

    Parameters
    ----------
    camera : Camera
    noise_scale : float
        As of :class:`evanesce.prediction.tone.SignalNoise`.
    """
    return _tabulate(ImageProcessor.of(camera), camera.pixel.bits, SignalNoise.of(camera, noise_scale))


@functools.lru_cache(maxsize=16)
def _tabulate(processor: ImageProcessor, bits: int, noise: SignalNoise) -> ExpectedColour:
    balanced = balance_table(processor, noise.black_DN, bits) / 65535.0
    filters = tuple(moments(table, noise) for table in balanced)
    full, matrix = 2**bits - 1 - noise.black_DN, np.array(processor.matrix)
    return ExpectedColour(
        filters, processor.gains, noise.sd, full, matrix, processor.demosaicing, *_after_noise(processor.curve)
    )


@functools.lru_cache(maxsize=4)
def _after_noise(curve: Curve) -> tuple[Array, Array]:
    """Return :attr:`ExpectedColour.developed` and :attr:`ExpectedColour.squares` of a tone curve."""
    table, level = tone_table(curve).astype(float), NEAR * np.sinh(np.linspace(*_ENDS, LEVELS))
    # Of a stair the mean over a normal distribution is a sum over its steps.
    steps = np.flatnonzero(np.diff(table))
    edge = (steps + 0.5) / 65535.0
    first, second = np.empty((2, SPREADS, LEVELS))
    for k, sd in enumerate(np.geomspace(LEAST_SPREAD, MOST_SPREAD, SPREADS)):
        beyond = ndtr((level[:, None] - edge) / sd)
        first[k] = table[0] + beyond @ np.diff(table)[steps]
        second[k] = table[0] ** 2 + beyond @ np.diff(table**2)[steps]
    return first, second


@functools.lru_cache(maxsize=16)
def _together(channel: int, bin_px: int) -> float:
    """Return the variance of a bin's mean over its pixels' number, over that of a filter's own pixel."""
    side = bin_px + 4
    weight = np.zeros((side, side))
    weight[2:-2, 2:-2] = 1.0
    if channel == 1:
        site = np.indices((side, side)).sum(axis=0) % 2 == 0
        kernel = np.array([[0, 0.25, 0], [0.25, 1.0, 0.25], [0, 0.25, 0]])
    else:
        site = (np.indices((side, side)) % 2 == 0).all(axis=0)
        kernel = np.outer([0.5, 1.0, 0.5], [0.5, 1.0, 0.5])
    share = cv2.filter2D(weight, cv2.CV_64F, kernel, borderType=cv2.BORDER_CONSTANT)[site]
    return float((share**2).sum() / bin_px**2)


def demosaiced(own: Array, pattern: Mosaic, how: Demosaicing) -> Array:
    """Return the colour (rows, cols, 3) of a mosaic (rows, cols) of full scale 1.

    Parameters
    ----------
    own : ndarray (rows, cols)
        Balanced value of each pixel's own filter.
    pattern : {"RGGB", "BGGR", "GRBG", "GBRG"}
    how : {"bilinear", "edge-aware"}
    """
    whole = np.floor(65535.0 * np.clip(own, 0.0, 1.0) + 0.5).astype(np.uint16)
    return np.asarray(cv2.cvtColor(whole, DEMOSAIC[pattern, how]) / 65535.0)
