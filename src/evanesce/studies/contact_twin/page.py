"""The page of a contact frame's twin: both side by side, what is left, what each cause explains."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from evanesce.report.html import Page, Picture, Section, Table, figure_png
from evanesce.studies.contact_twin.figures import figures
from evanesce.studies.contact_twin.model import CAUSES
from evanesce.studies.contact_twin.picture import LUMA
from evanesce.studies.contact_twin.record import automatic_levels
from evanesce.studies.contact_twin.study import ContactTwin, Step, medians, peaks, within_contact

RESIDUAL_DN = 60.0
CHANNELS = "red", "green", "blue"


def page(twin: ContactTwin, name: str, provenance: Mapping[str, Any]) -> Page:
    """Return the report of one contact frame and its twin.

    Parameters
    ----------
    twin : ContactTwin
    name : str
        Of the frame.
    provenance : mapping

    Returns
    -------
    Page
    """
    believed, final = twin.added[0], twin.final
    lead = (
        f"Fitted to half of the blocks of {name}, judged on the other half: the residual falls from "
        f"{_rms(believed):.1f} DN RMS over all channels for the believed rig to {_rms(final):.1f} DN with "
        f"{_listed(final.fit.causes)}; the log score rises by {final.gain:.0f} ± {final.gain_error:.0f} nat."
    )
    sections = [_pictures(twin), _added(twin), _without(twin), _figures(twin), _histogram(twin)]
    return Page(f"Twin of {name}", lead, sections, provenance)


def side_by_side(twin: ContactTwin) -> Canvas:
    """Return frame, twin and residual of each channel as one figure.

    Parameters
    ----------
    twin : ContactTwin

    Returns
    -------
    matplotlib.figure.Figure
    """
    data, simulated = twin.picture.data, twin.final.fit.predicted
    canvas = Canvas(figsize=(11.0, 6.4), layout="constrained")
    FigureCanvasAgg(canvas)
    axes = canvas.subplots(2, 3)
    shown = [
        (_eight(data), "frame"),
        (_eight(simulated), "simulated"),
        (_eight(twin.added[0].fit.predicted), "as believed"),
    ]
    for axis, (image, title) in zip(axes[0], shown, strict=True):
        axis.imshow(image, interpolation="nearest")
        axis.set_title(title)
    for k, axis in enumerate(axes[1]):
        drawn = axis.imshow(
            (data - simulated)[..., k], cmap="RdBu_r", vmin=-RESIDUAL_DN, vmax=RESIDUAL_DN, interpolation="nearest"
        )
        axis.set_title(f"frame − simulated, {CHANNELS[k]}")
    canvas.colorbar(drawn, ax=axes[1], label="DN")
    for axis in axes.ravel():
        axis.set(xlabel="x [px of the fit]", ylabel="y [px of the fit]")
    return canvas


def _eight(image: NDArray[Any]) -> NDArray[np.uint8]:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _rms(step: Step) -> float:
    return float(np.sqrt((step.rms_DN**2).mean()))


def _listed(causes: tuple[str, ...]) -> str:
    names = [cause for cause in causes if cause != "place"]
    return ", ".join(names) if names else "no cause beyond the place"


def _pictures(twin: ContactTwin) -> Section:
    return Section(
        "Side by side",
        pictures=[
            Picture(
                figure_png(side_by_side(twin)),
                f"Means of {twin.picture.bin_px} x {twin.picture.bin_px} pixels. Upper right: the believed rig, "
                "monochrome and exposed to half of full scale.",
            )
        ],
    )


def _row(step: Step, what: str) -> tuple[str, ...]:
    rms = [f"{value:.1f}" for value in step.rms_DN]
    return (what, *rms, f"{step.score:.0f}", f"{step.gain:+.0f} ± {step.gain_error:.0f}")


def _added(twin: ContactTwin) -> Section:
    header = ["model", "red [DN]", "green [DN]", "blue [DN]", "log score [nat]", "gain [nat]"]
    rows = [_row(step, "believed rig" if step.cause == "place" else f"+ {CAUSES[step.cause]}") for step in twin.added]
    return Section(
        "One cause after the other",
        paragraphs=["RMS residual of each channel, and log score, on blocks that no fit has seen."],
        tables=[Table(header, rows)],
    )


def _listed_rms(step: Step) -> str:
    return ", ".join(f"{value:.1f}" for value in step.rms_DN)


def _without(twin: ContactTwin) -> Section:
    full = twin.added[-1]
    header = ["without", "red [DN]", "green [DN]", "blue [DN]", "log score [nat]", "change [nat]", "kept"]
    rows = [
        (*_row(step, f"{step.cause}: {CAUSES[step.cause]}"), "yes" if step.cause in twin.final.fit.causes else "no")
        for step in twin.without
    ]
    return Section(
        "What each cause is needed for",
        paragraphs=[
            "The full model fitted again without each cause. The change is what the frame loses; its standard error "
            "is by the variance of whole blocks. What loses less than two of them is left out of the final twin, which "
            f"costs {full.score - twin.final.score:.0f} nat in all: the full model's score is {full.score:.0f}, with "
            f"residuals of {_listed_rms(full)} DN."
        ],
        tables=[Table(header, rows)],
    )


def _automatic(twin: ContactTwin) -> list[str]:
    levels = automatic_levels(twin)
    if not levels:
        return []
    text = ", ".join(f"{level:.1f} ({metering})" for metering, level in levels.items())
    return [f"libcamera's automatic exposure would settle on a contact level of {text}."]


def _figures(twin: ContactTwin) -> Section:
    header = ["figure", "estimate", "90 % interval", "unit", "meaning"]
    rows = []
    for one in figures(twin):
        ends = "held" if np.isnan(one.low) else f"{one.low:.3g} to {one.high:.3g}"
        rows.append((one.name, f"{one.value:.3g}", ends, "" if one.unit == "1" else one.unit, one.doc))
    regions = [
        (name, *(f"{a:.0f} / {b:.0f}" for a, b in zip(frame, simulated, strict=True)))
        for name, (frame, simulated) in medians(twin).items()
    ]
    return Section(
        "What the frame gives",
        paragraphs=[
            f"A contact of this size on this finger takes {twin.force_N:.2g} N by the scene's contact law. Scale is "
            "a hypothesis: it holds if the lit disc is the whole finger. Intervals hold filters and white balance. "
            "Medians are those of held-out blocks, frame / simulated.",
            *_automatic(twin),
        ],
        tables=[Table(header, rows), Table(["region", "red [DN]", "green [DN]", "blue [DN]"], regions)],
    )


def _histogram(twin: ContactTwin) -> Section:
    simulated = twin.final.fit.predicted @ LUMA / 255.0
    canvas = Canvas(figsize=(8.0, 3.4), layout="constrained")
    FigureCanvasAgg(canvas)
    axis = canvas.subplots()
    bins = np.arange(0.0, 1.02, 0.01).tolist()
    axis.hist(twin.picture.grey.ravel(), bins=bins, color="0.7", label="frame")
    axis.hist(simulated.ravel(), bins=bins, histtype="step", color="tab:red", label="simulated")
    axis.set(xlabel="grey of the published chain [1]", ylabel="pixels", yscale="log")
    axis.legend()
    inside = within_contact(twin)
    quantiles = ", ".join(f"{v:.3f} ({a:.3f} to {b:.3f})" for v, a, b in inside["quantiles"].values())
    shares = ", ".join(f"{c} {100 * s:.0f} %" for c, s in zip(CHANNELS, inside["variance_share"], strict=True))
    within = (
        [
            f"Within the contact, its rim left out, the twin has grey of {quantiles} at 5, 25, 50, 75 and 95 %; its "
            f"variance comes from {shares}.",
        ]
        if quantiles
        else []
    )
    pairs = zip(peaks(twin.picture.grey), peaks(simulated), strict=False)
    return Section(
        "Grey",
        paragraphs=[
            "Peaks, frame / simulated: " + ", ".join(f"{a:.3f} / {b:.3f}" for a, b in pairs) + ".",
            *within,
        ],
        pictures=[Picture(figure_png(canvas), "Histograms of the grey image.")],
    )
