"""Run what a tutorial shows: its files, Python and commands, in their order, in an empty folder.

A fenced block is run by its language: ``python`` in one process for the page, ``console`` line by line in bash. A
comment before a block changes that: ``<!-- file: NAME -->`` writes it to a file, ``<!-- not run -->`` leaves it out.
A ``text`` block is what the block before it prints: words are equal, numbers within :data:`TOLERANCE`.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

BLOCK = re.compile(
    r"(?:^<!-- (?P<note>[^>]*) -->\n+)?^```(?P<language>python|console|toml|text)\n(?P<body>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
TOLERANCE = 0.02
"""Of a printed number, relative, or of its last digits: processors round in their own ways."""


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes
    ----------
    language, body : str
    note : str
        Of the comment before it; empty: none.
    line : int
        Where it stands in the page.
    """

    language: str
    body: str
    note: str
    line: int


def blocks(page: str) -> list[Block]:
    """Return the fenced blocks of a page."""
    return [
        Block(m["language"], m["body"], m["note"] or "", page[: m.start("language")].count("\n") + 1)
        for m in BLOCK.finditer(page)
    ]


def same_text(printed: str, shown: str) -> bool:
    """Tell whether an output is the shown one: the same words, and numbers that agree."""
    if NUMBER.sub("#", printed).split() != NUMBER.sub("#", shown).split():
        return False
    pairs = zip(NUMBER.findall(printed), NUMBER.findall(shown), strict=True)
    return all(
        math.isclose(float(a), float(b), rel_tol=TOLERANCE, abs_tol=2 * 10.0 ** -len(b.partition(".")[2]))
        for a, b in pairs
    )


def run_page(page: str, folder: Path, environ: Mapping[str, str], name: str) -> Iterator[Path]:
    """Run a page's blocks in a folder, which is the working directory.

    Yields
    ------
    Path
        Of each file that was written for a ``file`` note.

    Raises
    ------
    AssertionError
        With page and line, if a command fails or prints something else than what is shown.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    printed = ""
    for block in blocks(page):
        where = f"{name}, line {block.line}"
        if block.note == "not run":
            printed = ""
        elif block.note.startswith("file: "):
            path = folder / block.note.removeprefix("file: ")
            path.write_text(block.body, encoding="utf-8")
            yield path
        elif block.language == "python":
            output = io.StringIO()
            with contextlib.redirect_stdout(output):
                exec(compile(block.body, where, "exec"), names)
            printed = output.getvalue()
        elif block.language == "console":
            printed = "".join(_command(line, folder, environ, where) for line in _lines(block.body))
        elif block.language == "text":
            assert same_text(printed, block.body), f"{where}: printed\n{printed}\nshown\n{block.body}"


def _lines(body: str) -> list[str]:
    return [line for line in body.replace("\\\n", " ").splitlines() if line.strip()]


def _command(line: str, folder: Path, environ: Mapping[str, str], where: str) -> str:
    path = str(Path(sys.executable).parent) + os.pathsep + os.environ["PATH"]
    done = subprocess.run(
        ["bash", "-c", line],
        cwd=folder,
        env={**os.environ, "PATH": path, **environ},
        capture_output=True,
        text=True,
        timeout=1500,
        check=False,
    )
    assert done.returncode == 0, f"{where}: {line}\n{done.stdout}\n{done.stderr}"
    return done.stdout
