"""One thread for all computing: jobs in their order, none in the server's own thread."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

T = TypeVar("T")


class Worker:
    """A thread that does one job after the other.

    The caches of the renderer are not made for several threads. The thread is a daemon: a long job does not keep the
    program from ending, as a pool's would.
    """

    def __init__(self) -> None:
        self._jobs: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = queue.SimpleQueue()
        threading.Thread(target=self._run, name="evanesce-live", daemon=True).start()

    def submit(self, job: Callable[[], T]) -> Future[T]:
        """Have a job done; its value or its error comes in the future."""
        future: Future[T] = Future()
        self._jobs.put((future, job))
        return future

    def _run(self) -> None:
        while True:
            future, job = self._jobs.get()
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(job())
            except BaseException as error:  # handed to whoever waits
                future.set_exception(error)
