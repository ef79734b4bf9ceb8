"""Pictures of docs/background/voltage.md: the figures of `evanesce study voltage thesis_ridged --samples 32`.

Run: python docs/pictures/voltage.py [FOLDER with samples.npz of such a run] (several minutes without it)
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from evanesce.report.html import figure_png
from evanesce.rig import load_scene
from evanesce.studies.voltage.page import best_figure, curves_figure, frames_figure, holds_figure
from evanesce.studies.voltage.study import run_study

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Run the study and write its figures."""
    keep = Path(sys.argv[1]) / "samples.npz" if len(sys.argv) > 1 else None
    volts = tuple(float(v) for v in np.round(np.arange(7.0, 12.001, 0.25), 9))
    found = run_study(load_scene("thesis_ridged"), (1.0, 5.0), volts, base=32, keep=keep)
    figures = {"curves": curves_figure, "frames": frames_figure, "holds": holds_figure, "best": best_figure}
    for name, draw in figures.items():
        (HERE / f"voltage-{name}.png").write_bytes(figure_png(draw(found), dpi=90))


if __name__ == "__main__":
    main()
