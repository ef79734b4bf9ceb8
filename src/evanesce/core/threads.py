"""Work on blocks of an image's rows, or on parts of anything else, in a few threads of this process."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Result = TypeVar("Result")

THREADS = 2
"""Set it before the first use."""


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(THREADS)


def in_threads(work: Callable[[range], None], rows: int, block: int) -> None:
    """Call ``work`` on blocks of rows, in a few threads; each writes to its own rows, so order does not matter.

    Parameters
    ----------
    work : callable
        Of a range of rows.
    rows : int
        In all.
    block : int
        Rows of a block.
    """
    blocks = [range(r, min(r + block, rows)) for r in range(0, rows, block)]
    if THREADS == 1 or len(blocks) == 1:
        for some in blocks:
            work(some)
        return
    list(_pool().map(work, blocks))


def one_by_one(work: Callable[[int], Result], count: int) -> Iterator[Result]:
    """Yield what ``work`` returns for 0, 1, ... in that order, a few of them worked on at once.

    Parameters
    ----------
    work : callable
        Of a number; shares nothing with the others that it changes.
    count : int
    """
    if THREADS == 1:
        yield from map(work, range(count))
    else:
        yield from _pool().map(work, range(count))
