"""Start an embedded Dask cluster of single-threaded processes, or connect to a running scheduler."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any, NoReturn

from evanesce.core.errors import InputError, WorkError
from evanesce.core.extras import require

STARTS = 3
"""Attempts to start the embedded cluster: a process that is killed while it starts ends the attempt."""

CHECK_S = 2.0
"""Time between two checks that all workers are running [s]."""

TRIM_BYTES = str(256 << 20)
"""Free memory that a worker does not return to the system [bytes]."""

_SETTINGS = {
    # Worker deaths are handled by dataset/run.py, at once.
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.worker.daemon": True,
    "distributed.comm.timeouts.connect": "60s",
    "distributed.admin.tick.limit": "60s",  # making a frame holds the interpreter for long
    "distributed.nanny.pre-spawn-environ": {
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        # Dask's default, 65536, returns every array to the system at once, which takes as long as a frame.
        "MALLOC_TRIM_THRESHOLD_": TRIM_BYTES,
        "MALLOC_MMAP_THRESHOLD_": TRIM_BYTES,
    },
}


def require_cluster() -> None:
    """Check that Dask is installed.

    Raises
    ------
    MissingExtraError
        If it is not.
    """
    require("dataset", "work in several processes (--workers above 0)", "dask", "distributed")


def require_scheduler(address: str) -> None:
    """Check that a scheduler answers.

    Raises
    ------
    InputError
        If none does.
    """
    with cluster_client(0, address):
        pass


ANSWER_S = 20.0
"""Time in which a scheduler has to answer."""


@contextmanager
def cluster_client(workers: int, scheduler: str) -> Iterator[Any]:
    """Yield a client of a running scheduler, or of a cluster of ``workers`` processes that ends with the context.

    Raises
    ------
    InputError
        If no scheduler answers at the address, or the extra ``dataset`` is not installed.
    WorkError
        If no workers start.
    """
    require_cluster()
    import dask
    from distributed import Client

    with dask.config.set(_SETTINGS):
        if scheduler:
            try:
                client = Client(scheduler, timeout=ANSWER_S, set_as_default=False)
            except (OSError, ValueError, TimeoutError) as error:
                raise InputError(
                    f"no scheduler answers: {error}", key="--scheduler", allowed="tcp://HOST:PORT"
                ) from None
            with client:
                yield client
            return
        for name in ("distributed", "asyncio", "tornado.application"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        with (
            _ended_in_order(),
            tempfile.TemporaryDirectory(prefix="evanesce-dask-", ignore_cleanup_errors=True) as scratch,
            _started(workers, scratch) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            try:
                with _kept_up(cluster, workers):  # ends before the workers do: none is replaced then
                    yield client
            except BaseException:
                _kill_workers(cluster)
                raise


@contextmanager
def _ended_in_order() -> Iterator[None]:
    """Handle SIGTERM as Ctrl-C, so that workers, temporary files and semaphores are cleaned up."""

    def leave(number: int, _frame: object) -> NoReturn:
        sys.exit(128 + number)

    ours = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    if ours:
        signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        if ours:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _started(workers: int, scratch: str) -> Any:
    # Ctrl-C in a terminal reaches every process. Only the driver handles it: the cluster's threads and processes,
    # replacements included, start with the signal blocked.
    resource_tracker.ensure_running()  # it would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        for left in reversed(range(STARTS)):
            try:
                return _local_cluster(workers, scratch)
            except (OSError, RuntimeError, TimeoutError) as error:
                if not left:
                    raise WorkError(f"no workers could be started: {error}") from None
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _kept_up(cluster: Any, workers: int) -> Iterator[None]:
    """Replace failed workers: Dask replaces none that dies while it starts."""
    from distributed.core import Status

    over = threading.Event()

    def drop_dead() -> None:
        for name, nanny in list(cluster.workers.items()):
            if nanny.status in (Status.failed, Status.closed):
                del cluster.workers[name]

    def watch() -> None:
        while not over.wait(CHECK_S):
            cluster.loop.add_callback(drop_dead)
            cluster.scale(workers)  # starts what is missing

    thread = threading.Thread(target=watch, name="evanesce-workers", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _kill_workers(cluster: Any) -> None:
    """End all workers at once: shards are published atomically, so that nothing has to be awaited."""
    for nanny in cluster.workers.values():
        nanny.close_gracefully()  # without a replacement
        if nanny.process is not None and nanny.process.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(nanny.process.pid, signal.SIGKILL)


def _local_cluster(workers: int, scratch: str) -> Any:
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        # No dashboard. The scheduler's HTTP server takes any free port: a fixed one would warn in a second run.
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
        memory_limit=0,
        local_directory=scratch,
        silence_logs=logging.CRITICAL,
        host="127.0.0.1",
    )


def default_workers() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))
