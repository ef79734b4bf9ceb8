"""Slides at mu 1.13: how far each goes, and what ends it (docs/validation/contact-fem.md); numbers pick some."""

from __future__ import annotations

import sys

from evanesce.contact.fem.material import rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize
from evanesce.contact.fem.programme import SLIDE_STEPS, slide
from evanesce.contact.fem.runs import cache_folder
from evanesce.contact.fem.steps import LimitReached, StepSizes

COARSE = MeshSize(1.1, growth=1.5, coarsest=4.0)
USUAL = MeshSize(0.8, growth=1.4, coarsest=4.0)
SMALL = StepSizes(0.25, 0.05, 1e-4)
PRESS_SMALL = StepSizes(0.3, 0.02, 2e-4)

# name, hold, mesh, bone radius [mm], c30 [MPa], distance [mm], steps, penalty [MPa/mm]
CASES = (
    ("depth held", "depth", COARSE, 0.0, 0.0, 16.0, SLIDE_STEPS, None),
    ("depth held", "depth", USUAL, 0.0, 0.0, 10.0, SLIDE_STEPS, None),
    ("depth held, c30", "depth", USUAL, 0.0, 0.005, 10.0, SLIDE_STEPS, None),
    ("1 N held", "force", COARSE, 0.0, 0.0, 16.0, SLIDE_STEPS, None),
    ("1 N held, small steps", "force", COARSE, 0.0, 0.0, 16.0, SMALL, None),
    ("1 N held, penalty a quarter", "force", COARSE, 0.0, 0.0, 16.0, SLIDE_STEPS, 26.0),
    ("1 N held, c30", "force", COARSE, 0.0, 0.002, 16.0, SLIDE_STEPS, None),
    ("depth held, bone", "depth", COARSE, 3.75, 0.0, 10.0, SLIDE_STEPS, None),
    ("depth held, bone, small steps", "depth", USUAL, 3.75, 0.0, 10.0, PRESS_SMALL, None),
    ("depth held, bone, small steps, c30", "depth", USUAL, 3.75, 0.005, 10.0, PRESS_SMALL, None),
)


def main() -> None:
    """Solve and print the cases whose numbers, from 1, are given; all without any."""
    wanted = [int(text) for text in sys.argv[1:]] or range(1, len(CASES) + 1)
    for name, hold, size, bone, c30, distance, sizes, penalty in (CASES[number - 1] for number in wanted):
        ended = ""
        try:
            run = slide(
                FingerShape(bone_radius=bone), rubber("silskin_0", c30=c30), force=1.0, distances=(distance,),
                friction=1.13, hold=hold, size=size, sizes=sizes, penalty=penalty, cache=cache_folder(),
            )  # fmt: skip
        except LimitReached as error:
            run, ended = error.run, str(error)
        rows = [run.row(index) for index in range(len(run))]
        slips = next((row["slide_mm"] for row in rows if row["slide_mm"] > 0 and row["stick_force_share"] == 0), None)
        last = rows[-1]
        print(
            f"{name}, {size.contact:g} mm ({len(run.mesh.cells)} bricks): {last['slide_mm']:.2f} mm,"
            f" {last['normal_force_N']:.3f} N, {last['tangential_force_N']:.3f} N,"
            f" stretches {last['stretch_min']:.2f} to {last['stretch_max']:.2f},"
            f" gross slip from {slips} mm; {ended or 'complete'}",
            flush=True,
        )


if __name__ == "__main__":
    main()
