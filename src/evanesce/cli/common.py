"""Shared by all commands: console, exit codes, atomic output files and folders."""

from __future__ import annotations

import functools
import json
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeVar

import typer
from rich.console import Console

from evanesce.cli.progress import CommandProgress
from evanesce.core.errors import EvanesceError, InputError
from evanesce.core.files import write_bytes, write_text

# Output to a file would be limited to 80 columns.
console = Console() if sys.stdout.isatty() else Console(width=150)
messages = Console(stderr=True)

P = ParamSpec("P")
R = TypeVar("R")

JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the result as JSON to this file.")]
OutOption = Annotated[Path | None, typer.Option("--out", help="Folder for everything the command writes.")]


def handles_errors(command: Callable[P, R]) -> Callable[P, R]:
    """Print errors as one line and set the exit code: 2 for bad input, 1 for failed work."""

    @functools.wraps(command)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except EvanesceError as error:
            print(f"error: {_with_scene(error, kwargs)}", file=sys.stderr)
            raise typer.Exit(error.exit_code) from None
        except (OSError, MemoryError) as error:
            print(f"error: {error.__class__.__name__}: {error}", file=sys.stderr)
            raise typer.Exit(1) from None
        except KeyboardInterrupt:
            print("error: interrupted", file=sys.stderr)
            raise typer.Exit(130) from None

    return wrapped


def _with_scene(error: EvanesceError, given: Mapping[str, Any]) -> EvanesceError:
    """Return an error about a key of the command's scene with the scene's name, where it names no file."""
    from evanesce.rig import Scene

    scene = given.get("scene")
    if not isinstance(error, InputError) or error.file is not None or not isinstance(scene, str) or "config" in given:
        return error
    if (error.key or "").partition(".")[0] not in Scene.model_fields:
        return error
    return InputError(error.what, file=scene, key=error.key, allowed=error.allowed)


@contextmanager
def named_options(options: Mapping[str, str]) -> Iterator[None]:
    """Let errors about parameters of the Python API name the options that set them, e.g. ``{"tune": "--tune"}``."""
    try:
        yield
    except InputError as error:
        key = options.get(error.key or "", error.key)
        raise InputError(error.what, file=error.file, key=key, allowed=error.allowed) from None


def chosen_variant(variant: str) -> Any:
    """Return the Mitsuba variant that works here; print a note where it is a slower one."""
    from evanesce.render.variant import select

    info = select(variant)
    if info.note:
        print(f"note: {info.note}", file=sys.stderr)
    return info


def progress() -> CommandProgress:
    """Return the progress of a command on standard error, with elapsed time and time left."""
    return CommandProgress(messages)


@contextmanager
def working(step: str) -> Iterator[Callable[[str], None]]:
    """Show the step a command is at: a spinner on a terminal, a line every ten seconds in a log.

    Yields
    ------
    callable
        Called with the next step.
    """
    if messages.is_terminal:
        with messages.status(step) as status:
            yield status.update
        return
    with progress() as bar:
        task = bar.add_task(step, total=None)
        yield lambda following: bar.update(task, description=following)


def out_dir(path: Path | None, default: str) -> Path:
    """Create and return the output folder; ``outputs/<default>`` when none is given."""
    folder = path if path is not None else Path("outputs") / default
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file", file=folder, key="--out", allowed="a folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder: {error.strerror}", file=folder, key="--out") from None
    return folder


def check_json_target(path: Path | None) -> None:
    """Refuse an unwritable ``--json`` target before any work is done."""
    if path is None:
        return
    if path.is_dir():
        raise InputError("is a folder", file=path, key="--json", allowed="a file")
    if not path.parent.is_dir():
        raise InputError("its folder does not exist", file=path, key="--json", allowed="a file in an existing folder")
    if not os.access(path.parent, os.W_OK):
        raise InputError("its folder is not writable", file=path, key="--json")


def write_figure(path: Path, figure: Any) -> None:
    """Write a Matplotlib figure as PNG atomically."""
    from evanesce.report.html import figure_png

    write_bytes(path, figure_png(figure))


def warn(lines: Iterable[str]) -> None:
    """Print warnings on standard error.

    Parameters
    ----------
    lines : iterable of str
    """
    for line in lines:
        messages.print(f"warning: {line}", markup=False, highlight=False, soft_wrap=True, style="yellow")


def write_json(path: Path | None, value: Any) -> None:
    """Write JSON atomically; NaN becomes null."""
    if path is not None:
        write_text(path, json.dumps(_plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    """Return JSON-able data: numpy scalars and arrays unpacked, paths as text, non-finite numbers as null."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value
