"""Picture of docs/reference/dataset.md: learning curves of the baselines and what randomised effects are worth.

Run: python docs/pictures/baseline.py [JSON of benchmarks/baseline.py; the one the data card reports by default]
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from evanesce.dataset.baselines import RECORD, TESTS
from evanesce.report.html import figure_png

HERE = Path(__file__).resolve().parent
LOOKS = {
    "train": ("#0072B2", "o-", "rigs with effects", "frames"),
    "train_rigs": ("#009E73", "^-.", "the same without effects", "frames, rigs without effects"),
    "train_plain": ("#D55E00", "s--", "one plain rig", "frames, one plain rig"),
}


def draw(found: dict[str, Any]) -> Figure:
    """Return the error of the stick ratio over the size of the training set, one panel a test."""
    figure = Figure(figsize=(10, 3.4), layout="constrained")
    axes = figure.subplots(1, len(TESTS), sharey=True)
    for axis, (test, title) in zip(axes, TESTS.items(), strict=True):
        for name, (colour, style, label, detector) in LOOKS.items():
            curve = found["curves"][name]
            counts = sorted(curve, key=int)
            axis.plot([int(n) for n in counts], [curve[n][test] for n in counts], style, color=colour, label=label)
            whole = found["results"][detector][test]
            axis.errorbar(int(counts[-1]), whole["mae"], whole["mae_standard"], color=colour, capsize=3)
        force = found["results"]["force threshold"][test]["mae"]
        axis.axhline(force, color="0.35", lw=1, ls=":", label="from the force ratio")
        axis.axhline(found["constant_mae"][test], color="0.35", lw=1, ls="-.", label="a constant")
        axis.set_title(title, fontsize=10)
        axis.set(xlabel="training trials", xscale="log")
        axis.set_xticks([int(n) for n in counts], [str(n) for n in counts], minor=False)
        axis.minorticks_off()
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("mean absolute error of the stick ratio")
    axes[0].legend(fontsize=8, loc="upper right", bbox_to_anchor=(1.0, 0.9))
    return figure


def main() -> None:
    """Write the picture."""
    source = Path(sys.argv[1]) if len(sys.argv) > 1 else RECORD
    found = json.loads(source.read_text(encoding="utf-8"))
    (HERE / "dataset-baseline.png").write_bytes(figure_png(draw(found), dpi=90))


if __name__ == "__main__":
    main()
