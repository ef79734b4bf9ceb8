"""The report of ``evanesce study all``: figures first, each with what it means; tables below; provenance last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.figure import Figure

from evanesce.report.html import Page, Picture, Section, Table, figure_png, image_png
from evanesce.studies.registry import Chart, Findings, Maps, Panel, Study

WIDTH_PX = 1150
COLOURS = ("#1f6feb", "#d1571b", "#2a8f4f", "#8250df", "#b8860b", "#c2255c", "#0b7285", "#57606a", "#000000")

MOST_INSIDE = 9
"""Entries of a legend that have room inside their panel; more stand below it."""


def chart_figure(chart: Chart) -> Figure:
    """Return a chart's panels side by side."""
    count = len(chart.panels)
    crowded = any(len(panel.series) > MOST_INSIDE for panel in chart.panels)
    figure = Figure(figsize=(5.8 * count + 0.6, 5.8 if crowded else 4.6), layout="constrained")
    for axis, panel in zip(np.atleast_1d(figure.subplots(1, count)), chart.panels, strict=True):
        _draw(axis, panel)
    return figure


def _draw(axis: Any, panel: Panel) -> None:
    groups: dict[str, str] = {}
    fresh, marks = cycle(COLOURS), cycle("os^D")
    drawn: dict[str, int] = {}
    for series in panel.series:
        name = series.group or series.label
        if name not in groups:
            groups[name] = next(fresh)
        colour = groups[name]
        # further curves of one group are dashed
        style = ("-", "--", ":", "-.")[drawn.get(name, 0) % 4]
        drawn[name] = drawn.get(name, 0) + 1
        x, y = _array(series.x), _array(series.y)
        if series.points:
            axis.plot(x, y, next(marks), color=colour, ms=5, mfc="none", label=series.label)
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
    if len(panel.series) > MOST_INSIDE:
        axis.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2, frameon=False)
    elif len(panel.series) > 1:
        axis.legend(fontsize=7.5, framealpha=0.85)


def maps_figure(maps: Maps) -> Figure:
    """Return rows of maps, each row with its scale; pixels that are not known are grey."""
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


def page(
    title: str,
    parts: Sequence[tuple[Study, Findings]],
    provenance: Mapping[str, Any],
    slider: Markup | None = None,
    lead: str = "",
) -> Page:
    """Return the report of some parts; :meth:`~evanesce.report.html.Page.render` gives HTML that needs no other file.

    Parameters
    ----------
    title : str
    parts : sequence of (Study, Findings)
    provenance : mapping
    slider : Markup, optional
        Of :func:`evanesce.studies.threshold.slider.slider`.
    lead : str
        One sentence under the title.
    """
    sections = []
    if slider is not None:
        text = (
            "A rendered frame, undistorted without error. Move the threshold: orange is what the reference segmentation"
            " (blur 1 px, dilation 10 px, blobs of at least 2000 px) takes for contact, blue the outline of the true contact."
        )
        sections.append(Section("How wrong is the area at this threshold?", [text], widget=slider))
    sections += [_figures(study, found) for study, found in parts]
    sections += [_tables(study, found) for study, found in parts if found.tables]
    return Page(title, lead, sections, provenance)


def pictures(parts: Sequence[tuple[Study, Findings]]) -> dict[str, bytes]:
    """Return every figure of the page as PNG by a name, ``threshold-1`` and so on."""
    found = {}
    for study, findings in parts:
        for k, picture in enumerate(_pictures(findings), start=1):
            found[f"{study.name}-{k}"] = picture.png
    return found


def _pictures(found: Findings) -> list[Picture]:
    charts = [Picture(figure_png(chart_figure(chart)), chart.caption) for chart in found.charts]
    charts += [Picture(figure_png(maps_figure(maps)), maps.caption) for maps in found.maps]
    return charts + [Picture(image_png(shown.image, WIDTH_PX), shown.caption) for shown in found.pictures]


def _figures(study: Study, found: Findings) -> Section:
    return Section(study.title, list(found.verdict), _pictures(found))


def _tables(study: Study, found: Findings) -> Section:
    tables = [Table(table.columns, table.rows, table.caption) for table in found.tables]
    return Section(f"Tables: {study.title[0].lower()}{study.title[1:]}", tables=tables)
