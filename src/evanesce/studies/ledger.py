"""Finished rows of a study on disk, from which an interrupted run goes on."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from evanesce.core import provenance
from evanesce.core.plain import plain

Keep = Callable[[str, Callable[[], Mapping[str, Any]]], Mapping[str, Any]]
"""``keep(key, make)`` returns a row: the one stored under the key, else what ``make`` returns."""


def not_kept(key: str, make: Callable[[], Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return ``make()``: the :data:`Keep` of a run without a folder.

    Parameters
    ----------
    key : str
    make : callable

    Returns
    -------
    mapping
    """
    return make()


class Ledger:
    """Rows of a study on disk, one JSON line each; what is there is not computed again.

    Parameters
    ----------
    path : Path
        Of the file. It is replaced where it belongs to another scene, other settings or other source code.
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
        """Return a row, computed and stored if it is not there yet.

        Parameters
        ----------
        key : str
        make : callable
            ``make() -> mapping`` of what JSON can hold, arrays included.

        Returns
        -------
        dict
            NaN and infinity become None.
        """
        if key not in self._rows:
            row = {name: plain(value) for name, value in make().items()}
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
