"""Make the pictures of the tutorials from what their pages compute: ``python docs/pictures/tutorials.py [NAME ...]``.

Names are those of the pictures: measurement, rig, threshold, dataset, effect; all of them by default.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import evanesce as ev

HERE = Path(__file__).resolve().parent
TUTORIALS = HERE.parent / "tutorials"
TRUE, MEASURED, REFINED = "#00b3ff", "#ff7f0e", "#2ca02c"


def fenced(page: str, note: str) -> str:
    """Return the block of a tutorial that a note stands before."""
    text = (TUTORIALS / page).read_text(encoding="utf-8")
    return text.split(f"<!-- {note} -->\n```")[1].split("\n", 1)[1].split("\n```")[0]


def extent(shot: ev.Shot) -> tuple[float, float, float, float]:
    """Return the edges of a frame [mm] from its middle, as imshow takes them."""
    rows, cols = np.array(shot.frame.shape) * shot.scale_mm2_per_px**0.5 / 2
    return -cols, cols, rows, -rows


def show(axis: Axes, shot: ev.Shot, half_mm: float, title: str = "") -> None:
    """Show a frame about its middle."""
    axis.imshow(shot.frame, cmap="gray", vmin=0, vmax=255, extent=extent(shot), interpolation="nearest")
    axis.set(xlim=(-half_mm, half_mm), ylim=(half_mm, -half_mm), xlabel="x [mm]", title=title)


def measurement() -> Figure:
    """Frame, mask over truth, and the refined boundary at the contact's edge."""
    camera = ev.Camera(ev.coarser(ev.load("thesis_ridged"), 2))
    shot = camera.shoot(force_N=2.0, seed=1)
    calibration = ev.calibrate([camera.shoot_target("checkerboard")], square=camera.shoot_target("square"))
    plain = ev.measure(shot.frame, scale_mm2_per_px=shot.scale_mm2_per_px, threshold=0.15, min_blob_px=500)
    refined = ev.measure(shot.frame, calibration=calibration, estimator="refined")
    figure = Figure(figsize=(11, 3.9), layout="constrained")
    axes = figure.subplots(1, 3)
    show(axes[0], shot, 3.6, "frame")
    axes[0].set_ylabel("y [mm]")
    colours = np.full((*shot.frame.shape, 3), 255, np.uint8)
    truth, mask = shot.truth.mask, plain.mask
    for where, colour in ((truth & mask, "#0072b2"), (truth & ~mask, "#f0e442"), (mask & ~truth, "#d55e00")):
        colours[where] = [round(255 * part) for part in matplotlib.colors.to_rgb(colour)]
    axes[1].imshow(colours, extent=extent(shot), interpolation="nearest")
    axes[1].set(xlim=(-3.6, 3.6), ylim=(3.6, -3.6), xlabel="x [mm]", title="threshold 0.15: blue true, orange false")
    show(axes[2], shot, 3.6, "left edge: true and refined boundary")
    axes[2].contour(shot.truth.coverage, [0.5], colors=TRUE, extent=extent(shot), origin="upper", linewidths=2)
    pitch = shot.scale_mm2_per_px**0.5
    middle = (np.array(shot.frame.shape[::-1]) - 1) / 2
    for contour in refined.contours_px:
        axes[2].plot(*((np.asarray(contour) - middle) * pitch).T, color=REFINED, lw=1, ls="--")
    axes[2].set(xlim=(-2.7, -1.9), ylim=(0.4, -0.4))
    return figure


def rig() -> Figure:
    """The rig of the second tutorial at two ridge heights."""
    path = HERE / ".rig.toml"
    path.write_text(fenced("your-own-rig.md", "file: rig.toml"), encoding="utf-8")
    try:
        scene = ev.load(path)
    finally:
        path.unlink()
    figure = Figure(figsize=(8.4, 4.2), layout="constrained")
    for axis, height in zip(figure.subplots(1, 2), (150.0, 40.0), strict=True):
        shot = ev.Camera(scene.with_(finger__ridges__height_um=height)).shoot(force_N=1.5, seed=1)
        show(axis, shot, 4.5, f"ridges of {height:.0f} µm, 1.5 N: {shot.truth.area_mm2:.1f} mm²")
    return figure


def threshold() -> Figure:
    """Area error by voltage and threshold, and frames at three voltages."""
    scene = ev.coarser(ev.load("thesis").with_(finger__scattering_length_mm=0.5), 4)
    voltages, thresholds = np.arange(8.0, 10.01, 0.25), np.linspace(0.05, 0.7, 27)
    shots = {v: ev.Camera(scene.with_(leds__voltage_V=float(v))).shoot(force_N=2.0, seed=1) for v in voltages}
    errors = np.empty((len(voltages), len(thresholds)))
    for row, shot in zip(errors, shots.values(), strict=True):
        for i, level in enumerate(thresholds):
            found = ev.measure(
                shot.frame, scale_mm2_per_px=shot.scale_mm2_per_px, threshold=float(level), min_blob_px=125
            )
            row[i] = 100 * (found.area_mm2 / shot.truth.area_mm2 - 1)
    figure = Figure(figsize=(12, 3.6), layout="constrained")
    axes = figure.subplots(1, 4, width_ratios=(1.6, 1, 1, 1))
    mesh = axes[0].pcolormesh(thresholds, voltages, errors, cmap="RdBu_r", vmin=-100, vmax=100, shading="nearest")
    axes[0].contour(thresholds, voltages, errors, [-10, 10], colors="k", linewidths=0.8)
    axes[0].set(xlabel="threshold", ylabel="LED voltage [V]", title="between the lines: less than 10 %")
    figure.colorbar(mesh, ax=axes[0], label="area error [%]")
    for axis, voltage in zip(axes[1:], (8.5, 9.5, 10.0), strict=True):
        show(axis, shots[voltage], 5.5, f"{voltage:g} V")
        axis.contour(
            shots[voltage].truth.coverage,
            [0.5],
            colors=TRUE,
            extent=extent(shots[voltage]),
            origin="upper",
            linewidths=1,
        )
    return figure


def dataset() -> Figure:
    """Frames and surface states along one slide."""
    samples = ev.make_dataset(
        ev.load("thesis_ridged"),
        trials=1,
        seed=7,
        trial__frames=40,
        camera__size_px=(320, 240),
        kinds={"slide": 1.0, "load_stop": 0, "wiggle": 0, "rotation": 0, "ramp": 0, "release": 0, "change": 0},
        randomisation__probability=0.0,
    )
    ratio = [sample.scalars["stick_ratio"] for sample in samples]
    moving = next(i for i, value in enumerate(ratio) if value < 0.9 and i > 3)
    chosen = np.linspace(moving - 2, min(moving + 12, len(ratio) - 1), 5).astype(int)
    figure = Figure(figsize=(12, 5), layout="constrained")
    axes = figure.subplots(2, 5)
    colours = matplotlib.colors.ListedColormap(["#ffffff", "#dddddd", "#0072b2", "#e69f00"])
    for column, index in zip(axes.T, chosen, strict=True):
        sample = samples[int(index)]
        column[0].imshow(sample.frame, cmap="gray", vmin=0, vmax=255)
        column[1].imshow(sample.state, cmap=colours, vmin=0, vmax=3, interpolation="nearest")
        column[0].set_title(f"{sample.scalars['time_s']:.2f} s: stick ratio {ratio[index]:.2f}", fontsize=10)
        for axis in column:
            axis.set(xticks=[], yticks=[])
    axes[0, 0].set_ylabel("frame")
    axes[1, 0].set_ylabel("blue sticks, orange slips")
    return figure


def effect() -> Figure:
    """The effect of the last tutorial on a frame."""
    names: dict[str, object] = {"__name__": "veiling_glare"}
    exec(compile(fenced("new-effect.md", "file: veiling_glare.py"), "veiling_glare.py", "exec"), names)
    apply, parameters = names["apply"], names["Parameters"]
    camera = ev.Camera(ev.coarser(ev.load("thesis"), 4))
    shot = camera.shoot(force_N=2.0, seed=1)
    figure = Figure(figsize=(10, 3.4), layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=(1, 1, 1.2))
    for axis, share in zip(axes, (0.0, 0.2), strict=False):
        light = apply(shot.sensor_light, parameters(share=share), None)
        level = np.asarray(light.irradiance) / np.asarray(shot.sensor_light.irradiance).max()
        axis.imshow(level**0.45, cmap="gray", vmin=0, vmax=1, extent=extent(shot))
        axis.set(xlim=(-6, 6), ylim=(6, -6), title=f"share {share:g}", xlabel="x [mm]")
        axes[2].semilogy(
            np.linspace(*extent(shot)[:2], level.shape[1]), level[level.shape[0] // 2], label=f"share {share:g}"
        )
    axes[2].set(ylim=(1e-4, 2), xlabel="x [mm]", ylabel="irradiance over its maximum", title="along the middle row")
    axes[2].legend(frameon=False)
    return figure


PICTURES: dict[str, Callable[[], Figure]] = {f.__name__: f for f in (measurement, rig, threshold, dataset, effect)}


if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name]().savefig(HERE / f"tutorial-{name}.png", dpi=90, facecolor="white")
