"""Solved presses of the thesis's fingers that ship with the project: FE contacts without the extra ``fem``.

``library/<material>_<bone>.npz`` holds one press through all forces: arrays ``force``, ``depth``, ``contact_radius``
(f,), ``r``, ``gap``, ``pressure``, ``traction``, ``slip``, ``slipping`` (f, k) by node of the cap, and ``meta`` (JSON:
schema, digest and inputs of the run). Lengths in mm, N, MPa. Made by ``python -m evanesce.contact.fem.make_library``.
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

from evanesce.contact.fem.result import DAMAGED, SolvedRun, write_npz
from evanesce.contact.fem.state import AxisymmetricProfile, gap_at, press_state, pressure_at, profile_of
from evanesce.core.errors import InputError
from evanesce.core.provenance import digest
from evanesce.core.states import ContactState, PlateGrid

Floats = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parent / "library"
BONES = {"none": 0.0, "half": 3.75}  # bone radius [mm] by name: none, or half the tip radius
_FIELDS = ("r", "gap", "pressure", "traction", "slip", "slipping")


@dataclass(frozen=True)
class LibraryPress:
    """A press as the library keeps it.

    Attributes
    ----------
    force, depth, contact_radius : ndarray (f,)
        [N], [mm], [mm]; forces rise.
    profiles : mapping of ndarray (f, k)
        See :class:`~evanesce.contact.fem.state.AxisymmetricProfile`.
    inputs : mapping
        Of the run.
    digest : str
    """

    force: Floats
    depth: Floats
    contact_radius: Floats
    profiles: Mapping[str, NDArray[Any]]
    inputs: Mapping[str, Any]
    digest: str

    def area(self, force: float) -> float:
        """Return the area of contact [mm^2] at a force [N] between the first and the last one kept."""
        return float(np.pi * self.at(force).contact_radius ** 2)

    def at(self, force: float) -> AxisymmetricProfile:
        """Return the profile at a force [N].

        Between two stored forces the radius of contact and the depth are interpolated in logs, and the shapes of
        pressure (over the mean pressure), gap and slip in log force at places that correspond.

        Raises
        ------
        InputError
            For a force outside the library.
        """
        low, high = float(self.force[0]), float(self.force[-1])
        if not low * (1 - 1e-9) <= force <= high * (1 + 1e-9):
            raise InputError(f"{force:g} N", key="force", allowed=f"{low:g} to {high:g} N in the library")
        index = int(np.clip(np.searchsorted(self.force, force) - 1, 0, self.force.size - 2))
        share = float(
            np.clip(np.log(force / self.force[index]) / np.log(self.force[index + 1] / self.force[index]), 0, 1)
        )

        def mix(a: Any, b: Any) -> Any:
            return (1 - share) * a + share * b

        radius = float(np.exp(mix(*np.log(self.contact_radius[index : index + 2]))))
        mean = force / (np.pi * radius**2)
        # nodes stretched so that both profiles have the wanted radius of contact, then mixed place by place
        pair = [self._scaled(index + i, radius) for i in (0, 1)]
        r = mix(pair[0]["r"], pair[1]["r"])
        mixed = {key: mix(pair[0][key], pair[1][key]) for key in ("gap", "pressure", "traction", "slip")}
        return AxisymmetricProfile(
            r=r,
            gap=np.where(r > radius, np.maximum(mixed["gap"], 1e-12), 0.0),
            pressure=np.where(r < radius, mean * mixed["pressure"], 0.0),
            traction=np.where(r < radius, mean * mixed["traction"], 0.0),
            slip=np.where(r < radius, mixed["slip"], 0.0),
            slipping=pair[round(share)]["slipping"] & (r < radius),
            contact_radius=radius,
            depth=float(np.exp(mix(*np.log(self.depth[index : index + 2])))),
            normal_force=float(force),
        )

    def _scaled(self, index: int, radius: float) -> dict[str, Any]:
        """Return one stored force's fields at places common to all; stresses in units of the mean pressure."""
        stored = {key: np.asarray(values[index], dtype=float) for key, values in self.profiles.items()}
        a, r = float(self.contact_radius[index]), stored["r"]
        widest = int(np.argmax(r)) + 1
        # inside, the place counts relative to the edge; outside, by its distance from the edge
        nodes = np.linspace(0.0, 1.0, 121)
        inner, outer = nodes * a, a + nodes[1:] ** 2 * (r[widest - 1] - a)
        own = np.concatenate([inner, outer])
        profile = _profile(self, index)
        mean = float(self.force[index]) / (np.pi * a**2)
        return {
            "r": np.concatenate([nodes * radius, radius + (outer - a)]),
            "gap": gap_at(profile, own, float(stored["gap"][widest - 1])),
            "pressure": pressure_at(profile, own) / mean,
            "traction": np.interp(own, r[:widest], stored["traction"][:widest]) / mean,
            "slip": np.interp(own, r[:widest], stored["slip"][:widest]),
            "slipping": np.interp(own, r[:widest], stored["slipping"][:widest]) >= 0.5,
        }


def _profile(press: LibraryPress, index: int) -> AxisymmetricProfile:
    fields = {key: np.asarray(values[index]) for key, values in press.profiles.items()}
    return AxisymmetricProfile(
        **{key: fields[key].astype(bool if key == "slipping" else float) for key in _FIELDS},
        contact_radius=float(press.contact_radius[index]),
        depth=float(press.depth[index]),
        normal_force=float(press.force[index]),
    )


def save_library_press(path: Path, run: SolvedRun) -> None:
    """Write the steps of a press at which a force was reached, as a library file (single precision, compressed)."""
    profiles = []
    for index in run.reached():
        state = run.history.steps[index].state
        profiles.append(profile_of(run.footprint(index), state.depth, state.normal_force))
    meta = {"schema": 1, "digest": digest(dict(run.inputs)), "inputs": dict(run.inputs)}
    arrays = {
        "meta": np.array(json.dumps(meta, sort_keys=True)),
        "force": np.array([p.normal_force for p in profiles]),
        "depth": np.array([p.depth for p in profiles]),
        "contact_radius": np.array([p.contact_radius for p in profiles]),
        **{
            key: np.array([getattr(p, key) for p in profiles], dtype="?" if key == "slipping" else "f4")
            for key in _FIELDS
        },
    }
    write_npz(path, arrays, compressed=True)


def library_names(folder: Path = FOLDER) -> tuple[str, ...]:
    """Return what the library holds, as ``<material>_<bone>``."""
    return tuple(sorted(path.stem for path in folder.glob("*.npz")))


@lru_cache(maxsize=16)
def library_press(material: str, bone: str = "none", folder: Path = FOLDER) -> LibraryPress:
    """Read one press of the library.

    Raises
    ------
    InputError
        If the library has no such press or its file is damaged.
    """
    path = folder / f"{material}_{bone}.npz"
    if not path.is_file():
        raise InputError(f"no solved press of {material!r} with bone {bone!r}", key="material",
                         allowed=", ".join(library_names(folder)))  # fmt: skip
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            meta = json.loads(str(data["meta"]))
            return LibraryPress(
                force=data["force"], depth=data["depth"], contact_radius=data["contact_radius"],
                profiles={key: data[key] for key in _FIELDS}, inputs=meta["inputs"], digest=meta["digest"],
            )  # fmt: skip
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
    """Return a finite-element contact of the thesis's finger at any force of the library, without the extra ``fem``.

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
