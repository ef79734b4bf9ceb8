"""Files of light fields in the user's cache folder: whole or absent, the longest unused beyond a number removed."""

from __future__ import annotations

import contextlib
import os
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import platformdirs
from numpy.typing import NDArray

KEEP_FILES = 12
"""Files in the folder, some 30 MB each for unit light."""


class Folder(NamedTuple):
    """A folder of kept files, and how many are kept there."""

    name: str
    files: int


FIELDS = Folder("fields", KEEP_FILES)


def cache_folder(folder: Folder = FIELDS) -> Path:
    """Return the folder of the files, under ``EVANESCE_CACHE`` or the user's cache folder."""
    return Path(os.environ.get("EVANESCE_CACHE") or platformdirs.user_cache_dir("evanesce")) / folder.name


def read_arrays(key: str, names: Iterable[str], folder: Folder = FIELDS) -> dict[str, NDArray[Any]] | None:
    """Read the named arrays of a key's file.

    Parameters
    ----------
    key : str
        Digest of all that they depend on.
    names : iterable of str
    folder : Folder

    Returns
    -------
    dict of ndarray or None
        By name; None where there is no file that can be read, or a number in it is not finite.
    """
    path = cache_folder(folder) / f"{key}.npz"
    try:
        # Opened here: numpy leaves a file open that turns out to be no archive.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            arrays = {name: data[name] for name in names}
        os.utime(path)
        finite = all(np.isfinite(array).all() for array in arrays.values())
    except (OSError, ValueError, KeyError, EOFError, AttributeError, TypeError, zipfile.BadZipFile):
        return None
    return arrays if finite else None


def write_arrays(key: str, arrays: Mapping[str, NDArray[Any]], folder: Folder = FIELDS) -> None:
    """Write arrays to a key's file, whole or not at all; a folder that cannot be written is no error.

    Parameters
    ----------
    key : str
        Digest of all that they depend on.
    arrays : mapping of ndarray
        By name.
    folder : Folder
    """
    path = cache_folder(folder) / f"{key}.npz"
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, part = tempfile.mkstemp(dir=path.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as stream:
                named: Any = dict(arrays)
                np.savez(stream, **named)
            os.replace(part, path)
        except BaseException:
            Path(part).unlink(missing_ok=True)
            raise
        files = sorted(path.parent.glob("*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
        for old in files[folder.files :]:
            old.unlink(missing_ok=True)
