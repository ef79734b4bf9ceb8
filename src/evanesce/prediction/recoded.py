"""Frames of the believed rig sent through a codec like the one the data came through: what it makes of them is drawn.

The replicates show what a codec leaves of the noise of one state. They do not show what it makes of the state itself,
the same in every frame: weak contrasts that vanish, dark levels that settle elsewhere, errors that are handed on from
frame to frame. So the predicted frames are given the camera's noise and filmed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from evanesce.core.threads import one_by_one
from evanesce.prediction import priors
from evanesce.prediction.codecs import Codec, Likely
from evanesce.prediction.colour import expected_grey, grey_of
from evanesce.prediction.correlation import Correlation
from evanesce.prediction.tone import ExpectedTone, SignalNoise
from evanesce.prediction.views import BIN_PX, View, binned
from evanesce.rig import Camera, Scene
from evanesce.sensor.colour import mosaic
from evanesce.sensor.expose import frame_of
from evanesce.sensor.response import card_response, led_response

Array = NDArray[Any]

DRAWS = 24
"""Of all frames; fewer where they are large (:data:`MOST_PIXELS`)."""

LEAST_DRAWS = 8

MOST_PIXELS = 1.2e9
"""Of all draws together, filmed frames included: some minutes."""

MOST_KEPT = 1e8
"""Pixels of predicted frames that are kept while they are drawn; more are made anew for each draw."""

JPEG_OFF, SCALE_OFF, LIGHT_OFF = 3.0, 0.03, 0.01
"""Standard deviations by which draws differ: a figure of JPEG from that of another encoder with as much noise left, the
logarithms of noise (half a step of those that were tried) and light. Black levels differ by their prior."""

BANDS = 2
"""Of spatial frequency, to an octave, over each of which the noise's power is averaged."""

LONG_PER_BIN = 1.0 / 16.0
"""Spatial frequency below which views tell how like each other they are: waves of four macroblocks and more."""

SMOOTH_BINS = 5
"""Variances of so few draws are averaged over so many bins a side."""

LEAST_DN = 0.02
"""Standard deviation of a bin below which none is believed: where every draw was coded alike."""

LUMA_STEP_DN = 255.0 / 219.0
"""Of brightness that is kept in the range from 16 to 235."""

SHRINK = 0.05
"""Of correlations between views towards none: so few draws know them so well."""


@dataclass(frozen=True)
class Recoded:
    """What a codec makes of the believed rig's frames.

    Attributes
    ----------
    codec : Codec
    bias : ndarray (views, rows, cols)
        Mean change of the bins [DN].
    fields : ndarray of float32 (draws, views, rows, cols)
        Departures of single draws from their mean, noise included [DN].
    passed : ndarray (views,)
        Share of the camera's noise, in amplitude, that outlives the codec.
    pixels : tuple of ndarray of float32 (views, pixel rows, pixel cols), optional
        Mean change of the model camera's pixels, and standard deviation of what a single draw adds to it [DN].
    encoders : tuple of str
        Of each draw; empty where one made them all.
    """

    codec: Codec
    bias: Array
    fields: Array
    passed: Array
    pixels: tuple[Array, Array] | None = None
    encoders: tuple[str, ...] = ()

    @cached_property
    def sd(self) -> Array:
        """Standard deviation of single bins (views, rows, cols) [DN]."""
        free = len(self.fields) - 1
        return np.sqrt(_smooth((self.fields.astype(float) ** 2).sum(axis=0) / free) + LEAST_DN**2)

    @property
    def rounding(self) -> Array:
        """Standard deviation of bins by the codec's rounding of levels (views,) [DN].

        Where next to no noise outlives it, nothing dithers that, and whole regions settle a step higher or lower; which
        is decided by tenths of a step that no prediction knows.
        """
        return np.asarray(np.clip(1.0 - self.passed, 0.0, 1.0) * LUMA_STEP_DN / np.sqrt(12.0))

    def correlation(self, share: Array, rounding: Array) -> Correlation:
        """Return how the noise of places and of views hangs together.

        Parameters
        ----------
        share, rounding : ndarray (views,)
            Of the whole variance, what the draws scatter and what is rounded; the rest is of independent bins.
        """
        waves = fft.dctn(self.fields / self.sd, axes=(2, 3), norm="ortho").astype(float)
        power = (waves**2).sum(axis=0) / (len(waves) - 1)
        down, right = (np.arange(n) / (2.0 * n) for n in power.shape[1:])
        lowest = 0.5 / max(power.shape[1:])
        per_bin = np.maximum(np.hypot(down[:, None], right), lowest)
        # Bands of equal ratio: a codec's errors are as large as a block or as the frame, in no direction of their own.
        band = np.unique(np.ceil(np.log2(per_bin / lowest) * BANDS), return_inverse=True)[1].reshape(per_bin.shape)
        count = np.bincount(band.ravel())
        spectrum = np.array([(np.bincount(band.ravel(), one.ravel()) / count)[band] for one in power])
        # Regions with sharp borders, of any size: their spectrum falls with the third power.
        regions = per_bin**-3.0
        regions /= regions.mean()
        mixed = [part[:, None, None] for part in (share, rounding, 1.0 - share - rounding)]
        spectrum = mixed[0] * spectrum + mixed[1] * regions + mixed[2]
        long = per_bin < LONG_PER_BIN
        seen = waves[:, :, long] / np.sqrt(power[:, long].mean(axis=1))[:, None]
        like = np.einsum("dvb,dub->vu", seen, seen)
        size = np.sqrt(np.maximum(np.diag(like), 1e-12) / (share + rounding))
        like = (1.0 - SHRINK) * like / np.outer(size, size)
        np.fill_diagonal(like, 1.0)
        return Correlation(like, spectrum)


@dataclass(frozen=True)
class Shooting:
    """How frames are taken and looked at.

    Attributes
    ----------
    scene : Scene
        With the real pixels.
    scale : float
        Real over modelled noise before the tone curve.
    factor : int
        By how much frames are averaged down before they are binned.
    modelled : float, optional
        The same of the prediction whose levels are given; as ``scale`` by default. Where black is cut off, more noise
        is a higher level.
    flicker : float
        Standard deviation of the logarithm of a frame's light [1]. Bright parts that change by half a level are coded
        anew where still ones would be handed on.
    black_DN, light : float
        Added to the black level [raw DN], and relatively to the light.
    card : bool
        Whether a card under a white lamp is seen.
    """

    scene: Scene
    scale: float
    factor: int
    modelled: float | None = None
    flicker: float = 0.0
    black_DN: float = 0.0
    light: float = 0.0
    card: bool = False

    @property
    def camera(self) -> Camera:
        """With the real pixels."""
        return self.scene.camera

    @property
    def response(self) -> Array:
        """Shares of light that the filters let through, as a mosaic (rows, cols) [1]; 1 of a monochrome camera."""
        colour, (cols, rows) = self.camera.colour, self.camera.resolution_px
        response = card_response(self.camera) if self.card else led_response(self.scene)
        if colour is None or response is None:
            return np.ones((1, 1))
        return mosaic(np.ones((rows, cols)), response, colour.mosaic)

    def tone(self, scale: float) -> ExpectedTone:
        """Return the moments of a pixel's level by noise so many times as large as modelled."""
        return expected_grey(self.scene, scale, card=self.card)

    def signal(self, level: Array) -> Array:
        """Return the mean signal [raw DN] where a prediction has a level [DN]."""
        tone = self.tone(self.scale if self.modelled is None else self.modelled)
        rising = np.concatenate([[True], np.diff(tone.mean) > 1e-9])
        signal = np.interp(level, tone.mean[rising], tone.signal[rising])
        return np.asarray(signal + self.black_DN + self.light * (signal - self.camera.pixel.black_level_DN))

    def frames(self, signal: Array, rng: np.random.Generator) -> Iterator[Array]:
        """Yield frames of uint8 of a mean signal (rows, cols) [raw DN], with the camera's noise, without end."""
        black = self.camera.pixel.black_level_DN
        part = self.response[: signal.shape[0], : signal.shape[1]]
        light = part * (signal - black)
        sd = SignalNoise.of(self.camera, self.scale).sd(black + light)
        while True:
            noise = sd * rng.standard_normal(signal.shape, np.float32)
            yield frame_of(black + (1.0 + self.flicker * rng.standard_normal()) * light + noise, self.camera).data

    def mean(self, signal: Array) -> Array:
        """Return the bins' mean without a codec [DN]."""
        return self.binned(self.tone(self.scale).mean_of(signal))

    def binned(self, frame: Array) -> Array:
        """Return a frame's bins, of its grey [DN]."""
        return binned(grey_of(frame), BIN_PX * self.factor)

    def averaged(self, frame: Array) -> Array:
        """Return a frame at the model camera's pixels [DN]."""
        return binned(grey_of(frame), self.factor)

    def another(self, rng: np.random.Generator) -> Shooting:
        """Return it with noise, black level and light as they may be instead."""
        off = rng.standard_normal(3) * (SCALE_OFF, priors.BLACK_DN, LIGHT_OFF)
        return replace(self, scale=self.scale * float(np.exp(off[0])), black_DN=float(off[1]), light=float(off[2]))


def recoded(
    shooting: Shooting,
    pictures: Callable[[int], Array],
    views: Sequence[View],
    likely: Likely,
    rng: np.random.Generator,
    most: int = DRAWS,
) -> Recoded:
    """Return what a codec makes of predicted frames, which are filmed in the order of the views.

    Each draw is of another noise, by a codec and of a camera that differ by what is not known of them.

    Parameters
    ----------
    shooting : Shooting
    pictures : callable
        The mean frame (real rows, real cols) of a view by its number [DN].
    views : sequence of View
    likely : Likely
        What the frames may have come through.
    rng : numpy.random.Generator
    most : int
        Draws at the most.
    """
    codec = likely.codec
    filmed = max(one.filmed for one in likely.codecs)
    size = float(np.prod(shooting.camera.resolution_px)) * filmed * sum(v.frames for v in views)
    draws = min(int(np.clip(MOST_PIXELS / size, LEAST_DRAWS, DRAWS)), most)
    kept: list[Array] | None = None
    if np.prod(shooting.camera.resolution_px) * len(views) < MOST_KEPT:
        kept = [pictures(k).astype(np.float32) for k in range(len(views))]
    making = Lock()

    def picture_of(k: int) -> Array:
        if kept is not None:
            return kept[k]
        with making:
            return pictures(k)

    draws_of, codecs = rng.spawn(draws), likely.drawn(draws)

    def drawn(number: int) -> tuple[Array, Array, Array]:
        own = draws_of[number]
        own_codec, scale = codecs[number]
        off = round(float(own.standard_normal()) * (JPEG_OFF if own_codec.kind == "jpeg" else 0.0))
        taking = replace(shooting, scale=scale).another(own)
        return _one_draw(taking, picture_of, views, own_codec.worse(off), own)

    noise, change = [], []
    total: Any = 0.0
    square: Any = 0.0
    for bins, changed, pixels in one_by_one(drawn, draws):
        noise.append(bins)
        change.append(changed)
        total, square = total + pixels, square + pixels**2
    before, after = np.array(noise, np.float32), np.array(change, np.float32)
    mean = after.mean(axis=0, dtype=float)
    fields = after - mean.astype(np.float32)
    # What the codec passes on of the noise is known without it: taken off, the mean of a few draws is that of many.
    passed = (fields * before).sum(axis=(0, 2, 3)) / np.maximum((before**2).sum(axis=(0, 2, 3)), 1e-9)
    left = _smooth(((fields - passed[:, None, None] * before) ** 2).sum(axis=0, dtype=float)) / (draws - 1) / draws
    bias = _settled(mean - passed[:, None, None] * before.mean(axis=0, dtype=float), left)
    middle = total / draws
    # A draw adds its own to a mean that is uncertain by a part of that.
    scatter = _smooth(np.maximum(square / draws - middle**2, 0.0)) * (draws + 1) / (draws - 1)
    encoders = tuple(one.maker for one, _ in codecs)
    return Recoded(codec, bias, fields, passed, (middle, np.sqrt(scatter)), encoders if len(set(encoders)) > 1 else ())


def _smooth(cube: Array) -> Array:
    return np.asarray(ndimage.uniform_filter(cube, (0, SMOOTH_BINS, SMOOTH_BINS), mode="nearest"))


def _settled(bias: Array, variance: Array) -> Array:
    """Return a mean of few draws (views, rows, cols) without what is not more than their scatter (Wiener's filter).

    As it is, its noise would be found again: data less a noisy prediction look like that noise, bin by bin.
    """
    middle = _smooth(bias)
    around = np.maximum(_smooth(bias**2) - middle**2, 1e-12)
    return np.asarray(middle + np.maximum(1.0 - variance / around, 0.0) * (bias - middle))


def _one_draw(
    shooting: Shooting, pictures: Callable[[int], Array], views: Sequence[View], codec: Codec, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return what all views differ from their expectation by: bins before and after the codec, pixels after [DN]."""
    expected: list[Array] = []
    level: list[Array] = []
    before: list[Array] = []

    def film() -> Iterator[Array]:
        for k, view in enumerate(views):
            taking = replace(shooting, card=view.is_card)
            signal = taking.signal(pictures(k))
            mean = taking.tone(shooting.scale).mean_of(signal)
            expected.append(shooting.binned(mean))
            level.append(shooting.averaged(mean).astype(np.float32))
            frames = taking.frames(signal, rng)
            kept = []
            for number in range(view.frames * codec.filmed):
                frame = next(frames)
                if number % codec.filmed == codec.filmed - 1:
                    kept.append(shooting.binned(frame))
                yield frame
            before.append(np.mean(kept, axis=0))

    back = codec.through(film())
    after = [np.mean([grey_of(next(back)).astype(np.float32) for _ in range(v.frames)], axis=0) for v in views]
    # The film is only done with, and its folder gone, once nothing more comes.
    if next(back, None) is not None:
        raise RuntimeError("more frames came back than were filmed")
    pixels = np.array([shooting.averaged(frame) for frame in after], np.float32) - np.array(level)
    return np.array(before) - expected, np.array([shooting.binned(frame) for frame in after]) - expected, pixels
