"""Finite-element presses over rigid bones of several radii, which the joint judgement interpolates.

``python -m evanesce.studies.thesis_jointly.bones`` solves them (minutes a press, extra ``fem``; a second call finds
solved runs in the cache) and writes ``data/presses.csv``: material, shape, bone radius [mm], force [N], depth [mm],
radius of contact [mm]. The thesis cast a bone in and does not print its size; the library of solved contacts has none
and half of the shaft's radius only.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from evanesce.contact.fem.material import rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize
from evanesce.contact.fem.programme import press
from evanesce.contact.fem.result import SolvedRun
from evanesce.contact.fem.runs import cache_folder
from evanesce.contact.fem.state import profile_of
from evanesce.contact.fem.steps import LimitReached
from evanesce.materials.tables import material as silicone
from evanesce.studies.mechanics.runs import SHAPES

FILE = Path(__file__).resolve().parent / "data" / "presses.csv"
COLUMNS = ("material", "shape", "bone_share", "force_N", "depth_mm", "contact_radius_mm")

SHARES = (0.125, 0.65, 0.25, 0.8, 0.5, 0.0)
"""Bone radius over the shaft's radius; meshes allow 0.9."""
FORCES = tuple(float(f) for f in np.geomspace(0.1, 20.0, 17).round(3))
"""[N]; beyond 5 N because a softer material at 5 N is the same finger at a higher force."""
SHAPED_FORCES = (0.7, 0.85, 1.0, 1.2, 1.4)
"""[N] around 1 N, at which shapes are compared."""
SIZE = MeshSize(contact=0.12, fine_extent=6.5)


def cases() -> Iterator[tuple[str, str, float]]:
    """Yield material, shape and bone share of every press.

    Yields
    ------
    tuple
    """
    for share in SHARES:
        for material in ("silskin_20", "silskin_0"):
            yield material, "standard", share
    for share in SHARES:
        for shape in ("short", "stout"):
            yield "silskin_0", shape, share


def solved(material: str, shape: str, share: float) -> SolvedRun:
    """Solve one press as far as the material carries it.

    Parameters
    ----------
    material, shape : str
        Keys of the tables of materials and of :data:`evanesce.studies.mechanics.runs.SHAPES`.
    share : float
        Bone radius over the shaft's radius.

    Returns
    -------
    SolvedRun
    """
    own = SHAPES[shape]
    finger = FingerShape(own.tip_radius, own.diameter, own.length, share * own.diameter / 2)
    friction = silicone(material).friction
    assert friction is not None  # both materials have one in the tables
    mu = friction.static_coefficient_smooth
    forces = FORCES if shape == "standard" else SHAPED_FORCES
    try:
        return press(finger, rubber(material), forces=forces, friction=mu, size=SIZE, cache=cache_folder())
    except LimitReached as error:
        print(f"{material} {shape} {share:g}: {error}", flush=True)
        if error.run is None or not error.run.reached():
            raise
        return error.run


def rows_of(material: str, shape: str, share: float) -> list[tuple[str | float, ...]]:
    """Return the rows of one press in the order of :data:`COLUMNS`.

    Parameters
    ----------
    material, shape, share
        See :func:`solved`.

    Returns
    -------
    list of tuple
    """
    run = solved(material, shape, share)
    found: list[tuple[str | float, ...]] = []
    for index in run.reached():
        state = run.history.steps[index].state
        profile = profile_of(run.footprint(index), state.depth, state.normal_force)
        figures = (profile.normal_force, profile.depth, profile.contact_radius)
        found.append((material, shape, share, *(float(f"{x:.6g}") for x in figures)))
    return found


def main(only: str = "", file: Path = FILE) -> None:
    """Solve every press whose name contains ``only`` and write all rows that are known.

    Parameters
    ----------
    only : str
        Part of ``<material>_<shape>_<share>``.
    file : Path
    """
    rows: dict[tuple[str, str, float], list[tuple[str | float, ...]]] = {}
    for case in cases():
        if only in "_".join(map(str, case)):
            rows[case] = rows_of(*case)
            print(*case, f"{len(rows[case])} forces, to {rows[case][-1][3]:g} N", flush=True)
            with file.open("w", newline="", encoding="utf-8") as out:
                writer = csv.writer(out, lineterminator="\n")
                writer.writerow(COLUMNS)
                for key in sorted(rows):
                    writer.writerows(rows[key])


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "")
