"""Tasks of several processes, by threads that stand for them: who does which, and in which order results come."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from evanesce.prediction.processes import AHEAD, Batch, Recipe


@contextmanager
def servers(*seconds: float) -> Iterator[tuple[list[Connection], list[list[int]]]]:
    """Yield ends to servers that take so long for a task, and the tasks that each does."""
    ends, done = [], []

    def serve(end: Connection, wait_s: float, mine: list[int]) -> None:
        while (asked := end.recv()) is not None:
            task, *_, (value,) = asked
            time.sleep(wait_s)
            mine.append(task)
            end.send((task, value**2))

    threads = []
    for wait_s in seconds:
        here, there = Pipe()
        ends.append(here)
        done.append([])
        threads.append(threading.Thread(target=serve, args=(there, wait_s, done[-1])))
        threads[-1].start()
    yield ends, done
    for end, thread in zip(ends, threads, strict=True):
        end.send(None)
        thread.join()


def batch(ends: list[Connection], count: int, places: list[int] | None) -> Batch:
    known: list[OrderedDict[int, None]] = [OrderedDict() for _ in ends]
    return Batch(ends, known, Recipe(dict, {}), {}, dict, [(k,) for k in range(count)], places)


def test_a_process_that_has_done_its_own_takes_the_others_last_ones() -> None:
    """Twelve tasks are meant for a slow one, two for a quick one: each begins with its own, from the first on."""
    places = [0] * 12 + [1] * 2
    with servers(0.05, 0.0) as (ends, done):
        assert batch(ends, 14, places).results() == [k**2 for k in range(14)]
    slow, quick = done
    assert sorted(slow + quick) == list(range(14))
    assert slow == list(range(len(slow)))
    assert AHEAD <= len(slow) <= AHEAD + 2
    assert quick == [12, 13, *range(11, len(slow) - 1, -1)]


def test_tasks_meant_for_nobody_are_done_in_their_order() -> None:
    told: list[int] = []
    with servers(0.0, 0.0) as (ends, done):
        assert batch(ends, 9, None).results(told.append) == [k**2 for k in range(9)]
    assert told == list(range(1, 10))
    assert all(mine == sorted(mine) and mine for mine in done)
