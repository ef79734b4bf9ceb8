"""Which codec the frames came through: the one whose noise outlives it as that of the replicates did.

Compared are the scatter of pixels and bins, its likeness from frame to frame, and levels.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.core.threads import one_by_one
from evanesce.prediction.codecs import ENCODERS, Codec, Kind, Likely
from evanesce.prediction.observe import pixel_scatter
from evanesce.prediction.recoded import Shooting
from evanesce.prediction.views import BIN_PX
from evanesce.sensor.codec import STEADY

Array = NDArray[Any]

QUALITIES: Mapping[Kind, tuple[int, ...]] = {"h264": tuple(range(14, 35, 4)), "jpeg": (50, 60, 67, 75, 80, 85, 90, 95)}
"""Tried first: constant rate factors (lower is better), and JPEG's own figures (higher is better)."""

NOISE_FACTORS = (0.8, 1.0, 1.25)
"""Noise before the codec over what is believed, of those tried first."""

REFINED = ((2, 1.12), (1, 1.06))
"""Rounds about the best: steps of quality, and of the noise before the codec, together."""

OTHERS = (-4, -2, 0, 2, 4)
"""Steps of quality from the best at which other encoders are tried: one that looks ahead keeps less of the noise. Their
noise is refined once: which one filmed is hardly told."""

LEAST_LIKELY = 0.01
"""Over the most probable one: less probable ones are no draw of some tens."""

SCALE_UNKNOWN = 0.25
"""Standard deviation of that noise's logarithm: what is believed was read off a level that the codec displaced."""

LEAST_TRAIT_SD, BIN_TRAIT_SD = 0.1, 1.5
"""To what a trait is known at best, and by one bin: a codec's work depends on more than is told here."""

LEVEL_DN, LEVEL_SHARE = 0.1, 0.05
"""To what a level is predicted: black and light of the nominal rig, beside what hides in it."""

FILMED = 3
"""Frames of a video for each that was kept, at first; one is tried, too."""

FILMS_KEPT = 4
"""Of frames before a codec, each of one noise: qualities are tried with the same ones; some tens of megabytes each."""

WINDOW_PX = (480, 640)
"""Part of the frame, where it is brightest, by which the codec is chosen."""

LEVELS = (8.0 / 255.0, 40.0 / 255.0)
"""Borders of the groups of level in which scatter is compared, over that of a full pixel."""


def codec_of(
    shooting: Shooting,
    picture: Array,
    before: Sequence[Callable[[], Array]],
    held: Array,
    scatter: tuple[Array, Array],
    rng: np.random.Generator,
    known: Codec | None = None,
) -> Likely:
    """Return the codecs through which noise comes as it came in the replicates, with the scale of that noise.

    Parameters
    ----------
    shooting : Shooting
        Its scale is what is believed.
    picture : ndarray (real rows, real cols)
        Predicted mean frame of the replicates [DN], by noise of the scale ``shooting.modelled``.
    before : sequence of callable
        Those of the states that were filmed before them, each made when it is asked for and cut at once: what a video
        made of them it hands on.
    held, scatter
        Binned replicates, and scatter of their pixels: :class:`evanesce.prediction.observe.Observation`.
    rng : numpy.random.Generator
    known : Codec, optional
        Of which the frames themselves tell: the scale alone is sought.
    """
    side = BIN_PX * shooting.factor
    part = _brightest(shooting.binned(picture), tuple(n // side for n in WINDOW_PX))
    real = tuple(slice(s.start * side, s.stop * side) for s in part)
    borders = shooting.tone(1.0).full_DN * np.array(LEVELS)
    seen, seen_sd = _traits(held[(slice(None), *part)], (scatter[0][part], scatter[1][part]), borders)
    states = [np.array(state()[real], np.float32) for state in before]
    seed = int(rng.integers(2**32))
    tried: dict[tuple[Codec, float], float] = {}

    @functools.lru_cache(FILMS_KEPT)
    def film(scale: float, kind: Kind, filmed: int) -> list[Array]:
        """Return the frames before a codec: the same noise for each."""
        taking, noise = replace(shooting, scale=scale), np.random.default_rng(seed)
        found = []
        for state in [*(states if kind == "h264" else ()), *[picture[real]] * len(held)]:
            # Each frame of the replicates has a light of its own.
            frames = taking.frames(taking.signal(state), noise)
            found += [next(frames) for _ in range(filmed)]
        return found

    def unlike(codec: Codec, scale: float) -> float:
        back = list(codec.through(iter(film(scale, codec.kind, codec.filmed))))[-len(held) :]
        found, sd = _traits(np.array([shooting.binned(b) for b in back]), pixel_scatter(back, shooting.factor), borders)
        off = float(np.nansum(((seen - found) / np.hypot(sd, seen_sd)) ** 2))
        return off + float(np.log(scale / shooting.scale) / SCALE_UNKNOWN) ** 2

    def attempt(pairs: Iterable[tuple[Codec, float]]) -> None:
        new = [pair for pair in dict.fromkeys(pairs) if pair not in tried]
        tried.update(zip(new, one_by_one(lambda k: unlike(*new[k]), len(new)), strict=True))

    def refine(maker: str, rounds: Sequence[tuple[int, float]] = REFINED) -> tuple[Codec, float]:
        own = [pair for pair in tried if pair[0].maker == maker]
        for steps, times in rounds:
            # How much noise came in and how much was kept back take each other's place.
            best, scale = min(own, key=lambda t: tried[t])
            around = itertools.product((1.0 / times, 1.0, times), (0,) if known else (-steps, 0, steps))
            attempt((best.worse(step), scale * factor) for factor, step in around)
            own = [pair for pair in tried if pair[0].maker == maker]
        return min(own, key=lambda t: tried[t])

    first = [Codec(kind, q, FILMED if kind == "h264" else 1) for kind, own in QUALITIES.items() for q in own]
    every = NOISE_FACTORS if known else (1.0,)
    pairs = [(known or c, f) for c in first for f in (NOISE_FACTORS if c.kind == "h264" else every)]
    attempt((codec, shooting.scale * factor) for codec, factor in pairs)
    traits = int(np.isfinite(seen).sum())
    for maker in {pair[0].maker: pair[0] for pair in tried}:
        refine(maker)
    if STEADY in _likely(tried, traits).makers:  # or another video's encoder may have made them, as well as a JPEG's
        best, scale = refine(STEADY)
        attempt([(replace(best, filmed=1), scale)])
        for one in ENCODERS[1:]:
            attempt((replace(best, encoder=one).worse(step), scale) for step in OTHERS)
            refine(one, REFINED[-1:])
    return _likely(tried, traits)


def _likely(tried: Mapping[tuple[Codec, float], float], traits: int) -> Likely:
    """Return what was tried by its probability, from sums of squared deviations of so many traits.

    Of one encoder (JPEG's, too), traits tell quality and noise. Which encoder it was they hardly tell: the one that
    filmed is like none of those tried, and all its traits are off together, so that they count as one.
    """
    every = {codec.maker: min(off for (c, _), off in tried.items() if c.maker == codec.maker) for codec, _ in tried}
    least = min(every.values())
    wide = max(least / traits, 1.0)
    shares = {name: float(np.exp(0.5 * (least - off) / (wide * traits))) for name, off in every.items()}
    weights: dict[tuple[Codec, float], float] = {}
    for name, share in shares.items():
        own = {pair: off for pair, off in tried.items() if pair[0].maker == name}
        alike = {pair: float(np.exp(0.5 * (every[name] - off) / wide)) for pair, off in own.items()}
        weights |= {pair: share * weight / sum(alike.values()) for pair, weight in alike.items()}
    largest = max(weights.values())
    kept = sorted((p for p, weight in weights.items() if weight > LEAST_LIKELY * largest), key=lambda p: -weights[p])
    # The one that is told is the most alike, even where others share what is as probable.
    kept.insert(0, kept.pop(kept.index(min(kept, key=lambda p: tried[p]))))
    total = sum(weights[pair] for pair in kept)
    return Likely(
        tuple(codec for codec, _ in kept), tuple(scale for _, scale in kept), tuple(weights[p] / total for p in kept)
    )


def _brightest(level: Array, most: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the brightest part (of some rows and cols at most) of binned levels."""
    rows, cols = (min(n, m) for n, m in zip(level.shape, most, strict=True))
    sums = ndimage.uniform_filter(level, (rows, cols), mode="constant")
    row, col = np.unravel_index(int(np.argmax(sums)), level.shape)
    top = int(np.clip(row - rows // 2, 0, level.shape[0] - rows))
    left = int(np.clip(col - cols // 2, 0, level.shape[1] - cols))
    return slice(top, top + rows), slice(left, left + cols)


def _traits(frames: Array, scatter: tuple[Array, Array], borders: Array) -> tuple[Array, Array]:
    """Return what tells codecs apart, and its standard deviation.

    By level: log scatter of pixels and of bins, how like that of the next frame is, the share that is the same in it,
    and the level itself, which noise raises and codecs lower where black is cut off; NaN where there is no such level.
    """
    level, variance = scatter
    left = frames - frames.mean(axis=0)
    bins = (left**2).sum(axis=0) / (len(frames) - 1)
    next_to = (left[1:] * left[:-1]).sum(axis=0) / (len(frames) - 1)
    group = np.digitize(level, borders)
    still = (frames[1:] == frames[:-1]).mean(axis=0)
    found: list[float] = []
    sd: list[float] = []
    for k in range(len(borders) + 1):
        mine = group == k
        if mine.sum() < 20:
            found, sd = [*found, *[np.nan] * 5], [*sd, *[1.0] * 5]
            continue
        pixel, whole, light = (float(one[mine].mean()) for one in (variance, bins, level))
        found += [np.log(pixel + 0.02), np.log(whole + 0.002), float(next_to[mine].mean()) / (whole + 0.002)]
        found += [float(still[mine].mean()), light]
        sd += [float(np.hypot(LEAST_TRAIT_SD, BIN_TRAIT_SD / np.sqrt(mine.sum())))] * 4
        sd += [float(np.hypot(LEVEL_DN, LEVEL_SHARE * light))]
    return np.array(found), np.array(sd)
