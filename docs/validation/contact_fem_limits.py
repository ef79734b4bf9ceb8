"""Slides at high friction: how far each goes, and what ends it (docs/validation/contact-fem.md); numbers pick some.

``shipped`` prints what the library's slides and the tilted presses show, and solves nothing.
"""

from __future__ import annotations

import sys
import time

from evanesce.contact.fem.library import FAR_SLIDES, library_slide
from evanesce.contact.fem.material import carried_on, rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize
from evanesce.contact.fem.programme import SLIDE_STEPS, slide
from evanesce.contact.fem.result import SolvedRun
from evanesce.contact.fem.runs import cache_folder
from evanesce.contact.fem.steps import LimitReached
from evanesce.studies.mechanics.runs import TILTED, solved_slide

COARSE = MeshSize(1.1, growth=1.5, coarsest=4.0)
USUAL = MeshSize(0.8, growth=1.4, coarsest=4.0)
FINE = MeshSize(0.5, growth=1.3, coarsest=3.0)
BONE_MM = 3.75

# material, friction, hold, mesh, bone radius [mm], carried on, distance [mm]
CASES = (
    ("silskin_0", 1.13, "depth", COARSE, 0.0, False, 16.0),
    ("silskin_0", 1.13, "depth", USUAL, 0.0, False, 10.0),
    ("silskin_0", 1.13, "force", COARSE, 0.0, False, 16.0),
    ("silskin_0", 1.13, "depth", COARSE, BONE_MM, False, 10.0),
    ("silskin_0", 1.13, "depth", COARSE, BONE_MM, True, 20.0),
    ("silskin_0", 1.13, "force", COARSE, BONE_MM, True, 20.0),
    ("silskin_0", 1.13, "depth", FINE, BONE_MM, True, 20.0),
    ("silskin_0", 1.13, "force", FINE, BONE_MM, True, 20.0),
    ("silskin_20", 1.75, "depth", FINE, BONE_MM, True, 20.0),
    ("silskin_20", 1.75, "force", FINE, BONE_MM, True, 20.0),
)


def shipped() -> None:
    """Print pull and area of the slides of the library, and areas at 45 deg over those at 0."""
    for (material, bone), (name, friction, contact) in FAR_SLIDES.items():
        rows = library_slide(name).scalars
        pull, way, area = rows["tangential_force"] / rows["normal_force"], rows["slide"], rows["area"]
        print(
            f"{material}, mu {friction}, bone {bone}, {contact} mm: to {way[-1]:.1f} mm, largest pull {pull.max():.2f},"
            f" from {way[int((pull > 0.99 * pull.max()).argmax())]:.1f} mm; area {area[0]:.1f},"
            f" at most {area.max():.1f} at {way[area.argmax()]:.1f} mm, {area[-1]:.1f} mm^2"
        )
    for upright, tilted in zip(TILTED[::2], TILTED[1::2], strict=True):
        areas = [float(solved_slide(case).scalars["area"][0]) for case in (upright, tilted)]
        print(
            f"{upright.material}, bone {upright.bone}: {areas[1] / areas[0]:.3f} of the area at {tilted.tilt_deg:g} deg"
        )


def main() -> None:
    """Solve and print the cases whose numbers, from 1, are given; all without any."""
    if sys.argv[1:] == ["shipped"]:
        shipped()
        return
    wanted = [int(text) for text in sys.argv[1:]] or range(1, len(CASES) + 1)
    for material, friction, hold, size, bone, carry, distance in (CASES[number - 1] for number in wanted):
        ended, began = "", time.monotonic()
        published = rubber(material)

        def told(run: SolvedRun, goal: int, began: float = began, distance: float = distance) -> None:
            there = run.history.steps[-1].state.slide
            left = (time.monotonic() - began) * (distance / max(there, 1e-9) - 1.0)
            print(f"\r{there:.3f} mm of {distance:g}; {left:.0f} s left", end="", file=sys.stderr, flush=True)

        try:
            run = slide(
                FingerShape(bone_radius=bone), carried_on(published) if carry else published, force=1.0,
                distances=(distance,), friction=friction, hold=hold, size=size, sizes=SLIDE_STEPS,
                cache=cache_folder(), on_step=told,
            )  # fmt: skip
        except LimitReached as error:
            run, ended = error.run, str(error)
        rows = [row for row in (run.row(index) for index in range(len(run))) if row["slide_mm"] > 0]
        pressed, last = run.row(run.reached()[0]), rows[-1]
        slips = next((row["slide_mm"] for row in rows if row["stick_force_share"] == 0), None)
        late = [row for row in rows if row["slide_mm"] > 0.5 * last["slide_mm"]]
        means = {key: sum(row[key] for row in late) / len(late) for key in ("normal_force_N", "tangential_force_N")}
        print(
            f"\r{material}, mu {friction}, {hold} held, {size.contact:g} mm ({len(run.mesh.cells)} bricks),"
            f" bone {bone:g} mm{', carried on' if carry else ''}: {last['slide_mm']:.2f} mm,"
            f" mean of the second half {means['normal_force_N']:.3f} N normal,"
            f" {means['tangential_force_N']:.3f} N tangential; area {pressed['area_mm2']:.1f} to"
            f" {last['area_mm2']:.1f} mm^2; stretches {last['stretch_min']:.2f} to {last['stretch_max']:.2f};"
            f" nothing sticks from {slips} mm; {time.monotonic() - began:.0f} s; {ended or 'complete'}",
            flush=True,
        )


if __name__ == "__main__":
    main()
