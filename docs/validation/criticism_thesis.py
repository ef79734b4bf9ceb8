"""Areas of Silskin 20 % from the thesis beside the believed rig and beside single causes fitted to them.

Run: python docs/validation/criticism_thesis.py BUNDLE PICTURE (some minutes)
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from evanesce.bundle import read_bundle
from evanesce.criticism.scalar import SeriesPredictor, Table, fit_series
from evanesce.prediction.candidates import candidates_of

SHOWN = {
    "lateral_glow": ("light", "length_mm"),
    "led_edge_reflections": ("light", "relative_radiance"),
    "modulus": ("mechanics", "relative"),
    "creep": ("mechanics", "per_decade"),
}
"""Kind of each cause, and its one parameter that is fitted here."""


def main() -> None:
    """Fit, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("picture", type=Path)
    given = parser.parse_args()
    bundle = read_bundle(given.bundle)
    table = Table.of(list(bundle.series.values()))
    series = table.series[0]
    predict = SeriesPredictor(bundle.scene, table.series)
    table = table.widened(predict.refine(bundle.scene))
    base = fit_series(predict, table, (), (), {})
    print(f"believed: chi-square {base.chi_square:.1f} of {table.log_y.size} points at {table.sigma[0]:.0%}")
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    left.errorbar(series.x, series.y, yerr=table.sigma * series.y, fmt="ko", ms=4, label="thesis")
    left.plot(series.x, np.exp(base.predicted), "k--", label="believed rig")
    for (name, (kind, parameter)), colour in zip(
        SHOWN.items(), ("tab:blue", "tab:cyan", "tab:red", "tab:orange"), strict=True
    ):
        candidate = next(c for c in candidates_of(bundle.scene, bundle.testable) if c.id == name)
        chosen = tuple(p for p in candidate.parameters if p.name == f"{name}:{parameter}")
        start = {p.name: float(np.clip(p.null + p.deviation, *p.bounds)) for p in chosen}
        found = fit_series(predict, table, (name,), chosen, start)
        values = ", ".join(f"{p.name} {found.point[p.name]:.3g} {p.unit}" for p in chosen)
        off = np.exp(table.log_y - found.predicted) - 1.0
        spread = f"thesis over model {off.min():+.0%} to {off.max():+.0%}"
        print(f"{name} ({kind}): chi-square {found.chi_square:.1f}; {values}; {spread}")
        left.plot(series.x, np.exp(found.predicted), color=colour, label=f"{name} ({kind})")
        right.plot(series.x, np.exp(table.log_y - found.predicted), "o-", ms=3, color=colour, label=name)
    right.plot(series.x, np.exp(table.log_y - base.predicted), "k--", label="believed rig")
    right.fill_between(series.x, 1 - table.sigma, 1 + table.sigma, color="0.85")
    left.set(xlabel="normal force [N]", ylabel="area by the reference segmentation [mm$^2$]")
    right.set(xlabel="normal force [N]", ylabel="thesis over model [1]")
    left.legend(fontsize=8)
    figure.savefig(given.picture, dpi=110)


if __name__ == "__main__":
    main()
