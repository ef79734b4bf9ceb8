"""Estimate disk space and time of a dataset before it is made."""

from __future__ import annotations

import math
import shutil
from dataclasses import dataclass
from pathlib import Path

from evanesce.core.errors import InputError
from evanesce.dataset.config import CHANNELS, MAPS
from evanesce.dataset.design import finger_plan, rig_plan
from evanesce.dataset.job import Job
from evanesce.dataset.rigs import rig_scene, rig_with_effects

PNG_BYTES_PER_PX = 0.42
"""Of a noisy 8-bit frame; 0.32 measured, 0.41 with effects that raise the background."""
RAW_BYTES_PER_PX = 1.6
LABEL_BYTES_PER_PX = 4.0
"""Of the labels' box, all channels at half precision; 3.4 measured in the frame."""
OTHER_BYTES = 8_000
"""Mask, JSON, headers, tar padding, manifest."""
CORE_SECONDS_PER_MPX = 0.09
"""Of one core and frame, with the fast camera."""
SCATTERED = 3.0
"""Relative time of a rig with subsurface scattering, which the fast camera takes from the general chain."""
SAMPLED_RIGS = 16
"""Number of rigs whose effects are considered."""
CORE_SECONDS_PER_FRAME = 0.02
RIG_SECONDS = 12.0
"""To compute the light fields of a rig, once in each process that uses it."""


@dataclass(frozen=True)
class Estimate:
    """Disk space and time of a dataset.

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
    """Return the disk space and time of a job by its resolution and count; nothing is simulated."""
    cols, rows = job.resolution
    labels = job.config.labels
    radius, margin = 3.5, labels.margin_mm
    box_mm2 = (2.0 * (radius + margin)) ** 2
    scale = job.scene.camera.scale_px_per_mm * job.config.camera.scale
    pitch = labels.grid_size_mm / labels.grid_samples
    depth = 1.0 if labels.precision == "half" else 2.2
    frame = cols * rows * (PNG_BYTES_PER_PX + (RAW_BYTES_PER_PX if labels.raw else 0.0)) + OTHER_BYTES
    shares = [len(labels.channels(key)) / len(CHANNELS) for key in MAPS]
    samples = shares[0] * min(scale**2, cols * rows / box_mm2) + shares[1] * pitch**-2
    frame += box_mm2 * samples * LABEL_BYTES_PER_PX * depth
    core = CORE_SECONDS_PER_FRAME + CORE_SECONDS_PER_MPX * (cols * rows / 1e6 + labels.grid_samples**2 / 1e6)
    rigs = min(job.config.rig.count, math.ceil(job.trials / job.config.rig.trials_in_a_row))
    seconds = job.frames * core * _slower(job) / max(workers, 1) + rigs * RIG_SECONDS
    return Estimate(int(job.frames * frame), int(frame), seconds)


def _slower(job: Job) -> float:
    """Return the time of a frame over that of the fast camera, by the effects of the first rigs."""
    finger = finger_plan(job.config, job.seed, 0)
    plans = [rig_plan(job.config, job.seed, i) for i in range(min(job.config.rig.count, SAMPLED_RIGS))]
    rigs = [rig_with_effects(rig_scene(job.scene, plan, finger, job.config), plan.seed) for plan in plans]
    return sum(SCATTERED if rig.scene.finger.scattering_length_mm > 0.0 else 1.0 for rig in rigs) / len(rigs)


def require_disk(folder: Path, need: int) -> int:
    """Return the free bytes of the disk of a dataset.

    Raises
    ------
    InputError
        If they are fewer than needed.
    """
    existing = folder
    while not existing.exists():
        existing = existing.parent
    free = shutil.disk_usage(existing).free
    if free < need:
        raise InputError(
            f"about {need / 1e9:.3g} GB are needed, {free / 1e9:.3g} GB are free", file=folder, key="--out",
            allowed="a larger disk, fewer frames, or a smaller camera.scale",
        )  # fmt: skip
    return free
