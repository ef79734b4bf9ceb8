"""The parts of ``evanesce study all``: what a part is, what it finds, and the walk that collects them.

Every module ``<name>_study.py`` or ``<name>_part.py`` of this folder that holds an object ``STUDY`` is a part. A part
returns data; :mod:`evanesce.studies.page` draws it. Long parts keep each row in a :class:`Ledger` as it comes,
so that an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import math
import os
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from evanesce import studies as here
from evanesce.core import provenance
from evanesce.rig import Scene

Progress = Callable[[str, int, int], None]
"""``progress(what, done, total)``, called as work proceeds."""


@dataclass(frozen=True, kw_only=True)
class Series:
    """One curve of a chart; ``low`` and ``high`` are the ends of its interval, where it has one.

    ``points`` draws marks instead of a line.
    """

    label: str
    x: Sequence[float]
    y: Sequence[float]
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None
    points: bool = False
    group: str = ""
    """Curves of one group share a colour."""


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Axes of a chart; labels carry units. ``y_range`` cuts what lies outside; (low, high).

    ``x_names`` stand at 1, 2, ... where the x axis is a list.
    """

    title: str
    x_label: str
    y_label: str
    series: Sequence[Series]
    log_x: bool = False
    log_y: bool = False
    y_range: tuple[float, float] | None = None
    x_names: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Panels side by side, with the sentence that says what they mean."""

    panels: Sequence[Panel]
    caption: str


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A picture (8-bit grey or RGB), with the sentence that says what it means."""

    image: NDArray[np.uint8]
    caption: str


@dataclass(frozen=True, kw_only=True)
class Map:
    """A field over pixels in its own unit; ``unknown`` pixels are drawn grey.

    A ``signed`` field gets a scale that is symmetric about 0, another starts at 0. ``top`` ends the scale.
    """

    title: str
    values: NDArray[np.float64]
    top: float
    signed: bool = False
    unknown: NDArray[np.bool_] | None = None


@dataclass(frozen=True, kw_only=True)
class Maps:
    """Rows of maps, each row with one scale, with the sentence that says what they mean; ``labels`` carry units."""

    rows: Sequence[Sequence[Map]]
    labels: Sequence[str]
    caption: str


@dataclass(frozen=True, kw_only=True)
class Listing:
    """A table of text under headings that carry their units."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What a part found.

    Attributes
    ----------
    verdict : sequence of str
        Sentences, the first of them the answer.
    charts, maps, pictures, tables : sequence
    data : mapping
        The numbers, JSON-able, units in the keys.
    """

    verdict: Sequence[str]
    charts: Sequence[Chart] = ()
    maps: Sequence[Maps] = ()
    pictures: Sequence[Shown] = ()
    tables: Sequence[Listing] = ()
    data: Mapping[str, Any] = field(default_factory=dict)


class Study(Protocol):
    """One part.

    Attributes
    ----------
    name : str
        As on the command line.
    title : str
        Heading.
    order : int
        Place on the page.
    """

    name: str
    title: str
    order: int

    def run(self, scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> Findings:
        """Do the study of a scene; files it keeps go to ``out``, which exists. ``quick`` takes fewer samples."""


@dataclass(frozen=True)
class Part:
    """A study that is one function."""

    name: str
    title: str
    order: int
    work: Callable[..., Findings]

    def run(self, scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> Findings:
        """Call the function."""
        return self.work(scene, out, progress, quick=quick, seed=seed)


def studies() -> list[Study]:
    """Return every part, in the order of the page."""
    found: list[Study] = []
    for folder in pkgutil.iter_modules(here.__path__):
        for name in ("study", "part"):
            module = f"{here.__name__}.{folder.name}.{name}"
            if folder.ispkg and importlib.util.find_spec(module) is not None:
                study = getattr(importlib.import_module(module), "STUDY", None)
                if study is not None:
                    found.append(study)
    return sorted(found, key=lambda study: (study.order, study.name))


Keep = Callable[[str, Callable[[], Mapping[str, Any]]], Mapping[str, Any]]
"""``keep(key, make)`` returns a row: the one put away under the key, else what ``make`` returns."""


def not_kept(key: str, make: Callable[[], Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return the row anew: the :data:`Keep` of a run without a folder."""
    return make()


class Ledger:
    """Rows of a study on disk, one JSON line each; what is there is not computed again.

    Parameters
    ----------
    path : Path
        Of the file. It is begun anew where it belongs to another scene, other settings or other source code.
    belongs_to : object
        JSON-able: everything that the rows depend on.
    """

    def __init__(self, path: Path, belongs_to: Any) -> None:
        self.path = path
        self._digest = provenance.digest({"source": provenance.code_digest(), "of": belongs_to})
        self._rows: dict[str, dict[str, Any]] = {}
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        if self._own(lines):
            for line in lines[1:]:
                entry = _parsed(line)  # a killed run leaves half a line at the end
                if entry is not None and isinstance(entry.get("row"), dict):
                    self._rows[str(entry.get("key"))] = entry["row"]
        head = json.dumps({"sha256": self._digest})
        kept = [json.dumps({"key": key, "row": row}) for key, row in self._rows.items()]
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        temporary.write_text("\n".join([head, *kept]) + "\n", encoding="utf-8")
        temporary.replace(path)

    def _own(self, lines: list[str]) -> bool:
        head = _parsed(lines[0]) if lines else None
        return head is not None and head.get("sha256") == self._digest

    def __contains__(self, key: str) -> bool:
        return key in self._rows

    def __len__(self) -> int:
        return len(self._rows)

    def row(self, key: str, make: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
        """Return a row, computed and put away if it is not there yet; NaN and infinity become None."""
        if key not in self._rows:
            row = {name: _finite(value) for name, value in make().items()}
            with self.path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps({"key": key, "row": row}, allow_nan=False) + "\n")
            self._rows[key] = row
        return self._rows[key]


def _parsed(line: str) -> dict[str, Any] | None:
    try:
        entry = json.loads(line)
    except ValueError:
        return None
    return entry if isinstance(entry, dict) else None


def _finite(value: Any) -> Any:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
