"""CalculiX input deck of a short slide, and what its output says; nothing of the project's solver is used."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# corners of each face of CalculiX's brick, in its order of faces
FACES = ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0))


@dataclass(frozen=True)
class Slide:
    """Half body (y >= 0) whose top is held while the glass rises by ``depth`` and then moves by ``way`` along -x.

    Attributes
    ----------
    points : ndarray (n, 3)
        [mm].
    cells : ndarray (m, 8)
    clamped, mirror : ndarray
        Nodes held in all directions, and across.
    skin : ndarray (f, 4)
        Faces that may touch.
    c10, c01, c11, bulk : float
        [MPa].
    friction : float
    penalty, stick : float
        Pressure per penetration and shear per elastic slip [MPa/mm].
    depth, way : float
        [mm].
    increment : float
        Largest share of each of the two steps in one increment.
    """

    points: Floats
    cells: Ints
    clamped: Ints
    mirror: Ints
    skin: Ints
    c10: float
    c01: float
    c11: float
    bulk: float
    friction: float
    penalty: float
    stick: float
    depth: float
    way: float
    increment: float = 0.1


def _numbers(values: Ints) -> str:
    """Return node numbers (from 1) in lines of 12."""
    lines = [values[i : i + 12] + 1 for i in range(0, len(values), 12)]
    return "\n".join(", ".join(str(v) for v in line) for line in lines)


def _skin_faces(cells: Ints, skin: Ints) -> list[tuple[int, int]]:
    """Return (element, face), from 1, of the faces whose four nodes are a face of the skin."""
    wanted = {frozenset(face) for face in skin.tolist()}
    found = []
    for number, cell in enumerate(cells.tolist(), 1):
        for side, corners in enumerate(FACES, 1):
            if frozenset(cell[c] for c in corners) in wanted:
                found.append((number, side))
    return found


def deck(slide: Slide) -> str:
    """Return the input file: bricks with incompatible modes (C3D8I) on one rigid brick of glass."""
    n, m = len(slide.points), len(slide.cells)
    side, low = 12.0, -2.0
    glass = np.array(
        [[x, y, z] for z in (low, 0.0) for x, y in ((-side, -1.0), (side, -1.0), (side, side), (-side, side))]
    )
    nodes = np.vstack([slide.points, glass])
    node_lines = "\n".join(f"{i}, {x:.9g}, {y:.9g}, {z:.9g}" for i, (x, y, z) in enumerate(nodes.tolist(), 1))
    body = "\n".join(f"{i}, " + ", ".join(str(c + 1) for c in cell) for i, cell in enumerate(slide.cells.tolist(), 1))
    block = f"{m + 1}, " + ", ".join(str(n + i) for i in range(1, 9))
    skin = "\n".join(f"{e}, S{f}" for e, f in _skin_faces(slide.cells, slide.skin))
    grown = [f"{slide.c10:.9g}", f"{slide.c01:.9g}", "0.", f"{slide.c11:.9g}", "0.", f"{2 / slide.bulk:.9g}", "1.e9"]

    def step(x: float, z: float) -> str:
        return f"""*STEP, NLGEOM, INC=400
*STATIC
{slide.increment:g}, 1., 1.e-4, {slide.increment:g}
*BOUNDARY
GLASS, 1, 1, {x:.9g}
GLASS, 2, 2, 0.
GLASS, 3, 3, {z:.9g}
*NODE PRINT, NSET=GLASS, TOTALS=ONLY, FREQUENCY=1
RF
*NODE PRINT, NSET=CAP, FREQUENCY=1000
U
*END STEP
"""

    return f"""*NODE, NSET=ALL
{node_lines}
*ELEMENT, TYPE=C3D8I, ELSET=BODY
{body}
*ELEMENT, TYPE=C3D8, ELSET=BLOCK
{block}
*NSET, NSET=GLASS
{_numbers(np.arange(n, n + 8))}
*NSET, NSET=CLAMPED
{_numbers(slide.clamped)}
*NSET, NSET=MIRROR
{_numbers(slide.mirror)}
*NSET, NSET=CAP
{_numbers(np.unique(slide.skin))}
*SURFACE, NAME=SKIN
{skin}
*SURFACE, NAME=TOP
{m + 1}, S2
*MATERIAL, NAME=SILICONE
*HYPERELASTIC, POLYNOMIAL, N=2
{", ".join(grown)}
*MATERIAL, NAME=HARD
*ELASTIC
1000., 0.3
*SOLID SECTION, ELSET=BODY, MATERIAL=SILICONE
*SOLID SECTION, ELSET=BLOCK, MATERIAL=HARD
*SURFACE INTERACTION, NAME=TOUCH
*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR
{slide.penalty:g}, 1.e-6, 0.05
*FRICTION
{slide.friction:g}, {slide.stick:g}
*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE
SKIN, TOP
*BOUNDARY
CLAMPED, 1, 3
MIRROR, 2, 2
{step(0.0, slide.depth)}{step(-slide.way, slide.depth)}"""


@dataclass(frozen=True)
class Outcome:
    """By increment: time (step 1 ends at 1, step 2 at 2) and force on the whole finger (x, z) [N]; and the last skin.

    ``cap`` are node indices, ``displacement`` (cap, 3) theirs at the end of each step [mm].
    """

    time: Floats
    force: Floats
    cap: Ints
    displacement: tuple[Floats, ...]


def run(slide: Slide, folder: Path, program: str = "ccx") -> Outcome:
    """Solve with CalculiX in a folder and read its table.

    Raises
    ------
    RuntimeError
        If CalculiX does not come to the end of the second step.
    """
    (folder / "slide.inp").write_text(deck(slide), encoding="ascii")
    done = subprocess.run([program, "slide"], cwd=folder, capture_output=True, text=True, check=False)
    if "Job finished" not in done.stdout:
        raise RuntimeError(done.stdout[-2000:])
    return read_dat((folder / "slide.dat").read_text(encoding="ascii"))


_HEAD = re.compile(r"^ (total force|displacements) .*set (\w+) and time\s+(\S+)", re.MULTILINE)


def read_dat(text: str) -> Outcome:
    """Return what the printed table holds."""
    time, force, fields, cap = [], [], [], np.empty(0, dtype=np.int64)
    heads = list(_HEAD.finditer(text))
    for head, end in zip(heads, [*(h.start() for h in heads[1:]), len(text)], strict=True):
        rows = np.array(
            [[float(v) for v in line.split()] for line in text[head.end() : end].splitlines() if line.strip()]
        )
        if head[1] == "total force":
            time.append(float(head[3]))
            force.append(2.0 * rows[0][[0, 2]])  # both halves
        else:
            cap = rows[:, 0].astype(np.int64) - 1
            fields.append(rows[:, 1:])
    return Outcome(np.array(time), np.array(force), cap, tuple(fields))
