"""One thread for all computation: jobs in their order, none in the server's thread."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

T = TypeVar("T")


class Worker:
    """A thread that runs one job after the other.

    The caches of the renderer are not thread-safe. The thread is a daemon: a long job does not keep the program from
    ending.
    """

    def __init__(self) -> None:
        self._jobs: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = queue.SimpleQueue()
        threading.Thread(target=self._run, name="evanesce-live", daemon=True).start()

    def submit(self, job: Callable[[], T]) -> Future[T]:
        """Enqueue a job; the future gets its value or its error."""
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
            except BaseException as error:  # raised where the future is awaited
                future.set_exception(error)
