"""Read the tables of a bundle strictly: every error names file, line and column."""

from __future__ import annotations

import csv
import difflib
import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from evanesce.bundle.layout import (
    CHOSEN,
    SERIES_X,
    SERIES_Y,
    SHEARED,
    SHOT_COLUMNS,
    Column,
    Series,
    Shot,
    conditions,
)
from evanesce.core.errors import InputError

MAX_TABLE_BYTES = 20_000_000
MAX_LINES = 1_000_000


def read_table(path: Path, columns: Mapping[str, Column]) -> dict[str, list[float | None]]:
    """Read a CSV table whose columns are known.

    Parameters
    ----------
    path : Path
    columns : Mapping
        Allowed columns.

    Returns
    -------
    dict
        Values by column, None for an empty cell; columns that are absent or wholly empty are left out.

    Raises
    ------
    InputError
        For a table that is not readable, an unknown or doubled column, a line of another length, a cell that is no
        finite number within bounds, or a column filled only here and there. Lines count from 1, the header's.
    """
    rows = _rows(path)
    if not rows:
        raise InputError("is empty", file=path, allowed="a header " + ",".join(columns) + " and a line for each frame")
    header = [name.strip() for name in rows[0][1]]
    _check_header(path, header, columns)
    found: dict[str, list[float | None]] = {name: [] for name in header}
    for line, cells in rows[1:]:
        if len(cells) != len(header):
            raise InputError(
                f"{len(cells)} cells", file=path, key=f"line {line}", allowed=f"{len(header)}, as the header has"
            )
        for name, text in zip(header, cells, strict=True):
            found[name].append(_cell(path, line, name, text, columns[name]))
    if not rows[1:]:
        raise InputError("holds no line below its header", file=path, allowed="a line for each frame")
    lines = [line for line, _ in rows[1:]]
    for name in header:
        gaps = [line for line, value in zip(lines, found[name], strict=True) if value is None]
        if len(gaps) == len(lines) and not columns[name].required:
            del found[name]
        elif gaps:
            raise InputError("is empty", file=path, key=f"line {gaps[0]}, column {name}", allowed=str(columns[name]))
    return found


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return the lines that hold anything, each with its number."""
    try:
        if path.stat().st_size > MAX_TABLE_BYTES:
            raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_TABLE_BYTES} bytes")
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream, strict=True)
            found = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot be read: {error}", file=path, allowed="a CSV table in UTF-8") from None
    if len(found) > MAX_LINES:
        raise InputError(f"{len(found)} lines", file=path, allowed=f"at most {MAX_LINES}")
    return found


def _check_header(path: Path, header: list[str], columns: Mapping[str, Column]) -> None:
    for name in header:
        if name not in columns:
            close = difflib.get_close_matches(name, columns, n=1, cutoff=0.0)
            raise InputError(
                f"unknown column {name!r}; nearest: {close[0]}", file=path, key="line 1", allowed=", ".join(columns)
            )
        if header.count(name) > 1:
            raise InputError(f"column {name} stands there twice", file=path, key="line 1", allowed="each column once")
    missing = [name for name, column in columns.items() if column.required and name not in header]
    if missing:
        raise InputError(
            f"column {missing[0]} is missing", file=path, key="line 1", allowed="a header of " + ", ".join(columns)
        )


def _cell(path: Path, line: int, name: str, text: str, column: Column) -> float | None:
    """Return a cell's number; None where it is empty."""
    text = text.strip()
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and column.lo <= value <= column.hi and (not column.whole or value == int(value))):
        raise InputError(f"{text!r}", file=path, key=f"line {line}, column {name}", allowed=str(column))
    return value


def line_numbers(path: Path) -> list[int]:
    """Return the number of each line below the header that holds anything.

    Parameters
    ----------
    path : Path
        CSV table.

    Returns
    -------
    list of int
        From 1, the header's.
    """
    return [line for line, _ in _rows(path)[1:]]


def read_shots(path: Path, voltage_V: float) -> tuple[Shot, ...]:
    """Read ``press.csv`` or ``replicates.csv``.

    Parameters
    ----------
    path : Path
    voltage_V : float
        Of the nominal model, used where the table gives none [V].

    Returns
    -------
    tuple of Shot
        With conditions and hold times.

    Raises
    ------
    InputError
        As :func:`read_table`; if indices do not rise, or the clock does not.
    """
    table = read_table(path, SHOT_COLUMNS)
    count = len(table["index"])
    filled = {
        "voltage_V": [voltage_V] * count,
        "displacement_mm": [math.nan] * count,
        "session": [0.0] * count,
        **{name: [math.nan] * count for name in (*SHEARED, *CHOSEN)},
    } | table
    lines = line_numbers(path)
    for name, what in (("index", "frames in the order of the table"), ("time_s", "times that rise: a clock runs on")):
        for k in range(1, count):
            before, now = _n(table[name][k - 1]), _n(table[name][k])
            if now <= before:
                raise InputError(
                    f"{now:g} comes after {before:g}", file=path, key=f"line {lines[k]}, column {name}", allowed=what
                )
    shots = [
        Shot(
            index=int(_n(filled["index"][k])),
            time_s=_n(filled["time_s"][k]),
            force_N=_n(filled["force_N"][k]),
            voltage_V=_n(filled["voltage_V"][k]),
            displacement_mm=_n(filled["displacement_mm"][k]),
            session=int(_n(filled["session"][k])),
            tangential_force_N=_n(filled["tangential_force_N"][k]),
            slide_mm=_n(filled["slide_mm"][k]),
            torque_Nmm=_n(filled["torque_Nmm"][k]),
            exposure_ms=_n(filled["exposure_ms"][k]),
            analogue_gain=_n(filled["analogue_gain"][k]),
            red_gain=_n(filled["red_gain"][k]),
            blue_gain=_n(filled["blue_gain"][k]),
        )
        for k in range(count)
    ]
    return conditions(shots)


def _n(value: Any) -> float:
    return float(value)


def read_series(path: Path, held: Mapping[str, float]) -> Series:
    """Read a scalar series: two columns, perhaps a third with the standard deviation of the second.

    Parameters
    ----------
    path : Path
    held : Mapping
        From ``measurement.toml``.

    Returns
    -------
    Series

    Raises
    ------
    InputError
        As :func:`read_table`, or if its columns are not x, y and the standard deviation of y.
    """
    rows = _rows(path)
    header = [name.strip() for name in rows[0][1]] if rows else []
    allowed = f"one of {', '.join(SERIES_X)}, then one of {', '.join(SERIES_Y)}, then perhaps sigma in its unit"
    if not (2 <= len(header) <= 3 and header[0] in SERIES_X and header[1] in SERIES_Y and header[0] != header[1]):
        raise InputError(f"columns {', '.join(header) or 'none'}", file=path, key="line 1", allowed=allowed)
    x_name, y_name = header[:2]
    unit = y_name.rpartition("_")[2]
    columns = {x_name: _required(SERIES_X[x_name]), y_name: _required(SERIES_Y[y_name])}
    if len(header) == 3:
        if header[2] != f"sigma_{unit}":
            raise InputError(f"third column {header[2]!r}", file=path, key="line 1", allowed=f"sigma_{unit}")
        columns[header[2]] = _required(Column(1e-12, SERIES_Y[y_name].hi, unit))
    table = read_table(path, columns)
    values = [np.array(table[name], dtype=np.float64) for name in header]
    if x_name == "time_s" and np.any(np.diff(values[0]) <= 0):
        at = int(np.argmax(np.diff(values[0]) <= 0)) + 1
        raise InputError(
            f"{values[0][at]:g} comes after {values[0][at - 1]:g}",
            file=path,
            key=f"line {rows[at + 1][0]}, column time_s",
            allowed="times that rise: a clock runs on",
        )
    for array in values:
        array.flags.writeable = False
    return Series(
        name=path.stem,
        x_name=x_name.rpartition("_")[0],
        x_unit=x_name.rpartition("_")[2],
        y_name=y_name.rpartition("_")[0],
        y_unit=unit,
        x=values[0],
        y=values[1],
        sigma=values[2] if len(header) == 3 else None,
        held=MappingProxyType(dict(held)),
    )


def _required(column: Column) -> Column:
    return Column(column.lo, column.hi, column.unit, required=True, whole=column.whole)
