"""Forces of a load cell from a CSV file with its own clock and rate."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.measurement.warnings import Warning

MAX_BYTES = 100_000_000
MOST_PLAUSIBLE_N = 100.0
"""Force above which it is probably in grams or in the counts of an amplifier [N]."""

UNITS = {"n": 1.0, "mn": 1e-3, "kn": 1e3, "g": 9.80665e-3, "gf": 9.80665e-3, "kg": 9.80665, "kgf": 9.80665}
"""Newtons in a unit; standard gravity by the 3rd CGPM (1901)."""

TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
ALLOWED = "a header with a time (time_s) and a force (force_N), separated by comma, semicolon or tab; times that rise"


@dataclass(frozen=True)
class ForceLog:
    """Force against the load cell's own time.

    Attributes
    ----------
    time_s, force_N : ndarray (n,)
        Times rise.
    warnings : tuple of Warning
    """

    time_s: NDArray[np.float64]
    force_N: NDArray[np.float64]
    warnings: tuple[Warning, ...] = ()

    def at(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the force at times of its own clock [N], by straight lines; NaN outside the log."""
        return np.asarray(np.interp(times_s, self.time_s, self.force_N, left=math.nan, right=math.nan))


def read_force(path: str | Path) -> ForceLog:
    """Read a table of times and forces.

    Parameters
    ----------
    path : str or Path
        CSV with a header; columns ``time_s`` and ``force_N``, or with another unit's suffix (``time_ms``, ``force_g``,
        ``Force [mN]``); others are not read.

    Returns
    -------
    ForceLog

    Raises
    ------
    InputError
        If the file is not readable, a column is missing or doubled, a cell is no finite number or times do not rise.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", file=path, key="--force", allowed=ALLOWED)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_BYTES} bytes")
        text = path.read_text(encoding="utf-8-sig")
        first = text.split("\n", 1)[0]
        mark = max((",", ";", "\t"), key=first.count)
        lines = list(csv.reader(text.splitlines(), delimiter=mark, strict=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot be read: {error}", file=path, allowed=ALLOWED) from None
    numbered = [(n, row) for n, row in enumerate(lines, 1) if any(cell.strip() for cell in row)]
    if len(numbered) < 3:
        raise InputError("holds fewer than two lines below its header", file=path, allowed=ALLOWED)
    time_at, time_unit = _column(path, numbered[0][1], "time", TIMES)
    force_at, force_unit = _column(path, numbered[0][1], "force", UNITS)
    times, forces = [], []
    for number, row in numbered[1:]:
        if len(row) != len(numbered[0][1]):
            raise InputError(f"{len(row)} cells", file=path, key=f"line {number}", allowed="as many as the header")
        times.append(_number(path, number, row[time_at], mark) * time_unit)
        forces.append(_number(path, number, row[force_at], mark) * force_unit)
        if len(times) > 1 and times[-1] <= times[-2]:
            raise InputError(f"time {row[time_at]} does not rise", file=path, key=f"line {number}", allowed=ALLOWED)
    time, force = np.array(times), np.array(forces)
    return ForceLog(time, force, tuple(force_doubts(path.name, force)))


def _column(path: Path, header: list[str], name: str, units: dict[str, float]) -> tuple[int, float]:
    """Return place and unit of the column of a quantity."""
    found = []
    for place, title in enumerate(header):
        words = title.strip().lower().replace("[", "_").replace("(", "_").rstrip("])").replace(" ", "_").split("_")
        if words[0] in (name, name[0]):
            found.append((place, words[-1] if len(words) > 1 else next(iter(units)), title.strip()))
    if len(found) != 1:
        what = "no column" if not found else "more than one column"
        raise InputError(f"{what} of {name} in {', '.join(header)}", file=path, key="line 1", allowed=ALLOWED)
    place, unit, title = found[0]
    if unit not in units:
        raise InputError(f"{title!r}", file=path, key="line 1", allowed=f"{name} in {', '.join(units)}")
    return place, units[unit]


def _number(path: Path, line: int, text: str, mark: str) -> float:
    text = text.strip()
    try:
        value = float(text.replace(",", ".") if mark != "," else text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{text!r}", file=path, key=f"line {line}", allowed="a finite number")
    return value


def force_doubts(name: str, force: NDArray[np.float64], grams: str = "name the column force_g") -> list[Warning]:
    """Return what makes forces doubtful: grams or counts in place of newtons, a sign turned round.

    Parameters
    ----------
    name : str
        Of their table.
    force : ndarray (n,)
        [N].
    grams : str
        What to do with grams.
    """
    most, least = float(force.max()), float(force.min())
    found = []
    if max(most, -least) > MOST_PLAUSIBLE_N:
        found.append(
            Warning(
                "force_implausible",
                f"{name} reaches {max(most, -least):.4g} N: is it in grams (then {grams}) or counts?",
            )
        )
    if -least > 0.5 * max(most, 1e-12):
        found.append(
            Warning(
                "force_negative",
                f"{name} falls to {least:.4g} N: pressing counts as positive; is its sign turned?",
            )
        )
    return found
