"""Progress of commands: lines with an estimate in a log, none for a short task, rates of resumed jobs."""

from __future__ import annotations

import io
import re
import subprocess
import sys
import time

import pytest
from rich.console import Console

from evanesce.cli import common
from evanesce.cli.progress import CommandProgress, duration


class Clock:
    """A clock that tests set [s]."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def logged(line_s: float = 3600.0, clock=time.monotonic) -> tuple[CommandProgress, io.StringIO]:
    """Return a progress that writes into a file, and the file."""
    file = io.StringIO()
    return CommandProgress(Console(file=file, force_terminal=False, width=200), line_s, clock), file


def lines_of(file: io.StringIO) -> list[str]:
    return [line for line in file.getvalue().splitlines() if line.strip()]


def test_a_log_gets_lines_with_an_estimate_while_a_step_runs():
    """No step ends for four periods: lines appear all the same, and a last one when the task ends (20 s a second)."""
    progress, file = logged(line_s=0.1, clock=lambda: 20.0 * time.monotonic())
    with progress:
        task = progress.add_task("designs", total=8)
        progress.update(task, completed=0, total=8)
        time.sleep(0.15)
        progress.update(task, completed=2, total=8)
        time.sleep(0.45)
        progress.update(task, completed=8, total=8)
    lines = lines_of(file)
    assert 4 <= len(lines) <= 7
    form = r"designs \d/8, \d+ s elapsed(, about \d+ s left)?"
    assert all(re.fullmatch(form, line) for line in lines)
    assert sum(line.startswith("designs 2/8") and "about" in line for line in lines) >= 3
    assert re.fullmatch(r"designs 8/8, 1\d s elapsed", lines[-1])


def test_a_short_task_leaves_no_line():
    progress, file = logged()
    with progress:
        progress.update(progress.add_task("frames", total=2), advance=2)
    assert lines_of(file) == []


def test_a_terminal_gets_a_bar_and_no_lines():
    file = io.StringIO()
    progress = CommandProgress(Console(file=file, force_terminal=True, width=120), line_s=0.01)
    with progress:
        task = progress.add_task("frames", total=4)
        progress.advance(task)
        time.sleep(0.1)
    assert "━" in file.getvalue()
    assert "1/4" in file.getvalue()
    assert "frames 1/4, " not in file.getvalue()


def test_time_left_is_that_of_the_mean_rate():
    """3 of 12 steps in 60 s: 180 s for the other nine."""
    clock = Clock()
    progress, _ = logged(clock=clock)
    task = progress.add_task("frames", total=12)
    assert progress.seconds_left(progress.tasks[0]) is None
    clock.now += 20.0
    progress.update(task, advance=1)
    clock.now += 40.0
    progress.update(task, advance=2)
    assert progress.seconds_left(progress.tasks[0]) == pytest.approx(180.0)
    assert progress.state(progress.tasks[0]) == "60 s elapsed, about 3 min left"


@pytest.mark.parametrize("how", ["first update", "count_from"])
def test_steps_of_an_earlier_run_are_no_rate(how):
    """10 of 24 steps are there at once; two more take 30 s each: 12 times 30 s are left, not 12 times 5."""
    clock = Clock()
    progress, _ = logged(clock=clock)
    task = progress.add_task("designs", total=24)
    if how == "count_from":
        clock.now += 50.0
        progress.count_from(task, 10)
    progress.update(task, completed=10)
    for done in (11, 12):
        clock.now += 30.0
        progress.update(task, completed=done)
    assert progress.seconds_left(progress.tasks[0]) == pytest.approx(360.0)


def test_an_unknown_total_has_no_estimate():
    clock = Clock()
    progress, _ = logged(clock=clock)
    task = progress.add_task("frames", total=None, rate="2.00 frames/s")
    clock.now += 7.0
    progress.update(task, completed=14)
    assert progress.state(progress.tasks[0]) == "2.00 frames/s, 7 s elapsed"


def test_named_tasks_are_added_at_their_first_report():
    progress, _ = logged()
    for name, done in (("runs", 0), ("frames", 1), ("runs", 2)):
        progress.report(name, done, 4)
    assert [(t.description, t.completed, t.total) for t in progress.tasks] == [("runs", 2, 4), ("frames", 1, 4)]


@pytest.mark.parametrize(("seconds", "words"), [(0.4, "0 s"), (119.0, "119 s"), (600.0, "10 min"), (9000.0, "2.5 h")])
def test_durations_in_words(seconds, words):
    assert duration(seconds) == words


def test_steps_of_a_command_stand_in_a_log(monkeypatch):
    """Without a terminal a command that only names its steps writes them with the time; a short one writes none."""
    file = io.StringIO()
    monkeypatch.setattr(common, "messages", Console(file=file, force_terminal=False, width=200))
    monkeypatch.setattr(common, "CommandProgress", lambda console: CommandProgress(console, 0.05))
    with common.working("corners") as step:
        time.sleep(0.12)
        step("light")
        time.sleep(0.12)
    lines = lines_of(file)
    assert lines == file.getvalue().splitlines()  # no empty line
    assert re.fullmatch(r"corners, \d+ s elapsed", lines[0])
    assert re.fullmatch(r"light, \d+ s elapsed", lines[-1])
    monkeypatch.setattr(common, "CommandProgress", CommandProgress)
    with common.working("nothing"):
        pass
    assert lines_of(file) == lines


def test_no_runtime_warning_of_a_library_reaches_a_user():
    """The entry point in a process of its own, whose command divides by zero; a warning of another kind is shown."""
    code = (
        "import warnings, numpy as np, evanesce.cli.app as a\n"
        "def work():\n np.zeros(1) / 0\n warnings.warn('seen', UserWarning)\n"
        "a.app = work; a.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "RuntimeWarning" not in done.stderr
    assert "seen" in done.stderr
