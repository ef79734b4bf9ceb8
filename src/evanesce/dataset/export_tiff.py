"""Export to TIFF stacks with scale and frame interval, as Fiji and napari read them: a file a trial."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tifffile

from evanesce.dataset.design import trial_plan
from evanesce.dataset.export import Advance
from evanesce.dataset.job import Job
from evanesce.dataset.read import Dataset
from evanesce.dataset.rigs import rig_scene
from evanesce.optics.projection import Projection

NAME = "trial-{:06d}.tif"
STATES = "trial-{:06d}-state.tif"


def px_per_mm(job: Job, trial: int) -> float:
    """Return the scale of a trial's frames on the plate, at the finger and along x [px/mm]."""
    plan = trial_plan(job.config, job.seed, trial)
    scene = rig_scene(job.scene, plan.rig, plan.finger, job.config)
    x, y = scene.finger.position_mm
    u, _ = Projection.of(scene.camera, scene.plate).to_image(np.array([x - 0.5, x + 0.5]), np.array([y, y]))
    return float(u[1] - u[0])


def write(dataset: Dataset, folder: Path, advance: Advance) -> None:
    """Write frames and surface states (0 none, 1 near, 2 stick, 3 slip) of each trial, in millimetres and seconds."""
    interval = 1.0 / dataset.job.config.trial.frame_rate_hz
    for trial, indices in dataset.trials().items():
        samples = [dataset[i] for i in indices]
        scale, frames = px_per_mm(dataset.job, trial), np.stack([sample.frame for sample in samples])
        for name, stack in ((NAME, frames), (STATES, np.stack([sample.state for sample in samples]))):
            tifffile.imwrite(
                folder / name.format(trial), stack, imagej=True, resolution=(scale, scale), compression=None,
                metadata={"axes": "TYX" if stack.ndim == 3 else "TYXS", "unit": "mm", "finterval": interval,
                          "fps": 1.0 / interval, "Labels": [sample.key for sample in samples]},
            )  # fmt: skip
        advance(len(samples))
