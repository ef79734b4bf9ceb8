"""File names, atomic writes and locks of a dataset."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from evanesce.core.errors import InputError, WorkError

FORMAT = "evanesce-dataset"
FORMAT_VERSION = 5
"""Incremented when a member or number changes its meaning; :data:`EARLIER` lists the changes."""
EARLIER = {
    1: "its stick_ratio is 0, as under full slip, where the finger is lifted",
    2: "its stick_ratio may be 0, as under full slip, where the finger is lifted",
    3: "its labels have no strength, and torque, stick ratio and slip of ridged fingers disagree with its maps",
    4: "its numbers have no rotation, its trials no motion",
}
"""Differences of earlier versions of the format."""
DESCRIPTION = "dataset.json"
MANIFEST = "manifest.sqlite"
SCHEMA = "schema.json"
DATA_CARD = "croissant.json"
SUMS = "SHA256SUMS"
SHARDS = "shards"
WORK = ".work"

_SHARD_NAME = re.compile(r"shard-\d{6}\.tar")


def shard_name(shard: int) -> str:
    """Return a shard's file name."""
    return f"shard-{shard:06d}.tar"


def shard_path(folder: Path, shard: int) -> Path:
    """Return the path of a shard."""
    return folder / SHARDS / shard_name(shard)


def is_shard_name(name: str) -> bool:
    """Return whether a name is a valid shard name."""
    return _SHARD_NAME.fullmatch(name) is not None


def frame_key(frame: int) -> str:
    """Return the key of a frame's members; keys sort as numbers."""
    return f"{frame:09d}"


def fsync_folder(folder: Path) -> None:
    """Flush a folder, so that renames in it persist."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file atomically: temporary file, fsync, rename, fsync of the folder.

    Raises
    ------
    WorkError
        If the system refuses.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        try:
            with part.open("wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(part, path)
            fsync_folder(path.parent)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise cannot_write(path, error) from None


def cannot_write(path: Path, error: OSError) -> WorkError:
    """Return the error of a refused write."""
    return WorkError(f"{path}: cannot write: {error.strerror or error}")


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically, keys sorted, so that equal values are equal bytes."""
    write_whole(path, (json.dumps(value, sort_keys=True, indent=1, allow_nan=False) + "\n").encode())


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises
    ------
    InputError
        If it is absent or broken.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError("no such file", file=path, allowed="a folder of `evanesce dataset make`") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"not readable: {error}", file=path) from None


def make_folders(folder: Path) -> None:
    """Create a dataset's folders.

    Raises
    ------
    WorkError
        If the system refuses.
    """
    try:
        for part in (folder, folder / SHARDS, folder / WORK):
            part.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from None


@contextmanager
def generator_lock(folder: Path, part: tuple[int, int] | None = None) -> Iterator[None]:
    """Lock a dataset for writing; a second generator is refused at once.

    A full run takes an exclusive lock; a part of a job array a shared one, and an exclusive one of its own. Locks end
    with the process.

    Raises
    ------
    WorkError
        If another generator holds it, or the file system refuses.
    """
    handles = []
    try:
        mode = fcntl.LOCK_EX if part is None else fcntl.LOCK_SH
        handles.append(_locked(folder / WORK / "lock", mode))
        if part is not None:
            handles.append(_locked(folder / WORK / f"lock-{part[0]}-of-{part[1]}", fcntl.LOCK_EX))
        yield
    finally:
        for handle in handles:
            os.close(handle)


def _locked(path: Path, mode: int) -> int:
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise cannot_write(path, error) from None
    try:
        fcntl.flock(handle, mode | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        if error.errno in (errno.EAGAIN, errno.EACCES):
            raise WorkError(f"{path.parent.parent}: another generator is writing this dataset") from None
        raise cannot_write(path, error) from None
    return handle
