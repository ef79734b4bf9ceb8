"""Findings of the threshold study: charts, tables and verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.report.charts import Chart, Panel, Series
from evanesce.report.html import Table
from evanesce.rig import Scene
from evanesce.studies.registry import Findings, Progress, Study
from evanesce.studies.scenes import Finger
from evanesce.studies.threshold.study import (
    BLOBS,
    BLURS,
    FIXED,
    RULES,
    THESIS_THRESHOLDS,
    THRESHOLDS,
    WINDOW_MM,
    cliff,
    compute,
    errors_by_setting,
    flat_range,
    ranked,
)


def findings(rows: Mapping[tuple[Finger, float], Mapping[str, Any]], card: Mapping[str, Any]) -> Findings:
    """Return tables, charts and verdict.

    Parameters
    ----------
    rows, card : mapping
        Of :func:`evanesce.studies.threshold.study.compute`.

    Returns
    -------
    Findings
    """
    table = ranked(errors_by_setting(rows))
    clear = ranked(errors_by_setting({k: r for k, r in rows.items() if not k[0].scattering}))
    rules = [entry for entry in table if "," in entry[0]]
    best, second = rules[0], next(r for r in rules[1:] if r[0].split(",")[0] != rules[0][0].split(",")[0])
    fixed = next(entry for entry in table if "," not in entry[0])
    clear_rule = next(entry for entry in clear if "," in entry[0])
    verdict = [
        f"Of scikit-image's rules {best[0]} has the smallest error over all fingers (RMS {_percent(best[2])}), ahead of"
        f" {second[0]} ({_percent(second[2])}); the best fixed level, {fixed[0]}, has {_percent(fixed[2])}, but was"
        " chosen with these frames' own truth.",
        f"Without scattering and specks the best rule is {clear_rule[0]} (RMS {_percent(clear_rule[2])}, worst"
        f" {_percent(clear_rule[3])}).",
        _card_sentence(card),
    ]
    return Findings(
        verdict=verdict,
        charts=[_threshold_chart(rows), _settings_chart(rows)],
        tables=[_range_table(rows), _rule_table(rows), _crop_table(rows), _ranking(table, clear), _card_table(card)],
        data={
            "thresholds": THRESHOLDS,
            "frames": [
                {"material": f.material, "finger": f.name, "force_N": force, **row} for (f, force), row in rows.items()
            ],
            "ranking": [dict(zip(("setting", "median", "rms", "worst"), entry, strict=True)) for entry in table],
            "card": dict(card),
        },
    )


def _percent(value: float | None) -> str:
    if value is None or not np.isfinite(value):
        return "none"
    return f"{100 * value:.3g} %" if abs(value) < 0.1 else f"{100 * value:.0f} %"


def _signed(value: float | None) -> str:
    return "not found" if value is None or not np.isfinite(value) else f"{100 * value:+.1f}"


def _card_sentence(card: Mapping[str, Any]) -> str:
    known = [e for e in card["scale_error"] if e is not None]
    if not known:
        return "The card was not found as a square at any fixed level."
    return (
        f"The card's threshold moves the area per pixel, and with it every area, by {_signed(min(known))} to"
        f" {_signed(max(known))} % over the levels at which the card is a square; half-way between its two levels"
        f" ({card['halfway_threshold']:.2f}) it is off by {_signed(card['halfway'])} %."
    )


def _threshold_chart(rows: Mapping[tuple[Finger, float], Mapping[str, Any]]) -> Chart:
    panels = []
    for scattering in (False, True):
        series = [
            Series(
                label=f"{f.material.replace('silskin_', 'Silskin ')} %, {'ridged' if f.ridged else 'smooth'}, {n:g} N",
                x=THRESHOLDS,
                y=[100 * (a / row["true_area_mm2"] - 1) for a in row["manual"]],
                group=f"{f.material} {f.ridged}",
            )
            for (f, n), row in rows.items()
            if f.scattering == scattering and n in (0.5, 5.0)
        ]
        title = "with scattering and specks (assumed)" if scattering else "clear silicone, clean glass"
        panels.append(
            Panel(
                title=title,
                x_label="threshold, grey level 0 to 1",
                y_label="area error [%]",
                series=series,
                y_range=(-100, 150),
            )
        )
    return Chart(
        panels=panels,
        caption="Where a curve is flat the threshold hardly matters; where it falls the light of the contact ends. With"
        " subsurface scattering there is no flat part.",
    )


def _settings_chart(rows: Mapping[tuple[Finger, float], Mapping[str, Any]]) -> Chart:
    panels = []
    for what, settings, label in (
        ("blob", BLOBS, "minimum size of a dilated blob [px]"),
        ("blur", BLURS, "standard deviation of the blur [px]"),
    ):
        series = []
        for name in sorted({f.name for f, _ in rows}):
            errors = np.array(
                [100 * (np.array(r[what]) / r["true_area_mm2"] - 1) for (f, _), r in rows.items() if f.name == name]
            )
            series.append(
                Series(
                    label=name,
                    x=settings,
                    y=np.median(errors, axis=0).tolist(),
                    low=errors.min(axis=0).tolist(),
                    high=errors.max(axis=0).tolist(),
                )
            )
        panels.append(Panel(title=f"threshold {FIXED:g}", x_label=label, y_label="area error [%]", series=series))
    return Chart(
        panels=panels,
        caption="Blob size takes away specks and nothing else; blur moves the edge outwards, because the threshold"
        " lies below half of the contact's level. Lines are medians over materials and forces, bands the extremes.",
    )


def _range_table(rows: Mapping[tuple[Finger, float], Mapping[str, Any]]) -> Table:
    lines = []
    for (finger, force), row in rows.items():
        truth = row["true_area_mm2"]
        low, high = flat_range(THRESHOLDS, row["manual"])
        edge = cliff(THRESHOLDS, row["manual"], truth)
        middle = np.interp(0.5 * (low + high), THRESHOLDS, row["manual"]) / truth - 1 if np.isfinite(low) else np.nan
        by_hand = [_signed(row["manual"][THRESHOLDS.index(t)] / truth - 1) for t in THESIS_THRESHOLDS]
        lines.append(
            (
                f"{finger.material}, {finger.name}", f"{force:g}", f"{truth:.2f}", *by_hand,
                f"{low:g} to {high:g}" if np.isfinite(low) else "none",
                _signed(float(middle)) if np.isfinite(low) else "none",
                f"{edge:g}" if np.isfinite(edge) else "none",
            )
        )  # fmt: skip
    return Table(
        columns=(
            "finger",
            "force [N]",
            "true area [mm²]",
            *(f"error at {t:g} [%]" for t in THESIS_THRESHOLDS),
            "flat (2 %) from to",
            "error there [%]",
            "20 % lost from",
        ),
        rows=lines,
        caption="Area error at four levels that an eye may pick from a histogram (the thesis prints none); the widest"
        " range of levels over which the area stays"
        " within 2 %; the level from which on a fifth of the contact is lost.",
    )


def _rule_table(rows: Mapping[tuple[Finger, float], Mapping[str, Any]]) -> Table:
    lines = []
    for name in sorted({f.name for f, _ in rows}):
        some = [r for (f, _), r in rows.items() if f.name == name]
        for where in some[0]["rules"]:
            cells = []
            for rule in RULES:
                errors = [r["rules"][where][rule]["area_mm2"] / r["true_area_mm2"] - 1 for r in some]
                level = np.median([r["rules"][where][rule]["threshold"] for r in some])
                cells.append(f"{_signed(min(errors))} to {_signed(max(errors))} ({level:.2f})")
            lines.append((name, where, *cells))
    return Table(
        columns=("finger", "pixels the rule sees", *(f"{rule} [%]" for rule in RULES)),
        rows=lines,
        caption="Extremes of the area error over materials and forces; in brackets the median level. A rule that sees"
        " more dark plate sets another level.",
    )


def _crop_table(rows: Mapping[tuple[Finger, float], Mapping[str, Any]]) -> Table:
    """Return the effect of the crop at the thesis's fixed levels."""
    lines = []
    for name in sorted({f.name for f, _ in rows}):
        some = [r for (f, _), r in rows.items() if f.name == name]
        cells = []
        for k, t in enumerate(THESIS_THRESHOLDS):
            change = [
                (r["manual_whole_frame"][k] - r["manual"][THRESHOLDS.index(t)]) / r["true_area_mm2"] for r in some
            ]
            cells.append(f"{_signed(min(change))} to {_signed(max(change))}")
        lines.append((name, *cells))
    return Table(
        columns=("finger", *(f"whole frame less crop, at {t:g} [% of the true area]" for t in THESIS_THRESHOLDS)),
        rows=lines,
        caption="Effect of the crop at fixed levels: the whole frame's area less that of a window around the finger,"
        f" {2 * WINDOW_MM:g} mm a side; extremes over materials and forces. The rest is specks and scattered"
        " light beyond the window.",
    )


def _ranking(
    table: Sequence[tuple[str, float, float, float]], clear: Sequence[tuple[str, float, float, float]]
) -> Table:
    other = {entry[0]: entry for entry in clear}
    return Table(
        columns=("setting", "median |error| [%]", "RMS [%]", "worst [%]", "RMS without scattering [%]", "worst [%]"),
        rows=[
            (name, *(f"{100 * v:.1f}" for v in (median, rms, worst, other[name][2], other[name][3])))
            for name, median, rms, worst in table
        ],
        caption="All fingers, materials and forces; fixed levels by number.",
    )


def _card_table(card: Mapping[str, Any]) -> Table:
    lines = [(f"{t:g}", _signed(e)) for t, e in zip(card["thresholds"], card["scale_error"], strict=True)]
    lines.append((f"half-way, {card['halfway_threshold']:.3f}", _signed(card["halfway"])))
    return Table(
        columns=("threshold on the card", "error of the area per pixel [%]"),
        rows=lines,
        caption="The square card through the same chain; what it adds to every area. Height of the print over the glass"
        " included.",
    )


def run(scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> Findings:
    """Compute the study and return its findings.

    Parameters
    ----------
    scene, out, progress, quick, seed
        As for :meth:`evanesce.studies.registry.Study.run`.

    Returns
    -------
    Findings
    """
    return findings(*compute(scene, out, progress, quick=quick, seed=seed))


STUDY = Study("threshold", "Threshold, blob size, blur and crop", 10, run)
