"""The page of ``evanesce criticise-photo``: residuals, causes with probabilities, gain, what is left, what to shoot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from evanesce.inference.naming import label_of
from evanesce.inference.page import MOST_PROBABLE
from evanesce.inference.photograph.critic import PhotoCriticism
from evanesce.report.html import Page, Picture, Section, Table, figure_png

RANGE_DN = 40.0


def page(answer: Mapping[str, Any], found: PhotoCriticism, name: str, provenance: Mapping[str, Any]) -> Page:
    """Return the report of one photograph.

    Parameters
    ----------
    answer : mapping
        The JSON of ``evanesce criticise-photo``.
    found : PhotoCriticism
    name : str
        Of the photograph.
    provenance : mapping
    """
    caption = "Red: the photograph is brighter than predicted, blue: darker. No fit saw the held-out blocks."
    further = answer["posterior"]["further"]
    left = [answer["unknown"]["what"] + "." if answer["unknown"]["found"] else "No more than noise is left."]
    left.append(
        f"Noise alone would give as much evidence for a further cause with probability {further['p_value']:.2g}; the"
        f" first asked for would be {', '.join(further['credible_set'][:3])}."
    )
    shots = [f"{s['what']} Separates: {', '.join(s['separates'])}." for s in answer["next_measurement"]]
    sections = [
        Section("Before you believe it", list(answer["warnings"])),
        Section("Before and after", pictures=[Picture(figure_png(residual_figure(found)), caption)]),
        _causes(answer),
        _gain(answer),
        Section("What is not explained", [text[0].upper() + text[1:] for text in left]),
        Section("What to photograph next", shots or ["Nothing asks for another photograph."]),
        _moves(answer),
    ]
    if "views" in answer:
        sections.append(_views(answer["views"]))
    return Page(f"What the simulation gets wrong: {name}", answer["first_line"], sections, provenance)


def residual_figure(found: PhotoCriticism) -> Figure:
    """Return photograph, held-out blocks, and the residuals of the nominal and the extended model."""
    one, light = found.bench.photograph, found.bench.light
    figure = Figure(figsize=(11.0, 8.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2)
    axes[0, 0].imshow(one.data, cmap="gray", vmin=0, vmax=np.quantile(one.data, 0.999))
    axes[0, 0].set_title("photograph")
    part = np.where(one.block < 0, 0, np.where(one.locked, 2, 1))
    axes[0, 1].imshow(part, cmap="Greys", vmin=0, vmax=2, interpolation="nearest")
    axes[0, 1].set_title("black: held-out blocks; grey: open; white: not counted")
    picture = None
    for panel, fit, title in zip(axes[1], (found.base, found.best), ("nominal", "extended"), strict=True):
        residual = one.data - light(fit.point)
        picture = panel.imshow(residual, cmap="RdBu_r", vmin=-RANGE_DN, vmax=RANGE_DN, interpolation="nearest")
        panel.set_title(f"photograph - {title}")
    for panel in axes.ravel():
        panel.set_xlabel(f"x [bins of {one.bin_px} px]")
        panel.set_ylabel(f"y [bins of {one.bin_px} px]")
    if picture is not None:
        figure.colorbar(picture, ax=axes[1].tolist(), label="residual [DN]", shrink=0.8)
    return figure


def loss_figure(answer: Mapping[str, Any]) -> Figure:
    """Return what the held-out blocks lose with each cause dropped."""
    losses = answer["held_out"]["without"]
    figure = Figure(figsize=(8.0, 0.5 * len(losses) + 1.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    values = np.array([one["log_score_lost"] for one in losses.values()]).reshape(-1, 3)
    spread = np.abs(values[:, 1:].T - values[:, 0])
    axes.errorbar(values[:, 0], np.arange(len(losses)), xerr=spread, fmt="o", color="tab:blue", capsize=4)
    axes.axvline(0.0, color="0.5", linewidth=0.8)
    axes.set_yticks(np.arange(len(losses)), list(losses))
    axes.set_ylim(len(losses) - 0.5, -0.5)
    axes.set_xscale("symlog", linthresh=100.0)
    axes.set_xlabel("log score lost on held-out blocks without it [nats], 95 % interval")
    return figure


def views_words(views: Mapping[str, Any]) -> str:
    """Return what the views of a calibration are."""
    count, distinct = views["views"], views["distinct"]
    if views["verdict"] == "different":
        return f"The {count} views differ from one another by more than noise."
    if views["verdict"] == "one":
        return "One view of a flat board: focal length, distance and tilt cannot be determined from it."
    what = (
        f"equal to the last digit; independent detections would differ by {views['expected_difference_px']:.3f} px RMS "
        "per axis: the same corners were copied"
        if views["verdict"] == "identical"
        else f"within {views['largest_difference_px']:.3f} px of one another: a board that did not move"
    )
    return f"The {count} views are {distinct}: {what}."


def _causes(answer: Mapping[str, Any]) -> Section:
    inclusion = [(n, f"{p:.2g}") for n, p in list(answer["posterior"]["inclusion"].items())[:MOST_PROBABLE]]
    tables = [Table(("cause", "probability"), inclusion, "The most probable, something unknown among them.")]
    rows = []
    for cause in answer["causes"]:
        others = [n for n in cause["credible_set"] if n != cause["id"]]
        for number, (name, p) in enumerate(cause["parameters"].items()):
            own = (label_of(cause), f"{cause['probability']:.2f}", ", ".join(others))
            interval = f"{p['lo']:.4g} to {p['hi']:.4g}"
            rows.append((*(own if number == 0 else ("", "", "")), name, f"{p['value']:.4g}", interval, str(p["unit"])))
    columns = ("cause", "probability", "stands for it (95 %)", "parameter", "value", "90 % interval", "unit")
    if rows:
        tables.insert(0, Table(columns, rows, "Intervals include what the model's forms may be off by."))
    return Section("Causes", [] if rows else ["None."], tables=tables)


def _gain(answer: Mapping[str, Any]) -> Section:
    gain, noise = answer["held_out"], answer["noise_DN"]
    score, rms = gain["log_score"], gain["rms_DN"]
    rows = [("all of them", f"{score[0]:.0f}", f"{score[1]:.0f} to {score[2]:.0f}", f"{rms[0]:.2f}")]
    for name, one in gain["without"].items():
        value, low, high = one["log_score_lost"]
        rows.append((name, f"{value:.0f}", f"{low:.0f} to {high:.0f}", f"{one['rms_DN']:.2f}"))
    text = (
        f"Noise of even print: {noise['dark']:.2f} DN in dark, {noise['bright']:.2f} DN in bright squares (bins of "
        f"{answer['bin_px']} px)."
    )
    columns = ("left out", "log score lost [nats]", "95 % interval", "RMS residual without it [DN]")
    pictures = [Picture(figure_png(loss_figure(answer)), "Each cause dropped in turn.")] if gain["without"] else []
    caption = f"On {gain['blocks']} held-out blocks; with everything: {rms[1]:.2f} DN RMS."
    return Section("Gain on held-out blocks", [text], pictures=pictures, tables=[Table(columns, rows, caption)])


def _moves(answer: Mapping[str, Any]) -> Section:
    rows = [(m["move"], m["cause"], m["other"], f"{m['misfit']:.4g}", m["reason"]) for m in answer["moves"]]
    columns = ("move", "cause", "in place of", "misfit", "because")
    tables = [Table(columns, rows, f"From a misfit of {answer['misfit']['before']:.4g}.")] if rows else []
    by_reason: dict[str, list[str]] = {}
    for entry in answer["not_judged"]:
        by_reason.setdefault(entry["why"], []).append(entry["id"])
    others = [f"{why}: {', '.join(names)}" for why, names in by_reason.items()]
    text = ["Not taken:", *(f"{other[0].upper()}{other[1:]}." for other in others)]
    return Section("How it was found", text, tables=tables)


def _views(views: Mapping[str, Any]) -> Section:
    text = [views_words(views)]
    tables = []
    single = views.get("single_view")
    if single:
        weakest = ", ".join(f"{n} ({s:+.2f})" for n, s in single["weakest"].items())
        text.append(
            f"The Jacobian of one such view has a condition number of {single['condition']:.3g}; its weakest direction "
            f"mixes {weakest}. Planar rectification does not need them: it leaves "
            f"{single['rectification_rms_px']:.2f} px RMS."
        )
        rows = [
            (f"{p['focal_px']:.0f}", f"{p['rms_px']:.4f}", f"{p['distance_mm']:.2f}", f"{p['tilt_deg']:.2f}")
            for p in single["profile"]
        ]
        columns = ("focal length held at [px]", "RMS left [px]", "distance [mm]", "tilt [deg]")
        tables.append(Table(columns, rows, "Everything else fitted."))
    return Section("The calibration's views", text, tables=tables)
