"""A solved slide that ships with the project: its footprints, to be sampled on any grid without the extra ``fem``.

``library/slides/<name>.npz`` holds the footprints of every step from the end of the press on: ``depth``, ``slide``,
``normal_force``, ``tangential_force``, ``area`` (s,), ``place``, ``traction``, ``slip`` (s, k, 2), ``pressure``,
``gap``, ``opening``, ``touching``, ``slipping`` (s, k) by node of the cap's half y >= 0, and ``meta`` (JSON). Lengths
in mm, forces in N, stresses in MPa.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.fem.library import FOLDER
from evanesce.contact.fem.result import DAMAGED, SolvedRun, write_npz
from evanesce.contact.fem.state import surface_state
from evanesce.contact.fem.surface import Footprint
from evanesce.core.errors import InputError
from evanesce.core.provenance import digest
from evanesce.core.states import ContactState, PlateGrid

SLIDES = FOLDER / "slides"
_SCALARS = ("depth", "slide", "normal_force", "tangential_force", "area")
_SMOOTH = ("place", "traction", "slip", "pressure", "gap", "opening")
_FLAGS = ("touching", "slipping")


@dataclass(frozen=True)
class LibrarySlide:
    """A slide as the library keeps it; see the module for its arrays."""

    scalars: Mapping[str, NDArray[np.float64]]
    fields: Mapping[str, NDArray[Any]]
    inputs: Mapping[str, Any]
    digest: str

    def _between(self, slide: float) -> tuple[int, float]:
        """Return the step before a slide and the share of the way to the next."""
        way = self.scalars["slide"]
        if not way[0] - 1e-9 <= slide <= way[-1] + 1e-9:
            raise InputError(f"{slide:g} mm", key="slide", allowed=f"{way[0]:g} to {way[-1]:g} mm in the library")
        index = int(np.clip(np.searchsorted(way, slide) - 1, 0, way.size - 2))
        return index, float(np.clip((slide - way[index]) / (way[index + 1] - way[index]), 0.0, 1.0))

    def scalar(self, name: str, slide: float) -> float:
        """Return depth [mm], a force [N] or the area [mm^2] at a slide [mm]."""
        index, share = self._between(slide)
        values = self.scalars[name]
        return float((1 - share) * values[index] + share * values[index + 1])

    def footprint(self, slide: float) -> Footprint:
        """Return the footprint at a slide [mm]; between steps node by node, in contact where the opening is negative.

        Raises
        ------
        InputError
            For a slide outside the library.
        """
        index, share = self._between(slide)
        mixed = {
            key: (1 - share) * self.fields[key][index].astype(float) + share * self.fields[key][index + 1].astype(float)
            for key in _SMOOTH
        }
        touching = mixed["opening"] < 0
        slipping = self.fields["slipping"][index + round(share)].astype(bool) & touching
        return Footprint(
            place=mixed["place"],
            pressure=np.where(touching, mixed["pressure"], 0.0),
            traction=np.where(touching[:, None], mixed["traction"], 0.0),
            gap=np.where(touching, 0.0, mixed["gap"]),
            touching=touching,
            slipping=slipping,
            slip=np.where(touching[:, None], mixed["slip"], 0.0),
            opening=mixed["opening"],
            area=self.scalar("area", slide),
        )


def save_library_slide(path: Path, run: SolvedRun) -> None:
    """Write the steps from the end of the press on as a library file (single precision, compressed)."""
    indices = range(run.reached()[0], len(run))
    prints = [run.footprint(i) for i in indices]
    states = [run.history.steps[i].state for i in indices]
    scalars = {key: np.array([getattr(state, key) for state in states]) for key in _SCALARS[:-1]}
    meta = {"schema": 1, "digest": digest(dict(run.inputs)), "inputs": dict(run.inputs)}
    arrays = {
        "meta": np.array(json.dumps(meta, sort_keys=True)),
        **scalars,
        "area": np.array([print_.area for print_ in prints]),
        **{key: np.array([getattr(print_, key) for print_ in prints], dtype="f4") for key in _SMOOTH},
        **{key: np.array([getattr(print_, key) for print_ in prints], dtype="?") for key in _FLAGS},
    }
    write_npz(path, arrays, compressed=True)


def slide_names(folder: Path = SLIDES) -> tuple[str, ...]:
    """Return the slides that the library holds."""
    return tuple(sorted(path.stem for path in folder.glob("*.npz")))


@lru_cache(maxsize=4)
def library_slide(name: str, folder: Path = SLIDES) -> LibrarySlide:
    """Read one slide of the library, e.g. ``"silskin_0_mu067"``.

    Raises
    ------
    InputError
        If the library has no such slide or its file is damaged.
    """
    path = folder / f"{name}.npz"
    if not path.is_file():
        raise InputError(f"no solved slide {name!r}", key="slide", allowed=", ".join(slide_names(folder)) or "none")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            meta = json.loads(str(data["meta"]))
            scalars = {key: data[key] for key in _SCALARS}
            fields = {key: data[key] for key in _SMOOTH + _FLAGS}
            return LibrarySlide(scalars, fields, meta["inputs"], meta["digest"])
    except DAMAGED as error:
        raise InputError(f"damaged: {error}", file=path) from None


def library_slide_state(
    name: str, slide_mm: float, grid: PlateGrid, *, centre: tuple[float, float] = (0.0, 0.0), time: float = 0.0
) -> ContactState:
    """Return a finite-element contact of a slide that ships with the project, without the extra ``fem``.

    Parameters
    ----------
    name : str
        One of :func:`slide_names`.
    slide_mm : float
        Way of the finger's top over the glass along +x since the press [mm].
    grid : PlateGrid
        At rest with the glass.
    centre : tuple of float
        Where the finger sets out from (x, y) [mm].
    time : float
        [s].

    Raises
    ------
    InputError
        For an unknown slide, a way outside it, or a contact that does not fit on the grid.
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
