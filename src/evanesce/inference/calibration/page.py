"""The page of ``evanesce fit``: measured beside simulated frames, residuals, area against force, what is left."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from evanesce.inference.calibration.fit import EDGE_PX, Areas, RigFit
from evanesce.inference.page import RANGE, residual_figure
from evanesce.report.html import Page, Picture, Section, Table, figure_png

MOST_FRAMES = 4
AREAS = (
    "Areas as the reference segmentation reads them from measured and simulated frames alike. It takes the rim's light"
    f" with the contact; the contact itself, in the last column, is smaller. Its edge is known to {EDGE_PX:g} pixels at"
    " best: what the light about it is, is no figure of the rig."
)
GAP_SHARE = 0.1
"""Of the brightest level, at which colours of the difference end."""


def page(result: Mapping[str, Any], found: RigFit, name: str, provenance: Mapping[str, Any]) -> Page:
    """Return the report of a calibrated rig.

    Parameters
    ----------
    result : mapping
        Of :func:`evanesce.inference.calibration.answer.result_of`.
    found : RigFit
    name : str
        Of the bundle.
    provenance : mapping
    """
    sections = [_judgement(result), _frames(found), _residuals(found), _areas(result, found), _figures(result)]
    return Page(f"Calibrated rig: {name}", result["first_line"], [*sections, _left(found), _rest(result)], provenance)


def _judgement(result: Mapping[str, Any]) -> Section:
    text = [f"Not good enough: {reason}." for reason in result["reasons"]] or [
        "Held-out areas, residuals of every kind of frame and the light that is left give no reason for doubt."
    ]
    text += [f"Left, too little to matter: {remark}." for remark in result["remarks"]]
    gain = result["held_out"]
    tables = []
    if gain is not None:
        rows = [
            ("residual of the bins, RMS [DN]", *(f"{v:.3g}" for v in gain["rms_DN"])),
            ("error of the area, mean [%]", *(f"{v:.3g}" for v in gain["area_error_percent"])),
        ]
        caption = f"{gain['views']} views whose conditions the fit has not seen."
        tables = [Table(("held out", "nominal scene", "calibrated scene"), rows, caption)]
    text += [f"Warning: {warning}." for warning in result["warnings"]]
    return Section("Is it good enough?", text, tables=tables)


def frame_figure(areas: Areas) -> Figure:
    """Return measured frames above simulated ones and their difference.

    Parameters
    ----------
    areas : Areas
    """
    chosen = np.unique(np.round(np.linspace(0, len(areas.views) - 1, MOST_FRAMES)).astype(int))
    rows, cols = areas.frames.shape[1:]
    figure = Figure(figsize=(2.7 * len(chosen) + 1.0, 3 * 2.7 * rows / cols + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(3, len(chosen), squeeze=False)
    # Grey of a colour camera under red light ends at a fifth of the scale.
    top = max(float(areas.images[chosen].max()), float(areas.frames[chosen].max()))
    gap_top = top * GAP_SHARE
    shade = difference = None
    for column, k in zip(axes.T, chosen, strict=True):
        shade = column[0].imshow(areas.images[k], cmap="gray", vmin=0, vmax=top)
        column[1].imshow(areas.frames[k], cmap="gray", vmin=0, vmax=top)
        gap = areas.images[k] - areas.frames[k]
        difference = column[2].imshow(gap, cmap="RdBu_r", vmin=-gap_top, vmax=gap_top, interpolation="nearest")
        held = ", held out" if areas.views[k].locked else ""
        column[0].set_title(f"{areas.views[k].force_N:g} N{held}", fontsize=9)
        for panel in column:
            panel.set_xticks([])
            panel.set_yticks([])
    for row, label in enumerate(("measured", "simulated", "difference")):
        axes[row, 0].set_ylabel(label, fontsize=9)
    if shade is not None and difference is not None:
        figure.colorbar(shade, ax=axes[:2].ravel().tolist(), label="level [DN]", shrink=0.7)
        figure.colorbar(difference, ax=axes[2].tolist(), label="measured less simulated [DN]")
    return figure


def area_figure(areas: Areas, contact: NDArray[np.float64]) -> Figure:
    """Return area against force: measured, of the nominal and of the calibrated scene, and relative differences.

    Parameters
    ----------
    areas : Areas
    contact : ndarray (views,)
        True area of the calibrated scene's contact [mm^2].
    """
    figure = Figure(figsize=(6.4, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    force = np.array([view.force_N for view in areas.views], float)
    locked = np.array([view.locked for view in areas.views], bool)
    order = np.argsort(force)
    above.plot(force[order], areas.nominal[order], "--", color="#b4b4b4", label="nominal scene")
    above.plot(force[order], areas.calibrated[order], "-", color="#2f6f9f", label="calibrated scene")
    above.plot(force[order], contact[order], ":", color="#2f6f9f", label="contact of the calibrated scene")
    above.plot(force[~locked], areas.measured[~locked], "o", color="black", label="measured")
    above.plot(force[locked], areas.measured[locked], "o", mfc="white", mec="black", label="measured, held out")
    known = areas.measured > 0
    for value, colour, style in ((areas.nominal, "#b4b4b4", "--"), (areas.calibrated, "#2f6f9f", "-")):
        relative = 100.0 * (value[known] / areas.measured[known] - 1.0)
        at = np.argsort(force[known])
        below.plot(force[known][at], relative[at], style, marker=".", color=colour)
    below.axhline(0.0, color="black", linewidth=0.8)
    above.set_ylabel("area [mm²]")
    below.set_ylabel("simulated over\nmeasured less 1 [%]")
    below.set_xlabel("normal force [N]")
    above.legend()
    return figure


def _frames(found: RigFit) -> Section:
    if not found.areas.views:
        return Section("Measured and simulated", ["No press frame at the nominal voltage."])
    caption = "Frames at the resolution of the fit. Red: brighter than simulated."
    return Section("Measured and simulated", pictures=[Picture(figure_png(frame_figure(found.areas)), caption)])


def _residuals(found: RigFit) -> Section:
    caption = "Bins over their standard deviation; below with the calibrated figures. Structure there is unexplained."
    rows = [(kind, f"{size:.2f}") for kind, size in found.by_kind.items()]
    table = Table(
        ("kind of view", "RMS [standard deviations]"), rows, "1: noise, and what the model's forms may be off by."
    )
    return Section(
        "Residuals", pictures=[Picture(figure_png(residual_figure(found.pictures)), caption)], tables=[table]
    )


def _areas(result: Mapping[str, Any], found: RigFit) -> Section:
    rows = [
        (
            f"{row['force_N']:g}", "yes" if row["held_out"] else "", f"{row['measured_mm2']:.2f}",
            f"{row['nominal_mm2']:.2f}", f"{row['calibrated_mm2']:.2f}",
            "" if row["contact_mm2"] is None else f"{row['contact_mm2']:.2f}",
        )
        for row in result["areas"]
    ]  # fmt: skip
    if not rows:
        return Section("Area against force", ["No press frame at the nominal voltage."])
    columns = (
        "force [N]", "held out", "measured [mm²]", "nominal [mm²]", "calibrated [mm²]", "its contact [mm²]"
    )  # fmt: skip
    contact = [np.nan if row["contact_mm2"] is None else row["contact_mm2"] for row in result["areas"]]
    picture = Picture(figure_png(area_figure(found.areas, np.array(contact, float))), AREAS)
    return Section("Area against force", pictures=[picture], tables=[Table(columns, rows)])


def _figures(result: Mapping[str, Any]) -> Section:
    columns = ("figure", "what", "value", "90 % interval", "unit", "nominal", "posterior over prior")
    tables = []
    for told, caption in (
        (True, "Determined by this bundle."),
        (False, "Not determined: the most probable value stands."),
    ):
        rows = [
            (
                row["key"].removeprefix("effects."), row["what"], f"{row['value']:.4g}",
                f"{row['lo']:.4g} to {row['hi']:.4g}", row["unit"], f"{row['nominal']:g}", f"{row['narrowing']:.2g}",
            )
            for row in (*result["figures"], *result["nuisances"])
            if row["told"] == told
        ]  # fmt: skip
        if rows:
            tables.append(Table(columns, rows, caption))
    text = (
        "All figures are fitted together, so that each interval holds what the others leave open. A figure counts as"
        " determined where its standard deviation is less than half of that before the measurement."
    )
    return Section("Figures of the rig", [text], tables=tables)


def _left(found: RigFit) -> Section:
    left = found.left
    figure = Figure(figsize=(5.2, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    shown = axis.imshow(left.map / left.sd, cmap="RdBu_r", vmin=-RANGE, vmax=RANGE, interpolation="nearest")
    axis.set_xticks([])
    axis.set_yticks([])
    figure.colorbar(shown, ax=axis, label="all views together [standard deviations]")
    sentence = left.sentence()
    text = f"{sentence[0].upper()}{sentence[1:]}." if left.found else "All views together show no more than noise."
    return Section("What is left", [text], [Picture(figure_png(figure), "Residual of all views together.")])


def _rest(result: Mapping[str, Any]) -> Section:
    rows = [(row["figure"], row["why"]) for row in result["not_fitted"]]
    gate = [(g["name"], f"{g['measured']:.4g}", f"{g['predicted']:.4g}", g["unit"]) for g in result["gate"]]
    tables = [Table(("figure", "measured", "nominal scene", "unit"), gate, "First look, before anything was fitted.")]
    if rows:
        tables.append(Table(("figure", "why"), rows, "Not fitted."))
    return Section("What was not fitted", tables=tables)
