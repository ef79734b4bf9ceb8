"""Pictures of docs/howto/design.md, of a finished `make design-demo`.

Run: python docs/pictures/design.py [outputs/design-demo]
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from evanesce.design.assessment import Chosen, ranked
from evanesce.design.plots import cases_figure, pareto_figure, tolerance_figure
from evanesce.design.question import Design, Question
from evanesce.design.search import Plan, Trial
from evanesce.design.variables import DesignVariable
from evanesce.report.html import figure_png
from evanesce.rig import load_scene

HERE = Path(__file__).resolve().parent
REACH_PX = 260
"""Half the side of the enlarged part."""


def pareto(result: dict[str, Any]) -> Figure:
    """Return the Pareto plot from the search's own file."""
    scene = load_scene("thesis")
    figures = {"figures": {}, "standard_percent": math.nan, "reason": "", "broken": ()}
    keys = ("number", "values", *figures)
    trials = [Trial(**{key: trial.get(key, figures.get(key)) for key in keys}) for trial in result["trials"]]
    by_number = {f"trial-{t.number}": t for t in trials}
    chosen = [
        Chosen(name=name, why=c["why"], values=c["values"], trial=by_number.get(name))
        for name, c in result["chosen"].items()
    ]
    plan = Plan(
        base=Design(scene=scene),
        variables=tuple(DesignVariable(**v) for v in result["provenance"]["search"]["variables"]),
        question=Question(forces_N=(1.0, 3.0), positions_mm=((0.0, 0.0),), materials=(scene.finger.material,)),
        objectives=tuple(result["objectives"]),
    )  # fmt: skip
    return pareto_figure(plan, trials, chosen, result["chosen"]["base"]["searched"]["figures"])


def frames(folder: Path, found: dict[str, Any]) -> Figure:
    """Return the whole frame of each design at the largest force, and the contact in it enlarged."""
    figure = Figure(figsize=(3.1 * len(found), 4.5), layout="constrained")
    axes = figure.subplots(2, len(found), squeeze=False, height_ratios=(3, 4))
    for name, (whole, part) in zip(found, axes.T, strict=True):
        frame = np.asarray(Image.open(folder / f"{name}.png").convert("L"))
        whole.imshow(
            cv2.resize(frame, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA), cmap="gray", vmin=0, vmax=255
        )
        whole.set_title("the thesis's rig" if name == "base" else name.replace("-", " "), fontsize=10)
        row, col = frame.shape[0] // 2, frame.shape[1] // 2
        part.imshow(
            frame[row - REACH_PX : row + REACH_PX, col - REACH_PX : col + REACH_PX], cmap="gray", vmin=0, vmax=255
        )
        grey = np.median(frame[row - 40 : row + 40, col - 40 : col + 40])
        part.set_xlabel(f"enlarged; middle {grey:.0f} of 255 DN", fontsize=9)
        for panel in (whole, part):
            panel.set(xticks=[], yticks=[])
    return figure


def main() -> None:
    """Draw the Pareto plot, the frames, the first winner's errors by load and its tolerances."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("outputs/design-demo")
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    found = result["chosen"]
    winner = next(design for name, design in found.items() if name != "base")
    figures = {
        "pareto": pareto(result),
        "frames": frames(folder, found),
        "cases": cases_figure(winner["assessed"], found["base"]["assessed"]),
        "tolerances": tolerance_figure(ranked(winner["tolerances"]["rows"])),
    }
    for name, figure in figures.items():
        (HERE / f"design-{name}.png").write_bytes(figure_png(figure, dpi=90))


if __name__ == "__main__":
    main()
