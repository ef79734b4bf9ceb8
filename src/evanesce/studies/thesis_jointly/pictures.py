"""Pictures of a joint judgement: one of each kind of outcome, the mechanisms' probabilities, the sheet of all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

Rows = Sequence[Mapping[str, Any]]

TITLES = {
    "read_area": "area by the waveguide", "depth": "depth on glass (eq 5.3)",
    "cylinder_depth": "depth under the cylinder", "youngs_modulus": "Young's modulus (DMA)",
    "friction": "static friction at 1 N", "tilt_friction": "friction change, 0 to 45 deg",
    "ridged_over_smooth": "ridged over smooth area", "ridged_depth": "ridged over smooth depth, less 1",
    "ridged_friction": "ridged over smooth friction", "fe_area": "area by finite elements",
    "overshoot": "force change at held depth",
    "length_change": "area change, L 7.5 to 25 mm", "diameter_change": "area change, D 15 to 20 mm",
    "bone_change": "area change by a bone", "lost_below": "patch lost below",
    "growth": "area change, 9 to 12 V",
}  # fmt: skip
NAMES = {"silskin_0": "Silskin 0 %", "silskin_20": "Silskin 20 %"}
BELIEVED, EXTENDED, OTHERS, PUBLISHED = "#8c959f", "#1f6feb", "#d1571b", "#000000"


def groups_of(result: Mapping[str, Any]) -> dict[str, list[Mapping[str, Any]]]:
    """Return the outcomes of a result by group, in order.

    Parameters
    ----------
    result : mapping
        Of :func:`evanesce.studies.thesis_jointly.answer.criticise_thesis`.

    Returns
    -------
    dict
    """
    found: dict[str, list[Mapping[str, Any]]] = {}
    for row in result["outcomes"]:
        found.setdefault(row["group"], []).append(row)
    return found


def title_of(group: str) -> str:
    """Return a group's name in words."""
    name, _, kind = group.partition(":")
    return f"{NAMES[name]}: {TITLES[kind]}"


def outcome_figure(group: str, rows: Rows) -> Figure:
    """Return one group's outcomes: published, believed, extended, predicted from the others.

    Parameters
    ----------
    group : str
    rows : sequence of mapping

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(5.4, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    draw_outcome(figure.subplots(), group, rows)
    figure.legend(*_handles(figure.axes[0]), loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    return figure


def sheet(result: Mapping[str, Any], columns: int = 4) -> Figure:
    """Return all outcomes on one sheet.

    Parameters
    ----------
    result : mapping
    columns : int

    Returns
    -------
    Figure
    """
    groups = groups_of(result)
    rows = -(-len(groups) // columns)
    figure = Figure(figsize=(3.3 * columns, 2.5 * rows + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, (group, own) in zip(axes, groups.items(), strict=False):
        draw_outcome(axis, group, own, small=True)
    for axis in axes[len(groups) :]:
        axis.set_axis_off()
    figure.legend(*_handles(axes[0]), loc="outside lower center", ncols=4, fontsize=10, frameon=False)
    return figure


def draw_outcome(axis: Axes, group: str, rows: Rows, *, small: bool = False) -> None:
    """Draw one group.

    Parameters
    ----------
    axis : Axes
    group : str
    rows : sequence of mapping
    small : bool
        Smaller text.
    """
    places = np.arange(len(rows), dtype=float)
    axis.plot(places - 0.24, [r["believed"] for r in rows], "s", ms=5, color=BELIEVED, label="believed (nominal model)")
    for key, shift, colour, label in (
        ("extended", 0.08, EXTENDED, "extended, 90 % interval"),
        ("from_others", 0.24, OTHERS, "from the other outcomes alone, 90 %"),
    ):
        shown = [(x, r[key]) for x, r in zip(places, rows, strict=True) if r[key] is not None]
        if shown:
            at, y = np.array([s[0] for s in shown]) + shift, np.array([s[1] for s in shown])
            axis.errorbar(at, y[:, 0], (y[:, 0] - y[:, 1], y[:, 2] - y[:, 0]), fmt="o", ms=4, color=colour, label=label)
    first = True
    for x, row in zip(places, rows, strict=True):
        for figure in row["published"]:
            once = "published, 1 standard deviation" if first else None
            axis.errorbar(x - 0.08, figure, row["sd"], fmt="D", ms=4, color=PUBLISHED, capsize=3, label=once)
            first = False
    size = 8 if small else 10
    axis.set_xticks(places, [_condition(row) for row in rows], fontsize=size)
    axis.set_xlim(-0.6, len(rows) - 0.4)
    values = [v for r in rows for v in (*r["published"], r["believed"], *r["extended"])]
    change = "change" in TITLES[group.partition(":")[2]]
    if not change and min(values) > 0 and max(values) > 4 * min(values):
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.4, 2.0, 3.0, 5.0, 7.0)))
        axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.yaxis.set_minor_locator(NullLocator())
    axis.set_ylabel(f"[{rows[0]['unit'].replace('mm2', 'mm²')}]", fontsize=size)
    axis.tick_params(labelsize=size)
    axis.set_title(title_of(group), fontsize=size + 0.5)
    axis.grid(axis="y", alpha=0.3)


def _condition(row: Mapping[str, Any]) -> str:
    if "friction" in row["at"]:
        return f"mu {row['at']['friction']:g}"
    return f"{row['at']['force_N']:g} N" if "force_N" in row["at"] else ""


def _handles(axis: Axes) -> tuple[list[Any], list[str]]:
    handles, labels = axis.get_legend_handles_labels()
    return handles, labels


def mechanism_figure(result: Mapping[str, Any]) -> Figure:
    """Return bars of the mechanisms' probabilities.

    Parameters
    ----------
    result : mapping

    Returns
    -------
    Figure
    """
    rows = result["mechanisms"]
    figure = Figure(figsize=(8.6, 0.3 * len(rows) + 0.9), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    at = np.arange(len(rows))[::-1]
    colours = [{"named": EXTENDED, "excluded": BELIEVED}.get(r["verdict"], OTHERS) for r in rows]
    axis.barh(at, [max(r["probability"], 0.003) for r in rows], color=colours)
    for y, row in zip(at, rows, strict=True):
        inside = row["probability"] > 0.85
        axis.text(
            row["probability"] + (-0.01 if inside else 0.01), y, f"{row['probability']:.2f}", va="center",
            ha="right" if inside else "left", fontsize=8, color="white" if inside else "black",
        )  # fmt: skip
    axis.set_yticks(at, [r["title"] for r in rows], fontsize=8)
    axis.set_xlim(0, 1)
    axis.set_xlabel("probability given all outcomes", fontsize=9)
    axis.tick_params(axis="x", labelsize=8)
    return figure
