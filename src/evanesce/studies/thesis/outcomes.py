"""What the thesis reports of its own finger (sections 6.4 to 6.6) beside what follows from its inputs alone.

Nothing is fitted, so that there is nothing to leave out. The value is that of the finger with a bone of half its
radius, which the thesis cast in without printing its size; the interval spans the solid finger and the other open
inputs. Each row names the assumption that moves it most, and from where to where.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.fem.library import LibrarySlide, library_press
from evanesce.materials.tables import material
from evanesce.studies.mechanics.ridges import press_ratios
from evanesce.studies.mechanics.runs import BONES, TILT_DEG, TILTED, Mesh, SlideCase, solved_press, solved_slide
from evanesce.studies.mechanics.study import MESHES, mesh_error, modulus_at_ridges, overshoot

Floats = NDArray[np.float64]

DESIGNED_MM = 0.1
"""Height of the ridges as drawn (table 4), which finite elements on the drawing have; moulded: 0.048 mm."""
RATE_MM_PER_MIN = 5.0
OVERSHOOT, FORCE = 0.72, 1.0
SLIPPING = 0.99
"""Pull over the sliding force from which a slide counts as gross [1]."""
BONE_NAMES = {"none": "solid", "half": "with bone"}


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A reported figure beside the computed one.

    Attributes
    ----------
    what, unit : str
    thesis, value, low, high : float
    moved_by : str
        The named assumption that moves the value most.
    moves : tuple of float
        The value at that assumption's two ends.
    counted : bool
        Whether agreement says something: not where the meshes' error is larger than what is reported.
    note : str
        How far the computation reaches.
    """

    what: str
    unit: str
    thesis: float
    value: float
    low: float
    high: float
    moved_by: str
    moves: tuple[float, float]
    counted: bool = True
    note: str = ""

    @property
    def agrees(self) -> bool:
        """Whether the reported figure lies in the interval."""
        return self.low <= self.thesis <= self.high


def outcomes() -> Iterator[Outcome]:
    """Yield every reported figure that an input could decide.

    Yields
    ------
    Outcome
    """
    yield _ridged()
    yield from _held_depth()
    yield from _shapes()
    yield from _tilted()
    yield _time()


def _outcome(
    what: str, unit: str, thesis: float, value: float, others: Floats, moved_by: str, ends: tuple[float, float],
    *, counted: bool = True, note: str = "",
) -> Outcome:  # fmt: skip
    every = [value, *np.asarray(others, dtype=float).ravel().tolist()]
    return Outcome(what=what, unit=unit, thesis=thesis, value=value, low=min(every), high=max(every),
                   moved_by=moved_by, moves=ends, counted=counted, note=note)  # fmt: skip


def _ridged() -> Outcome:
    """Return the ridged finger's area over the smooth one's, moulded and as drawn."""
    modulus = modulus_at_ridges("silskin_0")
    moulded = {bone: press_ratios(bone, modulus) for bone in BONES}
    drawn = {bone: press_ratios(bone, modulus, height=DESIGNED_MM) for bone in BONES}
    ends = (float(moulded["half"][:2].mean()), float(drawn["half"][:2].mean()))
    every = np.concatenate([*moulded.values(), *drawn.values()])
    return _outcome("ridged over smooth area, 1 N, Silskin 0 %", "1", 0.76, ends[0], every,
                    "ridge height: moulded 48 to drawn 100 um", ends)  # fmt: skip


def _held_depth() -> Iterator[Outcome]:
    # what a finer mesh does at 0.67 is taken to scale with the value itself
    check = {bone: [overshoot(solved_slide(SlideCase(0.67, bone, "depth", mesh))) for mesh in MESHES] for bone in BONES}
    errors = {bone: abs(finer / usual - 1.0) for bone, (usual, finer) in check.items()}
    for friction in (1.13, 0.82, 0.67):
        mesh: Mesh = "far" if friction == 1.13 else ""  # the usual ones end before gross slip there
        slides = {bone: solved_slide(SlideCase(friction, bone, "depth", mesh)) for bone in BONES}
        found = {bone: overshoot(slide) for bone, slide in slides.items()}
        ends = [value * (1.0 + sign * errors[bone]) for bone, value in found.items() for sign in (-1, 1)]
        # "proportional to the coefficient" is what the thesis says of the other two
        as_mu = "" if friction == 1.13 else " (thesis: as mu)"
        yield _outcome(f"normal force at held depth, mu {friction:g}{as_mu}", "1", OVERSHOOT * friction / 1.13,
                       found["half"], np.array(ends), "bone: none to half the radius",
                       (found["none"], found["half"]), note=_reached(slides, friction))  # fmt: skip


def _reached(slides: Mapping[str, LibrarySlide], friction: float) -> str:
    """Return where slides ended whose finger as a whole did not yet slip; empty for none."""
    ends = []
    for bone, slide in slides.items():
        way, pull, load = (slide.scalars[name] for name in ("slide", "tangential_force", "normal_force"))
        most = float((pull / load).max())
        if most < SLIPPING * friction:
            ends.append(f"{BONE_NAMES[bone]} to {way[-1]:.2g} mm, at {most:.3g} of {friction:g}")
    return f"solved before gross slip: {'; '.join(ends)}" if ends else ""


def _ratio(name: str, over: str, under: str, bone: str) -> float:
    pair = [solved_press(name, shape, bone).area(FORCE) for shape in (over, under)]
    return float(pair[0] / pair[1] - 1.0)


def sliding_area(shape: str, bone: str) -> float:
    """Return the mean area of a solved slide over the last quarter of its way [mm^2], where it slides as a whole.

    Parameters
    ----------
    shape : str
        Key of :data:`~evanesce.studies.mechanics.runs.SHAPES`.
    bone : {"none", "half"}

    Returns
    -------
    float
        [mm^2]; of Silskin 0 %, 1 N held, mu 0.82.
    """
    found = solved_slide(SlideCase(0.82, bone, "force", shape=shape)).scalars
    way, area = found["slide"], found["area"]
    at = np.linspace(0.75 * way[-1], way[-1], 64)
    return float(np.interp(at, way, area).mean())


def _shapes() -> Iterator[Outcome]:
    """Yield what length, size and bone do to the area of a slide at 1 N (section 6.5); pressed areas are its start."""
    name = "silskin_0"
    sliding = {(shape, bone): sliding_area(shape, bone) for shape in ("standard", "short", "stout") for bone in BONES}
    check = [solved_slide(SlideCase(0.82, "none", "force", mesh)).scalars["area"][-1] for mesh in MESHES]
    mesh = np.array([-1.0, 1.0]) * (mesh_error(name) + abs(float(check[1] / check[0]) - 1.0))
    for what, thesis, over, under in (
        ("area of a slide, length 25 over 7.5 mm, less 1", 0.04, "standard", "short"),
        ("area of a slide, D 20 L 10 over D 15 L 7.5, less 1", 0.27, "stout", "short"),
    ):
        found = {bone: sliding[over, bone] / sliding[under, bone] - 1.0 for bone in BONES}
        pressed = np.array([_ratio(name, over, under, bone) for bone in BONES])
        spread = np.concatenate([np.add.outer(np.array(list(found.values())), mesh).ravel(), pressed])
        yield _outcome(what, "1", thesis, found["half"], spread, "bone: none to half the radius",
                       (found["none"], found["half"]), counted=abs(thesis) > mesh[1],
                       note=f"pressed: {pressed[1]:.2g}")  # fmt: skip
    change = sliding["short", "half"] / sliding["short", "none"] - 1.0
    pair = [solved_press(name, "short", bone).area(FORCE) for bone in ("half", "none")]
    pressed = np.array([pair[0] / pair[1] - 1.0])
    yield _outcome("area of a slide, bone over none, L 7.5 mm, less 1", "1", 0.0, change,
                   np.concatenate([change + mesh, pressed]), "bone: none to half the radius", (0.0, change),
                   counted=False, note=f"pressed: {pressed[0]:.2g}")  # fmt: skip


def tilted_area(name: str, bone: str) -> float:
    """Return the pressed area at 45 deg over that at 0, by finite elements on the same mesh [1].

    Parameters
    ----------
    name : str
        Of the material.
    bone : {"none", "half"}
    """
    cases = {case.tilt_deg: case for case in TILTED if (case.material, case.bone) == (name, bone)}
    tilted, upright = (float(solved_slide(cases[tilt]).scalars["area"][0]) for tilt in (TILT_DEG, 0.0))
    return tilted / upright


def _tilted() -> Iterator[Outcome]:
    """Yield static friction of the finger at 45 deg over that at 0, from its area: mu = tau0 A/N + alpha."""
    for name, title, thesis in (("silskin_0", "Silskin 0 %", 0.14), ("silskin_20", "Silskin 20 %", 0.0)):
        friction = material(name).friction
        assert friction is not None  # in the tables
        upright = friction.static_coefficient_smooth
        share = (upright - friction.alpha) / upright
        found = {bone: share * (tilted_area(name, bone) - 1.0) for bone in BONES}
        # The tip over a bone is a sphere on a sphere, whose contact a tilt leaves as it is: what it changes by is the
        # meshes' error.
        error = abs(found["half"])
        yield _outcome(f"static friction at 45 over 0 deg, less 1, {title}", "1", thesis, 0.0,
                       np.add.outer([0.0, found["none"]], [-error, error]), "bone: none to half the radius",
                       (found["none"], 0.0), counted=abs(thesis) > error,
                       note=f"from the pressed area, known to {error:.2g}")  # fmt: skip


def _time() -> Outcome:
    """Return the time of a press of Silskin 20 % to 5 N at 5 mm/min."""
    seconds = {bone: 60.0 * float(library_press("silskin_20", bone).at(5.0).depth) / RATE_MM_PER_MIN for bone in BONES}
    return _outcome("press to 5 N at 5 mm/min, Silskin 20 %", "s", 37.0, seconds["half"],
                    np.array(list(seconds.values())), "bone: none to half the radius",
                    (seconds["none"], seconds["half"]))  # fmt: skip
