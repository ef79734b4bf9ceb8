"""Charts and maps of a report as data, and their drawing by Matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from numpy.typing import NDArray

COLOURS = ("#1f6feb", "#d1571b", "#2a8f4f", "#8250df", "#b8860b", "#c2255c", "#0b7285", "#57606a", "#000000")

MAX_INSIDE = 9
"""Entries of a legend that have room inside their panel; more stand below it."""


@dataclass(frozen=True, kw_only=True)
class Series:
    """One curve of a chart; ``low`` and ``high`` are the ends of its interval, where it has one.

    ``points`` draws markers instead of a line.
    """

    label: str
    x: Sequence[float]
    y: Sequence[float]
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None
    points: bool = False
    group: str = ""
    """Curves of one group share a colour."""


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Axes of a chart; labels carry units. ``y_range`` cuts what lies outside; (low, high).

    ``x_names`` stand at 1, 2, ... where the x axis is a list.
    """

    title: str
    x_label: str
    y_label: str
    series: Sequence[Series]
    log_x: bool = False
    log_y: bool = False
    y_range: tuple[float, float] | None = None
    x_names: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Panels side by side, with the sentence that says what they mean."""

    panels: Sequence[Panel]
    caption: str


@dataclass(frozen=True, kw_only=True)
class CaptionedImage:
    """An image, uint8 (rows, cols) or (rows, cols, 3) [DN], with the sentence that says what it means."""

    image: NDArray[np.uint8]
    caption: str


@dataclass(frozen=True, kw_only=True)
class Map:
    """A field over pixels in its own unit; ``unknown`` pixels are drawn grey.

    A ``signed`` field gets a scale that is symmetric about 0, another starts at 0. ``top`` ends the scale.
    """

    title: str
    values: NDArray[np.float64]
    top: float
    signed: bool = False
    unknown: NDArray[np.bool_] | None = None


@dataclass(frozen=True, kw_only=True)
class Maps:
    """Rows of maps, each row with one scale, with the sentence that says what they mean; ``labels`` carry units."""

    rows: Sequence[Sequence[Map]]
    labels: Sequence[str]
    caption: str


def chart_figure(chart: Chart) -> Figure:
    """Return a chart's panels side by side.

    Parameters
    ----------
    chart : Chart

    Returns
    -------
    Figure
    """
    count = len(chart.panels)
    crowded = any(len(panel.series) > MAX_INSIDE for panel in chart.panels)
    figure = Figure(figsize=(5.8 * count + 0.6, 5.8 if crowded else 4.6), layout="constrained")
    for axis, panel in zip(np.atleast_1d(figure.subplots(1, count)), chart.panels, strict=True):
        _draw(axis, panel)
    return figure


def _draw(axis: Any, panel: Panel) -> None:
    groups: dict[str, str] = {}
    unused, markers = cycle(COLOURS), cycle("os^D")
    drawn: dict[str, int] = {}
    for series in panel.series:
        name = series.group or series.label
        if name not in groups:
            groups[name] = next(unused)
        colour = groups[name]
        # further curves of one group are dashed
        style = ("-", "--", ":", "-.")[drawn.get(name, 0) % 4]
        drawn[name] = drawn.get(name, 0) + 1
        x, y = _array(series.x), _array(series.y)
        if series.points:
            axis.plot(x, y, next(markers), color=colour, ms=5, mfc="none", label=series.label)
        else:
            axis.plot(x, y, style, color=colour, lw=1.7, label=series.label)
        if series.low is not None and series.high is not None:
            axis.fill_between(x, _array(series.low), _array(series.high), color=colour, alpha=0.15, lw=0)
    axis.set_title(panel.title, fontsize=10)
    axis.set_xlabel(panel.x_label)
    axis.set_ylabel(panel.y_label)
    if panel.log_x:
        axis.set_xscale("log")
    if panel.log_y:
        axis.set_yscale("log")
    if panel.x_names:
        axis.set_xticks(range(1, len(panel.x_names) + 1), list(panel.x_names), rotation=20, ha="right", fontsize=8)
    if panel.y_range:
        axis.set_ylim(*panel.y_range)
    axis.grid(alpha=0.3)
    if len(panel.series) > MAX_INSIDE:
        axis.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2, frameon=False)
    elif len(panel.series) > 1:
        axis.legend(fontsize=7.5, framealpha=0.85)


def maps_figure(maps: Maps) -> Figure:
    """Return rows of maps, each row with its scale; pixels that are not known are grey.

    Parameters
    ----------
    maps : Maps

    Returns
    -------
    Figure
    """
    count = max(len(row) for row in maps.rows)
    figure = Figure(figsize=(3.4 * count + 1.2, 3.2 * len(maps.rows)), layout="constrained")
    grid = figure.subplots(len(maps.rows), count, squeeze=False)
    for axes, row, label in zip(grid, maps.rows, maps.labels, strict=True):
        top = max(one.top for one in row)
        for axis, one in zip(axes[count - len(row) :], row, strict=True):
            colours = colormaps["RdBu_r" if one.signed else "viridis"].with_extremes(bad="0.6")
            hidden = np.zeros(one.values.shape, bool) if one.unknown is None else one.unknown
            drawn = axis.imshow(
                np.ma.array(one.values, mask=hidden), vmin=-top if one.signed else 0.0, vmax=top, cmap=colours
            )
            axis.set_title(one.title, fontsize=10)
            axis.set_xlabel("[px]")
        for axis in axes[: count - len(row)]:
            axis.set_visible(False)
        figure.colorbar(drawn, ax=list(axes), label=label, extend="both" if row[0].signed else "neither")
    return figure


def _array(values: Sequence[Any]) -> Any:
    return np.array([np.nan if value is None else value for value in values], float)
