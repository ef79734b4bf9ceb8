"""One task: one shard, made whole or not at all, by any process at any time; the same shard twice is the same bytes.

A frame that raises is quarantined with its reason. A frame that ends the process cannot be caught: before each frame
its number is left in a file, and a task that finds the trace of a dead one twice at the same frame first makes that
frame in a process of its own, to see with certainty whether it is the frame that kills.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from evanesce.dataset import layout
from evanesce.dataset.job import Job, load_job
from evanesce.dataset.produce import Producer
from evanesce.dataset.shard import ShardIndex, ShardWriter

DEATHS_BEFORE_PROBE = 2
PROBES_KILLED = 3
"""Probes that may end by SIGKILL (memory, or somebody) before the frame itself is blamed."""


def single_threaded() -> None:
    """Keep libraries to one thread: a worker is one core's worth, and more would only take turns."""
    import cv2
    import OpenEXR

    from evanesce.render.fast import threads

    cv2.setNumThreads(1)
    OpenEXR.set_global_thread_count(0)
    threads.THREADS = 1  # its pool is made on first use


class _Kept(threading.local):
    """What a thread keeps for its next shard: a producer works at one trial at a time."""

    key: tuple[Any, ...] = ()
    producer: Producer | None = None


_kept = _Kept()


def _producer(folder: str, digest: str) -> Producer:
    key = (Producer, folder, digest)
    if _kept.producer is None or _kept.key != key:
        _kept.producer, _kept.key = Producer(load_job(Path(folder))), key
    return _kept.producer


def forget() -> None:
    """Let the next shard of this thread be made by a new producer."""
    _kept.producer = None


def make_shard(folder: str, shard: int, *, any_versions: bool = False) -> dict[str, Any]:
    """Make and publish one shard; the task that Dask runs.

    Parameters
    ----------
    folder : str
        The dataset's.
    shard : int
    any_versions : bool
        Make it although this process has other versions than the one that began the dataset.

    Returns
    -------
    dict
        ``shard``, ``frames``, ``quarantined`` and ``bytes``: counts only, the arrays stay where they are. ``failed``:
        why nothing was published, empty if all is well; other shards need not stop for it.

    Raises
    ------
    InputError
        If this process, perhaps on another machine, has other versions.
    WorkError
        If the system refuses to write.
    """
    single_threaded()
    path = Path(folder)
    job = load_job(path, check_versions=not any_versions)
    producer = _producer(folder, job.digest)
    try:
        index = _write(path, job, producer, shard)
    except OSError as error:
        raise layout.cannot_write(layout.shard_path(path, shard), error) from None
    except ShardFailed as error:
        return failed(shard, str(error))
    counts = {"frames": len(index.frames), "quarantined": len(index.quarantined), "bytes": index.size}
    return {"shard": shard, **counts, "failed": ""}


class ShardFailed(Exception):
    """A shard cannot be made, for a reason of its own."""


def failed(shard: int, reason: str) -> dict[str, Any]:
    """Return the report of a shard of which nothing was published."""
    return {"shard": shard, "frames": 0, "quarantined": 0, "bytes": 0, "failed": reason}


def _write(folder: Path, job: Job, producer: Producer, shard: int) -> ShardIndex:
    trace = Trace(folder, shard)
    poison = trace.poisoned()
    try:
        with ShardWriter(folder, shard) as writer:
            for trial in job.trials_of(shard):
                for frame in job.frames_of(trial):
                    if frame in poison:
                        writer.quarantine(frame, trial, poison[frame])
                        continue
                    trace.at(frame)
                    try:
                        record = producer.record(frame)
                    except OSError:
                        raise
                    except MemoryError:  # of the machine at this time: the frame may well be made another time
                        raise ShardFailed(f"not enough memory for frame {layout.frame_key(frame)}") from None
                    except Exception as error:
                        writer.quarantine(frame, trial, f"{type(error).__name__}: {error}")
                        continue
                    writer.add(record)
            if not writer.index.frames:
                trace.doubt()
                raise ShardFailed(f"no frame could be made: {writer.index.quarantined[0]['reason']}")
            trace.leave()  # a death from here on is not a frame's
            index = writer.publish()
        trace.clear()
    finally:
        trace.leave()
    return index


class Trace:
    """What a task leaves for the next one, should it die."""

    def __init__(self, folder: Path, shard: int) -> None:
        self._folder = folder
        self._now = folder / layout.WORK / f"shard-{shard:06d}.at"
        self._deaths = folder / layout.WORK / f"shard-{shard:06d}.deaths"
        self._handle: int | None = None

    def at(self, frame: int) -> None:
        """Note which frame is being made; 9 digits, written over each other."""
        if self._handle is None:
            self._handle = os.open(self._now, os.O_RDWR | os.O_CREAT, 0o644)
        os.pwrite(self._handle, layout.frame_key(frame).encode(), 0)

    def poisoned(self) -> dict[int, str]:
        """Return the frames known to kill, after counting the death that the last task may have died."""
        state = self._read()
        deaths, poison = state["deaths"], state["poison"]
        if died_at := self.place():
            frame = str(int(died_at))
            deaths[frame] = deaths.get(frame, 0) + 1
            self._save(state)
            self._now.unlink(missing_ok=True)
        for frame in [f for f, count in deaths.items() if count >= DEATHS_BEFORE_PROBE and f not in poison]:
            reason = probe(self._folder, int(frame))
            if reason:
                poison[frame] = reason
            else:
                deaths[frame] = 0
            self._save(state)
        return {int(frame): reason for frame, reason in poison.items()}

    def place(self) -> str:
        """Return the key of the frame at which the last task died; empty if there is no trace."""
        with contextlib.suppress(OSError, ValueError):
            found = self._now.read_text()
            if len(found) == len(layout.frame_key(0)) and found.isdigit():
                return found
        return ""

    def doubt(self) -> None:
        """No frame is left: the next task tries all those again that killed, in processes of their own."""
        state = self._read()
        if state["poison"]:
            self._save({"deaths": dict.fromkeys(state["poison"], DEATHS_BEFORE_PROBE), "poison": {}})

    def leave(self) -> None:
        """End without having died."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None
        self._now.unlink(missing_ok=True)

    def clear(self) -> None:
        """Forget: the shard is published."""
        self._deaths.unlink(missing_ok=True)

    def _read(self) -> dict[str, dict[str, Any]]:
        with contextlib.suppress(OSError, ValueError):
            found = json.loads(self._deaths.read_text())
            return {"deaths": found["deaths"], "poison": found["poison"]}
        return {"deaths": {}, "poison": {}}

    def _save(self, state: dict[str, Any]) -> None:
        layout.write_json(self._deaths, state)


_UNTIL_ORPHANED = """
import os, threading
def end_with_input():
    while os.read(0, 64):
        pass
    os._exit(0)
threading.Thread(target=end_with_input, daemon=True).start()
"""
"""Begins a probe, before imports that take seconds: it ends when its standard input closes, whose other end died."""


def probe(folder: Path, frame: int) -> str:
    """Make one frame in a process of its own; return what signal it dies of, empty if it lives."""
    code = _UNTIL_ORPHANED + f"from evanesce.dataset.worker import probe_main; probe_main({str(folder)!r}, {frame:d})"
    for _ in range(PROBES_KILLED):
        with subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as process:  # its input stays open while this process lives, which is how it knows
            try:
                status = process.wait()
            except BaseException:
                process.kill()
                raise
        if status >= 0:
            return ""
        name = signal.Signals(-status).name
        if -status not in (signal.SIGKILL, signal.SIGTERM):
            return f"the process that makes it dies of {name}"
    return f"the process that makes it is killed ({name}): perhaps it needs more memory than there is"


def probe_main(folder: str, frame: int) -> None:
    """Make one frame and throw it away; an exception is not what a probe looks for."""
    single_threaded()
    with contextlib.suppress(Exception):
        Producer(load_job(Path(folder))).record(frame)
