"""Manifest of a dataset: a SQLite file with a row per shard, frame, member, and frame that could not be made."""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from evanesce.core.errors import InputError, WorkError
from evanesce.dataset import layout
from evanesce.dataset.shard import Member, ShardIndex

_TABLES = """
CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE shards (shard INTEGER PRIMARY KEY, file TEXT NOT NULL UNIQUE, size INTEGER NOT NULL, sha256 TEXT NOT NULL);
CREATE TABLE frames (
    frame INTEGER PRIMARY KEY, key TEXT NOT NULL UNIQUE, shard INTEGER NOT NULL REFERENCES shards,
    trial INTEGER NOT NULL, split TEXT NOT NULL, kind TEXT NOT NULL, seed INTEGER NOT NULL, time_s REAL NOT NULL);
CREATE TABLE members (
    frame INTEGER NOT NULL REFERENCES frames, name TEXT NOT NULL, offset INTEGER NOT NULL, size INTEGER NOT NULL,
    sha256 TEXT NOT NULL, PRIMARY KEY (frame, name)) WITHOUT ROWID;
CREATE TABLE quarantine (frame INTEGER PRIMARY KEY, trial INTEGER NOT NULL, reason TEXT NOT NULL);
"""


class Manifest:
    """An open manifest.

    Parameters
    ----------
    path : Path
    connection : sqlite3.Connection
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path, self._db = path, connection
        self._db.row_factory = sqlite3.Row

    @classmethod
    def create(cls, path: Path, meta: dict[str, str]) -> Manifest:
        """Make an empty manifest."""
        db = sqlite3.connect(path)
        try:
            db.executescript("PRAGMA journal_mode=DELETE; PRAGMA synchronous=FULL;" + _TABLES)
            with db:
                db.executemany("INSERT INTO meta VALUES (?, ?)", sorted(meta.items()))
        except BaseException:
            db.close()
            raise
        return cls(path, db)

    @classmethod
    def begin(cls, path: Path, meta: dict[str, str]) -> Manifest:
        """Make an empty manifest atomically, and open it.

        Raises
        ------
        WorkError
            If the system refuses.
        """
        with _whole(path) as part:
            cls.create(part, meta).close()
        return cls.open(path, write=True)

    @classmethod
    def open(cls, path: Path, *, write: bool = False) -> Manifest:
        """Open a manifest.

        Raises
        ------
        InputError
            If it is absent or not one.
        """
        if not path.is_file():
            raise InputError("no such file", file=path, allowed="a folder of `evanesce dataset make`")
        mode = "rw" if write else "ro"
        try:
            db = sqlite3.connect(f"file:{_quoted(path)}?mode={mode}", uri=True)
            if write:
                db.execute("PRAGMA synchronous=FULL")
            db.execute("SELECT count(*) FROM shards").fetchone()
        except sqlite3.Error as error:
            raise InputError(f"not a readable manifest: {error}", file=path) from None
        return cls(path, db)

    def add(self, index: ShardIndex) -> None:
        """Insert the rows of a published shard in one transaction."""
        with self._writing():
            self._insert(index)

    def _insert(self, index: ShardIndex) -> None:
        db = self._db
        db.execute("INSERT INTO shards VALUES (?, ?, ?, ?)", (index.shard, index.file, index.size, index.sha256))
        db.executemany(
            "INSERT INTO frames VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            [
                (f["frame"], f["key"], index.shard, f["trial"], f["split"], f["kind"], f["seed"], f["time_s"])
                for f in index.frames
            ],
        )
        db.executemany(
            "INSERT INTO members VALUES (?, ?, ?, ?, ?)",
            [(m.frame, m.name, m.offset, m.size, m.sha256) for m in index.members],
        )
        db.executemany(
            "INSERT INTO quarantine VALUES (?, ?, ?)",
            [(q["frame"], q["trial"], q["reason"]) for q in index.quarantined],
        )

    def seal(self, path: Path) -> None:
        """Write the same rows, ordered, into a new file, so that its bytes do not depend on the order of work.

        Raises
        ------
        WorkError
            If the system refuses; the manifest is then as it was.
        """
        meta = {**self.meta(), "sealed": "1", "content_sha256": self.content_digest()}
        with _whole(path) as part:
            with closing(Manifest.create(part, meta)) as ordered, ordered._db as db:
                for table, order in _ORDER.items():
                    rows = self._db.execute(f"SELECT * FROM {table} ORDER BY {order}")
                    for row in rows:
                        db.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * len(row))})", tuple(row))
            self.close()

    def content_digest(self) -> str:
        """Return the SHA-256 of all rows except those of ``meta``, ordered."""
        digest = hashlib.sha256()
        for table, order in _ORDER.items():
            for row in self._rows(f"SELECT * FROM {table} ORDER BY {order}"):
                digest.update((json.dumps([table, *tuple(row)]) + "\n").encode())
        return digest.hexdigest()

    def meta(self) -> dict[str, str]:
        """Return the metadata of the dataset."""
        return {row["name"]: row["value"] for row in self._rows("SELECT * FROM meta")}

    def shards(self) -> dict[int, dict[str, Any]]:
        """Return the rows of the shards."""
        return {row["shard"]: dict(row) for row in self._rows("SELECT * FROM shards ORDER BY shard")}

    def frames(self) -> list[dict[str, Any]]:
        """Return the rows of the frames, in order."""
        return [dict(row) for row in self._rows("SELECT * FROM frames ORDER BY frame")]

    def members(self, frame: int) -> dict[str, Member]:
        """Return a frame's members by extension."""
        rows = self._rows("SELECT * FROM members WHERE frame = ?", (frame,))
        return {row["name"]: Member(*tuple(row)) for row in rows}

    def all_members(self) -> dict[int, dict[str, Member]]:
        """Return every frame's members by extension."""
        found: dict[int, dict[str, Member]] = {}
        for row in self._rows("SELECT * FROM members ORDER BY frame, offset"):
            found.setdefault(row["frame"], {})[row["name"]] = Member(*tuple(row))
        return found

    def members_of_shard(self, shard: int) -> list[Member]:
        """Return a shard's members by offset."""
        rows = self._rows(
            "SELECT m.* FROM members m JOIN frames f ON f.frame = m.frame WHERE f.shard = ? ORDER BY m.offset", (shard,)
        )
        return [Member(*tuple(row)) for row in rows]

    def quarantined(self) -> list[dict[str, Any]]:
        """Return the frames that could not be made, and why."""
        return [dict(row) for row in self._rows("SELECT * FROM quarantine ORDER BY frame")]

    def fault(self) -> str:
        """Return the fault that SQLite's integrity check finds in the file; empty if none."""
        try:
            found = [row[0] for row in self._db.execute("PRAGMA integrity_check(1)")]
        except sqlite3.Error as error:
            return str(error)
        return "" if found == ["ok"] else "; ".join(map(str, found))

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    def _rows(self, query: str, values: tuple[Any, ...] = ()) -> list[sqlite3.Row]:
        try:
            return self._db.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise InputError(f"not a readable manifest: {error}", file=self.path) from None

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            with self._db:
                yield
        except sqlite3.Error as error:
            raise WorkError(f"{self.path}: cannot write: {error}") from None


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path for a SQLite file, and move it to its own afterwards; leave nothing on failure."""
    part = path.with_name(f".{path.name}.part")
    journal = part.with_name(f"{part.name}-journal")
    try:
        try:
            part.unlink(missing_ok=True)
            yield part
            with part.open("rb+") as stream:
                os.fsync(stream.fileno())
            os.replace(part, path)
            layout.fsync_folder(path.parent)
        finally:
            part.unlink(missing_ok=True)
            journal.unlink(missing_ok=True)
    except OSError as error:
        raise layout.cannot_write(path, error) from None
    except sqlite3.Error as error:  # SQLite reports a full disk by its own errors
        raise WorkError(f"{path}: cannot write: {error}") from None


_ORDER = {"shards": "shard", "frames": "frame", "members": "frame, name", "quarantine": "frame"}


def _quoted(path: Path) -> str:
    from urllib.parse import quote

    return quote(str(path.resolve()))
