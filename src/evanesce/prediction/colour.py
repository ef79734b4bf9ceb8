"""A colour camera's frame as the segmentation reads it: grey, of what filters and image processor make of light.

What a frame in colour tells of light of one spectrum, its grey tells: of a red LED's light the processor's matrix
leaves green and blue at nothing until red is full. So the data stay one number a pixel, not rounded, weighted as the
segmentation weighs red, green and blue.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from evanesce.bundle.area import AreaReading, contact_area
from evanesce.bundle.bundle import Bundle
from evanesce.core.errors import InputError
from evanesce.measurement.reference.segment import grey
from evanesce.prediction.tone import ExpectedTone, expected_tone, moments
from evanesce.prediction.views import BIN_PX
from evanesce.rig import Camera, Scene
from evanesce.rig.colour import Demosaicing, Mosaic
from evanesce.sensor.automatic import LUMA, is_automatic
from evanesce.sensor.colour import DEMOSAIC, ImageProcessor, balance_table, channel_map, tone_table
from evanesce.sensor.response import Response, card_response, led_response
from evanesce.sensor.tone import Curve

Array = NDArray[np.float64]

GREY = grey(np.uint8(255) * np.eye(3, dtype=np.uint8)[None])[0]
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

SITE_SPREAD_PX2 = (0.5, 0.25, 0.5)
"""By which bilinear demosaicing widens light along each axis, in the mean over the mosaic [px^2]."""

NODES = 800
"""Light levels at which the way from light to grey is computed where each pixel goes it by itself."""

EVEN = 0.01
"""Step between neighbours, over their light, up to which demosaicing shows in none of them."""

BEYOND = 4.0
"""Times the light that fills the most sensitive filter: what the others tell from there on is followed so far."""

LEVELS, SPREADS = 2048, 96
"""Nodes of the tone curve after noise: linear value, and logarithm of the noise's standard deviation."""
LOW, HIGH, NEAR = -0.25, 1.25, 0.005
"""Of the linear value, full scale 1: nodes stand dense within the last of nothing, in equal ratios beyond."""
_ENDS = np.arcsinh(LOW / NEAR), np.arcsinh(HIGH / NEAR)
LEAST_SPREAD, MOST_SPREAD = 1e-4, 0.5
"""Of its standard deviation."""


def grey_of(frame: NDArray[np.uint8]) -> NDArray[Any]:
    """Return a frame as the segmentation reads it, (rows, cols) [DN]; a grey one as it is."""
    return frame if frame.ndim == 2 else np.asarray(frame @ GREY.astype(np.float32), np.float32)


def luma_of(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return what a codec keeps of a frame as its brightness, (rows, cols) [DN]; a grey one as it is."""
    return frame if frame.ndim == 2 else np.floor(frame @ LUMA + 0.5).astype(np.uint8)


def require_predictable(bundle: Bundle) -> None:
    """Refuse frames of a camera whose settings follow what it sees, which no prediction of single pixels can.

    Raises
    ------
    InputError
    """
    camera, file = bundle.scene.camera, bundle.path / "scene.toml"
    if is_automatic(camera):
        key = "camera.auto_exposure" if camera.auto_exposure is not None else "camera.colour.white_balance"
        raise InputError(
            "frames of automatic settings cannot be fitted or criticised", file=file, key=key,
            allowed="a fixed exposure and a fixed white balance",
        )  # fmt: skip
    if camera.colour is not None and (camera.colour.contrast_enhancement or camera.colour.sharpening > 0.0):
        key = "contrast_enhancement" if camera.colour.contrast_enhancement else "sharpening"
        raise InputError(
            "frames that were enhanced cannot be fitted or criticised", file=file, key=f"camera.colour.{key}",
            allowed="an image processor that leaves them as they are",
        )  # fmt: skip


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

    def grey_noise(self, signals: Array) -> tuple[Array, Array]:
        """Return the variance of the grey of a pixel, and of a bin times its pixels, (rows, cols) each [DN^2].

        Parameters
        ----------
        signals : ndarray (3, rows, cols)
            [raw DN].
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
        # How many pixels of a bin err together is a matter of the filters: by what comes of each of them.
        noise = self._noise(signals)
        covariance = self._covariance(noise, MEAN_SITE)
        slope = self._slope(self._linear(signals), self.spread(signals))
        one, many = (
            np.einsum("k,l,k...,l...,kl...->...", GREY, GREY, slope, slope, part)
            for part in (covariance, self._covariance(noise, TOGETHER))
        )
        return variance, variance * many / np.maximum(one, 1e-30)

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
        As of :func:`evanesce.prediction.tone.expected_tone`.
    """
    pixel = camera.pixel
    e_per_DN = pixel.conversion_gain_e_per_DN / camera.analogue_gain
    noise = (pixel.black_level_DN, e_per_DN, pixel.read_noise_e, pixel.full_well_capacity_e, round(noise_scale, 5))
    return _tabulate(ImageProcessor.of(camera), pixel.bits, *noise)


@functools.lru_cache(maxsize=16)
def _tabulate(
    processor: ImageProcessor, bits: int, black_DN: float, e_per_DN: float, read_e: float, well_e: float, scale: float
) -> ExpectedColour:
    balanced = balance_table(processor, black_DN, bits) / 65535.0
    filters = tuple(moments(table, black_DN, e_per_DN, read_e, well_e, scale) for table in balanced)

    def noise_of(signal: Array) -> Array:
        charge = np.clip((signal - black_DN) * e_per_DN, 0.0, well_e)
        return np.asarray(scale * np.sqrt(charge + read_e**2) / e_per_DN)

    full, matrix = 2**bits - 1 - black_DN, np.array(processor.matrix)
    return ExpectedColour(
        filters, processor.gains, noise_of, full, matrix, processor.demosaicing, *_after_noise(processor.curve)
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


def _together(channel: int) -> float:
    """Return the variance of a bin's mean over its pixels' number, over that of a filter's own pixel."""
    side = BIN_PX + 4
    weight = np.zeros((side, side))
    weight[2:-2, 2:-2] = 1.0
    if channel == 1:
        site = np.indices((side, side)).sum(axis=0) % 2 == 0
        kernel = np.array([[0, 0.25, 0], [0.25, 1.0, 0.25], [0, 0.25, 0]])
    else:
        site = (np.indices((side, side)) % 2 == 0).all(axis=0)
        kernel = np.outer([0.5, 1.0, 0.5], [0.5, 1.0, 0.5])
    share = cv2.filter2D(weight, cv2.CV_64F, kernel, borderType=cv2.BORDER_CONSTANT)[site]
    return float((share**2).sum() / BIN_PX**2)


TOGETHER = np.array([_together(channel) for channel in range(3)])
"""Of a bin's mean, as in :data:`SITES`, times its pixels."""


def expected_grey(scene: Scene, noise_scale: float = 1.0, *, card: bool = False) -> ExpectedTone:
    """Return the moments of a pixel's grey under a scene's light, by the signal of a pixel that lets all of it through.

    Of a monochrome camera it is :func:`evanesce.prediction.tone.expected_tone`.

    Parameters
    ----------
    scene : Scene
    noise_scale : float
        Real over modelled standard deviation before the image processor.
    card : bool
        Whether a white lamp shines, not the LEDs.
    """
    response = card_response(scene.camera) if card else led_response(scene)
    if response is None:
        return expected_tone(scene.camera, noise_scale)
    return _grey_tone(scene.camera, response, round(noise_scale, 5))


@functools.lru_cache(maxsize=16)
def _grey_tone(camera: Camera, response: Response, scale: float) -> ExpectedTone:
    black, full = camera.pixel.black_level_DN, _filled(camera, response)
    light = np.concatenate([np.linspace(-0.1 * full, 0.0, 50, endpoint=False), light_levels(camera, response)])
    signals = black + np.multiply.outer(np.array(response), light)[:, None]
    colour = expected_colour(camera, scale)
    mean, (variance, together) = (colour.mean_of(signals) @ GREY)[0], (part[0] for part in colour.grey_noise(signals))
    return ExpectedTone(
        black + light, np.maximum.accumulate(mean), variance, black, together / variance,
        step_DN=float(GREY[int(np.argmax(response))]), full_DN=float(np.interp(full, light, mean)),
    )  # fmt: skip


@dataclass(frozen=True)
class Development:
    """The way from light to a frame's grey.

    Attributes
    ----------
    colour : ExpectedColour
    levels_e : ndarray (n,)
        Light at which the way is computed where each pixel goes it alone: charge of a pixel that lets all through [e-].
    read : callable
        ``read(light_e (rows, cols)) -> ndarray (3, rows, cols)``: the filters' mean signals [raw DN].
    finish : callable
        What follows on mean developed colour (rows, cols, 3) [DN].
    plain : callable, optional
        ``read`` without what makes a pixel's signal depend on its neighbours'.
    finish_alone : bool
        Whether what follows depends on each pixel's own light alone.
    pattern : {"RGGB", "BGGR", "GRBG", "GBRG"}, optional
        Of the mosaic, where pixels are the camera's own; by default demosaicing widens the light.
    """

    colour: ExpectedColour
    levels_e: Array
    read: Callable[[Array], Array]
    finish: Callable[[Array], Array]
    plain: Callable[[Array], Array] | None = None
    finish_alone: bool = True
    pattern: Mosaic | None = None

    def way(self) -> Way:
        """Return the way at :attr:`levels_e`: it serves all frames of the same settings."""
        signals = (self.plain or self.read)(self.levels_e[None])
        colour = self.colour.mean_of(signals)[0]
        grey = (self.finish(colour[None]) @ GREY)[0] if self.finish_alone else np.zeros(0)
        spread = self.colour.spread(signals)[:, 0]
        nearly = self.colour.nearly(signals)[0]
        return Way(self.levels_e, grey, colour, nearly, self.colour.balanced(signals)[:, 0], spread)

    def grey(self, light_e: Array, way: Way) -> Array:
        """Return the mean grey (rows, cols) of light (rows, cols) [DN].

        Parameters
        ----------
        light_e : ndarray (rows, cols)
            [e-].
        way : Way
        """
        uneven, mixed = self._demosaiced(light_e, way)
        if self.plain is not None or not self.finish_alone:
            colour = way.at(light_e, way.colour)
            colour[uneven] = mixed
            if self.plain is not None:
                # By the change alone: what the two ways differ by would be found in the data.
                after, before = (self.colour.nearly(read(light_e), self.pattern) for read in (self.read, self.plain))
                colour += after - before
            return np.asarray(self.finish(colour) @ GREY)
        found = np.interp(light_e, way.levels_e, way.grey)
        if len(mixed):
            found[uneven] = (self.finish(mixed[None]) @ GREY)[0]
        return found

    def _demosaiced(self, light_e: Array, way: Way) -> tuple[NDArray[np.bool_], Array]:
        """Return which pixels have neighbours of other light, (rows, cols), and their mean colour (n, 3) [DN]."""
        if self.pattern is None:
            return np.zeros(light_e.shape, bool), np.zeros((0, 3))
        around = np.ones((3, 3), np.uint8)
        high = cv2.dilate(light_e, around)
        uneven = high - cv2.erode(light_e, around) > EVEN * high + way.levels_e[1]
        own = np.empty(light_e.shape)
        for place, letter in enumerate(self.pattern):
            here = np.s_[place // 2 :: 2, place % 2 :: 2]
            own[here] = np.interp(light_e[here], way.levels_e, way.balanced["RGB".index(letter)])
        light = light_e[uneven]
        linear = demosaiced(own, self.pattern, self.colour.demosaicing)[uneven] @ self.colour.matrix.T
        spread = np.array([np.interp(light, way.levels_e, part) for part in way.spread])
        developed = self.colour.developed_at(linear.T, spread).T
        return uneven, way.at(light, way.colour - way.nearly) + developed


@dataclass(frozen=True)
class Way:
    """What a development makes of levels of light.

    Attributes
    ----------
    levels_e : ndarray (n,)
        [e-].
    grey : ndarray (n,)
        [DN]; empty where pixels are not finished alone.
    colour, nearly : ndarray (n, 3)
        Mean colour, and as :meth:`ExpectedColour.nearly` has it [DN].
    balanced, spread : ndarray (3, n)
        Filters' mean balanced values, and standard deviation of linear output, full scale 1.
    """

    levels_e: Array
    grey: Array
    colour: Array
    nearly: Array
    balanced: Array
    spread: Array

    def at(self, light_e: Array, colour: Array) -> Array:
        """Return colours (..., 3) at light (...) of those at the levels (n, 3)."""
        return np.stack([np.interp(light_e, self.levels_e, part) for part in colour.T], axis=-1)


def light_levels(camera: Camera, response: Response) -> Array:
    """Return levels of light in units of a raw number of a pixel that lets all of it through (NODES,) [raw DN].

    From nothing to where the most sensitive filter is full and on: the others still tell of light.

    Parameters
    ----------
    camera : Camera
    response : tuple of float
        Of red, green and blue pixels [1].
    """
    return np.asarray(BEYOND * _filled(camera, response) * np.linspace(0.0, 1.0, NODES) ** 2)


def _filled(camera: Camera, response: Response) -> float:
    """Return the light that fills the most sensitive filter [raw DN]."""
    first = int(np.argmax(response))
    codes = 2**camera.pixel.bits - 1 - camera.pixel.black_level_DN
    return float(codes / (response[first] * ImageProcessor.of(camera).gains[first]))


def widened(light: Array, camera: Camera, response: Response, pixels: float) -> Array:
    """Return light widened by bilinear demosaicing, by the mean of the filters, weighted by what they see.

    Parameters
    ----------
    light : ndarray (rows, cols)
    camera : Camera
    response : tuple of float
        Of red, green and blue pixels [1].
    pixels : float
        Real pixels along one of these.
    """
    weight = np.array(response) * ImageProcessor.of(camera).gains
    spread = float(weight @ SITE_SPREAD_PX2 / weight.sum()) / pixels**2
    taps = np.array([0.5 * spread, 1.0 - spread, 0.5 * spread])
    return np.asarray(cv2.sepFilter2D(light, cv2.CV_64F, taps, taps, borderType=cv2.BORDER_REFLECT_101))


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


def area_in(picture: Array, scene: Scene, reading: AreaReading | None = None) -> float:
    """Return the area of contact that the reference segmentation reads in a mean frame [mm^2].

    Parameters
    ----------
    picture : ndarray (rows, cols)
        Grey [DN].
    scene : Scene
        Nominal.
    reading : AreaReading, optional
        By default the usual one, its threshold a share of what a full pixel shows.
    """
    # Counted in steps as fine as those of a monochrome frame.
    finer = 255.0 / expected_grey(scene).full_DN
    reading = AreaReading() if reading is None else replace(reading, threshold=min(reading.threshold * finer, 1.0))
    return contact_area(np.floor(np.clip(picture * finer, 0, 255) + 0.5).astype(np.uint8), scene, reading)
