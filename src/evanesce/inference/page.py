"""The page of ``evanesce criticise``: what it means for the measured area, pictures, causes, what is left."""

from __future__ import annotations

import difflib
import itertools
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from evanesce.inference.constants import CREDIBLE, LEAST_AREA
from evanesce.inference.naming import label_of, partner_of
from evanesce.inference.pictures import Pictures
from evanesce.inference.series.picture import Curve, series_figure
from evanesce.report.html import Page, Picture, Section, Table, figure_png

RANGE = 5.0
"""Residuals are shown from -RANGE to +RANGE standard deviations."""
MOST_PROBABLE = 8
LISTED, LISTED_LINES = re.compile(r"[+-]\s+[-+.\de]+,"), 3
"""Lines of a list of numbers in a difference, and how many of them are shown."""


def page(
    result: Mapping[str, Any],
    pictures: Pictures | tuple[Curve, ...],
    name: str,
    scenes: tuple[str, str],
    provenance: Mapping[str, Any],
) -> Page:
    """Return the report of one criticised bundle.

    Parameters
    ----------
    result : mapping
        The JSON of ``evanesce criticise``.
    pictures : Pictures, or tuple of Curve
        Of frames, or of series alone.
    name : str
        Of the bundle.
    scenes : tuple of str
        Nominal and extended scene as TOML.
    provenance : mapping
    """
    sections = [Section("Before you believe it", list(result["warnings"]))] if result["warnings"] else []
    sections += [_residuals(pictures), _causes(result), _left(result, pictures), *_next(result), _gain(result)]
    sections += [*([_gate(result)] if result["gate"] else []), _moves(result), _scene(*scenes)]
    return Page(f"What the simulation gets wrong: {name}", result["first_line"], sections, provenance)


def residual_figure(pictures: Pictures) -> Figure:
    """Return measured frames above what nominal and extended model leave of them."""
    count = len(pictures.views)
    rows, cols = pictures.views[0].measured.shape
    figure = Figure(figsize=(2.7 * count + 1.0, 3 * 2.7 * rows / cols + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(3, count, squeeze=False)
    top = max(float(view.measured.max()) for view in pictures.views)
    shade = picture = None
    for column, view in zip(axes.T, pictures.views, strict=True):
        shade = column[0].imshow(view.measured, cmap="gray", vmin=0, vmax=top)
        column[0].set_title(view.title, fontsize=9)
        for panel, residual in zip(column[1:], (view.before, view.after), strict=True):
            picture = panel.imshow(residual, cmap="RdBu_r", vmin=-RANGE, vmax=RANGE, interpolation="nearest")
        for panel in column:
            panel.set_xticks([])
            panel.set_yticks([])
    for row, label in enumerate(("measured", "left by the scene", "left with the causes")):
        axes[row, 0].set_ylabel(label, fontsize=9)
    if shade is not None and picture is not None:
        figure.colorbar(shade, ax=axes[0].tolist(), label="level [DN]")
        figure.colorbar(picture, ax=axes[1:].ravel().tolist(), label="residual [standard deviations]", shrink=0.7)
    return figure


def cause_figure(causes: Sequence[Mapping[str, Any]]) -> Figure:
    """Return bars of what each cause, or two that make up for each other, does to the area where it does most.

    With 90 % intervals.
    """
    causes = [cause for k, cause in enumerate(causes) if partner_of(cause) not in [other["id"] for other in causes[:k]]]
    rows = [_largest(_shown(cause)["area"]) for cause in causes]
    figure = Figure(figsize=(7.0, 0.45 * len(rows) + 1.1), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    at = np.arange(len(rows))
    value = np.array([r[0] for r in rows])
    ends = np.array([[r[0] - r[1], r[2] - r[0]] for r in rows]).T
    colours = ["#b4b4b4" if abs(r[0]) < 100 * LEAST_AREA else "#2f6f9f" for r in rows]
    axis.barh(at, value, color=colours, height=0.6)
    axis.errorbar(value, at, xerr=np.maximum(ends, 0.0), fmt="none", color="black", capsize=3, linewidth=1)
    axis.set_yticks(at, [f"{_bar(cause)}, {r[3]:g} N" for cause, r in zip(causes, rows, strict=True)])
    axis.invert_yaxis()
    axis.axvline(0.0, color="black", linewidth=0.8)
    axis.set_xlabel("change of the measured area [%], with 90 % interval")
    return figure


def _shown(cause: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what has the area to be drawn: the cause, or it and the one that makes up for it."""
    return cause["together"] or cause


def _bar(cause: Mapping[str, Any]) -> str:
    partner = partner_of(cause)
    return f"{cause['id']} and {partner}" if partner else label_of(cause)


def _largest(area: Mapping[str, Any]) -> tuple[float, float, float, float]:
    """Return change and both ends of its interval [%], and force [N], where it is largest; zeros if nothing changes."""
    if not area["percent"]:
        return 0.0, 0.0, 0.0, 0.0
    k = int(np.argmax(np.abs(np.nan_to_num(area["percent"]))))
    percent, change = area["percent"][k], area["mm2"][k]
    scale = percent / change if change else 0.0
    low, high = sorted((area["mm2_lo"][k] * scale, area["mm2_hi"][k] * scale))
    return float(np.nan_to_num(percent)), float(low), float(high), float(area["force_N"][k])


def _residuals(pictures: Pictures | tuple[Curve, ...]) -> Section:
    if isinstance(pictures, tuple):
        caption = "Rows and their standard deviations; below, measured over predicted. No fit saw the open circles."
        return Section("Before and after", pictures=[Picture(figure_png(series_figure(pictures)), caption)])
    caption = (
        "Red: brighter than predicted, blue: darker. In the middle what the scene leaves after place of the finger,"
        " light and black level were fitted; below what it leaves with the causes. Structure there is unexplained."
    )
    return Section("Before and after", pictures=[Picture(figure_png(residual_figure(pictures)), caption)])


def _causes(result: Mapping[str, Any]) -> Section:
    causes = result["causes"]
    if not causes:
        likely = [
            (name, f"{p:.2g}") for name, p in list(result["posterior"]["inclusion"].items())[:MOST_PROBABLE] if p > 0
        ]
        return Section("Causes", ["None."], tables=[Table(("cause", "probability"), likely, "The most probable.")])
    rows: list[tuple[str, ...]] = []
    for cause in causes:
        change, _, _, force = _largest(_shown(cause)["area"])
        others = [n for n in cause["credible_set"] if n != cause["id"]]
        for number, (name, p) in enumerate(cause["parameters"].items()):
            own = (
                label_of(cause),
                f"{cause['probability']:.2f}",
                ", ".join(others),
                f"{change:+.2f} at {force:g} N",
                _score(cause),
            )
            interval = f"{p['lo']:.4g} to {p['hi']:.4g}"
            value = (name, f"{p['value']:.4g}", interval, str(p["unit"]))
            rows.append((*(own if number == 0 else [""] * len(own)), *value))
    columns = (
        "cause", "probability", f"stands for it ({100 * CREDIBLE:.0f} %)", "area [%]",
        "held-out score [nats]", "parameter", "value", "90 % interval", "unit",
    )  # fmt: skip
    text = (
        "Ordered by what they do to the area that the reference segmentation reads. Grey bars move it by less than"
        f" {100 * LEAST_AREA:g} %: they are listed because the frames show them."
    )
    caption = "With the cause less without, where that is largest; with both where two make up for each other."
    return Section(
        "Causes", [text], [Picture(figure_png(cause_figure(causes)), caption)],
        [Table(columns, rows, "Intervals include what the model's forms may be off by.")],
    )  # fmt: skip


def _score(cause: Mapping[str, Any]) -> str:
    """Return what a cause adds to the log score of held-out conditions, with its interval."""
    if cause["held_out_nats"] is None:
        return "none held out"
    value, low, high = cause["held_out_nats"]
    return f"{value:+.0f} ({low:+.0f} to {high:+.0f})"


def _further(result: Mapping[str, Any]) -> str:
    further = result["posterior"]["further"]
    nearest = result["unknown"]["nearest"]
    more = f" The library's nearest to what is unknown is {nearest}." if nearest else ""
    return (
        f"Noise alone would give as much evidence for a further cause with probability {further['p_value']:.2g};"
        f" the first asked for would be {', '.join(further['credible_set'][:3])}.{more}"
    )


def _left(result: Mapping[str, Any], pictures: Pictures | tuple[Curve, ...]) -> Section:
    share = result["misfit"]["left_share"]
    if isinstance(pictures, tuple):
        text = [f"{100 * share:.3g} % of the misfit that could be explained is left.", _further(result)]
        left = result["unknown"]
        rows = [(name, *(f"{v:.3g}" for v in part.values())) for name, part in left["series"].items()]
        caption = f"Noise alone would leave as much with probability {left['p_value']:.2g}."
        columns = ("series", "measured over predicted, mean", "exponent along the abscissa")
        return Section("What is not explained", text, tables=[Table(columns, rows, caption)])
    left = pictures.left
    figure = Figure(figsize=(5.2, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    shown = axis.imshow(left.map / left.sd, cmap="RdBu_r", vmin=-RANGE, vmax=RANGE, interpolation="nearest")
    axis.set_xticks([])
    axis.set_yticks([])
    figure.colorbar(shown, ax=axis, label="all views together [standard deviations]")
    text = [f"{100 * share:.3g} % of the misfit that could be explained is left."]
    told = left.sentence()
    text.append(f"{told[0].upper()}{told[1:]}." if left.found else "All views together show no more than noise.")
    text.append(_further(result))
    return Section("What is not explained", text, [Picture(figure_png(figure), "Residual of all views together.")])


def _next(result: Mapping[str, Any]) -> list[Section]:
    advice = result["next_measurement"]
    if advice is None:
        return []
    between = " or ".join(advice["between"])
    text = f"No shot of the menu would tell {between} apart."
    if advice["what"] is not None:
        text = f"Take {advice['what']}: it would tell most about whether it is {between}."
    rows = [(r["what"], f"{r['minutes']:g}", f"{r['gain_nats']:.2f}") for r in advice["menu"]]
    caption = f"Doubt now: {advice['entropy_nats']:.2f} nats."
    columns = ("shot", "minutes", "expected to be resolved [nats]")
    return [Section("What to measure next", [text], tables=[Table(columns, rows, caption)])]


def _gain(result: Mapping[str, Any]) -> Section:
    gain = result["held_out"]
    if gain is None:
        return Section("Gain on held-out conditions", ["No condition was held out, so that no gain can be claimed."])
    unit, what = ("DN", "views") if "rms_DN" in gain else ("standard deviations", "rows")
    (rms, rms_after), score = gain["rms_DN" if unit == "DN" else "rms_sd"], gain["log_score"]
    rows = [
        (f"residual, RMS [{unit}]", f"{rms:.3g}", f"{rms_after:.3g}"),
        ("log score [nats]", "0", f"{score[0]:+.4g} ({score[1]:+.4g} to {score[2]:+.4g})"),
    ]
    if None not in gain["area_error_percent"]:
        area, area_after = gain["area_error_percent"]
        rows.insert(1, ("error of the predicted area, mean [%]", f"{area:.3g}", f"{area_after:.3g}"))
    text = [f"{gain['views']} {what} whose conditions no fit and no choice saw."]
    if gain["area_worse"]:
        text.insert(
            0, "The extension makes the area of conditions that it has not seen worse: do not use it for areas."
        )
    return Section("Gain on held-out conditions", text, tables=[Table(("figure", "scene", "with the causes"), rows)])


def _gate(result: Mapping[str, Any]) -> Section:
    rows = [(g["name"], f"{g['measured']:.4g}", f"{g['predicted']:.4g}", g["unit"]) for g in result["gate"]]
    text = "Read from the frames before anything was fitted. Gross differences would have ended the run here."
    return Section("First look", [text], tables=[Table(("figure", "measured", "predicted", "unit"), rows)])


def _moves(result: Mapping[str, Any]) -> Section:
    rows = [
        (m["move"], m["cause"], m["other"], f"{m['misfit']:.4g}", m["reason"], f"{m['seconds']:.0f}")
        for m in result["moves"]
    ]
    columns = ("move", "cause", "in place of", "misfit", "because", "s")
    tables = [Table(columns, rows, f"From a misfit of {result['misfit']['before']:.4g}.")] if rows else []
    judged = [f"{entry['id']}: {entry['why']}" for entry in result["not_judged"]]
    text = ["Not taken: " + "; ".join(judged) + "."] if judged else []
    return Section("How it was found", text, tables=tables)


def _scene(before: str, after: str) -> Section:
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), "nominal", "extended", lineterm="", n=1)
    rows = [(line,) for line in _shortened(list(lines)[2:])]
    text = "The extended scene renders with every other command." if rows else "The scene stands as it is."
    return Section("The extended scene", [text], tables=[Table(("difference",), rows)] if rows else [])


def _shortened(lines: Sequence[str]) -> list[str]:
    """Return lines of a difference without the most of lists: a speck of dust has some tens of places."""
    kept: list[str] = []
    for numbers, run in itertools.groupby(lines, lambda line: bool(LISTED.fullmatch(line))):
        part = list(run)
        short = not numbers or len(part) <= LISTED_LINES
        kept += part if short else [*part[:LISTED_LINES], f"{part[0][0]}    ... {len(part) - LISTED_LINES} more"]
    return kept
