"""Frames of the believed rig sent through a codec like the one the data came through: what it makes of them is drawn.

The replicates show what a codec leaves of the noise of one state. They do not show what it makes of the state itself,
the same in every frame: weak contrasts that vanish, dark levels that settle elsewhere, errors that are handed on from
frame to frame. So the predicted frames are given the camera's noise and filmed. Which codec it was nobody says; the
one is taken whose noise outlives it as that of the replicates did, pixel by pixel, bin by bin and from frame to frame.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.core.states import Frame
from evanesce.prediction import priors
from evanesce.prediction.observe import pixel_scatter
from evanesce.prediction.tone import expected_tone, signal_sd
from evanesce.prediction.views import BIN_PX, View, binned
from evanesce.rig import Camera
from evanesce.sensor.codec import VideoWriter
from evanesce.sensor.expose import frame_of

Array = NDArray[Any]
Kind = Literal["h264", "jpeg"]

DRAWS = 24
"""Of all frames; fewer where they are large (:data:`MOST_PIXELS`)."""

LEAST_DRAWS = 8

MOST_PIXELS = 1.2e9
"""Of all draws together, filmed frames included: some minutes."""

MOST_KEPT = 1e8
"""Pixels of predicted frames that are kept while they are drawn; more are made anew for each draw."""

QUALITIES: Mapping[Kind, tuple[int, ...]] = {"h264": tuple(range(14, 35, 4)), "jpeg": (50, 60, 67, 75, 80, 85, 90, 95)}
"""Tried first: constant rate factors (lower is better), and JPEG's own figures (higher is better)."""

REFINED = (((-2, -1, 1, 2), (0.85, 1.18)), ((-1, 1), (0.93, 1.08)))
"""Rounds about the best: steps of quality, and noise before the codec over what the best has."""

LEAST_TRAIT_SD, BIN_TRAIT_SD = 0.1, 1.5
"""To what a trait is known at best, and by one bin: a codec's work depends on more than is told here."""

FILMED = 3
"""Frames of a video for each that was kept, at first; one is tried, too."""

WINDOW_PX = (480, 640)
"""Part of the frame, where it is brightest, by which the codec is chosen."""

LEVELS_DN = (8.0, 40.0)
"""Borders of the groups of level in which scatter is compared."""

MAPS, MAP_BINS = 40, 1.5
"""Of places at which a mean change may be off, and how far each reaches: a macroblock or so."""

SMOOTH_BINS = 5
"""Variances of so few draws are averaged over so many bins a side."""


@dataclass(frozen=True)
class Codec:
    """A lossy codec.

    Attributes
    ----------
    kind : {"h264", "jpeg"}
    quality : int
        Constant rate factor; JPEG's quality.
    filmed : int
        Frames of a video for each that is kept, the last of them.
    """

    kind: Kind
    quality: int
    filmed: int = 1

    def __str__(self) -> str:
        name = "H.264 of rate factor" if self.kind == "h264" else "JPEG of quality"
        return f"{name} {self.quality}"

    def through(self, frames: Iterator[Array]) -> Iterator[Array]:
        """Yield frames (rows, cols) of uint8 after the codec, the kept ones."""
        return _as_video(frames, self.quality, self.filmed) if self.kind == "h264" else _as_jpeg(frames, self.quality)


def _as_jpeg(frames: Iterator[Array], quality: int) -> Iterator[Array]:
    for frame in frames:
        _, data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, quality])
        yield np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))


def _as_video(frames: Iterator[Array], quality: int, filmed: int) -> Iterator[Array]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        shape = (0, 0)
        with VideoWriter(path, codec="h264", quality=quality) as film:
            for k, frame in enumerate(frames):
                shape = frame.shape
                even = np.pad(frame, [(0, n % 2) for n in shape], mode="edge")
                film.add(Frame(data=even, time=k / 30.0, index=k))
        with av.open(str(path)) as container:
            for k, picture in enumerate(container.decode(video=0)):
                if k % filmed == filmed - 1:
                    yield picture.to_ndarray(format="rgb24")[: shape[0], : shape[1], 1]


@dataclass(frozen=True)
class Recoded:
    """What a codec makes of the believed rig's frames.

    Attributes
    ----------
    codec : Codec
    bias : ndarray (views, rows, cols)
        Mean change of the bins [DN].
    fields : ndarray of float32 (draws, views, rows, cols)
        Departures of single draws from their mean [DN].
    uneven : ndarray of float32 (maps, views, rows, cols)
        What its mean change may be off by from place to place, each map as likely as it is large [DN].
    variance : ndarray (views, rows, cols)
        Of the bins, their mean's own and what it may be off by included [DN^2].
    """

    codec: Codec
    bias: Array
    fields: Array
    uneven: Array
    variance: Array

    @property
    def every(self) -> Array:
        """Fields and uneven maps: (draws + maps, views, rows, cols) [DN]."""
        return np.concatenate([self.fields, self.uneven])

    def louder(self, excess: Array) -> Recoded:
        """Return it with the variance of each view (views, 1, 1) multiplied."""
        size = np.sqrt(excess).astype(np.float32)
        return replace(self, fields=self.fields * size, uneven=self.uneven * size, variance=self.variance * excess)

    def drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Return amplitudes (count, draws + maps) of :attr:`every` whose sums scatter as frames do.

        All views of a draw go together, since a codec hands on what it made of a place. So few fields know their own
        size badly: their amplitudes are Student's, those of the maps normal.
        """
        free = len(self.fields) - 1
        normal = rng.standard_normal((count, len(self.fields))) / np.sqrt(free)
        normal *= np.sqrt(free / rng.chisquare(free, (count, 1)))
        return np.concatenate([normal, rng.standard_normal((count, len(self.uneven)))], axis=1)


@dataclass(frozen=True)
class Shooting:
    """How frames are taken and looked at.

    Attributes
    ----------
    camera : Camera
        With the real pixels.
    scale : float
        Real over modelled noise before the tone curve.
    factor : int
        By how much frames are averaged down before they are binned.
    """

    camera: Camera
    scale: float
    factor: int

    def frames(self, level: Array, rng: np.random.Generator) -> Iterator[Array]:
        """Yield frames (rows, cols) of uint8 with a mean of ``level`` [DN] and the camera's noise, without end."""
        tone = expected_tone(self.camera, self.scale)
        rising = np.concatenate([[True], np.diff(tone.mean) > 1e-9])
        signal = np.interp(level, tone.mean[rising], tone.signal[rising])
        sd = signal_sd(self.camera, signal, self.scale)
        while True:
            yield frame_of(signal + sd * rng.standard_normal(level.shape, np.float32), self.camera).data

    def binned(self, frame: Array) -> Array:
        """Return a frame's bins [DN]."""
        return binned(frame, BIN_PX * self.factor)


def recoded(
    shooting: Shooting,
    pictures: Callable[[int], Array],
    views: Sequence[View],
    codec: Codec,
    expected: Array,
    rng: np.random.Generator,
    share: float = 0.25,
) -> Recoded:
    """Return what a codec makes of predicted frames, which are filmed in the order of the views.

    Parameters
    ----------
    shooting : Shooting
    pictures : callable
        The mean frame (real rows, real cols) of a view by its number [DN].
    views : sequence of View
    codec : Codec
    expected : ndarray (views, rows, cols)
        Bins of the mean frames without a codec [DN].
    rng : numpy.random.Generator
    share : float
        Of the mean change by which it may be off from place to place. It looks like any soft spot, so that a film is
        lost where it is allowed for without need: with noise that outlives the codec there is none.
    """
    size = float(np.prod(shooting.camera.resolution_px)) * codec.filmed * sum(v.frames for v in views)
    draws = int(np.clip(MOST_PIXELS / size, LEAST_DRAWS, DRAWS))
    if np.prod(shooting.camera.resolution_px) * len(views) < MOST_KEPT:
        kept = [pictures(k).astype(np.float32) for k in range(len(views))]
        pictures = kept.__getitem__
    plain = np.empty((draws, *expected.shape), np.float32)
    coded = np.empty_like(plain)
    for k in range(draws):
        plain[k], coded[k] = _one_draw(shooting, pictures, views, codec, rng)
    mean = coded.mean(axis=0, dtype=float)
    fields = (coded - mean).astype(np.float32)
    # What the codec passes on of the noise is known without it: taken off, the mean of a few draws is that of many.
    before = plain - plain.mean(axis=0)
    passed = (fields * before).sum(axis=(0, 2, 3)) / np.maximum((before**2).sum(axis=(0, 2, 3)), 1e-9)
    surplus = passed[:, None, None] * (plain.mean(axis=0, dtype=float) - expected)
    variance = (fields.astype(float) ** 2).sum(axis=0) / (draws - 1)
    variance = _smooth(variance)
    left = _smooth(((fields - passed[:, None, None] * before) ** 2).sum(axis=0, dtype=float)) / (draws - 1) / draws
    bias = _settled(mean - surplus - expected, left)
    uneven = _uneven(bias, share, rng)
    return Recoded(codec, bias, fields, uneven, variance + left + _smooth((uneven.astype(float) ** 2).sum(axis=0)))


def _uneven(bias: Array, share: float, rng: np.random.Generator) -> Array:
    """Return maps (maps, views, rows, cols) whose sum, each times a normal number, is what a mean change is off by.

    Which codec it was is known roughly, so that its changes may be off by a share: as a whole, for
    which a nuisance stands, and from one macroblock to the next, alike in all frames. That is no noise, which would
    average out over frames, and looks like an edge in another place.
    """
    maps = ndimage.gaussian_filter(rng.standard_normal((MAPS, *bias.shape[1:])), (0, MAP_BINS, MAP_BINS), mode="wrap")
    maps *= share / np.sqrt((maps**2).sum(axis=0).mean())
    return (maps[:, None] * bias).astype(np.float32)


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
) -> tuple[Array, Array]:
    """Return the bins of all views (views, rows, cols) before and after the codec [DN]."""
    before: list[Array] = []

    def film() -> Iterator[Array]:
        for k, view in enumerate(views):
            frames = shooting.frames(pictures(k), rng)
            kept = []
            for number in range(view.frames * codec.filmed):
                frame = next(frames)
                if number % codec.filmed == codec.filmed - 1:
                    kept.append(shooting.binned(frame))
                yield frame
            before.append(np.mean(kept, axis=0))

    back = codec.through(film())
    after = [np.mean([shooting.binned(next(back)) for _ in range(v.frames)], axis=0) for v in views]
    # The film is only done with, and its folder gone, once nothing more comes.
    if next(back, None) is not None:
        raise RuntimeError("more frames came back than were filmed")
    return np.array(before), np.array(after)


def codec_of(
    shooting: Shooting,
    picture: Array,
    before: Sequence[Callable[[], Array]],
    held: Array,
    scatter: tuple[Array, Array],
    rng: np.random.Generator,
) -> tuple[Codec, float]:
    """Return the codec through which noise comes as it came in the replicates, and the scale of that noise.

    Parameters
    ----------
    shooting : Shooting
        Its scale is what is believed.
    picture : ndarray (real rows, real cols)
        Predicted mean frame of the replicates [DN].
    before : sequence of callable
        Those of the states that were filmed before them, each made when it is asked for and cut at once: what a video
        made of them it hands on.
    held, scatter
        Binned replicates, and scatter of their pixels: :class:`evanesce.prediction.observe.Observation`.
    rng : numpy.random.Generator
    """
    side = BIN_PX * shooting.factor
    part = _brightest(shooting.binned(picture), tuple(n // side for n in WINDOW_PX))
    real = tuple(slice(s.start * side, s.stop * side) for s in part)
    seen, seen_sd = _traits(held[(slice(None), *part)], (scatter[0][part], scatter[1][part]))
    states = [np.array(state()[real], np.float32) for state in before]
    seed = int(rng.integers(2**32))
    tried: dict[tuple[Codec, float], float] = {}

    def attempt(codec: Codec, scale: float) -> None:
        if (codec, scale) in tried:
            return
        taking, noise = replace(shooting, scale=scale), np.random.default_rng(seed)

        def film() -> Iterator[Array]:
            for state in [*(states if codec.kind == "h264" else ()), *[picture[real]] * len(held)]:
                frames = taking.frames(state, noise)
                for _ in range(codec.filmed):
                    yield next(frames)

        back = list(codec.through(film()))[-len(held) :]
        found, sd = _traits(np.array([shooting.binned(b) for b in back]), pixel_scatter(back, shooting.factor))
        unlike = float(np.nansum(((seen - found) / np.hypot(sd, seen_sd)) ** 2))
        tried[codec, scale] = unlike + (np.log(scale / shooting.scale) / priors.SCALE_CODEC) ** 2

    for kind, qualities in QUALITIES.items():
        for quality in qualities:
            attempt(Codec(kind, quality, FILMED if kind == "h264" else 1), shooting.scale)
    for steps, louder in REFINED:
        # How much noise came in and how much was kept back take each other's place.
        best, scale = min(tried, key=lambda t: tried[t])
        for step in steps:
            attempt(replace(best, quality=best.quality + step), scale)
        for times in louder:
            attempt(best, scale * times)
        if best.kind == "h264":
            attempt(replace(best, filmed=1), scale)
    return min(tried, key=lambda t: tried[t])


def _brightest(level: Array, most: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the brightest part (of some rows and cols at most) of binned levels."""
    rows, cols = (min(n, m) for n, m in zip(level.shape, most, strict=True))
    sums = ndimage.uniform_filter(level, (rows, cols), mode="constant")
    row, col = np.unravel_index(int(np.argmax(sums)), level.shape)
    top = int(np.clip(row - rows // 2, 0, level.shape[0] - rows))
    left = int(np.clip(col - cols // 2, 0, level.shape[1] - cols))
    return slice(top, top + rows), slice(left, left + cols)


def _traits(frames: Array, scatter: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return what tells codecs apart, and its standard deviation.

    By level: log scatter of pixels and of bins, how like that of the next frame is, and the share that is the same in
    it; NaN where there is no such level.
    """
    level, variance = scatter
    left = frames - frames.mean(axis=0)
    bins = (left**2).sum(axis=0) / (len(frames) - 1)
    next_to = (left[1:] * left[:-1]).sum(axis=0) / (len(frames) - 1)
    group = np.digitize(level, LEVELS_DN)
    still = (frames[1:] == frames[:-1]).mean(axis=0)
    found: list[float] = []
    sd: list[float] = []
    for k in range(len(LEVELS_DN) + 1):
        mine = group == k
        if mine.sum() < 20:
            found, sd = [*found, *[np.nan] * 4], [*sd, *[1.0] * 4]
            continue
        sd += [float(np.hypot(LEAST_TRAIT_SD, BIN_TRAIT_SD / np.sqrt(mine.sum())))] * 4
        pixel, whole = float(variance[mine].mean()), float(bins[mine].mean())
        found += [np.log(pixel + 0.02), np.log(whole + 0.002), float(next_to[mine].mean()) / (whole + 0.002)]
        found += [float(still[mine].mean())]
    return np.array(found), np.array(sd)
