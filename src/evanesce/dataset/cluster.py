"""Dask's scheduler: an embedded cluster of single-threaded processes, or one that runs elsewhere."""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from evanesce.errors import InputError, WorkError

STARTS = 3
"""Tries to start the embedded cluster: a process that is killed while it starts ends the whole start."""

KEPT_BYTES = str(256 << 20)
"""Free memory that a worker keeps for its next arrays."""

_SETTINGS = {
    # A worker's death is answered by our own bookkeeping, at once.
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.worker.daemon": True,
    "distributed.comm.timeouts.connect": "60s",
    "distributed.admin.tick.limit": "60s",  # making a frame holds the interpreter for long
    "distributed.nanny.pre-spawn-environ": {
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        # Dask's own 65536 hands every array back to the system at once: its pages then cost as much as the frame.
        "MALLOC_TRIM_THRESHOLD_": KEPT_BYTES,
        "MALLOC_MMAP_THRESHOLD_": KEPT_BYTES,
    },
}


@contextmanager
def cluster_client(workers: int, scheduler: str) -> Iterator[Any]:
    """Give a client of a running scheduler, or of a cluster of ``workers`` processes that ends with it.

    Raises
    ------
    InputError
        If no scheduler answers at the address.
    WorkError
        If no workers start.
    """
    import dask
    from distributed import Client

    with dask.config.set(_SETTINGS):
        if scheduler:
            try:
                client = Client(scheduler, timeout="20s", set_as_default=False)
            except (OSError, ValueError, TimeoutError) as error:
                raise InputError(
                    f"no scheduler answers: {error}", key="--scheduler", allowed="tcp://HOST:PORT"
                ) from None
            with client:
                yield client
            return
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        with tempfile.TemporaryDirectory(prefix="evanesce-dask-", ignore_cleanup_errors=True) as scratch:
            for left in reversed(range(STARTS)):
                try:
                    cluster = _local_cluster(workers, scratch)
                    break
                except (OSError, RuntimeError, TimeoutError) as error:
                    if not left:
                        raise WorkError(f"no workers could be started: {error}") from None
            with cluster, Client(cluster, set_as_default=False) as client:
                yield client


def _local_cluster(workers: int, scratch: str) -> Any:
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        memory_limit=0,
        local_directory=scratch,
        silence_logs=logging.CRITICAL,
        host="127.0.0.1",
    )


def default_workers() -> int:
    """Return the count of cores that this process may use."""
    return len(os.sched_getaffinity(0))
