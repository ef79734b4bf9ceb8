"""Series for the page: measured, nominal and extended, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True)
class Curve:
    """One series for the page.

    Attributes
    ----------
    title, x_label, y_label : str
    x, measured, sd, nominal, extended, low, high : ndarray (n,)
        In the series' units; a 90 % interval of the extended model.
    held_out : ndarray of bool (n,)
    """

    title: str
    x_label: str
    y_label: str
    x: Array
    measured: Array
    sd: Array
    nominal: Array
    extended: Array
    low: Array
    high: Array
    held_out: NDArray[np.bool_]


def series_figure(curves: Sequence[Curve]) -> Figure:
    """Return each series, and below it measured over predicted; open circles are rows that were held out."""
    figure = Figure(figsize=(4.6 * len(curves), 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(curves), squeeze=False, gridspec_kw={"height_ratios": [1.6, 1.0]})
    for (above, below), curve in zip(axes.T, curves, strict=True):
        for held, face in ((False, "black"), (True, "white")):
            at = curve.held_out == held
            if not at.any():
                continue
            style = {"fmt": "o", "color": "black", "mfc": face, "ms": 4, "label": "held out" if held else "measured"}
            above.errorbar(curve.x[at], curve.measured[at], yerr=curve.sd[at], **style)
            for y, colour in ((curve.nominal, "#b04a3a"), (curve.extended, "#2f6f9f")):
                below.plot(curve.x[at], curve.measured[at] / y[at], "o", color=colour, mfc=colour if not held else face)
        above.plot(curve.x, curve.nominal, "--", color="#b04a3a", label="scene")
        above.plot(curve.x, curve.extended, color="#2f6f9f", label="with the causes")
        above.fill_between(curve.x, curve.low, curve.high, color="#2f6f9f", alpha=0.2, label="90 % interval")
        relative = curve.sd / curve.measured
        below.fill_between(curve.x, 1.0 - relative, 1.0 + relative, color="0.85")
        below.axhline(1.0, color="black", linewidth=0.8)
        if curve.x.min() > 0 and curve.x.max() > 20 * curve.x.min():
            above.set_xscale("log")
            below.set_xscale("log")
        above.set_title(curve.title, fontsize=9)
        above.set_ylabel(curve.y_label)
        below.set(xlabel=curve.x_label, ylabel="measured over predicted [1]")
    axes[0, 0].legend(fontsize=8)
    return figure
