"""Make one shard atomically, in any process; the same shard has the same bytes every time.

A frame that raises is quarantined with its reason. A frame that ends the process cannot be caught: the number of the
present frame is kept in a file, and after two deaths at one frame that frame is made in a separate process, to
determine whether it is fatal.
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
"""Number of probes that end by SIGKILL (lack of memory, or the user) before the frame is regarded as fatal."""


def single_threaded() -> None:
    """Limit libraries to one thread: each worker uses one core."""
    import cv2
    import OpenEXR
    import threadpoolctl

    from evanesce.core import threads

    cv2.setNumThreads(1)
    OpenEXR.set_global_thread_count(0)
    threads.THREADS = 1  # its thread pool is created on first use
    threadpoolctl.threadpool_limits(1)  # BLAS and OpenMP, whatever the environment said when they were loaded


class _Cache(threading.local):
    """Producer of a thread, reused for its next shard."""

    key: tuple[Any, ...] = ()
    producer: Producer | None = None


_cache = _Cache()


def _producer(folder: str, digest: str) -> Producer:
    key = (Producer, folder, digest)
    if _cache.producer is None or _cache.key != key:
        _cache.producer, _cache.key = Producer(load_job(Path(folder))), key
    return _cache.producer


def forget() -> None:
    """Discard the producer of this thread."""
    _cache.producer = None


def make_shard(folder: str, shard: int, *, any_versions: bool = False) -> dict[str, Any]:
    """Make and publish one shard: the task that Dask runs.

    Parameters
    ----------
    folder : str
        The dataset's.
    shard : int
    any_versions : bool
        Make it although this process has other versions than those that the dataset was begun with.

    Returns
    -------
    dict
        ``shard``, ``frames``, ``quarantined`` and ``bytes``: counts only. ``failed``: why nothing was published, else
        empty; other shards continue.

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
    """A shard cannot be made; others may."""


def failed(shard: int, reason: str) -> dict[str, Any]:
    """Return the report of a shard of which nothing was published."""
    return {"shard": shard, "frames": 0, "quarantined": 0, "bytes": 0, "failed": reason}


def _write(folder: Path, job: Job, producer: Producer, shard: int) -> ShardIndex:
    trace = Trace(folder, shard)
    fatal = trace.fatal_frames()
    try:
        with ShardWriter(folder, shard) as writer:
            for trial in job.trials_of(shard):
                for frame in job.frames_of(trial):
                    if frame in fatal:
                        writer.quarantine(frame, trial, fatal[frame])
                        continue
                    trace.at(frame)
                    try:
                        record = producer.record(frame)
                    except OSError:
                        raise
                    except MemoryError:  # the frame may succeed at another time
                        raise ShardFailed(f"not enough memory for frame {layout.frame_key(frame)}") from None
                    except Exception as error:
                        writer.quarantine(frame, trial, f"{type(error).__name__}: {error}")
                        continue
                    writer.add(record)
            if not writer.index.frames:
                trace.retry_fatal()
                raise ShardFailed(f"no frame could be made: {writer.index.quarantined[0]['reason']}")
            trace.leave()  # a death from here on is not due to a frame
            index = writer.publish()
        trace.clear()
    finally:
        trace.leave()
    return index


class Trace:
    """Files by which a task recognises that an earlier one died, and at which frame."""

    def __init__(self, folder: Path, shard: int) -> None:
        self._folder = folder
        self._now = folder / layout.WORK / f"shard-{shard:06d}.at"
        self._deaths = folder / layout.WORK / f"shard-{shard:06d}.deaths"
        self._handle: int | None = None

    def at(self, frame: int) -> None:
        """Record the present frame: 9 digits, overwritten."""
        if self._handle is None:
            self._handle = os.open(self._now, os.O_RDWR | os.O_CREAT, 0o644)
        os.pwrite(self._handle, layout.frame_key(frame).encode(), 0)

    def fatal_frames(self) -> dict[int, str]:
        """Return the fatal frames with reasons, after counting a death of the last task."""
        state = self._read()
        deaths, fatal = state["deaths"], state["fatal"]
        if died_at := self.frame():
            frame = str(int(died_at))
            deaths[frame] = deaths.get(frame, 0) + 1
            self._save(state)
            self._now.unlink(missing_ok=True)
        for frame in [f for f, count in deaths.items() if count >= DEATHS_BEFORE_PROBE and f not in fatal]:
            reason = probe(self._folder, int(frame))
            if reason:
                fatal[frame] = reason
            else:
                deaths[frame] = 0
            self._save(state)
        return {int(frame): reason for frame, reason in fatal.items()}

    def frame(self) -> str:
        """Return the key of the frame at which the last task died; empty if none did."""
        with contextlib.suppress(OSError, ValueError):
            found = self._now.read_text()
            if len(found) == len(layout.frame_key(0)) and found.isdigit():
                return found
        return ""

    def retry_fatal(self) -> None:
        """Let the next task probe all fatal frames again: no frame of the shard could be made."""
        state = self._read()
        if state["fatal"]:
            self._save({"deaths": dict.fromkeys(state["fatal"], DEATHS_BEFORE_PROBE), "fatal": {}})

    def leave(self) -> None:
        """Remove the record of the present frame."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None
        self._now.unlink(missing_ok=True)

    def clear(self) -> None:
        """Remove the record of deaths: the shard is published."""
        self._deaths.unlink(missing_ok=True)

    def _read(self) -> dict[str, dict[str, Any]]:
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            found = json.loads(self._deaths.read_text())
            return {"deaths": found["deaths"], "fatal": found["fatal"]}
        return {"deaths": {}, "fatal": {}}

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
"""First lines of a probe, before slow imports: it ends when its standard input closes, because its parent died."""


def probe(folder: Path, frame: int) -> str:
    """Make one frame in a separate process; return the signal that ends it in words, empty if none does."""
    code = _UNTIL_ORPHANED + f"from evanesce.dataset.worker import probe_main; probe_main({str(folder)!r}, {frame:d})"
    for _ in range(PROBES_KILLED):
        with subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as process:  # its input stays open while this process lives
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
    """Make one frame and discard it; exceptions are ignored, since they do not end a worker."""
    single_threaded()
    with contextlib.suppress(Exception):
        Producer(load_job(Path(folder))).record(frame)
