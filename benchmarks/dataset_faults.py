"""What a dataset survives: kills at random points, damage, a cycle of make, kill, resume, verify, export, read back.

Kills and damage are of real processes and real files; their frames are made of their numbers alone
(tests/support/datasets.py), so that a campaign takes minutes. The cycle is of simulated frames, small ones.

    python benchmarks/dataset_faults.py [--kills 200] [--worker-kills 24] [--mean-s 4] [--damages 1000] [--cycle 2000]
                                        [--seed 1] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np

import evanesce.dataset as dataset
from evanesce.core.errors import InputError
from evanesce.dataset.run import make, resume
from evanesce.dataset.verify import verify
from support.dataset_formats import exported_equal
from support.dataset_kills import Killed, campaign, environment, made_again
from support.datasets import contents, tiny_job, use_paper

FRAMES = 240


def killed(action: Any, delay: float) -> bool:
    """Run an action in a forked process and kill it after a delay; tell whether it was still running."""
    pid = os.fork()
    if pid == 0:
        try:
            action()
            os._exit(0)
        except BaseException:
            os._exit(9)
    time.sleep(delay)
    os.kill(pid, signal.SIGKILL)
    _, status = os.waitpid(pid, 0)
    return os.WIFSIGNALED(status)


def driver_kills(folder: Path, count: int, seed: int) -> dict[str, Any]:
    """Kill the making process at random points, again and again; compare each finished dataset with the reference."""
    scratch = folder / "drivers"
    scratch.mkdir()
    # Longer in all than a probe, which is a process of its own: or kills would only ever hit the same probe.
    os.environ |= environment(scratch, PAPER_PAUSE_S="0.02")
    log = scratch / "log"
    del os.environ["PAPER_LOG"]
    use_paper()
    job = tiny_job(frames=FRAMES)
    reference = folder / "reference"
    start = time.perf_counter()
    make(reference, job)
    whole = time.perf_counter() - start
    good, draw = contents(reference), random.Random(seed)
    kills = finished = equal = lost = again = worst = 0
    patience, begun = 1.0, ""
    target = folder / "target"
    os.environ["PAPER_LOG"] = str(log)
    while kills < count:
        shutil.rmtree(target, ignore_errors=True)
        log.unlink(missing_ok=True)
        while True:
            before = _published(target)
            delay = patience * draw.uniform(0.0, 0.6 * whole)
            start_over = (target / "dataset.json").exists()
            hit = killed(lambda: resume(target) if start_over else make(target, job), delay)  # noqa: B023
            kills += hit
            # A busy machine may not come to a frame in that time: without end, were the next kill no later.
            seen = log.read_text() if log.exists() else ""
            patience, begun = (2.0 * patience if hit and seen == begun else 1.0), seen
            lost += hit and _published(target) < before  # a published shard must never be lost
            if not hit or kills >= count:
                break
        resume(target) if (target / "dataset.json").exists() else make(target, job)
        finished += 1
        equal += contents(target) == good and verify(target).good
        cost = made_again(log)
        again, worst = again + sum(cost.values()), max(worst, *cost.values(), 0)
        print(f"{kills} kills, {equal} of {finished} datasets equal, {time.perf_counter() - start:.0f} s", flush=True)
    del os.environ["PAPER_LOG"]
    return {
        "kills": kills, "datasets": finished, "byte_identical": equal, "published_shards_lost": int(lost),
        "shards_made_again": again, "most_for_one_kill": worst,
    }  # fmt: skip


def _published(target: Path) -> int:
    return len(list((target / "shards").glob("*.tar"))) if target.exists() else 0


def worker_kills(folder: Path, count: int, mean_s: float, seed: int) -> dict[str, Any]:
    """Kill workers of the embedded cluster, and sometimes its driver, at random times; count what was made again.

    One dataset after another until there are as many kills: each has as many as fall into its making.
    """
    found: list[Killed] = []
    targets = []
    while (left := count - sum(one.workers + one.drivers for one in found)) > 0:
        scratch = folder / f"kills-{len(found)}"
        scratch.mkdir()
        one = campaign(
            scratch, frames=FRAMES, kills=left, mean_s=mean_s, seed=seed + len(found), pause_s=0.2, driver_share=0.15
        )
        found.append(one)
        targets.append(scratch / "d")
        print(f"dataset {len(found)}: {one}", flush=True)
    use_paper()
    os.environ["PAPER_PAUSE_S"] = "0"
    reference = folder / "reference-w"
    make(reference, tiny_job(frames=FRAMES))
    good = contents(reference)
    return {
        "datasets": len(found),
        "byte_identical": sum(contents(target) == good for target in targets),
        "verified": sum(verify(target).good for target in targets),
        "kills_of_workers": sum(one.workers for one in found),
        "of_them_while_they_started": sum(one.idle for one in found),
        "kills_of_drivers": sum(one.drivers for one in found),
        "shards_made_again": sum(one.redone for one in found),
        "most_for_one_kill": max(one.worst for one in found),
        "made_again_for_nothing": sum(one.for_nothing for one in found),
        "statuses": [one.statuses for one in found],
    }


def damages(folder: Path, count: int, seed: int) -> dict[str, Any]:
    """Damage a finished dataset in one place at a time; count what ``verify`` does not notice."""
    use_paper()
    os.environ["PAPER_PAUSE_S"] = "0"
    target = folder / "damaged"
    make(target, tiny_job(frames=48))
    good, rng = contents(target), np.random.default_rng(seed)
    names, tally, unnoticed, named = sorted(good), {}, [], 0
    shards = [n for n in names if n.startswith("shards/")]
    done = 0
    while done < count:
        kind = str(rng.choice(["bit flip", "truncation", "deletion", "swapped shards"]))
        name = str(rng.choice(shards if rng.random() < 0.7 else names))
        path, data = target / name, bytearray(good[name])
        touched = [name]
        if kind == "bit flip":
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
            path.write_bytes(data)
        elif kind == "truncation":
            path.write_bytes(data[: rng.integers(len(data))])
        elif kind == "deletion":
            path.unlink()
        else:
            a, b = (str(n) for n in rng.choice(shards, 2, replace=False))
            (target / a).write_bytes(good[b])
            (target / b).write_bytes(good[a])
            touched = [a, b]
        try:
            report = verify(target, threads=1)
            seen, named = not report.good, named + bool(report.bad_frames)
        except InputError:
            seen = True
        tally[kind] = tally.get(kind, 0) + 1
        done += 1
        if not seen:
            unnoticed.append((kind, name))
        for n in touched:
            (target / n).write_bytes(good[n])
    assert verify(target).good
    return {"damages": done, "by_kind": tally, "unnoticed": unnoticed, "reports_naming_frames": named}


def cycle(folder: Path, frames: int) -> dict[str, Any]:
    """Make simulated frames, kill, resume, verify, export to each format and compare with what was made."""
    code = """
if __name__ == "__main__":
    from pathlib import Path
    from evanesce.dataset.run import Engine, make, resume
    from evanesce.dataset.job import new_job
    from support.datasets import tiny_config
    from support.rigs import small_rig
    folder = Path({folder!r})
    if (folder / "dataset.json").exists():
        resume(folder, Engine(workers=2))
    else:
        config = tiny_config(trial={{"frames": 40, "frame_rate_hz": 30.0}}, trials_per_shard=2)
        make(folder, new_job(small_rig(), config, frames={frames}, seed=3), Engine(workers=2))
"""
    target = folder / "cycle"
    start, kills = time.perf_counter(), 0
    command = [sys.executable, "-c", code.format(folder=str(target), frames=frames)]
    tests = str(Path(__file__).resolve().parents[1] / "tests")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([tests, os.environ.get("PYTHONPATH", "")])}
    draw = random.Random(frames)
    for _ in range(2):  # at any time of the making, which takes some 20 frames/s; the next one begins at once
        run = subprocess.Popen(command, env=environment)
        try:
            run.wait(draw.uniform(0.0, frames / 20.0))
        except subprocess.TimeoutExpired:
            run.kill()
            kills += 1
            run.wait()
    subprocess.run(command, env=environment, check=True)
    made = time.perf_counter() - start
    report = verify(target)
    equal = {to: exported_equal(target, folder / f"as-{to}", to) for to in ("hdf5", "lerobot", "coco", "parquet")}
    with dataset.open(target) as data:
        count = len(data)
    return {
        "frames": count, "kills": kills, "seconds": made, "verify_good": report.good,
        "verify_MB_per_s": report.size / report.seconds / 1e6, "bytes": report.size, "exports_equal": equal,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--worker-kills", type=int, default=24)
    parser.add_argument("--mean-s", type=float, default=4.0, help="between kills of workers [s]")
    parser.add_argument("--damages", type=int, default=1000)
    parser.add_argument("--cycle", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    result: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="evanesce-faults-") as scratch:
        folder = Path(scratch)
        for name, count, action in (
            ("driver_kills", given.kills, lambda: driver_kills(folder, given.kills, given.seed)),
            ("damages", given.damages, lambda: damages(folder, given.damages, given.seed)),
            (
                "worker_kills",
                given.worker_kills,
                lambda: worker_kills(folder, given.worker_kills, given.mean_s, given.seed),
            ),
            ("cycle", given.cycle, lambda: cycle(folder, given.cycle)),
        ):
            if count:
                start = time.perf_counter()
                result[name] = action()
                print(f"{name}: {result[name]} in {time.perf_counter() - start:.0f} s", flush=True)
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
