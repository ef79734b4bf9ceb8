"""The file of a measured LED spectrum: its path, its digest, its two columns, and a copy beside a written scene."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evanesce.core.columns import number, read_rows
from evanesce.core.errors import InputError
from evanesce.rig.beside import copy_beside, digest_of, file_beside
from evanesce.rig.height_map import copy_height_map
from evanesce.rig.leds import SPECTRA
from evanesce.rig.scene import Scene

KEY = "leds.spectrum"
HEADINGS = ("wavelength_nm", "power")
NAME = "spectrum.csv"
MAX_BYTES = 1_000_000
RANGE_NM = (300.0, 1100.0)
"""Wavelengths that silicon sees and the glass's published absorption covers [nm]."""

Array = NDArray[np.float64]


def located(scene: Scene, path: Path) -> Scene:
    """Return a scene whose spectrum, if it is a file, is an absolute path with its digest; the file is checked.

    Parameters
    ----------
    scene : Scene
        As its file ``path`` has it: the spectrum is named relative to that file.
    path : Path

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        As for :func:`evanesce.rig.beside.file_beside` and :func:`read_spectrum`.
    """
    leds = scene.leds
    if leds.spectrum in SPECTRA:
        return scene
    file, digest = file_beside(
        leds.spectrum, path, key=KEY, suffixes=(".csv",), max_bytes=MAX_BYTES, sha256=leds.spectrum_sha256,
        sha256_key=f"{KEY}_sha256",
    )  # fmt: skip
    read_spectrum(file, digest)
    return _with_file(scene, file, digest)


def relative(scene: Scene) -> Scene:
    """Return a scene whose spectrum file is named as :func:`copy_spectrum` names the copy.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Scene
    """
    leds = scene.leds
    return scene if leds.spectrum in SPECTRA else _with_file(scene, NAME, leds.spectrum_sha256)


def copy_spectrum(scene: Scene, folder: Path) -> None:
    """Copy a scene's spectrum file into a folder as ``spectrum.csv``; without one, do nothing.

    Parameters
    ----------
    scene : Scene
    folder : Path

    Raises
    ------
    WorkError
        If it cannot be read or written.
    """
    if scene.leds.spectrum not in SPECTRA:
        copy_beside(scene.leds.spectrum, folder / NAME, "the spectrum")


def copy_scene_files(scene: Scene, folder: Path) -> None:
    """Copy all files that a scene names into a folder: height map and spectrum, as a dumped scene names them.

    Parameters
    ----------
    scene : Scene
    folder : Path

    Raises
    ------
    WorkError
        If one cannot be read or written.
    """
    copy_height_map(scene, folder)
    copy_spectrum(scene, folder)


@lru_cache(maxsize=8)
def read_spectrum(file: str, sha256: str | None) -> tuple[Array, Array]:
    """Read a spectrum: headings ``wavelength_nm`` and ``power``, rising wavelengths, powers that are not negative.

    Parameters
    ----------
    file : str
        Absolute path.
    sha256 : str or None
        Digest with which the scene was read.

    Returns
    -------
    wavelength : ndarray (n,)
        [nm], read-only.
    power : ndarray (n,)
        Radiant power per nm, in any unit; read-only.

    Raises
    ------
    InputError
        With file, row and heading of what is wrong.
    """
    path = Path(file)
    if not path.is_absolute() or not path.is_file() or digest_of(path) != sha256:
        raise InputError(
            "not the file that the scene was read with", file=path, key=KEY,
            allowed="a scene from load_scene, its spectrum unchanged since",
        )  # fmt: skip
    headings, *body = read_rows(path)
    if tuple(headings) != HEADINGS:
        raise InputError(f"headings {', '.join(headings)}", file=path, allowed=",".join(HEADINGS))
    table = np.empty((len(body), 2))
    for i, row in enumerate(body):
        if len(row) != 2:
            raise InputError(f"row {i + 2} has {len(row)} columns", file=path, allowed="2 columns")
        table[i] = [number(cell, path, i + 2, name) for cell, name in zip(row, HEADINGS, strict=True)]
    _check(table, path)
    wavelength, power = np.ascontiguousarray(table.T)
    wavelength.setflags(write=False)
    power.setflags(write=False)
    return wavelength, power


def _check(table: Array, path: Path) -> None:
    """Refuse a table (rows, 2) of wavelength and power that is no spectrum."""
    wavelength, power = table.T
    low, high = RANGE_NM
    if len(table) < 2 or not power.any():
        raise InputError("holds no spectrum", file=path, allowed="2 rows or more, one of them with power")
    outside = (wavelength < low) | (wavelength > high)
    falling = np.append(False, np.diff(wavelength) <= 0.0)
    for wrong, column, allowed in (
        (outside, 0, f"{low:g} to {high:g} nm"),
        (falling, 0, "rising wavelengths"),
        (power < 0.0, 1, "at least 0"),
    ):
        if wrong.any():
            at = int(np.argmax(wrong))
            raise InputError(f"row {at + 2}: {table[at, column]:g}", file=path, key=HEADINGS[column], allowed=allowed)


def _with_file(scene: Scene, file: str, sha256: str | None) -> Scene:
    leds = scene.leds.model_copy(update={"spectrum": file, "spectrum_sha256": sha256})
    return scene.model_copy(update={"leds": leds})
