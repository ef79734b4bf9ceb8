"""Small, ugly datasets for the tests: a rig of 64 x 48 px, and frames made without light where only files matter."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from evanesce.dataset import worker
from evanesce.dataset.config import CHANNELS, DatasetConfig
from evanesce.dataset.encode import exr, png
from evanesce.dataset.job import Job, new_job
from evanesce.dataset.labels import LabelBox, empty_box
from evanesce.dataset.layout import frame_key
from evanesce.dataset.numbers import SCALARS
from evanesce.dataset.produce import Record
from support.rigs import small_rig


def tiny_config(**changes: object) -> DatasetConfig:
    """Return six frames a trial, one trial a shard, on a grid of 96 samples."""
    data: dict = {
        "title": "tiny",
        "trial": {"frames": 6, "frame_rate_hz": 8.0},
        "trials_per_shard": 1,
        "labels": {"grid_samples": 96, "grid_size_mm": 12.0, "frame": ("all",), "plate": ("all",)},
        "programme": {
            "normal_force_N": {"uniform": (0.4, 1.2)},
            "distance_mm": {"uniform": (1.0, 2.0)},
            "second_force_share": {"uniform": (0.5, 1.0)},
        },
        "friction": {"levels": 5},
        "finger": {
            "count": 3,
            "material": {"choice": ("silskin_0",)},
            "ridged_share": 0.5,
            "ridge_pitch_um": {"uniform": (800.0, 1200.0)},
        },
        "rig": {"count": 2, "draw": {"camera.exposure_ms": {"uniform": (0.02, 0.04)}}},
        "randomisation": {"probability": 0.0},
    }
    for section, value in changes.items():
        data[section] = {**data.get(section, {}), **value} if isinstance(value, dict) else value
    return DatasetConfig.model_validate(data)


def tiny_job(frames: int = 24, seed: int = 11, **changes: object) -> Job:
    """Return a job on :func:`rigs.small_rig`."""
    return new_job(small_rig(), tiny_config(**changes), frames=frames, seed=seed)


class PaperProducer:
    """Makes frames out of their numbers alone: real members, no physics. For tests of files."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self._pause = float(os.environ.get("PAPER_PAUSE_S", "0"))
        self._poison = {int(f) for f in os.environ.get("PAPER_POISON", "").split(",") if f}

    def record(self, frame: int) -> Record:
        if log := os.environ.get("PAPER_LOG"):
            with open(log, "a") as stream:  # one short write at the end of a file: whole, whoever else writes
                stream.write(f"{os.getpid()} {frame}\n")
        if frame in self._poison:
            os.abort()
        time.sleep(self._pause)
        trial = frame // self.job.config.trial.frames
        rng = np.random.default_rng([self.job.seed, frame])
        image = rng.integers(0, 255, (12, 17), np.uint8)
        box = LabelBox(2, 3, (12, 17), {n: rng.random((5, 7)).astype(np.float16).astype(np.float32) for n in CHANNELS})
        box.channels["state"][:] = rng.integers(0, 4, (5, 7))
        if frame % 6 == 5:
            box = empty_box((12, 17))
        meta = paper_meta(self.job, frame, trial)
        members = {
            "frame.png": png(image),
            "labels.exr": exr(box, "half", {"key": meta["key"]}),
            "plate.exr": exr(box, "half", {"key": meta["key"]}),
            "mask.png": png(box.whole("state").astype(np.uint8)),
            "json": (json.dumps(meta, sort_keys=True) + "\n").encode(),
        }
        row = {"split": meta["split"], "kind": "slide", "seed": 5, "time_s": meta["scalars"]["time_s"]}
        return Record(frame, trial, row, members)


def paper_meta(job: Job, frame: int, trial: int) -> dict:
    position = frame - trial * job.config.trial.frames
    scalars = {name: float(np.float32(0.37 * i + 0.01 * frame)) for i, name in enumerate(SCALARS)}
    return {
        "key": frame_key(frame),
        "index": frame,
        "trial": trial,
        "frame_in_trial": position,
        "kind": "slide",
        "split": "test" if trial % 3 == 2 else "train",
        "scalars": {**scalars, "time_s": position / 8.0},
        "onset_first_slip_s": None,
        "onset_gross_slip_s": 0.25,
        "finger": {"index": 1, "material": "silskin_0", "pattern": "", "ridge_pitch_um": 0.0},
        "friction": {"index": 2, "friction_coefficient": 0.7},
        "rig": {"index": 0, "seed": 5, "changes": {}, "effects": {}, "left_out": []},
        "camera": {"scale_px_per_mm": 6.0, "exposure_ms": 2.0, "analogue_gain": 1.0, "readout_ms": 0.0},
        "programme": {"normal_force_N": 1.0},
        "motion": {},
        "liquid": {},
        "markers": [],
        "seed": job.seed,
        "config_sha256": job.digest,
    }


def use_paper() -> None:
    """Let this process make paper frames."""
    worker.Producer = PaperProducer  # type: ignore[misc,assignment]
    worker.forget()


def paper_frames() -> Iterator[None]:
    """Let this process make paper frames until the end of a test: the body of a fixture."""
    real = worker.Producer
    use_paper()
    yield
    worker.Producer = real  # type: ignore[misc]
    worker.forget()


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file of a finished dataset but its locks."""
    return {
        str(p.relative_to(folder)): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and not p.name.startswith("lock")
    }
