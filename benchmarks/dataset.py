"""Labelled frames per second of a core, bytes a frame, against an earlier commit; workers, and what many would take.

python benchmarks/dataset.py [--against COMMIT] [--cases NAME ...] [--workers 1 2] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

BEFORE = "c9c10816"
"""The commit that the targets are stated against."""
CASES: dict[str, dict[str, Any]] = {
    "320x240, effects off": {"size": "320x240", "share": 0.0, "rigs": 3, "frames": 40, "target": 200.0},
    "320x240, effects on": {"size": "320x240", "share": 0.25, "rigs": 8, "frames": 30, "target": 80.0},
    "2000x1500, effects on": {"size": "", "share": 0.25, "rigs": 4, "frames": 10, "target": 8.0},
}
"""Size, share of rigs that an effect acts in, rigs of two trials each, frames a trial, wanted frames/s of two cores."""
DASK_TASK_S = 1e-3
"""Of the scheduler, a task: https://distributed.dask.org/en/stable/efficiency.html"""


# --- one case, in a process of its own with the sources of one commit -------------------------------------------------


def measure(case: dict[str, Any]) -> dict[str, float]:
    """Return processor time and bytes a frame, and the processor time that a rig takes once.

    Uses what this commit and :data:`BEFORE` have in common. Frames are from the middle of their trials, in contact.
    What the first frame of a rig computes for all others is the rig's, and of a trial its trial's.
    """
    from evanesce.dataset.config import DatasetConfig, with_size
    from evanesce.dataset.job import new_job
    from evanesce.dataset.produce import Producer
    from evanesce.dataset.worker import single_threaded
    from evanesce.rig import load_scene

    single_threaded()
    given = {
        "rig": {"count": case["rigs"], "trials_in_a_row": 2},
        "randomisation": {"probability": case["share"]},
    }
    config, trials, length = with_size(DatasetConfig.model_validate(given), case["size"]), 2 * case["rigs"], 80
    job = new_job(load_scene("thesis"), config, frames=trials * length, seed=7)
    producer = Producer(job)
    rigs, ready, making, size, count = 0.0, 0.0, 0.0, 0, 0
    for trial in range(trials):
        start = time.process_time()
        producer.trial(trial)
        producer.record(trial * length + 30)
        if trial % 2 == 0:
            rigs += time.process_time() - start
        else:
            ready += (time.process_time() - start) / length
        for k in range(case["frames"]):
            start = time.process_time()
            record = producer.record(trial * length + 31 + k)
            making += time.process_time() - start
            size += sum(len(data) for data in record.members.values())
            count += 1
    return {
        "s_a_frame": making / count + ready / case["rigs"],
        "bytes_a_frame": size / count,
        "s_a_rig": 2 * rigs / trials,
    }


def in_process(sources: Path, case: dict[str, Any]) -> dict[str, float]:
    """Return :func:`measure` of the sources of a commit."""
    threads = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
    call = [sys.executable, str(Path(__file__).resolve()), "--measure", json.dumps(case)]
    done = subprocess.run(
        call, env={**os.environ, **threads, "PYTHONPATH": str(sources)}, check=True, capture_output=True, text=True
    )
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def against(commit: str, names: list[str]) -> dict[str, Any]:
    """Measure each case with this tree and with a commit, one after the other, and print the ratios."""
    root = Path(__file__).resolve().parents[1]
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as scratch:
        tree = Path(scratch) / "before"
        subprocess.run(["git", "-C", str(root), "worktree", "add", "-q", "--detach", str(tree), commit], check=True)
        try:
            for name in names:
                pair = [in_process(source, CASES[name]) for source in (tree / "src", root / "src")]
                found[name] = {"before": pair[0], "now": pair[1]}
                old, new = pair
                print(
                    f"{name}: {1e3 * new['s_a_frame']:.1f} ms of a core a frame ({1e3 * old['s_a_frame']:.1f} before:"
                    f" {old['s_a_frame'] / new['s_a_frame']:.1f} times as fast), {2 / new['s_a_frame']:.0f} frames/s of"
                    f" two cores (wanted {CASES[name]['target']:.0f}), {new['bytes_a_frame'] / 1e3:.1f} kB a frame"
                    f" ({old['bytes_a_frame'] / 1e3:.0f}), {new['s_a_rig']:.1f} s a rig ({old['s_a_rig']:.1f});"
                    f" load {os.getloadavg()[0]:.1f}",
                    flush=True,
                )
        finally:
            subprocess.run(["git", "-C", str(root), "worktree", "remove", "--force", str(tree)], check=True)
    return found


# --- whole data sets --------------------------------------------------------------------------------------------------


def throughput(frames: int, workers: int) -> dict[str, float]:
    """Make a data set of 320 x 240 px without effects; return frames per second after the start, and bytes on disk."""
    from evanesce.dataset.config import DatasetConfig, with_size
    from evanesce.dataset.job import new_job
    from evanesce.dataset.run import Engine, make
    from evanesce.rig import load_scene

    config = DatasetConfig.model_validate({"randomisation": {"probability": 0.0}, "rig": {"count": 3}})
    job = new_job(load_scene("thesis"), with_size(config, "320x240"), frames=frames, seed=5)
    with tempfile.TemporaryDirectory() as scratch:
        ticks: list[tuple[float, int]] = []
        outcome = make(
            Path(scratch) / "d",
            job,
            Engine(workers=workers),
            lambda r: ticks.append((time.perf_counter(), r["frames"])),
        )
    # From the first round of shards on: start of processes and light fields are behind.
    steady = ticks[workers:]
    rate = sum(n for _, n in steady[1:]) / (steady[-1][0] - steady[0][0]) if len(steady) > 1 else float("nan")
    return {"frames_per_s": rate, "bytes_on_disk_a_frame": outcome.size / outcome.frames}


def streamed(trials: int = 8) -> dict[str, float]:
    """Return the processor time of a frame of a stream of default trials at 320 x 240 px [s], rigs' fields apart.

    Each trial's own share (its slide, its region) is in it; the first trial of a rig is not.
    """
    from evanesce.dataset.stream import stream
    from evanesce.dataset.worker import single_threaded

    single_threaded()
    busy, frames, rig, first = 0.0, 0, None, 0.0
    start = time.process_time()
    for clip in stream(size="320x240", seed=7, trials=trials).clips():
        now, this = time.process_time(), clip[0].meta["rig"]["index"]
        if this == rig:
            busy, frames = busy + now - start, frames + len(clip)
        else:
            first += now - start
        rig, start = this, time.process_time()
    return {"s_a_frame": busy / frames, "frames": frames, "first_trials_s": first}


def storing(shards: int = 20) -> dict[str, float]:
    """Return what one process takes for all others, a shard of 160 frames: of the manifest, and of its file [s]."""
    from dataclasses import replace

    from evanesce.dataset import layout
    from evanesce.dataset.config import DatasetConfig, with_size
    from evanesce.dataset.job import new_job
    from evanesce.dataset.manifest import Manifest
    from evanesce.dataset.produce import Producer
    from evanesce.dataset.shard import ShardWriter
    from evanesce.rig import load_scene

    job = new_job(load_scene("thesis"), with_size(DatasetConfig(), "320x240"), frames=80, seed=5)
    kept, found = Producer(job).record(40), {"manifest": 0.0, "manifest_processor": 0.0, "file": 0.0}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        layout.make_folders(folder)
        manifest = Manifest.create(folder / "m.sqlite", {})
        for shard in range(shards):
            with ShardWriter(folder, shard) as writer:
                for k in range(160):
                    writer.add(replace(kept, frame=shard * 160 + k))
                start = time.perf_counter()
                index = writer.publish()
                found["file"] += (time.perf_counter() - start) / shards
            start, busy = time.perf_counter(), time.process_time()
            manifest.add(index)
            found["manifest"] += (time.perf_counter() - start) / shards
            found["manifest_processor"] += (time.process_time() - busy) / shards
        found["rows_MB"] = (folder / "m.sqlite").stat().st_size / shards / 1e6
        manifest.close()
    return found


def on_paper(s_a_frame: float, bytes_a_frame: float, kept: dict[str, float], frames_a_shard: int = 160) -> None:
    """Print what manifest, scheduler and file system would take with many workers, a shard a task."""
    print(
        f"on paper, shards of {frames_a_shard} frames: manifest {1e3 * kept['manifest']:.1f} ms a shard"
        f" ({1e3 * kept['manifest_processor']:.1f} of a processor, the rest until its rows are on disk),"
        f" file {1e3 * kept['file']:.1f} ms, Dask {1e3 * DASK_TASK_S:.0f} ms"
    )
    for workers in (2, 100, 1000):
        shards = workers / (s_a_frame * frames_a_shard)
        print(
            f"  {workers:5d} workers: {shards * frames_a_shard:8.0f} frames/s, {shards:6.1f} shards/s, manifest busy"
            f" {100 * shards * kept['manifest']:5.0f} %, scheduler {100 * shards * DASK_TASK_S:4.0f} %,"
            f" {shards * frames_a_shard * bytes_a_frame / 1e6:6.0f} MB/s"
        )
    a_shard = s_a_frame * frames_a_shard
    print(
        f"  the one writer of the manifest is busy at {a_shard / kept['manifest']:.0f} workers, with far larger shards"
        f" at {a_shard / kept['manifest_processor']:.0f};"
    )
    print("  beyond, each task of a job array (--shard i/n) writes its own files, and `resume` adds their rows after.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", default=BEFORE)
    parser.add_argument("--cases", nargs="*", choices=list(CASES), default=list(CASES))
    parser.add_argument("--frames", type=int, default=1600)
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--streamed", type=int, default=8, help="trials of `evanesce.dataset.stream`; 0: none")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--measure", type=json.loads, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measure:
        print(json.dumps(measure(given.measure)))
        return
    found: dict[str, Any] = {"cases": against(given.against, given.cases) if given.cases else {}, "workers": {}}
    if given.streamed:
        found["stream"] = streamed(given.streamed)
        each = found["stream"]["s_a_frame"]
        print(f"stream: {1e3 * each:.1f} ms of a core a frame, {1 / each:.0f} frames/s of a core", flush=True)
    for workers in given.workers:
        found["workers"][workers] = throughput(given.frames, workers)
        print(workers, found["workers"][workers], f"load {os.getloadavg()[0]:.1f}", flush=True)
    quick = found["cases"].get("320x240, effects off")
    if quick and found["workers"]:
        disk = next(iter(found["workers"].values()))["bytes_on_disk_a_frame"]
        found["storing"] = storing()
        on_paper(quick["now"]["s_a_frame"], disk, found["storing"])
    if given.json:
        from evanesce.core import provenance

        found["provenance"] = dict(provenance.record())
        given.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
