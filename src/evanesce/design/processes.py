"""Run calls on Dask's workers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from evanesce.core.errors import WorkError

MAX_ATTEMPTS = 5
"""Number of times that a call's worker may die before the call fails."""

Call = tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]


def done_by(client: Any, calls: Iterator[Call] | Sequence[Call]) -> Iterator[tuple[int, Any]]:
    """Yield (number, result) of calls as they end; every worker has one at a time, and calls are drawn lazily.

    Parameters
    ----------
    client : distributed.Client
    calls : iterable of (function, arguments, options)
        A generator is advanced only when a worker is free.

    Raises
    ------
    WorkError
        If one call's workers die :data:`MAX_ATTEMPTS` times.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    queue, waiting = as_completed(loop=client.loop), enumerate(iter(calls))
    running: dict[Any, tuple[int, Call, int]] = {}

    def submit(number: int, call: Call, attempt: int) -> None:
        function, given, options = call
        key = f"{function.__name__}-{number}-{attempt}-{id(queue)}"
        future = client.submit(function, *given, **options, key=key, pure=False)
        running[future] = (number, call, attempt)
        queue.add(future)

    def fill() -> None:
        while len(running) < max(1, sum(client.nthreads().values())):
            following = next(waiting, None)
            if following is None:
                return
            submit(*following, 1)

    fill()
    for future in queue:
        number, call, attempt = running.pop(future)
        try:
            result = future.result()
        except KilledWorker:
            if attempt >= MAX_ATTEMPTS:
                raise WorkError(f"{call[0].__name__} {number}: its worker died {MAX_ATTEMPTS} times") from None
            submit(number, call, attempt + 1)
            continue
        future.release()
        yield number, result
        fill()
