"""Pictures of docs/design.md, of a finished `make design-demo`.

Run: python docs/pictures/design.py [outputs/design-demo]
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

from evanesce.design.finish import ranked
from evanesce.report.design_plots import cases_figure, tolerance_figure
from evanesce.report.html import figure_png

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Copy the Pareto plot; draw the first winner's errors by load and its tolerances."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("outputs/design-demo")
    found = json.loads((folder / "result.json").read_text(encoding="utf-8"))["chosen"]
    winner = next(design for name, design in found.items() if name != "base")
    shutil.copyfile(folder / "pareto.png", HERE / "design-pareto.png")
    figures = {
        "cases": cases_figure(winner["assessed"], found["base"]["assessed"]),
        "tolerances": tolerance_figure(ranked(winner["tolerances"]["rows"])),
    }
    for name, figure in figures.items():
        (HERE / f"design-{name}.png").write_bytes(figure_png(figure, dpi=90))


if __name__ == "__main__":
    main()
