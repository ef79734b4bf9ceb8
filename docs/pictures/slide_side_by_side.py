"""Fast slide beside finite elements: ``python docs/pictures/slide_side_by_side.py [--cache FOLDER]``.

Silskin 0 %, 1 N held, mu 0.67. The fast model gets the finite-element press as its normal contact and beam theory for
the shaft; nothing is fitted. Solving takes minutes and the extra ``fem``; with the solved run in the cache, seconds.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from evanesce.contact.analytic.partial_slip import tangential_modulus
from evanesce.contact.fem.library import library_press
from evanesce.contact.fem.material import rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize
from evanesce.contact.fem.programme import slide
from evanesce.contact.fem.runs import cache_folder
from evanesce.contact.fem.state import axisymmetric_contact
from evanesce.contact.sliding.shaft import shaft_stiffness
from evanesce.contact.sliding.solver import march
from evanesce.materials.friction import coulomb
from evanesce.materials.hyperelastic import of_material
from evanesce.report.html import figure_png

HERE = Path(__file__).resolve().parent
FRICTION, FORCE = 0.67, 1.0
DISTANCES = (1, 2, 3, 4, 5, 6, 7, 8)


def finite_elements(cache: Path) -> dict[str, np.ndarray]:
    """Return slide [mm], tangential force [N], area [mm^2] and stick share of the force at each solved step."""
    size = MeshSize(contact=0.8, growth=1.4, coarsest=4.0)
    run = slide(
        FingerShape(), rubber("silskin_0"), force=FORCE, distances=DISTANCES, friction=FRICTION, size=size, cache=cache
    )
    rows = [run.row(i) for i in range(len(run))]
    pressed = next(i for i, row in enumerate(rows) if row["normal_force_N"] > 0.999 * FORCE)
    names = ("slide_mm", "tangential_force_N", "area_mm2", "stick_force_share")
    return {name: np.array([row[name] for row in rows[pressed:]]) for name in names}


def fast(way: np.ndarray) -> dict[str, np.ndarray]:
    """Return the same of the fast model at the ways of the drive [mm]."""
    contact = axisymmetric_contact(library_press("silskin_0").at(FORCE), 25.0)
    silicone = of_material("silskin_0")
    modulus = float(tangential_modulus(silicone.youngs_modulus / 0.75, 0.5))
    shortened = 25.0 - contact.depth
    _, bending = shaft_stiffness(silicone.youngs_modulus, 7.5, shortened, normal_force=FORCE, tip_radius=7.5)
    count = len(way)
    result = march([contact] * count, np.arange(count) * 0.1, way, coulomb(FRICTION), modulus, drive_stiffness=bending)
    sticking = contact.force_within(result.series("stick_radius")) / FORCE
    return {"force": result.series("tangential_force"), "area": result.series("area"), "stick": sticking}


def main() -> None:
    """Print both and write the picture beside this script."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cache", type=Path, default=None)
    solved = finite_elements(parser.parse_args().cache or cache_folder())
    way = np.linspace(0.0, float(solved["slide_mm"].max()), 81)
    quick = fast(way)
    figure = Figure(figsize=(12, 3.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    at = solved["slide_mm"]
    left.plot(at, solved["tangential_force_N"], "o", label="finite elements")
    left.plot(way, quick["force"], label="fast model, nothing fitted")
    left.axhline(FRICTION * FORCE, color="0.6", lw=0.8)
    left.set(xlabel="way of the drive [mm]", ylabel="tangential force [N]")
    left.legend(frameon=False)
    middle.plot(at, solved["area_mm2"] / solved["area_mm2"][0], "o")
    middle.plot(way, quick["area"] / quick["area"][0])
    middle.set(xlabel="way of the drive [mm]", ylabel="contact area over that of the press [1]", ylim=(0.8, 1.1))
    right.plot(at, solved["stick_force_share"], "o")
    right.plot(way, quick["stick"])
    right.set(xlabel="way of the drive [mm]", ylabel="share of the normal force that sticks [1]")
    (HERE / "slide_side_by_side.png").write_bytes(figure_png(figure, dpi=90))
    print("way [mm]: finite elements / fast: force [N], area over that of the press, share of the force that sticks")
    for i, x in enumerate(at):
        q, area, stick = (np.interp(x, way, quick[name]) for name in ("force", "area", "stick"))
        pair = f"{solved['tangential_force_N'][i]:.3f} / {q:.3f}"
        areas = f"{solved['area_mm2'][i] / solved['area_mm2'][0]:.3f} / {area / quick['area'][0]:.3f}"
        print(f"{x:5.2f}:  {pair},  {areas},  {solved['stick_force_share'][i]:.2f} / {stick:.2f}")


if __name__ == "__main__":
    main()
