"""The finite-element runs that the mechanics study needs beyond the library.

``python -m evanesce.studies.mechanics.runs`` solves and writes them: presses of the thesis's other fingers (length
7.5 mm, tip radius 10 mm), slides at its three coefficients of friction and of its other fingers, and tilted presses of
both materials, each without a bone and with one of half the shaft's radius. ``data/*.npz`` has the library's formats
(:mod:`evanesce.contact.fem.library`) and ships with the project, so that reading it needs no extra. A second call finds
solved runs in the cache.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from evanesce.contact.fem.library import library_press, library_slide, save_library_press, save_library_slide
from evanesce.contact.fem.make_library import FAR_SIZE
from evanesce.contact.fem.material import carried_on, rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize
from evanesce.contact.fem.programme import press, slide
from evanesce.contact.fem.result import SolvedRun
from evanesce.contact.fem.runs import cache_folder
from evanesce.contact.fem.steps import LimitReached
from evanesce.contact.fem.stored import LibraryPress, LibrarySlide
from evanesce.materials.tables import material as silicone

FOLDER = Path(__file__).resolve().parent / "data"
MATERIALS = ("silskin_0", "silskin_20")
BONES = ("none", "half")

# Around 1 N: a line through their logarithms averages out where the edge lies among the nodes.
FORCES = (0.7, 0.85, 1.0, 1.2, 1.4)
PRESS_SIZE = MeshSize(contact=0.12)

Hold = Literal["force", "depth"]
Mesh = Literal["", "check", "far", "tilt"]
FRICTIONS = (0.67, 0.82, 1.13)  # thesis, chapter 6: tried in its finite elements
DISTANCE, FAR = 10.0, 20.0  # [mm]
SLIDE_SIZE = MeshSize(contact=0.8, growth=1.4, coarsest=4.0)
# A second, finer mesh for the error of the first.
CHECK_SIZE = MeshSize(contact=0.6, growth=1.4, coarsest=3.0)
# Even out to where a finger tilted by 45 deg touches.
TILT_SIZE = MeshSize(contact=0.8, fine_extent=8.8, growth=1.4, coarsest=3.0)
TILT_DEG = 45.0  # thesis, section 6.6


@dataclass(frozen=True)
class Shape:
    """A finger of the thesis by its outer measures [mm]; a bone has half the shaft's radius."""

    tip_radius: float
    diameter: float
    length: float

    def finger(self, bone: str, tilt_deg: float = 0.0) -> FingerShape:
        """Return it without a bone (``"none"``) or with one (``"half"``).

        Parameters
        ----------
        bone : {"none", "half"}
        tilt_deg : float
            [deg].

        Returns
        -------
        FingerShape
        """
        radius = self.diameter / 4 if bone == "half" else 0.0
        return FingerShape(self.tip_radius, self.diameter, self.length, radius, tilt_deg)


# Section 6.5 compares D 20 L 10 with D 15 L 7.5; the long fingers of both diameters are solved beside them.
SHAPES = {
    "standard": Shape(7.5, 15.0, 25.0),
    "short": Shape(7.5, 15.0, 7.5),
    "large15": Shape(10.0, 15.0, 25.0),
    "large20": Shape(10.0, 20.0, 25.0),
    "stout": Shape(10.0, 20.0, 10.0),
}


@dataclass(frozen=True)
class SlideCase:
    """One slide from 1 N.

    Attributes
    ----------
    friction : float
        Coefficient.
    bone, hold : str
        Bone, and what is held.
    mesh : {"", "check", "far", "tilt"}
        The usual one, or another of this module. ``far`` slides to gross slip, by a material that is carried on beyond
        where its fit loses stability; on ``tilt`` a finger is pressed and hardly slid.
    material, shape : str
    tilt_deg : float
        [deg].
    """

    friction: float
    bone: str
    hold: Hold
    mesh: Mesh = ""
    material: str = "silskin_0"
    shape: str = "standard"
    tilt_deg: float = 0.0

    @property
    def name(self) -> str:
        """File name without suffix."""
        shape = "" if self.shape == "standard" else f"_{self.shape}"
        mesh = f"_{self.mesh}" if self.mesh else ""
        tilt = f"{self.tilt_deg:.0f}" if self.mesh == "tilt" else ""
        return f"{self.material}{shape}_{self.bone}_mu{round(100 * self.friction):03d}_{self.hold}{mesh}{tilt}"

    @property
    def distance(self) -> float:
        """[mm]."""
        return {"far": FAR, "tilt": 0.01}.get(self.mesh, DISTANCE)


SLIDES = (
    *(SlideCase(mu, bone, "depth") for mu in FRICTIONS for bone in BONES),
    *(SlideCase(0.82, bone, "force") for bone in BONES),
    *(SlideCase(0.67, bone, "depth", "check") for bone in BONES),
    SlideCase(0.82, "none", "force", "check"),
)
AT_DEPTH = tuple(SlideCase(1.13, bone, "depth", "far") for bone in BONES)
SIZES = tuple(SlideCase(0.82, bone, "force", shape=shape) for shape in ("short", "stout") for bone in BONES)
TILTED = tuple(
    SlideCase(mu, bone, "force", "tilt", name, tilt_deg=tilt)
    for name, mu in (("silskin_0", 0.67), ("silskin_20", 1.75)) for bone in BONES for tilt in (0.0, TILT_DEG)
)  # fmt: skip
MESHES = {"": SLIDE_SIZE, "check": CHECK_SIZE, "far": FAR_SIZE, "tilt": TILT_SIZE}


def solved_press(material: str, shape: str, bone: str, folder: Path = FOLDER) -> LibraryPress:
    """Return a press that ships with the study.

    Parameters
    ----------
    material, shape : str
        Keys of the tables of materials and of :data:`SHAPES`.
    bone : {"none", "half"}
    folder : Path

    Returns
    -------
    LibraryPress
    """
    return library_press(f"{material}_{shape}", bone, folder)


def solved_slide(case: SlideCase, folder: Path = FOLDER) -> LibrarySlide:
    """Return a slide that ships with the study.

    Parameters
    ----------
    case : SlideCase
    folder : Path

    Returns
    -------
    LibrarySlide
    """
    return library_slide(case.name, folder)


def _press(material: str, shape: str, bone: str) -> SolvedRun:
    friction = silicone(material).friction
    assert friction is not None  # both materials have one in the tables
    finger, mu = SHAPES[shape].finger(bone), friction.static_coefficient_smooth
    return press(finger, rubber(material), forces=FORCES, friction=mu, size=PRESS_SIZE, cache=cache_folder())


def _slide(case: SlideCase) -> SolvedRun:
    """Solve a slide, as far as the material carries it."""
    finger = SHAPES[case.shape].finger(case.bone, case.tilt_deg)
    chosen = rubber(case.material)
    if case.mesh == "far":
        chosen = carried_on(chosen)
    try:
        return slide(
            finger, chosen, force=1.0, distances=(case.distance,), friction=case.friction,
            hold=case.hold, size=MESHES[case.mesh], cache=cache_folder(),
        )  # fmt: skip
    except LimitReached as error:
        print(f"{case.name}: {error}", flush=True)
        if error.run is None or not error.run.reached():
            raise
        return error.run


def _save_press(path: Path, material: str, shape: str, bone: str) -> None:
    save_library_press(path, _press(material, shape, bone))


def _save_slide(path: Path, case: SlideCase) -> None:
    save_library_slide(path, _slide(case))


def _jobs(folder: Path) -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield every run as its name and what solves and writes it."""
    for material in MATERIALS:
        for shape in SHAPES:
            for bone in BONES:
                name = f"{material}_{shape}_{bone}"

                def solve_press(
                    path: Path = folder / f"{name}.npz", what: tuple[str, str, str] = (material, shape, bone)
                ) -> None:
                    save_library_press(path, _press(*what))

                yield name, solve_press
    for case in (*SLIDES, *AT_DEPTH, *SIZES, *TILTED):
        yield case.name, partial(_save_slide, folder / f"{case.name}.npz", case)


def main(only: str = "", folder: Path = FOLDER) -> None:
    """Solve and write every run whose name contains ``only``.

    Parameters
    ----------
    only : str
        Part of a run's name.
    folder : Path
    """
    for name, work in _jobs(folder):
        if only in name:
            work()
            print(name, flush=True)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "")
