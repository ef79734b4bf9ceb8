"""Make the picture of the tutorial of a first measurement: ``python docs/pictures/first_lab.py [FOLDER]``.

A folder keeps the lab's files and results, and those in it are used again; a temporary one is made without.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "tests"))

import evanesce as ev  # noqa: E402
from support.labs import LABS, Contact, Rig, shares  # noqa: E402
from support.walk import walk  # noqa: E402

TRUE, REFINED, OTHER = "#0072b2", "#d55e00", "#999999"


def grey(axis: Axes, picture: np.ndarray, title: str) -> None:
    """Show a picture."""
    axis.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    axis.set(xticks=[], yticks=[])
    axis.set_title(title, fontsize=10)


def main(folder: Path) -> None:
    """Walk the lab unless it was, and draw."""
    lab = next(lab for lab in LABS if lab.name == "rough")
    rig = Rig(lab)
    if not (folder / "measured.json").is_file():
        walk(lab, folder)
    data = json.loads((folder / "measured.json").read_text())
    frames, joined = data["frames"], data["area_force"]
    figure = Figure(figsize=(11.5, 7.4), layout="constrained")
    axes = figure.subplots(2, 3)
    grey(axes[0, 0], cv2.imread(str(folder / "board0.png"), cv2.IMREAD_GRAYSCALE), "board on the glass, LEDs off")
    grey(axes[0, 1], cv2.imread(str(folder / "card.png"), cv2.IMREAD_GRAYSCALE), "white card on the glass")
    k = lab.frames - 1
    image = rig.frame(k)
    pipeline = ev.Pipeline(
        calibration=str(folder / "cal.json"), estimator="refined", dark=[rig.frame(0) for _ in range(3)]
    )
    found = pipeline.measure(image)
    grey(axes[0, 2], image, f"frame {k} and the boundary found")
    share = shares(rig.x - lab.middle[0], rig.y - lab.middle[1], Contact(lab.axes(k), lab.ridges, lab.air))
    grey(axes[1, 0], image, "its middle: true boundary (blue), found (orange)")
    axes[1, 0].contour(share, [0.5], colors=TRUE, linewidths=4, alpha=0.6)
    for contour in found.contours_px:
        axes[0, 2].plot(*np.asarray(contour).T, color=REFINED, lw=0.7)
        axes[1, 0].plot(*np.asarray(contour).T, color=REFINED, lw=1.2, zorder=5)
    rows, cols = np.nonzero(share > 0.5)
    axes[1, 0].set(xlim=(cols.mean() - 45, cols.mean() + 45), ylim=(rows.mean() + 38, rows.mean() - 38))
    times(axes[1, 1], frames, [rig.true(n) for n in range(lab.frames)])
    force, area = (np.array([row[key] for row in joined["frames"]]) for key in ("force_N", "area_mm2"))
    law, line = joined["power_law"], np.linspace(0.02, force.max(), 200)
    axes[1, 2].plot(force, area, ".", color=REFINED, ms=4, label="refined area")
    axes[1, 2].plot(line, law["factor"] * line ** law["exponent"], color=REFINED, lw=1,
                    label=f"fit: {law['factor']:.2f} F^{law['exponent']:.3f}")  # fmt: skip
    axes[1, 2].plot(line, lab.law[0] * line ** lab.law[1], "--", color=TRUE, lw=1,
                    label=f"drawn: {lab.law[0]:.2f} F^{lab.law[1]:.3f}")  # fmt: skip
    axes[1, 2].set(
        xlabel="force [N]", ylabel="area [mm²]", title=f"clocks {joined['offset_s']:.3f} s apart (drawn 0.900)"
    )
    axes[1, 2].legend(frameon=False, fontsize=8)
    figure.savefig(HERE / "first-lab.png", dpi=90, facecolor="white")


def times(axis: Axes, frames: list[dict[str, float]], true: list[float]) -> None:
    """Draw areas with intervals against time, the reference segmentation's beside them."""
    time, area, low, high = (
        np.array([row[key] for row in frames]) for key in ("time_s", "area_mm2", "area_low_mm2", "area_high_mm2")
    )
    axis.fill_between(time, low, high, color=REFINED, alpha=0.3, lw=0, label="95 % interval")
    axis.plot(time, area, color=REFINED, lw=1, label="refined area")
    axis.plot(time, true, "--", color=TRUE, lw=1, label="drawn area")
    axis.plot(time, [row["reference_mm2"] for row in frames], color=OTHER, lw=1, label="reference at 0.15")
    axis.set(xlabel="time [s]", ylabel="area [mm²]", title="area against time")
    axis.legend(frameon=False, fontsize=8)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as name:
            main(Path(name))
