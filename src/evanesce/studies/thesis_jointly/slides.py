"""Normal force at held depth while Silskin 0 % slides, by finite elements over rigid bones of several radii.

``python -m evanesce.studies.thesis_jointly.slides`` solves the slides that the mechanics study does not ship (several
minutes each, extra ``fem``) and writes ``data/slides.csv``: bone share, coefficient of friction, largest signed change
of the normal force over that of the press [1], slide that was reached [mm].
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from evanesce.contact.fem.make_library import FAR_SIZE
from evanesce.contact.fem.material import carried_on, rubber
from evanesce.contact.fem.mesh import FingerShape
from evanesce.contact.fem.programme import slide
from evanesce.contact.fem.runs import cache_folder
from evanesce.contact.fem.steps import LimitReached
from evanesce.studies.mechanics.runs import DISTANCE, FAR, FRICTIONS, SLIDE_SIZE, SlideCase, solved_slide
from evanesce.studies.mechanics.study import overshoot

FILE = Path(__file__).resolve().parent / "data" / "slides.csv"
COLUMNS = ("bone_share", "friction", "change", "slide_mm")
SHIPPED = {"none": 0.0, "half": 0.5}
SOLVED = ((0.65, 0.67), (0.25, 0.67), (0.8, 0.67), (0.25, 1.13), (0.65, 1.13))
FAR_FRICTION = max(FRICTIONS)
"""At which slides need the coarser elements and the carried-on material of the far ones."""


def solved(share: float, friction: float) -> tuple[float, float]:
    """Return the largest signed change of the normal force over that of the press, and the slide reached [mm].

    Parameters
    ----------
    share : float
        Bone radius over the shaft's radius.
    friction : float
        Coulomb's coefficient.

    Returns
    -------
    tuple of float
    """
    far, silicone = friction == FAR_FRICTION, rubber("silskin_0")
    try:
        run = slide(
            FingerShape(bone_radius=7.5 * share), carried_on(silicone) if far else silicone, force=1.0,
            distances=(FAR if far else DISTANCE,), friction=friction, hold="depth",
            size=FAR_SIZE if far else SLIDE_SIZE, cache=cache_folder(),
        )  # fmt: skip
    except LimitReached as error:
        print(f"{share:g} {friction:g}: {error}", flush=True)
        if error.run is None or not error.run.reached():
            raise
        run = error.run
    states = [run.history.steps[k].state for k in range(run.reached()[0], len(run))]
    force = np.array([s.normal_force for s in states])
    change = force / force[0] - 1.0
    return float(change[np.argmax(np.abs(change))]), float(states[-1].slide)


def main(file: Path = FILE) -> None:
    """Write the shipped slides' figures and those that are solved here.

    Parameters
    ----------
    file : Path
    """
    rows = []
    for friction in FRICTIONS:
        for bone, share in SHIPPED.items():
            found = solved_slide(SlideCase(friction, bone, "depth", "far" if friction == FAR_FRICTION else ""))
            rows.append((share, friction, overshoot(found), float(found.scalars["slide"][-1])))
    for case in (None, *SOLVED):
        if case is not None:
            rows.append((*case, *solved(*case)))
            print(rows[-1], flush=True)
        with file.open("w", newline="", encoding="utf-8") as out:
            writer = csv.writer(out, lineterminator="\n")
            writer.writerow(COLUMNS)
            writer.writerows((s, mu, round(c, 4), round(w, 3)) for s, mu, c, w in sorted(rows))


if __name__ == "__main__":
    main()
