"""How much disk and time a dataset will take, before it is begun."""

from __future__ import annotations

import math
import shutil
from dataclasses import dataclass
from pathlib import Path

from evanesce.core.errors import InputError
from evanesce.dataset.design import finger_plan, rig_plan
from evanesce.dataset.job import Job
from evanesce.dataset.rigs import real_rig, rig_scene, way_of

PNG_BYTES_PER_PX = 0.35
"""Of a noisy 8-bit frame; 0.27 measured, more where effects lift the dark."""
RAW_BYTES_PER_PX = 1.6
LABEL_BYTES_PER_PX = 4.0
"""Of the labels' box, all channels at half precision; 3.4 measured in the frame."""
OTHER_BYTES = 12_000
"""JSON, headers, tar padding, manifest."""
CORE_SECONDS_PER_MPX = 0.09
"""Of one core and frame, with the fast camera."""
TIMES = {"fast": 1.0, "charge": 2.0, "general": 10.0}
"""How much longer the ways of :class:`~evanesce.dataset.rigs.RigCamera` take: upper guesses."""
LOOKED_AT = 16
"""Rigs whose effects are looked at."""
CORE_SECONDS_PER_FRAME = 0.05
RIG_SECONDS = 12.0
"""To compute the light fields of a rig, once in each process that meets it."""


@dataclass(frozen=True)
class Estimate:
    """Of a whole dataset.

    Attributes
    ----------
    size : int
        [bytes].
    frame_size : int
        [bytes].
    seconds : float
        With the given processes.
    """

    size: int
    frame_size: int
    seconds: float


def estimate(job: Job, workers: int) -> Estimate:
    """Return what a job will take; a guess by the areas, not by a try."""
    cols, rows = job.resolution
    labels = job.config.labels
    radius, margin = 3.5, labels.margin_mm
    box_mm2 = (2.0 * (radius + margin)) ** 2
    scale = job.scene.camera.scale_px_per_mm * job.config.camera.scale
    pitch = labels.grid_size_mm / labels.grid_samples
    depth = 1.0 if labels.precision == "half" else 2.2
    frame = cols * rows * (PNG_BYTES_PER_PX + (RAW_BYTES_PER_PX if labels.raw else 0.0)) + OTHER_BYTES
    frame += box_mm2 * (min(scale**2, cols * rows / box_mm2) + pitch**-2) * LABEL_BYTES_PER_PX * depth
    core = CORE_SECONDS_PER_FRAME + CORE_SECONDS_PER_MPX * (cols * rows / 1e6 + labels.grid_samples**2 / 1e6)
    rigs = min(job.config.rig.count, math.ceil(job.trials / job.config.rig.trials_in_a_row))
    seconds = job.frames * core * _slower(job) / max(workers, 1) + rigs * RIG_SECONDS
    return Estimate(int(job.frames * frame), int(frame), seconds)


def _slower(job: Job) -> float:
    """Return how much longer frames take than by the fast camera, from the effects of the first rigs."""
    finger = finger_plan(job.config, job.seed, 0)
    plans = [rig_plan(job.config, job.seed, i) for i in range(min(job.config.rig.count, LOOKED_AT))]
    rigs = [real_rig(rig_scene(job.scene, plan, finger, job.config), plan.seed) for plan in plans]
    return sum(TIMES[way_of(rig.effects)] for rig in rigs) / len(rigs)


def require_disk(folder: Path, need: int) -> int:
    """Return the free bytes where a dataset will lie.

    Raises
    ------
    InputError
        If they are fewer than needed.
    """
    place = folder
    while not place.exists():
        place = place.parent
    free = shutil.disk_usage(place).free
    if free < need:
        raise InputError(
            f"about {need / 1e9:.3g} GB are needed, {free / 1e9:.3g} GB are free", file=folder, key="--out",
            allowed="a larger disk, fewer frames, or a smaller camera.scale",
        )  # fmt: skip
    return free
