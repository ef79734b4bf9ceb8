"""The page of ``evanesce criticise``: what is wrong, how sure that is, what to measure next, what it gains."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from evanesce.criticism.evidence import Evidence, Shown
from evanesce.report.html import Page, Picture, Section, Table, figure_png

MOST_VIEWS = 6

MOST_PROBABLE = 6
"""Rows of the table of probabilities where nothing was fitted."""
RANGE = 5.0
"""Residuals are shown from -RANGE to +RANGE standard deviations."""

VERDICTS = {
    "none": "Nothing: what the believed rig leaves of these data is noise, as far as this can be seen.",
    "named": "The data depart from the believed rig, and {names}.",
    "ambiguous": "The data depart from the believed rig; {names}.",
    "unknown": "The data depart from the believed rig in a way that no effect of the library explains.",
}


def page(result: Mapping[str, Any], evidence: Evidence, name: str, provenance: Mapping[str, Any]) -> Page:
    """Return the report of one criticised bundle.

    Parameters
    ----------
    result : mapping
        The JSON of ``evanesce criticise``.
    evidence : Evidence
    name : str
        Of the bundle.
    provenance : mapping
    """
    sections = [_residuals(evidence), _causes(result, evidence), _next(result), _battery(result, evidence)]
    if result.get("unknown"):
        sections.insert(2, _unknown(result["unknown"]))
    sections += [_gain(result), _scene(evidence)]
    if evidence.notes:
        sections.append(Section("What limits this answer", list(evidence.notes)))
    return Page(f"What the simulation gets wrong: {name}", verdict_words(result), sections, provenance)


def verdict_words(result: Mapping[str, Any]) -> str:
    """Return the verdict as a sentence, with the family's probability."""
    words = VERDICTS[result["verdict"]].format(names=_causes_words(result))
    # Of series alone, whose answer has alternatives, the standard deviations are the lab's word.
    missing = "A series states no standard deviation" if "alternatives" in result else "There are no replicate frames"
    control = f" {missing}: the rate of false alarms is not controlled."
    if result.get("false_alarm_control", True):
        control = ""
    return f"{words} Noise alone rings as loudly with probability {result['global_p']:.3g}.{control}"


def _causes_words(result: Mapping[str, Any]) -> str:
    """Return who explains the data with whom, and who might in their stead."""
    found = [effect["id"] for effect in result.get("effects", [])]
    others = [name for name in result.get("ambiguous_with", []) if name not in found]
    together = " and ".join(found)
    if not found:
        if len(others) == 1:
            return f"{others[0]} may explain it, but not well enough to be named"
        return f"one of these may explain it, none well enough to be named: {' or '.join(others)}"
    if others:
        whose = "them" if len(found) > 1 else "it"
        return f"{together} would explain it, but these data cannot tell {whose} from {' or '.join(others)}"
    return f"these causes explain it together: {together}" if len(found) > 1 else f"one cause explains it: {together}"


def residual_figure(shown: list[Shown]) -> Figure:
    """Return measured frames above their residuals before and after."""
    figure = Figure(figsize=(2.6 * len(shown) + 0.8, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(3, len(shown), squeeze=False)
    picture = None
    for column, view in zip(axes.T, shown, strict=True):
        column[0].imshow(view.data, cmap="gray", vmin=0)
        column[0].set_title(view.title + (" (locked)" if view.locked else ""), fontsize=8)
        for panel, residual in zip(column[1:], (view.before, view.after), strict=True):
            picture = panel.imshow(residual, cmap="RdBu_r", vmin=-RANGE, vmax=RANGE, interpolation="nearest")
        for panel in column:
            panel.set_xticks([])
            panel.set_yticks([])
    for row, label in enumerate(("measured", "residual, believed", "residual, extended")):
        axes[row, 0].set_ylabel(label, fontsize=9)
    if picture is not None:
        figure.colorbar(picture, ax=axes[1:].ravel().tolist(), label="residual [standard deviations]", shrink=0.7)
    return figure


def _residuals(evidence: Evidence) -> Section:
    if not evidence.shown:
        return Section("Residuals", ["These data hold no frames; see the tests of the series below."])
    size = [float(np.nanmean(np.square(view.before))) for view in evidence.shown]
    chosen = sorted(np.argsort(size)[::-1][:MOST_VIEWS])
    caption = (
        "Red: brighter than the model says, blue: darker. Above, what the believed rig leaves after pose, light and "
        "the other nuisances were fitted; below, what the extended one leaves. Structure below is still unexplained."
    )
    figure = residual_figure([evidence.shown[k] for k in chosen])
    return Section("Residuals before and after", pictures=[Picture(figure_png(figure), caption)])


def _causes(result: Mapping[str, Any], evidence: Evidence) -> Section:
    rows = [
        (" + ".join(r.effects) or "none", f"{r.gain:+.1f} ± {r.gain_error:.1f}", f"{r.probability:.3f}", r.note)
        for r in evidence.ranking
    ]
    tables = [
        Table(
            ("cause", "held-out log score over believed [nats]", "probability", "remark"), rows,
            "The likeliest first. The log score is of conditions that the fit did not see.",
        ),
        _parameters(result),
    ]  # fmt: skip
    text = []
    if not rows:
        text.append("No cause was fitted, so that there is no held-out score to rank by.")
        tables.append(_probabilities(result))
    if others := result.get("ambiguous_with"):
        text.append(f"Cannot be told apart with these data: {', '.join(others)}.")
    text += [f"{entry['id']} would not be seen: {entry['by']} takes its place." for entry in result.get("absorbed", [])]
    return Section("Causes", text, tables=[table for table in tables if table.rows])


def _probabilities(result: Mapping[str, Any]) -> Table:
    likeliest = sorted(result["probabilities"].items(), key=lambda entry: entry[1], reverse=True)[:MOST_PROBABLE]
    rows = [(name, f"{probability:.2g}") for name, probability in likeliest if probability]
    return Table(("what", "probability"), rows, "The likeliest first.")


def _parameters(result: Mapping[str, Any]) -> Table:
    rows = [
        (effect["id"], name, f"{p['value']:.4g}", f"{p['lo']:.4g} to {p['hi']:.4g}", str(p["unit"]))
        for effect in result.get("effects", [])
        for name, p in effect["parameters"].items()
    ]
    return Table(("effect", "parameter", "value", "90 % interval", "unit"), rows, "Fitted to all data but the locked.")


def _next(result: Mapping[str, Any]) -> Section:
    advice = result.get("next_measurement")
    if not advice:
        words = {
            "none": "Nothing rings: no shot is asked for.",
            "named": "No other cause that was fitted draws the same: no shot would tell more of them apart.",
            "unknown": "No cause of the library explains it: there are none that a shot could separate.",
        }
        told = words.get(result["verdict"], "No shot of the menu would tell these causes apart.")
        return Section("What to measure next", [told])
    separates = ", ".join(advice.get("separates", [])) or "what remains"
    return Section("What to measure next", [f"{advice['what']}. It would tell apart: {separates}."])


def _battery(result: Mapping[str, Any], evidence: Evidence) -> Section:
    rows = [(o.name, f"{o.statistic:.3g}", f"{o.p:.3g}", f"{o.tail_p:.1e}") for o in evidence.outcomes[:12]]
    text = f"Global probability that noise rings as loudly: {result['global_p']:.3g}."
    if evidence.score_p is None or evidence.battery_p is None:
        text += (
            " Of series it is made up of two: that their standard deviations make the sum of squares as large"
            " (chi-square), and runs of points to one side as long (Fisher's combination)."
        )
        return Section("The battery", [text])
    text += (
        f" It is made up of two: noise makes any candidate's score as loud with {evidence.score_p:.3g}, any of these"
        f" {len(evidence.outcomes)} tests with {evidence.battery_p:.3g}."
    )
    if not evidence.listened:
        text += " A codec was at work, which leaves structure of any kind: the tests below do not count."
    text += (
        " Draws of noise are mixtures of the differences of replicate frames, the same nuisances taken from each."
        if result.get("false_alarm_control", True)
        else " There being no replicates, draws are of the believed camera's noise, independent from bin to bin."
    )
    columns = ("test on the believed rig's residuals", "statistic", "p (by draws)", "p (by tail law)")
    return Section("The battery", [text], tables=[Table(columns, rows, "The loudest first.")])


def _unknown(found: Mapping[str, Any]) -> Section:
    rows = [(str(key).replace("_", " "), _words(value)) for key, value in found.items()]
    text = "A flexible term describes it; it may be used between the conditions measured, not beyond them."
    return Section("What is not in the library", [text], tables=[Table(("property", "finding"), rows)])


def _words(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key.replace('_', ' ')}: {_words(part)}" for key, part in value.items())
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _gain(result: Mapping[str, Any]) -> Section:
    gain = result.get("gain") or {}
    rows = []
    if score := gain.get("log_score"):
        rows.append(
            ("log score, extended over believed [nats]", f"{score[0]:+.1f} ({score[1]:+.1f} to {score[2]:+.1f})")
        )
    for key, label in (("rmse_dn", "RMS residual [DN]"), ("area_error_pct", "error of predicted area [%]")):
        if pair := gain.get(key):
            rows.append((label, f"{pair[0]:.3g} before, {pair[1]:.3g} after"))
    text = "On the locked conditions, which no fit and no choice saw; opened once, after all else was decided."
    if not rows:
        text = "There are no locked conditions in these data, so no gain can be claimed."
    return Section(
        "Gain on data that were locked away", [text], tables=[Table(("figure", "value"), rows)] if rows else []
    )


def _scene(evidence: Evidence) -> Section:
    lines = difflib.unified_diff(
        evidence.scene_before.splitlines(), evidence.scene_after.splitlines(), "believed", "extended", lineterm="", n=1
    )
    rows = [(line,) for line in list(lines)[2:]]
    text = "The extended scene renders with every other command." if rows else "The believed scene stands as it is."
    return Section("The extended scene", [text], tables=[Table(("difference",), rows)] if rows else [])
