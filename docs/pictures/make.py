"""Make the README's picture: rendered frames with the true and the measured outline, and a profile across an edge.

Run from the checkout: ``python docs/pictures/make.py [--fast]``; writes ``docs/pictures/loop.png``. With the argument
``fast_vs_reference`` it writes ``docs/pictures/fast_vs_reference.png`` instead: six contacts by both renderers.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from evanesce.chain.simulate import simulate
from evanesce.evaluation.agreement import cases, coarser, picture
from evanesce.evaluation.evaluate import Camera, evaluate
from evanesce.evaluation.labels import label
from evanesce.measurement.reference.segment import Chain
from evanesce.render.fast.transport import render_fast
from evanesce.render.reference.path import render
from evanesce.rig import load_scene

HERE = Path(__file__).resolve().parent
PANELS = (
    ("thesis", 2.0, "smooth, 2 N"),
    ("thesis_ridged", 0.3, "ridged, 0.3 N"),
    ("thesis_ridged", 2.0, "ridged, 2 N"),
)
THRESHOLD = 0.15
TRUE, MEASURED = "#00b3ff", "#ff7f0e"


def main() -> None:
    """Render the panels and write the picture."""
    fast = "--fast" in sys.argv[1:]
    options = {} if fast else {"samples_per_pixel": 256, "passes": 4}
    figure = Figure(figsize=(13.2, 3.7), layout="constrained")
    axes = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.1))
    camera = None
    for axis, (name, force, title) in zip(axes, PANELS, strict=False):
        scene = load_scene(name)
        # Frames are taken as they are: at the middle the lens distorts by less than a pixel.
        camera = camera or Camera.of(scene, None, scene.camera.scale_px_per_mm**-2)
        shot = simulate(scene, force, seed=7, render=render_fast if fast else render, **options)
        found = evaluate(shot, Chain(threshold=THRESHOLD), camera, seed=7, parts=False)
        truth = label(shot.state, camera.geometry)
        rows, cols = slice(550, 950), slice(800, 1200)
        extent = np.array([cols.start, cols.stop, rows.stop, rows.start]) / scene.camera.scale_px_per_mm
        extent -= np.repeat(np.array(shot.frame.data.shape[::-1]) / 2 / scene.camera.scale_px_per_mm, 2)
        axis.imshow(shot.frame.data[rows, cols], cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="nearest")
        where = {"extent": extent, "origin": "upper", "linewidths": 1.1}
        axis.contour(truth.mask[rows, cols], [0.5], colors=TRUE, **where)
        axis.contour(found.measured.estimate.mask[rows, cols], [0.5], colors=MEASURED, **where)
        axis.set(xlabel="x [mm]", title=f"{title}: area {found.comparison.error_percent:+.1f} %")
        if force == PANELS[0][1] and name == PANELS[0][0]:
            axis.set_ylabel("y [mm]")
            row, edge = 750, slice(840, 880)
            axes[3].plot(np.arange(edge.start, edge.stop), shot.frame.data[row, edge], "k.-", label="frame")
            step = 255 * truth.mask[row, edge]
            axes[3].step(np.arange(edge.start, edge.stop), step, where="mid", c=TRUE, label="true contact")
    axes[3].axhline(255 * THRESHOLD, c=MEASURED, ls="--", label=f"threshold {THRESHOLD}")
    axes[3].set(xlabel="column [px]", ylabel="grey level [DN]", title="smooth, across the left edge")
    axes[3].legend(frameon=False, fontsize=8)
    figure.savefig(HERE / "loop.png", dpi=100, facecolor="white")


COMPARED = (0, 2, 3, 4, 5, 8)
"""Of :func:`evanesce.evaluation.agreement.cases`."""


def fast_vs_reference(samples: int = 96) -> None:
    """Render six contacts by path tracer and by transport, and show what differs.

    Parameters
    ----------
    samples : int
        Paths per pixel of the reference.
    """
    figure = Figure(figsize=(13.2, 5.6), layout="constrained")
    axes = figure.subplots(3, len(COMPARED))
    found = cases(coarser(8))
    for column, number in zip(axes.T, COMPARED, strict=True):
        case = found[number]
        traced = render(case.scene, case.state, samples_per_pixel=samples, passes=2, seed=9, focus=False)
        reference, fast = picture(traced, case.scene), picture(render_fast(case.scene, case.state), case.scene)
        half = np.array(reference.shape[::-1]) / 2 / case.scene.camera.scale_px_per_mm
        extent = (-half[0], half[0], half[1], -half[1])
        centre = case.scene.finger.position_mm
        grey = column[0].imshow(reference, cmap="gray", vmin=0, vmax=255, extent=extent)
        column[1].imshow(fast, cmap="gray", vmin=0, vmax=255, extent=extent)
        signed = column[2].imshow(fast - reference, cmap="RdBu_r", vmin=-12, vmax=12, extent=extent)
        for axis in column:
            axis.set(xlim=(centre[0] - 8.5, centre[0] + 8.5), ylim=(centre[1] + 8.5, centre[1] - 8.5))
        column[0].set_title(case.name, fontsize=10)
        column[2].set_xlabel("x [mm]")
    for row, name in zip(axes, ("path tracer", "fast", "fast less path tracer"), strict=True):
        row[0].set_ylabel(f"{name}\ny [mm]")
    figure.colorbar(grey, ax=axes[:2], label="grey level [DN]", shrink=0.8)
    figure.colorbar(signed, ax=axes[2], label="difference [DN]")
    figure.savefig(HERE / "fast_vs_reference.png", dpi=100, facecolor="white")


if __name__ == "__main__":
    if "fast_vs_reference" in sys.argv[1:]:
        fast_vs_reference()
    else:
        main()
