"""From a measurement bundle to what the critic compares: views, their binned images, and frames of held states."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, ndimage

from evanesce.bundle.bundle import Bundle
from evanesce.bundle.layout import Series, Shot
from evanesce.core.errors import InputError
from evanesce.prediction.codec_traces import codec_traces
from evanesce.prediction.colour import grey_of, luma_of
from evanesce.prediction.jpeg_steps import jpeg_quality
from evanesce.prediction.views import BIN_PX, View, binned
from evanesce.rig import Scene

Array = NDArray[Any]

MODEL_COLS, WIDER = 400, 0.25
"""Frames that are wider than this, and by more than this share of it, are averaged down before anything else [px]."""

GRID_SAMPLES = 512
"""Of the contact grid of a smooth finger: 1/32 mm, an edge's share of a cell is kept exactly."""

LOCKED_EVERY = 4
"""One in so many conditions is locked."""

MOST_FIELDS = 8
"""Fields of pixel noise that are kept."""

AROUND_PX = 6.0
"""Scatter of a pixel is that of so many about it."""

DWELL_FRAMES = 3
"""A condition with so many frames is a dwell: all that tells of time, so it stays open."""


@dataclass(frozen=True, kw_only=True)
class Observation:
    """What was measured, at the critic's resolution.

    Attributes
    ----------
    believed : Scene
        As the bundle states it.
    scene : Scene
        The same rig seen by the model camera.
    views : tuple of View
    images : ndarray of float32 (views, rows, cols)
        Mean frames [DN].
    held : mapping of str to ndarray (frames, bin rows, bin cols)
        Binned frames of states that were held still, by kind: their differences are noise [DN].
    scatter : mapping of str to tuple of ndarray (bin rows, bin cols)
        Of the same states, level [DN] and variance of single real pixels [DN^2] in bins.
    pixel_noise : ndarray of float32 (fields, rows, cols), optional
        Noise of single pixels as replicates show it, of unit variance.
    jpeg : int, optional
        Quality of the JPEG whose steps the replicates keep; None where they keep none.
    coded : bool
        Whether a codec may have been at work: the replicates show traces of one, or too little to tell.
    series : mapping of str to Series
    available : frozenset of str
        Observables, in the words of :data:`evanesce.effects.OBSERVABLES`.
    """

    believed: Scene
    scene: Scene
    views: tuple[View, ...]
    images: Array
    held: Mapping[str, Array] = field(default_factory=dict)
    scatter: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    pixel_noise: Array | None = None
    jpeg: int | None = None
    coded: bool = True
    series: Mapping[str, Series] = field(default_factory=dict)
    available: frozenset[str] = frozenset()

    @property
    def cube(self) -> Array:
        """Binned means (views, bin rows, bin cols) [DN]."""
        return binned(self.images)

    @property
    def open(self) -> NDArray[np.int_]:
        """Numbers of the views that fits and choices may use."""
        return np.flatnonzero([not view.locked for view in self.views])

    @property
    def locked(self) -> NDArray[np.int_]:
        """Numbers of the views that are kept for the gain."""
        return np.flatnonzero([view.locked for view in self.views])


JPEG_FRAMES = 4
"""By which the quality of a JPEG is judged."""


def model_factor(scene: Scene) -> int:
    """Return by how much frames are averaged down, per side."""
    return max(1, math.ceil(scene.camera.resolution_px[0] / MODEL_COLS - WIDER))


def model_scene(scene: Scene, *, finer: int = 1) -> Scene:
    """Return the rig as the critic computes it: fewer, larger pixels, and no finer a contact grid than they need.

    Parameters
    ----------
    scene : Scene
        The believed rig.
    finer : int
        As many times finer in pixels and contact grid: to find what the resolution costs.
    """
    factor = model_factor(scene) / finer
    camera, pixel = scene.camera, scene.camera.pixel
    (cols, rows), (px, py) = camera.resolution_px, camera.principal_point_offset_px
    larger = pixel.model_copy(
        update={
            "pitch_um": pixel.pitch_um * factor,
            "full_well_capacity_e": pixel.full_well_capacity_e * factor**2,
            "conversion_gain_e_per_DN": pixel.conversion_gain_e_per_DN * factor**2,
            "read_noise_e": pixel.read_noise_e * factor,
            "dark_current_e_per_s": pixel.dark_current_e_per_s * factor**2,
            "dark_nonuniformity_e_per_s": pixel.dark_nonuniformity_e_per_s * factor,
        }
    )
    coarse = camera.model_copy(
        update={
            "resolution_px": (int(cols / factor), int(rows / factor)),
            "scale_px_per_mm": camera.scale_px_per_mm / factor,
            "principal_point_offset_px": (px / factor, py / factor),
            "pixel": larger,
        }
    )
    samples = scene.grid.samples
    if scene.finger.ridges is None:
        samples = min(samples, GRID_SAMPLES * finer)
    grid = scene.grid.model_copy(update={"samples": samples})
    return scene.model_copy(update={"camera": coarse, "grid": grid})


def observe(bundle: Bundle) -> Observation:
    """Return what a bundle holds, split into open and locked by condition before anything is fitted.

    Raises
    ------
    InputError
        If the bundle holds no frame.
    """
    factor = model_factor(bundle.scene)
    views: list[View] = []
    images: list[Array] = []
    held: dict[str, Array] = {}
    locked = locked_conditions(bundle.press)
    for shot in bundle.press:
        views.append(_press_view(shot, locked=shot.condition in locked))
        images.append(binned(grey_of(bundle.frame(shot)), factor))
    scatter: dict[str, tuple[Array, Array]] = {}
    pixel_noise: Array | None = None
    raw = list(bundle.replicate_frames)
    luma = [luma_of(frame) for frame in raw]
    jpeg, traces = jpeg_quality(luma[:JPEG_FRAMES]), codec_traces(luma)
    replicates = [binned(grey_of(frame), factor) for frame in raw]
    if len(replicates) > 1:
        held["replicate"] = binned(np.array(replicates))
        scatter["replicate"] = pixel_scatter(raw, factor)
        pixel_noise = noise_fields(np.array(replicates, np.float32))
    if replicates and bundle.replicates.shots:
        first = bundle.replicates.shots[0]
        whole = replace(_press_view(first, locked=False), kind="replicate", frames=len(replicates))
        force, time = (float(np.mean([getattr(s, n) for s in bundle.replicates.shots])) for n in ("force_N", "time_s"))
        views.append(replace(whole, force_N=force, time_s=time))
        images.append(np.mean(replicates, axis=0))
    for kind in ("led_off", "lens_cap", "checkerboard", "square"):
        raw = list(bundle.frames(kind))
        frames = [binned(grey_of(frame), factor) for frame in raw]
        if not frames:
            continue
        if len(frames) > 1:
            held[kind] = binned(np.array(frames))
            scatter[kind] = pixel_scatter(raw, factor)
        views.append(View(kind=kind, frames=len(frames)))
        images.append(np.mean(frames, axis=0))
    if not views:
        raise InputError("holds no frame to compare", file=bundle.path, allowed="press frames or auxiliary shots")
    return Observation(
        believed=bundle.scene,
        scene=model_scene(bundle.scene),
        views=tuple(views),
        images=np.array(images, np.float32),
        held=held,
        scatter=scatter,
        pixel_noise=pixel_noise,
        jpeg=jpeg,
        coded=jpeg is not None or traces is None or traces.found,
        series=dict(bundle.series),
        available=bundle.available,
    )


def pixel_scatter(frames: Sequence[Array], factor: int) -> tuple[Array, Array]:
    """Return level [DN] and variance [DN^2] of single pixels over frames of one state, both in bins."""
    total, square = np.zeros(frames[0].shape[:2]), np.zeros(frames[0].shape[:2])
    for frame in map(grey_of, frames):
        total += frame
        square += np.square(frame, dtype=float)
    mean = total / len(frames)
    variance = (square - len(frames) * mean**2) / (len(frames) - 1)
    return binned(mean, BIN_PX * factor), binned(variance, BIN_PX * factor)


def noise_fields(frames: Array) -> Array:
    """Return independent fields (frames - 1, rows, cols) of noise of unit variance from frames of one state.

    Contrasts of the frames, each pixel over the scatter about it; at most :data:`MOST_FIELDS`.

    Parameters
    ----------
    frames : ndarray (frames, rows, cols)
    """
    contrasts = np.tensordot(linalg.helmert(len(frames)), frames, 1)[:MOST_FIELDS]
    variance = ndimage.gaussian_filter((contrasts**2).mean(axis=0), AROUND_PX)
    return np.asarray(contrasts / np.sqrt(np.maximum(variance, 1.0 / 12.0)), np.float32)


def _press_view(shot: Shot, *, locked: bool) -> View:
    return View(
        kind="press",
        force_N=shot.force_N,
        voltage_V=shot.voltage_V,
        time_s=shot.time_s,
        index=shot.index,
        session=shot.session,
        condition=shot.condition,
        displacement_mm=shot.displacement_mm,
        locked=locked,
    )


def locked_conditions(shots: Sequence[Shot]) -> frozenset[int]:
    """Return the conditions to lock: one in four, spread over force and voltage, none that an answer would hang on.

    Dwells stay open because only they tell of time; the least and the largest force and voltage stay open, so that the
    locked part asks for what lies between.
    """
    by_condition: dict[int, list[Shot]] = {}
    for shot in shots:
        by_condition.setdefault(shot.condition, []).append(shot)
    forces = [s.force_N for s in shots]
    voltages = [s.voltage_V for s in shots]
    inner = []
    for condition, members in by_condition.items():
        first = members[0]
        extreme = (len(set(forces)) > 1 and first.force_N in (min(forces), max(forces))) or (
            len(set(voltages)) > 1 and first.voltage_V in (min(voltages), max(voltages))
        )
        if len(members) < DWELL_FRAMES and not extreme:
            inner.append((first.session, first.force_N, first.voltage_V, condition))
    inner.sort()
    count = min(round(len(by_condition) / LOCKED_EVERY), len(inner) // 2)
    if count < 1:
        return frozenset()
    chosen = np.unique(np.round((np.arange(count) + 0.5) * len(inner) / count - 0.5).astype(int))
    return frozenset(inner[i][3] for i in chosen)
