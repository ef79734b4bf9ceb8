"""Label-complete 2000 x 1500 frames per second, bytes a frame, scaling over workers, and where a frame's time goes.

python benchmarks/dataset.py [--frames 160] [--workers 1 2] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from evanesce.core import provenance
from evanesce.dataset import layout
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.encode import exr, png
from evanesce.dataset.job import Job, new_job
from evanesce.dataset.labels import plate_labels
from evanesce.dataset.manifest import Manifest
from evanesce.dataset.produce import Producer
from evanesce.dataset.run import Engine, make
from evanesce.dataset.shard import ShardWriter
from evanesce.dataset.verify import verify
from evanesce.dataset.worker import single_threaded
from evanesce.rig import load_scene


def job(frames: int, probability: float) -> Job:
    """Return slides of the thesis's rig; one rig, so that its light fields are computed once."""
    config = DatasetConfig.model_validate(
        {
            "trial": {"frames": 40},
            "trials_per_shard": 1,
            "kinds": {name: 0.0 for name in ("load_stop", "wiggle", "rotation", "ramp", "release", "change")},
            "rig": {"count": 1, "draw": {}},
            "randomisation": {"probability": probability},
        }
    )
    return new_job(load_scene("thesis"), config, frames=frames, seed=5)


def profile(frames: int = 12) -> dict[str, float]:
    """Return processor seconds of each part of a frame, the least of several [s]."""
    single_threaded()
    producer = Producer(job(80, 0.0))
    producer.record(20)
    current = producer.trial(0)
    spent: dict[str, float] = {}

    def timed(name: str, action: Callable[[], Any]) -> Any:
        start = time.process_time()
        found = action()
        spent[name] = min(spent.get(name, 1e9), time.process_time() - start)
        return found

    for i in range(20, 20 + frames):
        truth = timed("contact state", lambda i=i: current.trial.truth(i))
        frame = timed(
            "camera", lambda i=i, t=truth: current.ready.camera.frame(t.state, index=i, time_s=0.1, with_raw=False)
        )
        seen = timed("labels", lambda t=truth: current.ready.labeller.labels(t, 0.5))
        flat = timed("plate labels", lambda t=truth: plate_labels(t, current.ready.grid, 0.5))
        timed("PNG", lambda f=frame: png(f.data))
        timed("mask PNG", lambda s=seen: png(s.whole("state").astype("uint8")))
        timed("EXR", lambda s=seen: exr(s, "half", {}))
        timed("plate EXR", lambda s=flat: exr(s, "half", {}))
    return spent


def storing(frames: int = 40) -> dict[str, float]:
    """Return seconds a frame of what comes after the encoding, the least of three shards [s].

    Processor time of tar and SHA-256 (of members and of the shard), wall-clock time of making the file last, and of the
    rows in the manifest.
    """
    kept = [Producer(job(80, 0.0)).record(20)]
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        layout.make_folders(folder)
        manifest = Manifest.create(folder / "m.sqlite", {})
        for shard in range(3):
            with ShardWriter(folder, shard) as writer:
                start = time.process_time()
                for k in range(frames):
                    writer.add(replace(kept[0], frame=shard * frames + k))
                found["tar, SHA-256"] = min(found.get("tar, SHA-256", 1e9), time.process_time() - start)
                start = time.perf_counter()
                index = writer.publish()
                found["fsync, rename"] = min(found.get("fsync, rename", 1e9), time.perf_counter() - start)
            start = time.perf_counter()
            manifest.add(index)
            found["manifest"] = min(found.get("manifest", 1e9), time.perf_counter() - start)
        manifest.close()
    return {name: seconds / frames for name, seconds in found.items()}


def spent_cores() -> float:
    """Return processor seconds of this process and of those that it has waited for."""
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(use.ru_utime + use.ru_stime for use in both)


def throughput(frames: int, workers: int) -> dict[str, float]:
    """Make a dataset; return frames per second with and without the start, processor time and bytes a frame."""
    with tempfile.TemporaryDirectory() as scratch:
        folder, ticks = Path(scratch) / "d", []
        before = spent_cores()
        outcome = make(
            folder,
            job(frames, 0.0),
            Engine(workers=workers),
            lambda r: ticks.append((time.perf_counter(), r["frames"])),
        )
        cores = spent_cores() - before
        # From the first round of shards on: start of processes and light fields are behind.
        steady = ticks[workers:]
        rate = sum(n for _, n in steady[1:]) / (steady[-1][0] - steady[0][0]) if len(steady) > 1 else float("nan")
        report = verify(folder)
    return {
        "frames_per_s": outcome.made / outcome.seconds,
        "steady_frames_per_s": rate,
        "processor_s_per_frame": cores / outcome.made,
        "bytes_per_frame": outcome.size / outcome.frames,
        "verify_MB_per_s": report.size / report.seconds / 1e6,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=320)
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    parts = profile()
    for name, seconds in parts.items():
        print(f"{name:14s} {1e3 * seconds:7.1f} ms")
    making = sum(parts[n] for n in ("contact state", "camera", "labels", "plate labels"))
    writing = sum(parts.values()) - making
    print(f"making {1e3 * making:.0f} ms, writing {1e3 * writing:.0f} ms of a core; load {os.getloadavg()[0]:.1f}")
    stored = storing()
    for name, seconds in stored.items():
        print(f"{name:14s} {1e3 * seconds:7.2f} ms a frame; load {os.getloadavg()[0]:.1f}")
    rates = {}
    for workers in given.workers:
        rates[workers] = throughput(given.frames, workers)
        print(
            workers, {k: round(v, 2) for k, v in rates[workers].items()}, f"load {os.getloadavg()[0]:.1f}", flush=True
        )
    if given.json:
        result = {"profile_s": parts, "storing_s": stored, "rates": rates, "provenance": dict(provenance.record())}
        given.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
