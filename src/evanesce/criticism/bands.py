"""The bands of a rippling light in frames read row by row: their frequency and phase, from what a model leaves.

Rows tell the frequency to some hertz, frames that are minutes apart tell it to millihertz; other frequencies that agree
at all frames' times do as well. Nothing but the data can say which, so they choose and the choice is paid for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.criticism.problem import Fit, Problem
from evanesce.prediction.candidates import Candidate
from evanesce.prediction.views import BIN_PX

Array = NDArray[Any]

RANGE_HZ = (40.0, 440.0)
"""Of frequencies that are tried: one period over a frame's rows to ten; wider bands are slopes, narrower ones bins."""

FINER = 4
"""Trial frequencies for each that rows, and that the whole time, tell apart."""

LEAST_SHARE = 0.02
"""Of a ripple that an exposure must leave: a light that is averaged out cannot be seen, whatever it does."""

MOVING = 0.3
"""Least share of the bands' power that moves from frame to frame: with less they are a pattern that stands."""


@dataclass(frozen=True)
class FoundBands:
    """A ripple.

    Attributes
    ----------
    frequency_hz : float
    phase_deg : float
        Of the crest at time 0.
    amplitude : float
        Of the rows' light over its mean.
    penalty : float
        What the choice of frequency and phase costs [nats].
    """

    frequency_hz: float
    phase_deg: float
    amplitude: float
    penalty: float


def with_bands(problem: Problem, base: Fit, candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Return the candidates; those that modulate rows have frequency and phase from what a fitted model leaves.

    What the believed rig has already is not looked for anew. Phase and frequency are handed to the predictor.
    """
    believed = problem.predictor.scene.effects
    return tuple(
        _banded(problem, base, c) if c.effect.bands and not c.missing and c.id not in believed else c
        for c in candidates
    )


def _banded(problem: Problem, base: Fit, candidate: Candidate) -> Candidate:
    bands, scene = candidate.effect.bands, problem.predictor.scene
    assert bands is not None
    names = [p.name for p in base.parameters]
    single = [k for k, view in enumerate(problem.kinds) if view.touches and view.frames == 1]
    if "@light" not in names or not single:
        return replace(candidate, unseen="no single frame that LEDs light")
    exposure_s = scene.camera.exposure_ms * 1e-3
    defaults = candidate.effect.parameters()
    found = brightest_bands(
        problem.unwhitened(base.residual)[single],
        problem.unwhitened(base.rows[names.index("@light")])[single],
        np.array([problem.kinds[k].time_s for k in single]),
        row_times(problem.data.shape[1], scene.camera.resolution_px[1], getattr(defaults, bands.readout) * 1e-3),
        lambda frequency_hz: abs(bands.share(frequency_hz, exposure_s)) > LEAST_SHARE,
    )
    if found is None:
        return replace(candidate, unseen="no bands stand out")
    share = bands.share(found.frequency_hz, exposure_s)
    phase = found.phase_deg if share > 0 else found.phase_deg + 180.0
    problem.predictor.fixed[candidate.id] = {
        bands.frequency: found.frequency_hz,
        bands.phase: (phase + 180.0) % 360.0 - 180.0,
    }
    own = next(p for p in candidate.parameters if p.name == f"{candidate.id}:{bands.amount}")
    start = {own.name: float(np.clip(found.amplitude / abs(share), *own.bounds))}
    return replace(candidate, parameters=(own,), starts=(start,), penalty=found.penalty)


def row_times(bins: int, rows: int, readout_s: float) -> Array:
    """Return when the middle row of each bin is exposed, after the frame's middle one [s]."""
    middle = np.arange(bins) * BIN_PX + (BIN_PX - 1) / 2
    return np.asarray((middle - (rows - 1) / 2) / rows * readout_s)


def brightest_bands(
    residual: Array, light: Array, times_s: Array, late_s: Array, possible: Callable[[float], bool] = lambda f: True
) -> FoundBands | None:
    """Return the ripple that explains most, None where that is not worth its choice.

    Parameters
    ----------
    residual, light : ndarray (frames, rows, cols)
        Whitened; the second is what a rise of all light changes, per unit of its logarithm.
    times_s : ndarray (frames,)
    late_s : ndarray (rows,)
        When a row is exposed, after its frame's time.
    possible : callable
        Whether a ripple of a frequency [Hz] could be seen at all.
    """
    product, weight = (np.einsum("vrc,vrc->vr", a, light, dtype=float) for a in (residual, light))
    # Rows that are brighter in all frames alike are no ripple's, or of one whose rate nobody could tell from that.
    product = product - weight * (product.sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-300))
    readout, span = float(np.ptp(late_s)), float(np.ptp(times_s))
    coarse = np.arange(RANGE_HZ[0], RANGE_HZ[1], 1.0 / (FINER * readout))
    # No finer than a frame's rows tell where there is no other frame.
    step = 1.0 / (FINER * max(span, readout))
    offsets = np.arange(0.0, coarse[1] - coarse[0], step)

    def along(tried: Array, sums: Array, size: Array) -> tuple[Array, Array]:
        """Return complex sums over all frames, and how large what moves from frame to frame can make them."""
        turn = np.exp(-2j * np.pi * np.outer(tried, times_s))
        moving = size.sum() - np.abs(turn @ size) ** 2 / max(float(size.sum()), 1e-300)
        return turn @ sums, np.where(moving > MOVING * size.sum(), moving, np.inf)

    best, at = 0.0, 0.0
    for start in coarse:
        tried = start + offsets
        sums, moving = along(tried, *_sums(product, weight, late_s, start + 0.5 * offsets[-1]))
        squares = 2.0 * np.abs(sums) ** 2 / moving
        k = int(np.argmax(squares))
        if squares[k] > best and possible(float(tried[k])):
            best, at = float(squares[k]), float(tried[k])
    (whole,), (size,) = along(np.array([at]), *_sums(product, weight, late_s, at))
    square = float(2.0 * abs(whole) ** 2 / size)
    # One frequency among those that can be told apart, and a phase that may as well have been another one.
    number = (RANGE_HZ[1] - RANGE_HZ[0]) * max(span, readout)
    penalty = float(np.log(number) + 0.5 * np.log1p(square))
    if 0.5 * square <= penalty:
        return None
    # The sums hold exp(-i phase) of a crest: cos(2 pi f t + phase) has the sum's own angle.
    return FoundBands(at, float(np.degrees(np.angle(whole))), float(2.0 * abs(whole) / size), penalty)


def _sums(product: Array, weight: Array, late_s: Array, frequency_hz: float) -> tuple[Array, Array]:
    """Return each frame's complex sum (frames,) and twice what noise makes of its square, its mean light taken off."""
    wave = np.exp(-2j * np.pi * frequency_hz * late_s)
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    about = wave - (weight @ wave)[:, None] / total
    return (product * about).sum(axis=1), (weight * np.abs(about) ** 2).sum(axis=1)
