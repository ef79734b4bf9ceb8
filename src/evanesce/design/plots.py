"""Figures of a design search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from evanesce.design.assessment import Chosen, change
from evanesce.design.search import Plan, Trial, pareto
from evanesce.design.secondary import OBJECTIVES

BASE_COLOUR, FRONT_COLOUR, OTHER_COLOUR = "#d1242f", "#0969da", "0.65"

LABEL_REACH_PT = (7.0, 16.0, 28.0, 42.0)
LABEL_WAYS = 8
LABEL_PENALTY = 100
LEADER = {"arrowstyle": "-", "linewidth": 0.6, "color": "0.4", "shrinkB": 4}
"""Distances of a label from its point, number of directions, penalty of an overlap in points covered, and the line
to a point farther away."""


def _figure(width: float, height: float, cols: int = 1) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(1, cols, squeeze=False)[0]


def label(name: str, plan: Plan) -> str:
    """Return an objective's name with its unit."""
    unit = OBJECTIVES[name].unit
    if name == "cost" and plan.parts is not None:
        unit = plan.parts.currency
    words = "95 % area error" if name == "area_error" else name.replace("_", " ")
    return words if unit == "1" else f"{words} [{unit}]"


def pareto_figure(plan: Plan, trials: Sequence[Trial], chosen: Sequence[Chosen], base: Mapping[str, float]) -> Figure:
    """Return the plot of all trials, Pareto front and winners: the first objective against each of the others."""
    first, *others = plan.objectives
    front = {t.number for t in pareto(trials, plan.objectives)}
    figure, axes = _figure(5.6 * max(1, len(others)) + 0.6, 4.6, max(1, len(others)))
    against: list[str | None] = [*others] or [None]
    for panel, other in zip(axes, against, strict=True):
        for group, colour, size, text in (
            ([t for t in trials if not t.reason and t.violated], "#e0c040", 18, "violates a limit"),
            ([t for t in trials if t.feasible and t.number not in front], OTHER_COLOUR, 18, "evaluated"),
            ([t for t in trials if t.number in front], FRONT_COLOUR, 34, "Pareto front"),
        ):
            if not group:
                continue
            x = [t.figures[other] if other else t.number for t in group]
            y = [t.figures[first] for t in group]
            if first == "area_error":
                spread = [t.standard_percent for t in group]
                panel.errorbar(x, y, yerr=spread, fmt="none", ecolor=colour, elinewidth=0.8, alpha=0.6)
            panel.scatter(x, y, s=size, color=colour, label=text, zorder=2)
        if other:
            panel.plot(base[other], base[first], "*", color=BASE_COLOUR, markersize=14, label="as given", zorder=4)
        else:
            panel.axhline(base[first], color=BASE_COLOUR, label="as given")
        panel.set(xlabel=label(other, plan) if other else "trial", ylabel=label(first, plan), yscale="log")
        panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        panel.yaxis.set_minor_formatter(NullFormatter())
        panel.grid(alpha=0.3)
    axes[0].legend(frameon=True, fontsize=8)
    figure.draw_without_rendering()  # positions depend on the final layout
    figure.set_layout_engine("none")
    for panel, other in zip(axes, against, strict=True):

        def at(trial: Trial, other: str | None = other) -> tuple[float, float]:
            return (trial.figures[other] if other else trial.number), trial.figures[first]

        drawn = [(*at(t), t.standard_percent if first == "area_error" else 0.0) for t in trials if not t.reason]
        drawn.append((base[other] if other else 0.0, base[first], 0.0))
        name_points(panel, [(c.name, at(c.trial)) for c in chosen if c.trial is not None], drawn)
    return figure


def name_points(
    panel: Any, names: Sequence[tuple[str, tuple[float, float]]], drawn: Sequence[tuple[float, float, float]]
) -> None:
    """Label points, each at the offset that covers fewest points, error bars, labels and parts of the legend.

    Parameters
    ----------
    panel : matplotlib.axes.Axes
        With its final limits.
    names : sequence of (text, (x, y))
    drawn : sequence of (x, y, half length of the bar)
        All points of the panel, labelled ones included.
    """
    renderer = panel.figure.canvas.get_renderer()
    along = np.linspace(-1.0, 1.0, 9)
    spots = np.array([(x, max(y + s * bar, 1e-9)) for x, y, bar in drawn for s in along])
    hidden = panel.transData.transform(spots)
    legend = panel.get_legend()
    taken = [] if legend is None else [legend.get_window_extent(renderer)]
    axes_box = panel.get_window_extent(renderer)
    for text, point in names:
        tried: list[tuple[int, int, Any, Any]] = []
        for reach in LABEL_REACH_PT:
            for k in range(LABEL_WAYS):
                angle = np.pi / 4 + 2 * np.pi * k / LABEL_WAYS  # up and to the right first
                dx, dy = reach * np.cos(angle), reach * np.sin(angle)
                note = panel.annotate(
                    text, point, xytext=(dx, dy), textcoords="offset points", fontsize=9, zorder=5,
                    ha="left" if dx > 1 else "right" if dx < -1 else "center",
                    va="bottom" if dy > 1 else "top" if dy < -1 else "center",
                    arrowprops=None if reach == LABEL_REACH_PT[0] else LEADER,
                )  # fmt: skip
                box = Text.get_window_extent(note, renderer).padded(2.0)  # of the words, without the line to the point
                covered = int(box.count_contains(hidden)) + LABEL_PENALTY * sum(box.overlaps(other) for other in taken)
                outside = not (axes_box.contains(box.x0, box.y0) and axes_box.contains(box.x1, box.y1))
                tried.append((covered + LABEL_PENALTY * outside, len(tried), note, box))
        best = min(tried, key=lambda one: one[:2])
        for one in tried:
            if one is not best:
                one[2].remove()
        taken.append(best[3])


def cases_figure(found: Mapping[str, Any], base: Mapping[str, Any] | None) -> Figure:
    """Return the box plot of all drawn rigs' errors by case, a design's beside the base's."""
    figure, (panel,) = _figure(1.9 * len(found["errors_percent"]) + 2.5, 4.0)
    names = list(found["errors_percent"])
    groups = [("this design", found, FRONT_COLOUR, 0.17)] + ([("as given", base, BASE_COLOUR, -0.17)] if base else [])
    for text, data, colour, shift in groups:
        values = [data["errors_percent"][name] for name in names]
        at = np.arange(len(names)) + (shift if base else 0.0)
        boxes = panel.boxplot(values, positions=at, widths=0.28, whis=(2.5, 97.5), patch_artist=True, showfliers=True,
                              flierprops={"markersize": 3})  # fmt: skip
        for patch in boxes["boxes"]:
            patch.set(facecolor=colour, alpha=0.45)
        for line in boxes["medians"]:
            line.set(color="k")
        panel.plot([], [], color=colour, linewidth=6, alpha=0.45, label=text)
    panel.axhline(0.0, color="k", linewidth=0.8)
    panel.set_xticks(np.arange(len(names)), [n.replace(" at ", "\nat ").replace(" mm, ", " mm\n") for n in names])
    panel.set_ylabel("area error [%]")
    panel.legend(frameon=False)
    return figure


def tolerance_figure(rows: Sequence[Mapping[str, Any]], most: int = 12) -> Figure:
    """Return the bar chart of one measurement's change by each parameter, one standard deviation down and up."""
    shown = list(rows[:most])[::-1]
    figure, (panel,) = _figure(8.0, 0.34 * len(shown) + 1.2)
    for k, row in enumerate(shown):
        panel.barh(k + 0.18, row["high_percent"], 0.36, color=FRONT_COLOUR)
        panel.barh(k - 0.18, row["low_percent"], 0.36, color="#e39b3a")
    panel.barh([0], [0], color=FRONT_COLOUR, label="one standard deviation up")
    panel.barh([0], [0], color="#e39b3a", label="down")
    panel.set_yticks(range(len(shown)), [r["name"] for r in shown])
    panel.axvline(0.0, color="k", linewidth=0.8)
    limit = max([change(r) for r in shown], default=1.0)
    panel.set(xlabel="change of the area error [% of the area]", xlim=(-1.1 * limit, 1.1 * limit))
    panel.legend(frameon=False, fontsize=8, loc="lower right")
    return figure


def frame_figure(frames: Sequence[tuple[str, NDArray[np.uint8], Any]], threshold: float | None) -> Figure:
    """Return the plot of measured parts of frames with the true outline and the measured one.

    Parameters
    ----------
    frames : sequence of (title, crop, lines)
        ``lines``: (true, measured), each a list of (n, 2) points (x, y) in the crop [px].
    threshold : float or None
        Drawn into the histogram [1].
    """
    figure, axes = _figure(4.4 * (len(frames) + 1), 4.4, len(frames) + 1)
    for panel, (title, crop, lines) in zip(axes[:-1], frames, strict=True):
        panel.imshow(crop, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        for points, colour, style in zip(lines, ("#00b3ff", "#ff7f0e"), ("-", "--"), strict=True):
            for line in points:
                panel.plot(line[:, 0], line[:, 1], style, color=colour, linewidth=1.1)
        panel.set(title=title, xlabel="column [px]", ylabel="row [px]")
        panel.set_xlim(-0.5, crop.shape[1] - 0.5)
        panel.set_ylim(crop.shape[0] - 0.5, -0.5)
    panel = axes[-1]
    for title, crop, _ in frames:
        counts, edges = np.histogram(crop, bins=np.arange(0, 257, 4))
        panel.stairs(np.maximum(counts, 0.5), edges / 255, label=title)
    if threshold is not None:
        panel.axvline(threshold, color="#ff7f0e", linestyle="--", label="threshold")
    panel.set(xlabel="grey level [1]", ylabel="pixels of the crop", yscale="log", title="histogram")
    panel.legend(frameon=False, fontsize=8)
    return figure
