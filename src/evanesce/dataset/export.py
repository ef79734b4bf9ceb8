"""Export a dataset to another format, atomically: the folder gets its name when it is complete."""

from __future__ import annotations

import importlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path

from evanesce.core.errors import InputError, WorkError
from evanesce.core.extras import require
from evanesce.dataset.read import Dataset

FORMATS = ("hdf5", "lerobot", "coco", "parquet", "rrd", "mcap", "tiff")

_NEEDED = {
    "hdf5": ("export", "h5py"),
    "lerobot": ("export", "pandas", "pyarrow"),
    "parquet": ("export", "pyarrow"),
    "rrd": ("rerun",),
    "mcap": ("mcap",),
    "tiff": ("tiff",),
}
"""Extra of a format, and the modules of it that it needs; all where none is named."""

Advance = Callable[[int], None]


def export(
    folder: Path, target: Path, to: str, *, split: str | None = None, advance: Advance | None = None,
    partial: bool = False,
) -> int:  # fmt: skip
    """Write a dataset in another format; return the number of frames.

    Every member is compared with its SHA-256, since most formats have none.

    Parameters
    ----------
    folder : Path
    target : Path
        New folder.
    to : str
        One of :data:`FORMATS`.
    split : str, optional
    advance : callable, optional
        Called with the count of frames that were written since the last call.
    partial : bool
        Export the finished part of an unfinished dataset.

    Raises
    ------
    InputError
        If the format is unknown, its library is missing, the target exists, the dataset is not finished, or a member
        is not what the manifest says.
    WorkError
        If the system refuses to write.
    """
    if to not in FORMATS:
        raise InputError(f"{to!r}", key="--to", allowed=", ".join(FORMATS))
    if target.exists():
        raise InputError("exists", file=target, key="--out", allowed="a new folder")
    if needed := _NEEDED.get(to):
        require(needed[0], f"export to {to}", *needed[1:])
    module = importlib.import_module(f"evanesce.dataset.export_{to}")
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        part.mkdir(parents=True)
        with Dataset(folder, split=split, check=True) as dataset:
            if not (dataset.complete or partial):
                raise InputError(
                    f"not finished, {len(dataset)} of {dataset.job.frames} frames", file=folder, key="--partial",
                    allowed="a finished dataset (`resume` finishes it), or --partial",
                )  # fmt: skip
            if not len(dataset):
                raise InputError("no frames", file=folder, key="--split", allowed="a split that has some")
            module.write(dataset, part, advance or (lambda count: None))
            count = len(dataset)
        os.replace(part, target)
    except OSError as error:
        raise WorkError(f"{target}: cannot write: {error.strerror or error}") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return count
