"""Progress of a command: a bar on a terminal, a line every ten seconds in a log, both with an estimate of time left."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.text import Text

LINE_S = 10.0
"""Time between two lines of a log [s]."""


def duration(seconds: float) -> str:
    """Return a time [s] in words: ``42 s``, ``17 min``, ``2.5 h``."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


class CommandProgress(Progress):
    """Progress of the tasks of one command.

    Parameters
    ----------
    console : rich.console.Console
        A terminal gets bars. Anything else, a file or a pipe, gets a line for each unfinished task every ``line_s``.
    line_s : float
        [s]
    clock : callable
        Current time [s]; monotonic.
    """

    def __init__(self, console: Console, line_s: float = LINE_S, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            _StateColumn(self),
            console=console,
            transient=not console.is_terminal,
            get_time=clock,
        )
        self._line_s, self._clock = line_s, clock
        self._begun: dict[TaskID, tuple[float, float]] = {}
        self._named: dict[str, TaskID] = {}
        self._logged: set[TaskID] = set()
        self._ended = threading.Event()
        self._logger: threading.Thread | None = None

    def start(self) -> None:
        """Show the bars, or begin to write lines."""
        super().start()
        if not self.console.is_terminal and self._logger is None:
            self._logger = threading.Thread(target=self._log, daemon=True)
            self._logger.start()

    def stop(self) -> None:
        """End the bars or the lines; a task that has lines gets a last one."""
        if self.console.is_terminal:
            super().stop()
        else:
            self.live.stop()  # without the empty line that Progress.stop leaves in a log
        self._ended.set()
        if self._logger is not None:
            self._logger.join()
            self._logger = None
            self._lines()

    def update(self, task_id: TaskID, **changes: Any) -> None:
        """Update a task; steps that its first second finds done, as in a resumed job, do not count for its rate."""
        super().update(task_id, **changes)
        task = self._tasks[task_id]
        if task_id not in self._begun and task.completed:
            self.count_from(task_id, task.completed if (task.elapsed or 0.0) < 1.0 else 0.0)

    def count_from(self, task_id: TaskID, completed: float) -> None:
        """Estimate a task's rate without the first ``completed`` steps, which an earlier run made."""
        task = self._tasks[task_id]
        self._begun[task_id] = (self._clock() if completed else task.start_time or 0.0), completed

    def report(self, name: str, done: int, total: int | None) -> None:
        """Set how many steps of a named task are done; the first call adds the task."""
        if name not in self._named:
            self._named[name] = self.add_task(name, total=total)
        self.update(self._named[name], completed=done, total=total)

    def seconds_left(self, task: Task) -> float | None:
        """Return the estimated time to the end of a task [s] by its mean rate so far; None while that is unknown."""
        started, before = self._begun.get(task.id, (task.start_time, 0.0))
        if started is None or task.total is None or task.completed <= before:
            return None
        return (self._clock() - started) * (task.total - task.completed) / (task.completed - before)

    def state(self, task: Task) -> str:
        """Return time elapsed and left of a task in words."""
        left = None if task.finished else self.seconds_left(task)
        elapsed = f"{duration((task.finished_time if task.finished else task.elapsed) or 0.0)} elapsed"
        rate = str(task.fields.get("rate", ""))
        return ", ".join(
            part for part in (rate, elapsed, "" if left is None else f"about {duration(left)} left") if part
        )

    def _log(self) -> None:
        while not self._ended.wait(self._line_s):
            self._lines()

    def _lines(self) -> None:
        """Write a line of each task that runs, and a last one of each that has lines and ended."""
        for task in self.tasks:
            ended = task.finished or self._ended.is_set()
            if not ended:
                self._logged.add(task.id)
                self._print(task)
            elif task.id in self._logged:
                self._logged.remove(task.id)
                self._print(task)

    def _print(self, task: Task) -> None:
        count = f" {task.completed:.0f}" if task.completed or task.total is not None else ""
        total = "" if task.total is None else f"/{task.total:.0f}"
        line = f"{task.description}{count}{total}, {self.state(task)}"
        self.console.print(line, highlight=False, markup=False, soft_wrap=True)


class _StateColumn(ProgressColumn):
    """Time elapsed and left."""

    def __init__(self, owner: CommandProgress) -> None:
        super().__init__()
        self._owner = owner

    def render(self, task: Task) -> Text:
        """Return the text of a task."""
        return Text(self._owner.state(task))
