"""Area against time, and the onset of slip, as read with a camera's time stamps, exposure and rolling shutter.

Frames are taken at ``FINE_HZ``. A longer exposure is the mean of successive frames' light; rows that are read one after
the other are rows of neighbouring frames, each at its own time. Stamps need no frames of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.chain.fast import FastCamera
from evanesce.core import rng
from evanesce.core.states import ContactState
from evanesce.evaluation.perfect_view import PerfectView
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.measurement.refined.light import tone_table
from evanesce.rig import Scene

Floats = NDArray[np.float64]

FINE_HZ = 150.0
READOUT_S = 22.75e-3
"""From the first row to the last: IMX477, mode of 2028 x 1520."""

EXPOSED_SPEED = 25.0  # [mm/s]
LEVELS = (0.05, 0.15, 0.35)
"""Thresholds that smeared frames get."""

MERGED = {"6 ms": 1, "20 ms": 3, "33 ms": 5}
"""Successive frames whose mean stands for an exposure."""

TRUE_HZ, ASSUMED_HZ = 30.0, 25.0
"""The camera is said to run at 30 Hz; the published scripts divide by 25."""

OFF_MM = 8.0
"""How far from the frame's middle row the patch lies in the two further cases of rows."""

JITTER_S = 5e-3
DROPPED = 0.05
DRAWS = 8
"""Of stamps, for each phase of the camera."""


def averaged(images: Sequence[NDArray[np.uint8]], curve: Any) -> NDArray[np.uint8]:
    """Return the frame whose light is the mean of several frames' [DN].

    Parameters
    ----------
    images : sequence of ndarray of uint8 (rows, cols)
    curve : str or sequence of float
        The tone curve, see :func:`~evanesce.measurement.refined.light.tone_table`.

    Returns
    -------
    ndarray of uint8 (rows, cols)
    """
    if len(images) == 1:
        return images[0]
    table = tone_table(curve)
    light = sum(table[image] for image in images) / len(images)
    return np.searchsorted((table[1:] + table[:-1]) / 2, light).astype(np.uint8)


def rolled(time: Floats, masks: NDArray[np.bool_], delay: Floats) -> tuple[Floats, Floats]:
    """Return pixels and mean column of a patch whose rows are read one after the other.

    Parameters
    ----------
    time : ndarray (frames,)
        [s].
    masks : ndarray of bool (frames, rows, cols)
        As seen with all rows at once.
    delay : ndarray (rows,)
        When each row is read, after the frame's stamp [s].

    Returns
    -------
    pixels, column : ndarray (frames,)
        Each row's count and first moment are taken at its own time, linearly between frames, which is exact for a
        patch that runs along its rows; NaN where nothing is found.
    """
    count = masks.sum(axis=2).astype(float)
    moment = np.stack([mask @ np.arange(masks.shape[2], dtype=float) for mask in masks])
    pixels, moments = np.zeros(len(time)), np.zeros(len(time))
    for row in np.flatnonzero(count.any(axis=0)):
        pixels += np.interp(time + delay[row], time, count[:, row])
        moments += np.interp(time + delay[row], time, moment[:, row])
    return pixels, np.divide(moments, pixels, out=np.full(len(time), np.nan), where=pixels > 0)


def film_row(
    view: PerfectView, moving: Scene, states: Sequence[ContactState], chain: Chain, half_mm: float, seed: int
) -> dict[str, Any]:
    """Return area [mm^2] and position [mm] of the patch over time, by each exposure and way of reading rows.

    Stamps are mid-exposure, and those of the frame's middle row. The first and last two frames, whose neighbours are
    missing, are left out.

    Parameters
    ----------
    view : PerfectView
    moving : Scene
    states : sequence of ContactState
        One per frame.
    chain : Chain
    half_mm : float
        Half the side of the crop [mm].
    seed : int

    Returns
    -------
    dict
        Units in the keys.
    """
    camera, crop = FastCamera(moving), view.window(half_mm)
    time = np.array([state.time for state in states])
    images = [
        crop.apply(view.straight(camera.frame(state, seed=seed, index=i, time_s=state.time).data)).copy()
        for i, state in enumerate(states)
    ]
    inner, scale = slice(2, len(images) - 2), view.mm2_per_px
    chain = replace(chain, crop=replace(crop, r0=0, r1=None, c0=0, c1=None))
    found: dict[str, Any] = {}
    masks = np.zeros((len(images), *images[0].shape), bool)
    for name, count in MERGED.items():
        half = count // 2
        for i in range(half, len(images) - half):
            masks[i] = segment(averaged(images[i - half : i + half + 1], moving.camera.tone_curve), chain).mask
        if count == 1:  # rows are read of the short exposure
            rows = view.view.shape[0]
            middle = (np.arange(masks.shape[1]) + crop.r0 - (rows - 1) / 2) / rows
            for case, off in (("rows", 0.0), ("rows, above", -OFF_MM), ("rows, below", OFF_MM)):
                delay = (middle + off / (rows * scale**0.5)) * READOUT_S
                pixels, column = rolled(time, masks, delay)
                found[case] = _kept(pixels[inner], column[inner], scale)
        still = np.zeros(masks.shape[1])
        pixels, column = rolled(time[inner], masks[inner], still)
        found[name] = _kept(pixels, column, scale)
    true = [state.nominal_contact_area for state in states][inner]
    return {"time_s": time[inner], "true_area_mm2": true, "seen": found}


def _kept(pixels: Floats, column: Floats, scale: float) -> dict[str, Any]:
    return {"area_mm2": pixels * scale, "x_mm": column * scale**0.5}


def stamped(
    time: Floats, rate: float, generator: np.random.Generator, *, jitter_s: float = 0.0, dropped: float = 0.0
) -> tuple[NDArray[np.intp], Floats]:
    """Return which frames of a camera arrive, and the times that are written on them.

    Parameters
    ----------
    time : ndarray (n,)
        True times of frames at a constant rate [s]; frames before them count from 0 s on.
    rate : float
        [Hz].
    generator : numpy.random.Generator
    jitter_s : float
        Standard deviation of a stamp [s].
    dropped : float
        Share of frames that are lost unnoticed: those that arrive are numbered on, and number over rate is the time.

    Returns
    -------
    kept : ndarray of int
        Numbers of the frames that arrive.
    time : ndarray
        Their stamps [s].
    """
    before = max(0, int(np.floor(time[0] * rate + 1e-6)))
    arrives = generator.random(before + len(time)) >= dropped
    number = np.cumsum(arrives) - 1
    stamp = time[0] - before / rate + number / rate + jitter_s * generator.normal(size=len(arrives))
    kept = np.flatnonzero(arrives[before:])
    return kept, stamp[before:][kept]


def reading_errors(
    press: Mapping[str, Any], seen: str = "6 ms", *, rate: float, clock: float, jitter_s: float = 0.0,
    dropped: float = 0.0, seed: int = 1,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return the error of the area that a film of a press gives for a time, and its rate of growth.

    Parameters
    ----------
    press : mapping
        Of :func:`film_row`, times from the press's start.
    seen : str
        Exposure or way of reading rows.
    rate, clock : float
        True and assumed frame rate [Hz].
    jitter_s, dropped : float
        See :func:`stamped`.
    seed : int

    Returns
    -------
    error : ndarray
        Area as read less that of a short exposure at the same stated time [mm^2], of every frame, phase and draw.
    growth : ndarray
        Slope of area over time by least squares, over that of all short exposures; of every phase and draw [1].
    """
    time, area = np.array(press["time_s"]), np.array(press["seen"][seen]["area_mm2"])
    right = np.array(press["seen"]["6 ms"]["area_mm2"])
    usual = np.polyfit(time, right, 1)[0]
    generator = rng.generator(seed, "time", "stamps")
    step = round(FINE_HZ / rate)
    errors, growth = [], []
    for phase in range(step):
        for _ in range(DRAWS if jitter_s or dropped else 1):
            kept, stamp = stamped(time[phase::step], rate, generator, jitter_s=jitter_s, dropped=dropped)
            stamp, some = stamp * rate / clock, area[phase::step][kept]
            # beyond the record the area is held
            errors.append(some - np.interp(stamp, time, right))
            growth.append(np.polyfit(stamp, some, 1)[0] / usual)
    return np.concatenate(errors), np.array(growth)


def broken_line(time: Floats, way: Floats) -> tuple[float, float]:
    """Return when a point at rest begins to move, and its speed then, by least squares.

    Parameters
    ----------
    time, way : ndarray (n,)
        [s], [mm].

    Returns
    -------
    onset, speed : float
        [s], [mm/s] of way = rest + speed max(0, time - onset); NaN where fewer than two frames move.
    """
    tried = np.linspace(time[0], time[-2], 20 * len(time))
    basis = np.maximum(0.0, time - tried[:, None])
    tried, basis = (some[np.count_nonzero(basis, axis=1) >= 2] for some in (tried, basis))
    basis = basis - basis.mean(axis=1, keepdims=True)
    rest = way - way.mean()
    speed = basis @ rest / (basis**2).sum(axis=1)
    misfit = ((rest - speed[:, None] * basis) ** 2).sum(axis=1)
    misfit[speed <= 0] = np.inf
    if not len(misfit) or not np.isfinite(misfit).any():
        return float("nan"), float("nan")
    best = int(np.argmin(misfit))
    return float(tried[best]), float(speed[best])


def onsets(
    row: Mapping[str, Any], rate: float, clock: float, *, jitter_s: float = 0.0, dropped: float = 0.0, seed: int = 1
) -> list[float]:
    """Return the detected onset of slip at each phase of a camera, by a clock that assumes another rate [s].

    Parameters
    ----------
    row : mapping
        Of one slide: ``time_s``, ``x_mm``, ``slide_starts_s``.
    rate, clock : float
        True and assumed frame rate [Hz]; time counts from the start of the slide.
    jitter_s, dropped : float
        See :func:`stamped`; with either, each phase is drawn ``DRAWS`` times.
    seed : int

    Returns
    -------
    list of float
        [s].
    """
    step = round(FINE_HZ / rate)
    time = np.array(row["time_s"]) - row["slide_starts_s"]
    way = np.array([np.nan if v is None else v for v in row["x_mm"]], float)
    generator = rng.generator(seed, "time", "onsets")
    found = []
    for phase in range(step):
        for _ in range(DRAWS if jitter_s or dropped else 1):
            kept, stamp = stamped(time[phase::step], rate, generator, jitter_s=jitter_s, dropped=dropped)
            seen = way[phase::step][kept]
            some = np.isfinite(seen)
            onset, _ = broken_line(stamp[some], seen[some])
            found.append(onset * rate / clock)
    return found
