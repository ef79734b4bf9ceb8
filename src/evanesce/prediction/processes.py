"""Predictions by several processes: views of one point, or derivatives by many parameters.

What a view needs of a rig (its contact, the plate's light) is kept by the process that made it. Views of a point go to
the process that has always had them, so that a fit asks for each where the last point's is known; a process that has
done its own takes over the others' last ones, as how long a view takes depends on the point (a contact that creeps is
another one at each time).
"""

from __future__ import annotations

import itertools
import multiprocessing
import traceback
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from typing import Any

import cv2

from evanesce.core import threads
from evanesce.core.errors import InputError, WorkError
from evanesce.prediction.views import View

KEEP = 6
"""Predictors that a process holds: the coarse one, and the fine ones of the last anchor."""
STATE_VIEWS = 15
"""Views of a state whose exposures take as long as the light of the state itself."""
AHEAD = 2
"""Tasks that a process is given at once: it need not wait while this one is busy."""

_numbers = itertools.count()
_present: list[Processes] = []


@dataclass(frozen=True)
class Recipe:
    """How another process makes a predictor.

    Attributes
    ----------
    make : callable
        At the top of a module.
    options : mapping
        Its arguments.
    number : int
        Of the predictor.
    """

    make: Callable[..., Any]
    options: Mapping[str, Any]
    number: int = field(default_factory=lambda: next(_numbers))


class Batch:
    """Tasks that are being worked on, each for one predictor.

    Parameters
    ----------
    ends : sequence of Connection
        To the processes.
    known : sequence of OrderedDict
        Predictors that each of them has.
    recipe : Recipe
    fixed : mapping
        See :attr:`evanesce.prediction.predict.Predictor.fixed`.
    work : callable
        ``work(predictor, *arguments)``, at the top of a module.
    tasks : sequence of tuple
        Arguments.
    places : sequence of int, optional
        Which process each task is meant for: one that has done its own does the others' last ones. By default the
        first that is free.
    """

    def __init__(
        self,
        ends: Sequence[Connection],
        known: Sequence[OrderedDict[int, None]],
        recipe: Recipe,
        fixed: Mapping[str, Any],
        work: Callable[..., Any],
        tasks: Sequence[tuple[Any, ...]],
        places: Sequence[int] | None = None,
    ) -> None:
        self._ends, self._known, self._recipe, self._fixed, self._work = ends, known, recipe, fixed, work
        self._tasks = tasks
        shared = deque(range(len(tasks)))
        own = [deque(k for k, at in enumerate(places or ()) if at == place) for place in range(len(ends))]
        self._left = [shared] * len(ends) if places is None else own
        self._found: list[Any] = [None] * len(tasks)
        self._open = [0] * len(ends)
        for _ in range(AHEAD):
            for place in range(len(ends)):
                self._send(place)

    def _send(self, place: int) -> None:
        own, longest = self._left[place], max(self._left, key=len)
        if not longest:
            return
        task, number = own.popleft() if own else longest.pop(), self._recipe.number
        recipe = None if number in self._known[place] else self._recipe
        _used(self._known[place], number, None)
        self._open[place] += 1
        with _ended():
            self._ends[place].send((task, number, recipe, self._fixed, self._work, self._tasks[task]))

    def results(self, told: Callable[[int], None] = lambda done: None) -> list[Any]:
        """Wait for the results, in the order of the tasks; what was refused is an InputError in its place.

        Parameters
        ----------
        told : callable
            Told how many are done.

        Raises
        ------
        WorkError
            If a task has failed, or a process has ended.
        """
        failed: list[WorkError] = []
        done = 0
        while any(self._open):
            busy = {self._ends[place]: place for place, count in enumerate(self._open) if count}
            for end in wait(list(busy)):
                place = busy[end]  # type: ignore[index]
                with _ended():
                    task, answer = self._ends[place].recv()
                self._open[place] -= 1
                self._found[task] = answer
                if isinstance(answer, WorkError):
                    failed.append(answer)
                if isinstance(answer, Exception):
                    # Whether the predictor was made there is not known.
                    self._known[place].pop(self._recipe.number, None)
                done += 1
                told(done)
                self._send(place)
        if failed:
            raise failed[0]
        return self._found


class Processes:
    """Some processes that predict.

    Parameters
    ----------
    count : int
    """

    def __init__(self, count: int) -> None:
        # What has not started threads of its own may not be copied while another thread runs.
        context = multiprocessing.get_context("spawn")
        self.count = count
        self._last: Batch | None = None
        self._ends: list[Connection] = []
        self._known: list[OrderedDict[int, None]] = [OrderedDict() for _ in range(count)]
        self._running = []
        for _ in range(count):
            here, there = context.Pipe()
            process = context.Process(target=_serve, args=(there,), daemon=True)
            process.start()
            there.close()
            self._ends.append(here)
            self._running.append(process)

    def begin(
        self,
        recipe: Recipe,
        fixed: Mapping[str, Any],
        work: Callable[..., Any],
        tasks: Sequence[tuple[Any, ...]],
        places: Sequence[int] | None = None,
    ) -> Batch:
        """Begin tasks, after those that nobody has waited for; arguments as of :class:`Batch`."""
        if self._last is not None:
            self._last.results()
        self._last = Batch(self._ends, self._known, recipe, fixed, work, tasks, places)
        return self._last

    def close(self) -> None:
        """End the processes."""
        for end in self._ends:
            end.close()
        for process in self._running:
            process.join(timeout=5.0)
            process.kill()


def shares(views: Sequence[View], count: int) -> list[list[int]]:
    """Return the views that each of some processes has: states of one force together, about as much work for each.

    Cards and contacts are shared out apart from each other, as the fine model predicts them one after the other, and
    what is locked apart from what each step of a fit asks for.

    Parameters
    ----------
    views : sequence of View
    count : int
    """
    found: list[list[int]] = [[] for _ in range(count)]
    for card, locked in itertools.product((False, True), repeat=2):
        alike: dict[Any, list[int]] = {}
        for k, view in enumerate(views):
            if (view.is_card, view.locked) == (card, locked):
                alike.setdefault((view.force_N, view.touches or view.kind, view.session), []).append(k)
        load = [0] * count
        for group in sorted(alike.values(), key=len, reverse=True):
            least = min(range(count), key=lambda place: (load[place], len(found[place])))
            load[least] += STATE_VIEWS + len(group)
            found[least].extend(group)
    return found


def present() -> Processes | None:
    """Return the processes that share the work; None where there is this one alone."""
    return _present[-1] if _present else None


@contextmanager
def processes(count: int) -> Iterator[None]:
    """Predict by so many processes while the context lasts; with fewer than two by this one.

    Parameters
    ----------
    count : int
    """
    if count < 2:
        yield
        return
    these = Processes(count)
    _present.append(these)
    try:
        yield
    finally:
        _present.remove(these)
        these.close()


@contextmanager
def _ended() -> Iterator[None]:
    """Say what it means that nobody is at the other end."""
    try:
        yield
    except (EOFError, OSError) as error:
        raise WorkError("a process that predicts frames has ended: out of memory?") from error


def _used(kept: OrderedDict[int, Any], number: int, value: Any) -> None:
    """Keep a predictor, and no more than :data:`KEEP`; either side of a connection does alike."""
    kept[number] = value
    kept.move_to_end(number)
    while len(kept) > KEEP:
        kept.popitem(last=False)


def _serve(end: Connection) -> None:
    """Do what is asked for until nobody asks any more."""
    cv2.setNumThreads(1)
    threads.THREADS = 1  # its thread pool is created on first use
    made: OrderedDict[int, Any] = OrderedDict()
    while True:
        try:
            task, number, recipe, fixed, work, arguments = end.recv()
        except EOFError:
            return
        try:
            _used(made, number, made[number] if number in made else recipe.make(**recipe.options))
            made[number].fixed = fixed
            answer: Any = work(made[number], *arguments)
        except InputError as error:
            answer = error
        except Exception:
            answer = WorkError(f"a process that predicts frames failed: {traceback.format_exc()}")
        end.send((task, answer))
