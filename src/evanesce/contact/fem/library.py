"""Solved presses and slides of the thesis's fingers that ship with the project: FE contacts without the extra ``fem``.

``library/<material>_<bone>.npz`` holds one press through all forces: arrays ``force``, ``depth``, ``contact_radius``
(f,), ``r``, ``gap``, ``pressure``, ``traction``, ``slip``, ``slipping`` (f, k) by node of the cap.
``library/slides/<name>.npz`` holds the footprints of every step of a slide from the end of the press on: ``depth``,
``slide``, ``normal_force``, ``tangential_force``, ``area`` (s,), ``place``, ``traction``, ``slip`` (s, k, 2),
``pressure``, ``gap``, ``opening``, ``touching``, ``slipping`` (s, k) by node of the cap's half y >= 0.
Each has ``meta`` (JSON: schema, digest and inputs of the run). Lengths in mm, forces in N, stresses in MPa. Made by
``python -m evanesce.contact.fem.make_library``.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.fem.result import DAMAGED, SolvedRun, write_npz
from evanesce.contact.fem.state import press_state, profile_of, surface_state
from evanesce.contact.fem.stored import PRESS_FIELDS, SLIDE_FIELDS, Arrays, LibraryPress, LibrarySlide
from evanesce.core.errors import InputError
from evanesce.core.provenance import digest
from evanesce.core.states import ContactState, PlateGrid

FOLDER = Path(__file__).resolve().parent / "library"
SLIDES = FOLDER / "slides"
BONES = {"none": 0.0, "half": 3.75}
"""Bone radius [mm] by name: none, or half the tip radius."""

FAR_SLIDES = {
    ("silskin_0", "none"): ("silskin_0_none_mu113", 1.13, 1.1),
    ("silskin_0", "half"): ("silskin_0_half_mu113", 1.13, 0.8),
    ("silskin_20", "none"): ("silskin_20_none_mu175", 1.75, 1.1),
    ("silskin_20", "half"): ("silskin_20_half_mu175", 1.75, 1.1),
}
"""Slides by material and bone at 1 N held, their coefficients of friction (the largest of the thesis's slides), and the
size of their elements [mm]."""

_PRESS_SCALARS = ("force", "depth", "contact_radius")
_SLIDE_SCALARS = ("depth", "slide", "normal_force", "tangential_force", "area")
_SLIDE_FLAGS = ("touching", "slipping")


def save_library_press(path: Path, run: SolvedRun) -> None:
    """Write the steps of a press at which a force was reached as a library file (single precision, compressed).

    Parameters
    ----------
    path : Path
    run : SolvedRun
        From :func:`evanesce.contact.fem.programme.press`.

    Raises
    ------
    WorkError
        If the file cannot be written.
    """
    profiles = []
    for index in run.reached():
        state = run.history.steps[index].state
        profiles.append(profile_of(run.footprint(index), state.depth, state.normal_force))
    arrays = {
        "force": np.array([p.normal_force for p in profiles]),
        "depth": np.array([p.depth for p in profiles]),
        "contact_radius": np.array([p.contact_radius for p in profiles]),
        **{
            key: np.array([getattr(p, key) for p in profiles], dtype="?" if key == "slipping" else "f4")
            for key in PRESS_FIELDS
        },
    }
    _write(path, run, arrays)


def save_library_slide(path: Path, run: SolvedRun) -> None:
    """Write the steps of a slide from the end of the press on as a library file (single precision, compressed).

    Parameters
    ----------
    path : Path
    run : SolvedRun
        From :func:`evanesce.contact.fem.programme.slide`.

    Raises
    ------
    WorkError
        If the file cannot be written.
    """
    indices = range(run.reached()[0], len(run))
    prints = [run.footprint(i) for i in indices]
    states = [run.history.steps[i].state for i in indices]
    arrays = {
        **{key: np.array([getattr(state, key) for state in states]) for key in _SLIDE_SCALARS[:-1]},
        "area": np.array([print_.area for print_ in prints]),
        **{key: np.array([getattr(print_, key) for print_ in prints], dtype="f4") for key in SLIDE_FIELDS},
        **{key: np.array([getattr(print_, key) for print_ in prints], dtype="?") for key in _SLIDE_FLAGS},
    }
    _write(path, run, arrays)


def _write(path: Path, run: SolvedRun, arrays: Arrays) -> None:
    meta = {"schema": 1, "digest": digest(dict(run.inputs)), "inputs": dict(run.inputs)}
    write_npz(path, {"meta": np.array(json.dumps(meta, sort_keys=True)), **arrays}, compressed=True)


def library_names(folder: Path = FOLDER) -> tuple[str, ...]:
    """Return the presses that a folder holds, as ``<material>_<bone>``.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    tuple of str
    """
    return _names(folder)


def slide_names(folder: Path = SLIDES) -> tuple[str, ...]:
    """Return the slides that a folder holds.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    tuple of str
    """
    return _names(folder)


def _names(folder: Path) -> tuple[str, ...]:
    return tuple(sorted(path.stem for path in folder.glob("*.npz")))


@lru_cache(maxsize=16)
def library_press(material: str, bone: str = "none", folder: Path = FOLDER) -> LibraryPress:
    """Read one press of the library.

    Parameters
    ----------
    material : str
        ``"silskin_0"`` or ``"silskin_20"``.
    bone : {"none", "half"}
        Name of the bone's radius in :data:`BONES`.
    folder : Path

    Returns
    -------
    LibraryPress

    Raises
    ------
    InputError
        If the library has no such press or its file is damaged.
    """
    path = folder / f"{material}_{bone}.npz"
    if not path.is_file():
        raise InputError(f"no solved press of {material!r} with bone {bone!r}", key="material",
                         allowed=", ".join(library_names(folder)))  # fmt: skip
    data, meta = _read(path, _PRESS_SCALARS + PRESS_FIELDS)
    return LibraryPress(
        **{key: data[key] for key in _PRESS_SCALARS}, profiles={key: data[key] for key in PRESS_FIELDS},
        inputs=meta["inputs"], digest=meta["digest"],
    )  # fmt: skip


@lru_cache(maxsize=4)
def library_slide(name: str, folder: Path = SLIDES) -> LibrarySlide:
    """Read one slide of the library.

    Parameters
    ----------
    name : str
        One of :func:`slide_names`, e.g. ``"silskin_0_mu067"``.
    folder : Path

    Returns
    -------
    LibrarySlide

    Raises
    ------
    InputError
        If the library has no such slide or its file is damaged.
    """
    path = folder / f"{name}.npz"
    if not path.is_file():
        raise InputError(f"no solved slide {name!r}", key="slide", allowed=", ".join(slide_names(folder)) or "none")
    data, meta = _read(path, _SLIDE_SCALARS + SLIDE_FIELDS + _SLIDE_FLAGS)
    scalars = {key: data[key] for key in _SLIDE_SCALARS}
    fields = {key: data[key] for key in SLIDE_FIELDS + _SLIDE_FLAGS}
    return LibrarySlide(scalars, fields, meta["inputs"], meta["digest"])


def _read(path: Path, keys: tuple[str, ...]) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return arrays and meta (inputs and digest) of a library file."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            meta = json.loads(str(data["meta"]))
            return {key: data[key] for key in keys}, {key: meta[key] for key in ("inputs", "digest")}
    except DAMAGED as error:
        raise InputError(f"damaged: {error}", file=path) from None


def library_state(
    material: str,
    force_N: float,
    grid: PlateGrid,
    *,
    centre: tuple[float, float] = (0.0, 0.0),
    bone: str = "none",
    time: float = 0.0,
) -> ContactState:
    """Return the finite-element contact of the thesis's pressed finger at any force of the library.

    Parameters
    ----------
    material : str
        ``"silskin_0"`` or ``"silskin_20"``.
    force_N : float
        [N].
    grid : PlateGrid
    centre : tuple of float
        (x, y) of the finger's axis [mm].
    bone : {"none", "half"}
        No bone, or a rigid one of half the tip radius.
    time : float
        [s].

    Returns
    -------
    ContactState

    Raises
    ------
    InputError
        For an unknown press, a force outside the library, or a contact that does not fit on the grid.
    """
    press = library_press(material, bone)
    parameters = {"material": material, "bone": bone, "run_sha256": press.digest, "force_N": float(force_N)}
    beyond = float(press.inputs["shape"]["length"])
    return press_state(
        grid, centre, press.at(float(force_N)), beyond=beyond, parameters=parameters, law="fem_library", time=time
    )


def library_slide_state(
    name: str, slide_mm: float, grid: PlateGrid, *, centre: tuple[float, float] = (0.0, 0.0), time: float = 0.0
) -> ContactState:
    """Return the finite-element contact of the thesis's sliding finger at any slide of the library.

    Parameters
    ----------
    name : str
        One of :func:`slide_names`.
    slide_mm : float
        Displacement of the finger's top over the glass along +x since the press [mm].
    grid : PlateGrid
        At rest with the glass.
    centre : tuple of float
        Plate point (x, y) under the finger's axis before the slide [mm].
    time : float
        [s].

    Returns
    -------
    ContactState

    Raises
    ------
    InputError
        For an unknown slide, a displacement outside it, or a contact that does not fit on the grid.
    """
    found = library_slide(name)
    return surface_state(
        grid,
        (centre[0] + slide_mm, centre[1]),
        found.footprint(slide_mm),
        depth=found.scalar("depth", slide_mm),
        normal_force=found.scalar("normal_force", slide_mm),
        tangential_force=found.scalar("tangential_force", slide_mm),
        beyond=float(found.inputs["shape"]["length"]),
        parameters={"slide": name, "slide_mm": float(slide_mm), "run_sha256": found.digest},
        law="fem_library_slide",
        time=time,
    )
