"""CSV tables whose headings carry their units, as labs export them: read whole, checked, in canonical units."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError

MAX_CSV_BYTES = 200_000_000

# Factor from the unit in a heading to the canonical unit of each kind.
UNITS: Mapping[str, Mapping[str, float]] = {
    "stress": {"pa": 1e-6, "kpa": 1e-3, "mpa": 1.0, "gpa": 1e3, "n/mm^2": 1.0, "n/mm2": 1.0},
    "length": {"nm": 1e-6, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3},
    "force": {"mn": 1e-3, "n": 1.0, "kn": 1e3},
    "time": {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0},
    "frequency": {"hz": 1.0, "khz": 1e3, "rad/s": 1.0 / (2.0 * np.pi), "rad_per_s": 1.0 / (2.0 * np.pi)},
    "temperature": {"c": 1.0, "degc": 1.0, "°c": 1.0, "k": 1.0},
    "signal": {"dn": 1.0},
    "variance": {"dn2": 1.0, "dn^2": 1.0, "dn²": 1.0},
    "ratio": {"": 1.0, "1": 1.0, "-": 1.0, "%": 0.01, "percent": 0.01},
}


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    name : str
    aliases : sequence of str
        Other headings, without unit.
    kind : str
        Of unit, a key of :data:`UNITS`.
    required : bool
    """

    name: str
    aliases: Sequence[str]
    kind: str
    required: bool = True


def _split(heading: str) -> tuple[str, str]:
    """Split ``"Storage modulus [MPa]"``, ``"storage (MPa)"`` or ``"storage_MPa"`` into (name, unit), lower case."""
    text = heading.strip().lower().lstrip("\ufeff")
    bracketed = re.fullmatch(r"(.*?)\s*[\[(]\s*(.*?)\s*[\])]", text)
    if bracketed:
        return _plain(bracketed.group(1)), bracketed.group(2)
    plain = re.sub(r"\s+", "_", text)
    known = {unit for units in UNITS.values() for unit in units if unit}
    for unit in sorted(known, key=len, reverse=True):
        if plain.endswith("_" + unit):
            return _plain(plain[: -len(unit) - 1]), unit
    return _plain(plain), ""


def _plain(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


def read_rows(path: Path) -> list[list[str]]:
    """Return the non-empty, non-comment rows of a CSV file (comma, semicolon or tab, found from its first row).

    Parameters
    ----------
    path : Path

    Returns
    -------
    list of list of str
        Cells, stripped of blanks.
    """
    if not path.is_file():
        raise InputError("no such file", file=path, allowed="a CSV file")
    if path.stat().st_size > MAX_CSV_BYTES:
        raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_CSV_BYTES} bytes")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise InputError("not UTF-8 text", file=path, allowed="a CSV file") from None
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise InputError("holds no data", file=path)
    delimiter = max(",;\t", key=lines[0].count)
    try:
        return [
            [cell.strip() for cell in row] for row in csv.reader(io.StringIO("\n".join(lines)), delimiter=delimiter)
        ]
    except csv.Error as error:
        raise InputError(f"not readable as CSV: {error}", file=path) from None


def number(text: str, path: Path, row: int, heading: str) -> float:
    """Return a finite number, or name the row and column in which it is not one.

    Parameters
    ----------
    text : str
    path : Path
        Named in errors.
    row : int
        Named in errors, from 1.
    heading : str
        Named in errors.

    Returns
    -------
    float
    """
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"row {row}: {text!r} is not a number", file=path, key=heading) from None
    if not np.isfinite(value):
        raise InputError(f"row {row}: {text!r} is not finite", file=path, key=heading)
    return value


def _assign(headings: list[str], columns: Sequence[Column], path: Path) -> dict[str, tuple[int, float, float]]:
    """Map each wanted column to (index, factor, offset); name what is missing, doubled or in an unknown unit."""
    split = [_split(heading) for heading in headings]
    found: dict[str, tuple[int, float, float]] = {}
    for column in columns:
        names = {column.name, *column.aliases}
        hits = [i for i, (name, _) in enumerate(split) if name in names]
        units = UNITS[column.kind]
        if not hits:
            if column.required:
                example = next(iter(u for u in units if units[u] == 1.0))
                raise InputError(
                    f"no column '{column.name}' among {', '.join(headings)}",
                    file=path,
                    allowed=f"a heading such as {column.name}{'_' + example if example else ''}",
                )
            continue
        if len(hits) > 1:
            raise InputError(f"column '{column.name}' occurs {len(hits)} times", file=path, key=headings[hits[1]])
        unit = split[hits[0]][1]
        if unit not in units:
            raise InputError(
                f"unit {unit!r} of column '{column.name}'" if unit else f"column '{column.name}' has no unit",
                file=path,
                key=headings[hits[0]],
                allowed=", ".join(u for u in units if u),
            )
        # Kelvin is the one unit with an offset.
        found[column.name] = (hits[0], units[unit], -273.15 if unit == "k" else 0.0)
    return found


def read_columns(path: Path, columns: Sequence[Column]) -> dict[str, NDArray[np.float64]]:
    """Read the wanted columns of a CSV file with headings, converted to canonical units.

    Parameters
    ----------
    path : Path
    columns : sequence of Column

    Returns
    -------
    dict of ndarray (rows,)
        Present columns: mm, N, MPa, s, Hz, degC, DN, DN^2, ratio.

    Raises
    ------
    InputError
        With file, row and heading: no such file, no such column, unknown or missing unit, text or NaN for a number.
    """
    rows = read_rows(path)
    headings, body = rows[0], rows[1:]
    found = _assign(headings, columns, path)
    if not body:
        raise InputError("has headings but no rows", file=path)
    data: dict[str, NDArray[np.float64]] = {}
    for name, (index, factor, offset) in found.items():
        values = np.empty(len(body))
        for i, row in enumerate(body):
            if len(row) <= index:
                raise InputError(f"row {i + 2} has {len(row)} columns", file=path, allowed=f"{len(headings)} columns")
            values[i] = number(row[index], path, i + 2, headings[index])
        data[name] = values * factor + offset
    return data
