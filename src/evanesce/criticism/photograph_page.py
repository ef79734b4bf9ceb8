"""The page of ``evanesce criticise-photo``: what the believed picture lacks, what that is worth, what to shoot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from evanesce.criticism.photograph import PhotographCritique
from evanesce.criticism.photograph_fit import Bench
from evanesce.report.html import Page, Picture, Section, Table, figure_png

RANGE_DN = 40.0


def page(found: PhotographCritique, bench: Bench, name: str, provenance: Mapping[str, Any]) -> Page:
    """Return the report of one criticised photograph.

    Parameters
    ----------
    found : PhotographCritique
    bench : Bench
        The photograph with its noise.
    name : str
        Of the photograph.
    provenance : mapping
    """
    answer = found.answer
    sections = [
        Section(
            "Residuals before and after",
            pictures=[
                Picture(
                    figure_png(residual_figure(found, bench)),
                    "Red: the photograph is brighter than its model, blue: darker. No fit saw the locked blocks.",
                )
            ],
        ),
        _gain(answer),
        _effects(answer),
        _ranking(answer),
        Section("What to photograph next", [_shot(shot) for shot in answer["next_measurement"]]),
    ]
    if "views" in answer:
        sections.append(_views(answer["views"]))
    return Page(f"What the simulation lacks of {name}", lead(answer), sections, provenance)


def _shot(shot: Mapping[str, Any]) -> str:
    return f"{shot['what']} Separates: {', '.join(shot['separates'])}."


def lead(answer: Mapping[str, Any]) -> str:
    """Return the finding in a few sentences."""
    score, rmse = answer["gain"]["log_score"], answer["gain"]["rmse_dn"]
    names = ", ".join(effect["id"] for effect in answer["effects"])
    if not names:
        return "Nothing: no candidate predicts blocks left out of its fit better than the believed picture does."
    return (
        f"The photograph departs from the believed picture by: {names}. On {answer['gain']['blocks']} locked blocks "
        f"the extended model gains {score[0]:.0f} nats (95 % {score[1]:.0f} to {score[2]:.0f}); the RMS residual "
        f"falls from {rmse[0]:.1f} to {rmse[1]:.1f} DN."
    )


def views_words(views: Mapping[str, Any]) -> str:
    """Return what the views of a calibration are."""
    count, distinct = views["views"], views["distinct"]
    if views["verdict"] == "different":
        return f"The {count} views differ from one another by more than noise."
    if views["verdict"] == "one":
        return "One view of a flat board: focal length, distance and tilt cannot be told from it."
    what = (
        f"equal to the last digit; independent detections would differ by {views['expected_difference_px']:.3f} px RMS "
        "per axis: the same corners were copied"
        if views["verdict"] == "identical"
        else f"within {views['largest_difference_px']:.3f} px of one another: a board that did not move"
    )
    return f"The {count} views are {distinct}: {what}."


def residual_figure(found: PhotographCritique, bench: Bench) -> Figure:
    """Return photograph, what is locked, and the residuals of the believed and the extended model."""
    one = bench.photograph
    figure = Figure(figsize=(11.0, 8.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2)
    axes[0, 0].imshow(one.data, cmap="gray", vmin=0, vmax=np.quantile(one.data, 0.999))
    axes[0, 0].set_title("photograph")
    part = np.where(one.block < 0, 0, np.where(one.locked, 2, 1))
    axes[0, 1].imshow(part, cmap="Greys", vmin=0, vmax=2, interpolation="nearest")
    axes[0, 1].set_title("black: locked blocks; grey: open; white: not counted")
    picture = None
    for panel, fit, title in zip(axes[1], (found.believed, found.extended), ("believed", "extended"), strict=True):
        residual = one.data - bench.model(fit.values)
        picture = panel.imshow(residual, cmap="RdBu_r", vmin=-RANGE_DN, vmax=RANGE_DN, interpolation="nearest")
        panel.set_title(f"photograph - {title}")
    for panel in axes.ravel():
        panel.set_xlabel(f"x [bins of {one.bin_px} px]")
        panel.set_ylabel(f"y [bins of {one.bin_px} px]")
    if picture is not None:
        figure.colorbar(picture, ax=axes[1].tolist(), label="residual [DN]", shrink=0.8)
    return figure


def loss_figure(answer: Mapping[str, Any]) -> Figure:
    """Return what the locked blocks lose with each cause dropped."""
    names = list(answer["dropped"])
    figure = Figure(figsize=(8.0, 0.5 * len(names) + 1.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    values = np.array([answer["dropped"][n]["loss"] for n in names])
    spread = np.abs(values[:, 1:].T - values[:, 0])
    axes.errorbar(values[:, 0], np.arange(len(names)), xerr=spread, fmt="o", color="tab:blue", capsize=4)
    axes.axvline(0.0, color="0.5", linewidth=0.8)
    axes.set_yticks(np.arange(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xscale("symlog", linthresh=100.0)
    axes.set_xlabel("log score lost on the locked blocks without it [nats], 95 % interval")
    return figure


def _gain(answer: Mapping[str, Any]) -> Section:
    score, rmse = answer["gain"]["log_score"], answer["gain"]["rmse_dn"]
    rows = [("all of them", f"{score[0]:.0f}", f"{score[1]:.0f} to {score[2]:.0f}", f"{rmse[0]:.2f}")]
    for name, one in answer["dropped"].items():
        value, low, high = one["loss"]
        rows.append((name, f"{value:.0f}", f"{low:.0f} to {high:.0f}", f"{one['rmse_dn']:.2f}"))
    noise, scale = answer["noise_dn"], answer["core_over_noise"]
    text = (
        f"Noise of even print, measured in the photograph: {noise['dark']:.2f} DN in dark, {noise['bright']:.2f} DN in "
        f"bright squares (bins of {answer['bin_px']} px). The core of the residuals is {scale['believed']:.2f} times "
        f"as wide under the believed picture, {scale['extended']:.2f} times under the extended one: above 1, "
        "something is left."
    )
    columns = ("left out", "log score lost [nats]", "95 % interval", "RMS residual without it [DN]")
    pictures = [Picture(figure_png(loss_figure(answer)), "Each cause dropped in turn.")] if answer["dropped"] else []
    caption = f"On {answer['gain']['blocks']} locked blocks, opened once; with everything: {rmse[1]:.2f} DN RMS."
    return Section("Gain on the locked half", [text], pictures=pictures, tables=[Table(columns, rows, caption)])


def _effects(answer: Mapping[str, Any]) -> Section:
    rows = [
        (effect["id"], name, f"{p['value']:.4g}", p["unit"])
        for effect in answer["effects"]
        for name, p in effect["parameters"].items()
    ]
    text = [
        f"{name} was chosen, but {', '.join(others)} would have gained as much at that step, within two standard "
        "errors: this frame alone does not tell them apart."
        for name, others in answer["rivals"].items()
        if others
    ]
    text += [f"{entry['id']}: taken up by {entry['by']}." for entry in answer["absorbed"]]
    text.append("Not tried, because they need a press, time or another shot: " + ", ".join(answer["not_tried"]) + ".")
    return Section("Causes", text, tables=[Table(("effect", "parameter", "value", "unit"), rows)] if rows else [])


def _ranking(answer: Mapping[str, Any]) -> Section:
    rows = []
    for t in answer["ranking"]:
        remark = "taken" if t["accepted"] else "at a bound" if t["at_bound"] else ""
        rows.append((str(t["step"]), t["id"], f"{t['gain']:+.0f}", f"{t['error']:.0f}", remark))
    text = (
        "Gain in held-out log density on the open blocks over the model so far. The largest that exceeds two standard "
        "errors over blocks is taken; one that did not pass is tried again before anything is concluded."
    )
    columns = ("step", "candidate", "gain [nats]", "standard error [nats]", "")
    return Section("Everything that was tried", [text], tables=[Table(columns, rows)])


def _views(views: Mapping[str, Any]) -> Section:
    text = [views_words(views)]
    tables = []
    single = views.get("single_view")
    if single:
        text.append(
            f"The Jacobian of one such view has a condition number of {single['condition']:.3g}; its weakest direction "
            "mixes "
            + ", ".join(f"{n} ({s:+.2f})" for n, s in single["weakest"].items())
            + ". Planar rectification does "
            f"not need them: it leaves {single['rectification_rms_px']:.2f} px RMS."
        )
        rows = [
            (f"{p['focal_px']:.0f}", f"{p['rms_px']:.4f}", f"{p['distance_mm']:.2f}", f"{p['tilt_deg']:.2f}")
            for p in single["profile"]
        ]
        columns = ("focal length held at [px]", "RMS left [px]", "distance [mm]", "tilt [deg]")
        tables.append(Table(columns, rows, "Everything else fitted."))
    return Section("The calibration's views", text, tables=tables)
