"""Write the files of a bundle: frames, tables, and a folder that appears whole or not at all."""

from __future__ import annotations

import csv
import io
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.layout import CHOSEN, SHEARED, Shot
from evanesce.core.errors import InputError, WorkError
from evanesce.sensor.codec import write_png

Grey = NDArray[np.uint8]


def write_frame(root: Path, kind: str, index: int, frame: Grey) -> None:
    """Write one frame of a kind under its number in a bundle.

    Parameters
    ----------
    root : Path
        Folder of the bundle.
    kind : str
        Folder of the frame: ``press``, ``replicates``, ``led_off`` ...
    index : int
        Number of the frame.
    frame : ndarray of uint8 (rows, cols)
        [DN].
    """
    (root / kind).mkdir(exist_ok=True)
    write_png(root / kind / f"{index:04d}.png", frame)


def write_shots(path: Path, shots: tuple[Shot, ...] | list[Shot], displacement_mm: list[float] | None = None) -> None:
    """Write ``press.csv`` or ``replicates.csv``; unknown displacements stay empty.

    What the camera chose itself has columns where all shots state it.

    Parameters
    ----------
    path : Path
    shots : tuple or list of Shot
    displacement_mm : list of float, optional
        One per shot [mm].
    """
    known = displacement_mm is not None and bool(np.isfinite(displacement_mm).all())
    depths = displacement_mm if known and displacement_mm is not None else [None] * len(shots)
    chosen = [name for name in (*SHEARED, *CHOSEN) if shots and np.isfinite([getattr(s, name) for s in shots]).all()]
    rows = [
        [s.index, s.time_s, s.force_N, s.voltage_V, "" if d is None else d, s.session]
        + [getattr(s, name) for name in chosen]
        for s, d in zip(shots, depths, strict=True)
    ]
    write_csv(path, ["index", "time_s", "force_N", "voltage_V", "displacement_mm", "session", *chosen], rows)


def write_shear(folder: Path, shots: list[Shot]) -> None:
    """Write series of what a load cell read along a slide, up to where it turns back; nothing of a press.

    Parameters
    ----------
    folder : Path
        Of series; made if there is anything to write.
    shots : list of Shot
    """
    rows: list[Shot] = []
    for shot in shots:
        if not shot.slide_mm > 0.0:
            continue
        if rows and shot.slide_mm <= rows[-1].slide_mm:
            break
        rows.append(shot)
    for name in ("tangential_force_N", "torque_Nmm"):
        if any(getattr(row, name) for row in rows):
            folder.mkdir(exist_ok=True)
            table = [[row.slide_mm, getattr(row, name)] for row in rows]
            write_csv(folder / f"{name.rpartition('_')[0]}_slide.csv", ["slide_mm", name], table)


def write_csv(path: Path, header: list[str], rows: list[list[Any]]) -> None:
    """Write a table; floats to nine digits.

    Parameters
    ----------
    path : Path
    header : list of str
    rows : list of list
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        writer.writerow([f"{value:.9g}" if isinstance(value, float) else value for value in row])
    path.write_text(text.getvalue(), encoding="utf-8")


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder beside ``folder``, which takes that name only if no error occurs.

    Parameters
    ----------
    folder : Path
        Absent or empty.

    Yields
    ------
    Path

    Raises
    ------
    InputError
        If ``folder`` exists and is no empty folder, or its parent is missing.
    WorkError
        If the system refuses.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError("exists and is not empty", file=folder, allowed="a new folder; nothing is overwritten")
    if not folder.parent.is_dir():
        raise InputError("no such folder", file=folder.parent, allowed="a folder in which the bundle can be made")
    try:
        part = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    except OSError as error:
        raise WorkError(f"{folder}: cannot make the folder: {error.strerror}") from None
    try:
        yield part
        umask = os.umask(0)
        os.umask(umask)
        part.chmod(0o777 & ~umask)
        os.replace(part, folder)
    except OSError as error:
        raise WorkError(f"{folder}: cannot write: {error.strerror}") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)
