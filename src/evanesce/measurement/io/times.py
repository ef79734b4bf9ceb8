"""Time stamps of a folder of images, from a table beside them."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from evanesce.core.errors import InputError

TIMES_FILE = "times.csv"
MAX_TIMES_BYTES = 100_000_000


def read_times(folder: Path, names: Sequence[str]) -> list[float] | None:
    """Read the times of images from the folder's ``times.csv`` with the columns ``file`` and ``time_s``.

    Parameters
    ----------
    folder : Path
    names : sequence of str
        File names in the order in which they are to be read.

    Returns
    -------
    list of float or None
        Time of each image [s]; None where there is no such table.

    Raises
    ------
    InputError
        If the table is not readable, misses a column or an image, or its times are not finite and rising.
    """
    path = folder / TIMES_FILE
    if not path.is_file():
        return None
    allowed = f"columns file and time_s, one line to each image, times rising; or no {TIMES_FILE}"
    try:
        if path.stat().st_size > MAX_TIMES_BYTES:
            raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_TIMES_BYTES} bytes")
        with path.open(newline="", encoding="utf-8-sig") as stream:
            lines = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot be read: {error}", file=path, allowed=allowed) from None
    found: dict[str, float] = {}
    for number, line in enumerate(lines, start=2):
        try:
            time = float(line["time_s"])
            name = line["file"]
        except (KeyError, TypeError, ValueError):
            raise InputError("no file and time_s", file=path, key=f"line {number}", allowed=allowed) from None
        if not math.isfinite(time):
            raise InputError(f"time_s is {time}", file=path, key=f"line {number}", allowed=allowed)
        found[name] = time
    missing = [name for name in names if name not in found]
    if missing:
        raise InputError(f"{len(missing)} image(s) without a time, first {missing[0]}", file=path, allowed=allowed)
    times = [found[name] for name in names]
    for before, after, name in zip(times, times[1:], names[1:], strict=False):
        if after <= before:
            raise InputError(f"{name} at {after} s comes after {before} s", file=path, allowed=allowed)
    return times
