"""Kill drivers and workers of a dataset's making at random times; count what had to be made again, from a log."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]

_SITE = """
import importlib.abc, importlib.util, os, sys

class Finder(importlib.abc.MetaPathFinder):
    # once the worker's module is loaded, it makes frames of their numbers alone
    def find_spec(self, name, path, target=None):
        if name != "evanesce.dataset.worker":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        load = spec.loader.exec_module
        def exec_module(module):
            load(module)
            import support.datasets
            support.datasets.use_paper()
            real = module.probe_main
            def probe_main(*given):
                os.environ.pop("PAPER_LOG", None)  # a probe is no shard begun again
                real(*given)
            module.probe_main = probe_main
        spec.loader.exec_module = exec_module
        return spec

sys.meta_path.insert(0, Finder())
"""

_DRIVER = """
if __name__ == "__main__":
    import sys
    from pathlib import Path
    from evanesce.dataset import run
    from evanesce.core.errors import EvanesceError
    from support.datasets import tiny_job
    run.MAX_DEATHS = {most}
    folder, engine = Path({folder!r}), run.Engine(workers={workers})
    try:
        if (folder / "dataset.json").exists():
            run.resume(folder, engine)
        else:
            run.make(folder, tiny_job(frames={frames}), engine)
    except EvanesceError as error:
        print(error)
        sys.exit(error.exit_code)
"""


@dataclass
class Killed:
    """What a campaign did and what came of it.

    Attributes
    ----------
    workers, drivers : int
        Kills of each.
    idle : int
        Of the workers, those that had not begun a shard yet: killed while they started.
    statuses : list of int
        Exit status of each driver; one whose workers were all killed as they started is followed by another.
    said : str
        What the last driver printed.
    redone : int
        Shards begun again because a process that made them was killed.
    worst : int
        Most shards that one killed worker cost.
    for_nothing : int
        Shards begun again although nobody who made them had died.
    """

    workers: int = 0
    drivers: int = 0
    idle: int = 0
    statuses: list[int] = field(default_factory=list)
    said: str = ""
    redone: int = 0
    worst: int = 0
    for_nothing: int = 0


def environment(scratch: Path, **more: str) -> dict[str, str]:
    """Return an environment in which every process that loads the worker's module makes paper frames."""
    site = scratch / "site"
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text(_SITE)
    paths = [str(site), str(TESTS), *(p for p in sys.path if p)]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "PAPER_LOG": str(scratch / "log"), **more}


def campaign(
    scratch: Path,
    *,
    frames: int,
    kills: int,
    mean_s: float,
    seed: int,
    pause_s: float,
    driver_share: float = 0.0,
    poison: str = "",
    workers: int = 2,
    most: int = 50,
) -> Killed:
    """Make ``scratch/d``; kill at times that are exponentially distributed, whatever the victim is doing.

    Parameters
    ----------
    scratch : Path
        Empty folder.
    frames : int
        Of the dataset, six a shard.
    kills : int
        After so many the making is left in peace.
    mean_s : float
        Between kills [s].
    seed : int
    pause_s : float
        Minimum time of a frame [s].
    driver_share : float
        Of the kills; after one of the driver it is started again at once.
    poison : str
        Frames that abort their process, separated by commas.
    workers, most : int
        Workers; deaths in a row at one frame after which a shard is given up.
    """
    given = environment(scratch, PAPER_PAUSE_S=str(pause_s), PAPER_POISON=poison)
    code = _DRIVER.format(folder=str(scratch / "d"), frames=frames, workers=workers, most=most)
    script = scratch / "drive.py"
    script.write_text(code)
    draw, found, dead = random.Random(seed), Killed(), set()
    while True:
        run = subprocess.Popen([sys.executable, str(script)], env=given, stdout=subprocess.PIPE, text=True,
                               stderr=subprocess.DEVNULL)  # fmt: skip
        at = time.monotonic() + draw.expovariate(1.0 / mean_s)
        hit_driver = False
        while run.poll() is None:
            if time.monotonic() < at or found.workers + found.drivers >= kills:
                time.sleep(0.01)
                continue
            at = time.monotonic() + draw.expovariate(1.0 / mean_s)
            those = workers_of(run.pid)
            if draw.random() < driver_share:
                dead |= {run.pid, *those}  # the workers end by themselves
                run.kill()
                found.drivers, hit_driver = found.drivers + 1, True
                break
            if those:
                victim = draw.choice(those)
                with contextlib.suppress(ProcessLookupError):
                    os.kill(victim, signal.SIGKILL)
                    dead.add(victim)
                    found.workers += 1
                    found.idle += victim not in _beginners(scratch / "log")
        found.said = run.communicate()[0]
        found.statuses.append(run.returncode)
        no_start = "no workers could be started" in found.said  # all of its tries were hit: the next run has others
        if not hit_driver and not no_start:
            break
    _count(found, scratch / "log", dead)
    return found


def _log(path: Path) -> list[tuple[int, int]]:
    """Return (process, frame) in the order in which frames were begun."""
    lines = path.read_text().splitlines() if path.exists() else []
    return [(int(pid), int(frame)) for pid, frame in (line.split() for line in lines)]


def _beginners(path: Path) -> set[int]:
    return {pid for pid, _ in _log(path)}


def made_again(path: Path) -> dict[int, int]:
    """Return how many shards were begun again after each process: the next to begin one is due to the one before."""
    makers: dict[int, list[int]] = defaultdict(list)
    for pid, frame in _log(path):
        if makers[frame // 6][-1:] != [pid]:
            makers[frame // 6].append(pid)
    cost: dict[int, int] = defaultdict(int)
    for those in makers.values():
        for before in those[:-1]:
            cost[before] += 1
    return cost


def _count(found: Killed, path: Path, dead: set[int]) -> None:
    cost = made_again(path)
    found.redone = sum(count for pid, count in cost.items() if pid in dead)
    found.worst = max((count for pid, count in cost.items() if pid in dead), default=0)
    found.for_nothing = sum(count for pid, count in cost.items() if pid not in dead)


def workers_of(pid: int) -> list[int]:
    """Return the processes below a driver that run Dask's workers."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            command = (entry / "cmdline").read_bytes()
        except OSError:
            continue
        if parent == pid and b"spawn_main" in command:
            found.append(int(entry.name))
    return found
