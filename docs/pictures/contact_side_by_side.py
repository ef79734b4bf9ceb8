"""Rendered frames of one press by three kinds of law: ``python docs/pictures/contact_side_by_side.py [FORCE_N]``.

Silskin 0 %, smooth and with the moulded ridges (pitch assumed 1 mm). Half-space and Hertz get E* = 4 G of the same
material, so that what differs is the law. Writes ``docs/pictures/contact_side_by_side.png`` and prints the areas.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from evanesce.chain.simulate import simulate
from evanesce.contact.laws import small_strain_modulus
from evanesce.evaluation.labels import label, view_geometry
from evanesce.optics.projection import Projection
from evanesce.render.fast.transport import render_fast
from evanesce.report.html import figure_png
from evanesce.rig import load_scene

HERE = Path(__file__).resolve().parent
MODULUS = {"reduced_modulus_MPa": small_strain_modulus("silskin_0")}
LAWS = (
    ("finite elements", {"law": "fem", "bone": "none"}),
    ("finite elements, bone of half the radius", {"law": "fem", "bone": "half"}),
    ("half-space", {"law": "halfspace"} | MODULUS),
    ("Hertz", {"law": "hertz"} | MODULUS),
)
CROP = slice(560, 940), slice(810, 1190)  # the middle 6.5 mm of the frame


def main() -> None:
    """Render, print the areas and write the picture."""
    force = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
    figure = Figure(figsize=(13.2, 7.0), layout="constrained")
    axes = figure.subplots(2, len(LAWS))
    for row, name in zip(axes, ("thesis", "thesis_ridged"), strict=True):
        for axis, (title, law) in zip(row, LAWS, strict=True):
            scene = load_scene(name, {"contact": law, "grid.size_mm": 12.0})
            shot = simulate(scene, force, seed=7, render=render_fast)
            assert shot.state is not None
            truth = label(shot.state, view_geometry(Projection.of(shot.scene.camera, shot.scene.plate)))
            rows = CROP[0]
            half = 0.5 * (rows.stop - rows.start) / scene.camera.scale_px_per_mm
            extent = (-half, half, half, -half)
            axis.imshow(shot.frame.data[CROP], cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="nearest")
            axis.contour(np.asarray(truth.mask[CROP]), [0.5], colors="#00b3ff", extent=extent, linewidths=0.7)
            area = shot.state.nominal_contact_area
            kind = "smooth" if name == "thesis" else "ridged"
            kind += ", first model" if kind == "ridged" and title == "Hertz" else ""
            axis.set_title(f"{title}\n{kind}, {force:g} N: {area:.1f} mm$^2$", fontsize=10)
            axis.set(xlabel="x [mm]", ylabel="y [mm]")
            print(f"{kind:20s} {title:42s} {area:6.2f} mm^2  peak {np.asarray(shot.state.pressure).max():.4f} MPa")
    (HERE / "contact_side_by_side.png").write_bytes(figure_png(figure, dpi=75))


if __name__ == "__main__":
    main()
