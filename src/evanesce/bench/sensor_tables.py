"""Tables of a sensor's bench test: photon transfer (mean and variance) and dark variance against exposure."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evanesce.bench.dark_signal import DarkSeries
from evanesce.core.columns import Column, read_columns, read_rows
from evanesce.core.errors import InputError

Floats = NDArray[np.float64]

TRANSFER_COLUMNS = (
    Column("mean", ("signal", "mean_signal"), "signal"),
    Column("variance", ("var", "temporal_variance"), "variance"),
)
GROUP_HEADINGS = ("bayer_class", "class", "channel", "colour", "color", "group")
PLAUSIBLE_TEMPERATURE_C = (-80.0, 120.0)


@dataclass(frozen=True)
class TransferTable:
    """Rows of a photon transfer table of one kind of pixels.

    Attributes
    ----------
    name : str
        Of the pixels.
    mean_DN : ndarray (n,)
        With the black level in it [DN].
    variance_DN2 : ndarray (n,)
        [DN^2].
    """

    name: str
    mean_DN: Floats
    variance_DN2: Floats


def is_transfer(path: Path) -> bool:
    """Return whether a table has means beside its variances: photon transfer; otherwise it is a dark series.

    Parameters
    ----------
    path : Path
    """
    return any(re.match(r"\s*(mean|signal)", heading.lower()) for heading in read_rows(path)[0])


def read_transfer(path: Path, full_DN: float) -> dict[str, TransferTable]:
    """Read ``mean_DN, variance_DN2`` and, optionally, a column that names the pixels' kind (``bayer_class``).

    Parameters
    ----------
    path : Path
    full_DN : float
        Largest number of the converter [DN].

    Returns
    -------
    dict of TransferTable
        By the name of the kind; ``"all"`` without such a column.

    Raises
    ------
    InputError
        For missing columns or units, negative variances, and means outside the converter's range.
    """
    data = read_columns(path, TRANSFER_COLUMNS)
    for name, values, high, unit in (
        ("mean", data["mean"], full_DN, "DN"), ("variance", data["variance"], full_DN**2 / 4.0, "DN2")
    ):  # fmt: skip
        _check(values, 0.0, high, path, name, unit)
    rows = read_rows(path)
    column = next((i for i, h in enumerate(rows[0]) if h.strip().lower() in GROUP_HEADINGS), None)
    kinds = np.array(["all" if column is None else row[column] for row in rows[1:]])
    return {
        str(kind): TransferTable(str(kind), data["mean"][kinds == kind], data["variance"][kinds == kind])
        for kind in dict.fromkeys(kinds)
    }


def read_dark(path: Path, temperature_C: float | None = None) -> list[DarkSeries]:
    """Read ``exposure_s`` and one or more columns ``variance..._DN2`` of covered frames, sorted by exposure.

    Parameters
    ----------
    path : Path
        A column ``temperature_C`` splits it into series.
    temperature_C : float, optional
        Where the table has no such column [degC].

    Returns
    -------
    list of DarkSeries

    Raises
    ------
    InputError
        For missing columns, units or temperature, negative figures, and a series without exposure 0 to compare with.
    """
    headings = read_rows(path)[0]
    names = {_variance_name(h): h for h in headings if h.strip().lower().startswith("variance")}
    if not names:
        raise InputError("no column 'mean' and none that begins with 'variance'", file=path, allowed="variance_DN2")
    columns = [Column(name, (), "variance") for name in names]
    data = read_columns(
        path, [Column("exposure", ("exposure_time", "t"), "time"),
               Column("temperature", ("temp",), "temperature", required=False), *columns]
    )  # fmt: skip
    exposure = data["exposure"]
    _check(exposure, 0.0, 1e5, path, "exposure", "s")
    if "temperature" not in data and temperature_C is None:
        raise InputError(
            "has no temperature", file=path, key="temperature_C", allowed="a column, or --temperature-C for this file"
        )
    temperature = data.get("temperature", np.full(exposure.size, np.nan if temperature_C is None else temperature_C))
    _check(temperature, *PLAUSIBLE_TEMPERATURE_C, path, "temperature", "degC")
    found = []
    for at in np.unique(temperature):
        here = np.flatnonzero(temperature == at)
        here = here[np.argsort(exposure[here], kind="stable")]
        for name in names:
            variance = data[name][here]
            _check(variance, 0.0, 1e9, path, name, "DN2")
            if not variance[0] > 0.0:
                raise InputError("the shortest exposure has no variance", file=path, key=names[name], allowed="above 0")
            found.append(DarkSeries(_short(name), float(at), exposure[here], variance))
    return found


def by_kind(series: list[DarkSeries]) -> Mapping[str, list[DarkSeries]]:
    """Return dark series by the kind of their pixels, each sorted by temperature.

    Parameters
    ----------
    series : list of DarkSeries
    """
    kinds: dict[str, list[DarkSeries]] = {}
    for one in sorted(series, key=lambda s: s.temperature_C):
        kinds.setdefault(one.name, []).append(one)
    return kinds


def _variance_name(heading: str) -> str:
    bare = re.sub(r"[\s_]*[\[(]?\s*dn(\^?2|²)\s*[\])]?\s*$", "", heading.strip().lower())
    return re.sub(r"[^a-z0-9]+", "_", bare).strip("_")


def _short(name: str) -> str:
    return name.removeprefix("variance").strip("_") or "all"


def _check(values: Floats, low: float, high: float, path: Path, key: str, unit: str) -> None:
    """Name the first row that lies outside a range."""
    bad = np.flatnonzero(~((values >= low) & (values <= high)))
    if bad.size:
        raise InputError(
            f"row {bad[0] + 2}: {values[bad[0]]:g} {unit}", file=path, key=key, allowed=f"{low:g} to {high:g} {unit}"
        )
