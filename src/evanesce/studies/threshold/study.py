"""Area error of the reference segmentation by threshold, blob size, blur and crop, and by rules that set it.

Lens distortion is undone without error and the pixel's area is the true one, so that the error is the chain's own.
What the card's threshold does to that area per pixel is a table of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from skimage import filters

from evanesce.chain.fast import FastCamera
from evanesce.chain.simulate import simulate_card, solve_contact
from evanesce.core.errors import InputError
from evanesce.evaluation.perfect_view import PerfectView
from evanesce.measurement.io.images import read_image
from evanesce.measurement.reference.area import halfway_threshold, square_scale
from evanesce.measurement.reference.segment import Chain, Crop, blurred_grey, segment
from evanesce.rig import Scene
from evanesce.sensor.codec import write_png
from evanesce.studies.registry import Chart, Findings, Ledger, Listing, Panel, Part, Progress, Series
from evanesce.studies.scenes import Finger, check_studied, every_finger

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]

FORCES = (0.5, 1.0, 2.0, 5.0)  # [N]
QUICK_FORCES = (0.5, 5.0)  # [N]
AUTHORS = (0.0375, 0.15, 0.35, 0.6)
"""Grey levels that the thesis sets by hand."""

THRESHOLDS = tuple(
    sorted({*AUTHORS, *(round(0.025 * k, 4) for k in range(2, 13)), *(round(0.05 * k, 4) for k in range(6, 16))})
)
BLOBS = (0, 200, 2000, 5000, 20_000)  # [px]
BLURS = (0.0, 1.0, 2.0, 4.0, 8.0)  # [px]
WINDOW_MM = 8.0
"""Half the side of the crop around the finger."""

FIXED = 0.15
CARD_PATHS: dict[str, Any] = {"samples_per_pixel": 4, "passes": 2}
CARD_THRESHOLDS = (0.0375, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6)


def _yen(level: Floats) -> float:
    with np.errstate(divide="ignore"):  # scikit-image takes the logarithm of empty ends of the histogram
        return float(filters.threshold_yen(level))


RULES: dict[str, Callable[[Floats], float]] = {
    "Otsu": lambda level: float(filters.threshold_otsu(level)),
    "2.5 x Otsu": lambda level: 2.5 * float(filters.threshold_otsu(level)),
    "triangle": lambda level: float(filters.threshold_triangle(level)),
    "mean": lambda level: float(filters.threshold_mean(level)),
    "Yen": _yen,
    "Li": lambda level: float(filters.threshold_li(level)),
}
"""Threshold of a blurred grey image (0 to 1), as scikit-image gives it."""


def chain_areas(image: Image, chains: Sequence[Chain], mm2_per_px: float) -> list[float]:
    """Return the area that each chain finds on one image [mm^2]."""
    return [segment(image, chain).pixels * mm2_per_px for chain in chains]


def frame_row(image: Image, truth: float, mm2_per_px: float, window: Crop) -> dict[str, Any]:
    """Return everything the study asks of one frame; areas in mm^2.

    Parameters
    ----------
    image : ndarray of uint8 (rows, cols)
        Undistorted [DN].
    truth : float
        True area [mm^2].
    mm2_per_px : float
    window : Crop
        Around the finger.
    """
    rules: dict[str, Any] = {}
    for where, crop in (("whole frame", Crop()), ("around the finger", window)):
        level = blurred_grey(crop.apply(image), 1.0)
        found = {name: min(max(rule(level), 0.0), 1.0) for name, rule in RULES.items()}
        areas = chain_areas(image, [Chain(threshold=t, crop=crop) for t in found.values()], mm2_per_px)
        rules[where] = {n: {"threshold": t, "area_mm2": a} for (n, t), a in zip(found.items(), areas, strict=True)}
    return {
        "true_area_mm2": truth,
        "manual": chain_areas(image, [Chain(threshold=t, crop=window) for t in THRESHOLDS], mm2_per_px),
        "manual_whole_frame": chain_areas(image, [Chain(threshold=t) for t in AUTHORS], mm2_per_px),
        "blob": chain_areas(image, [Chain(threshold=FIXED, min_blob=n) for n in BLOBS], mm2_per_px),
        "blur": chain_areas(image, [Chain(threshold=FIXED, blur=s, crop=window) for s in BLURS], mm2_per_px),
        "rules": rules,
    }


def flat_range(thresholds: Sequence[float], areas: Sequence[float], span: float = 0.02) -> tuple[float, float]:
    """Return the widest range of thresholds over which the area varies by no more than a share of its mean.

    NaN where not even neighbours agree, or nothing is found.
    """
    t, a = np.asarray(thresholds), np.asarray(areas)
    best = (float("nan"), float("nan"))
    for i in range(len(t)):
        for j in range(i + 1, len(t)):
            part = a[i : j + 1]
            if part.min() > 0 and np.ptp(part) <= span * part.mean() and not t[j] - t[i] <= best[1] - best[0]:
                best = (float(t[i]), float(t[j]))
    return best


def cliff(thresholds: Sequence[float], areas: Sequence[float], truth: float, loss: float = 0.2) -> float:
    """Return the least threshold from which on more than ``loss`` of the true area is missing; NaN if there is none."""
    missing = np.asarray(areas) < (1.0 - loss) * truth
    if not missing[-1]:
        return float("nan")
    return float(thresholds[len(missing) - int(np.argmin(missing[::-1])) if not missing.all() else 0])


def errors_by_setting(rows: Mapping[tuple[Finger, float], Mapping[str, Any]]) -> dict[str, Floats]:
    """Return the relative area error of each fixed threshold and each rule, over all frames."""
    found: dict[str, list[float]] = {}
    for row in rows.values():
        truth = row["true_area_mm2"]
        for threshold, area in zip(THRESHOLDS, row["manual"], strict=True):
            found.setdefault(f"{threshold:g}", []).append(area / truth - 1.0)
        for where, rules in row["rules"].items():
            for name, entry in rules.items():
                found.setdefault(f"{name}, {where}", []).append(entry["area_mm2"] / truth - 1.0)
    return {name: np.array(values) for name, values in found.items()}


def ranked(errors: Mapping[str, Floats]) -> list[tuple[str, float, float, float]]:
    """Return (setting, median size, root mean square, worst size of the relative error), best root mean square first.

    A frame in which nothing is found counts with its error of -1.
    """
    table = [
        (name, float(np.median(np.abs(e))), float(np.sqrt((e**2).mean())), float(np.abs(e).max()))
        for name, e in errors.items()
    ]
    return sorted(table, key=lambda entry: entry[2])


def run(scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> Findings:
    """Do the study; see :class:`evanesce.studies.registry.Study`."""
    check_studied(scene)
    forces = QUICK_FORCES if quick else FORCES
    ledger = Ledger(out / "threshold.jsonl", {"scene": scene.as_dict(), "seed": seed, "thresholds": THRESHOLDS})
    view = PerfectView.of(scene)
    fingers = list(every_finger())
    total, done = len(fingers) * len(forces) + 1, 0
    rows: dict[tuple[Finger, float], dict[str, Any]] = {}
    for finger in fingers:
        camera: FastCamera | None = None
        for force in forces:
            key = f"{finger.material} {finger.name} {force:g}"
            if key not in ledger:
                camera = camera or FastCamera(finger.on(scene))
            rows[finger, force] = ledger.row(key, partial(_frame, view, camera, force, seed))
            done += 1
            progress("threshold: frames", done, total)
    card = ledger.row("card", lambda: _card(scene, view, out, seed))
    progress("threshold: frames", total, total)
    return findings(rows, card)


def _frame(view: PerfectView, camera: FastCamera | None, force: float, seed: int) -> dict[str, Any]:
    assert camera is not None  # made whenever a row is missing
    _, state = solve_contact(camera.scene, force, seed=seed)
    assert state is not None  # a force was given
    image = view.straight(camera.press(force, seed=seed).data)
    return frame_row(image, state.nominal_contact_area, view.mm2_per_px, view.window(WINDOW_MM))


def _card(scene: Scene, view: PerfectView, out: Path, seed: int) -> dict[str, Any]:
    """Return what the card's threshold does to the area per pixel; relative errors."""
    path = out / "square.png"
    frame = simulate_card(scene, "square", seed=seed, **CARD_PATHS)
    write_png(path, frame.data)
    straight = view.straight(read_image(path).data)
    side = scene.card.square_side_mm

    def scale_error(chain: Chain | None) -> float:
        colour: Literal["white", "black"] = "black" if scene.card.square_inverted else "white"
        try:
            return square_scale(straight, side, chain, square=colour).mm2_per_px / view.mm2_per_px - 1.0
        except InputError:  # at this level the card is no square
            return float("nan")

    return {
        "halfway_threshold": halfway_threshold(straight),
        "halfway": scale_error(None),
        "thresholds": CARD_THRESHOLDS,
        "scale_error": [scale_error(Chain(threshold=t)) for t in CARD_THRESHOLDS],
    }


def findings(rows: Mapping[tuple[Finger, float], Mapping[str, Any]], card: Mapping[str, Any]) -> Findings:
    """Return tables, charts and verdict from the rows of all frames and of the card."""
    table = ranked(errors_by_setting(rows))
    clear = ranked(errors_by_setting({k: r for k, r in rows.items() if not k[0].glowing}))
    rules = [entry for entry in table if "," in entry[0]]
    best, second = rules[0], next(r for r in rules[1:] if r[0].split(",")[0] != rules[0][0].split(",")[0])
    fixed = next(entry for entry in table if "," not in entry[0])
    clear_rule = next(entry for entry in clear if "," in entry[0])
    verdict = [
        f"Of scikit-image's rules {best[0]} errs least over all fingers (RMS {_percent(best[2])}), ahead of {second[0]}"
        f" ({_percent(second[2])}); the best fixed level, {fixed[0]}, has {_percent(fixed[2])}, but was chosen by"
        f" these frames' own truth.",
        f"Without glow and specks the best rule is {clear_rule[0]} (RMS {_percent(clear_rule[2])}, worst"
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
    for glowing in (False, True):
        series = [
            Series(
                label=f"{f.material.replace('silskin_', 'Silskin ')} %, {'ridged' if f.ridged else 'smooth'}, {n:g} N",
                x=THRESHOLDS,
                y=[100 * (a / row["true_area_mm2"] - 1) for a in row["manual"]],
                group=f"{f.material} {f.ridged}",
            )
            for (f, n), row in rows.items()
            if f.glowing == glowing and n in (0.5, 5.0)
        ]
        title = "with glow and specks (assumed)" if glowing else "clear silicone, clean glass"
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
        " light that wanders in the silicone there is no flat part.",
    )


def _settings_chart(rows: Mapping[tuple[Finger, float], Mapping[str, Any]]) -> Chart:
    panels = []
    for what, settings, label in (
        ("blob", BLOBS, "least size of a dilated blob [px]"),
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


def _range_table(rows: Mapping[tuple[Finger, float], Mapping[str, Any]]) -> Listing:
    lines = []
    for (finger, force), row in rows.items():
        truth = row["true_area_mm2"]
        low, high = flat_range(THRESHOLDS, row["manual"])
        edge = cliff(THRESHOLDS, row["manual"], truth)
        middle = np.interp(0.5 * (low + high), THRESHOLDS, row["manual"]) / truth - 1 if np.isfinite(low) else np.nan
        by_hand = [_signed(row["manual"][THRESHOLDS.index(t)] / truth - 1) for t in AUTHORS]
        lines.append(
            (
                f"{finger.material}, {finger.name}", f"{force:g}", f"{truth:.2f}", *by_hand,
                f"{low:g} to {high:g}" if np.isfinite(low) else "none",
                _signed(float(middle)) if np.isfinite(low) else "none",
                f"{edge:g}" if np.isfinite(edge) else "none",
            )
        )  # fmt: skip
    return Listing(
        columns=(
            "finger",
            "force [N]",
            "true area [mm²]",
            *(f"error at {t:g} [%]" for t in AUTHORS),
            "flat (2 %) from to",
            "error there [%]",
            "20 % lost from",
        ),
        rows=lines,
        caption="Area error at the four levels of the thesis; the widest range of levels over which the area stays"
        " within 2 %; the level from which on a fifth of the contact is lost.",
    )


def _rule_table(rows: Mapping[tuple[Finger, float], Mapping[str, Any]]) -> Listing:
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
    return Listing(
        columns=("finger", "pixels the rule sees", *(f"{rule} [%]" for rule in RULES)),
        rows=lines,
        caption="Extremes of the area error over materials and forces; in brackets the median level. A rule that sees"
        " more dark plate sets another level.",
    )


def _crop_table(rows: Mapping[tuple[Finger, float], Mapping[str, Any]]) -> Listing:
    """Return the effect of the crop at the thesis's levels, which no rule sets."""
    lines = []
    for name in sorted({f.name for f, _ in rows}):
        some = [r for (f, _), r in rows.items() if f.name == name]
        cells = []
        for k, t in enumerate(AUTHORS):
            change = [
                (r["manual_whole_frame"][k] - r["manual"][THRESHOLDS.index(t)]) / r["true_area_mm2"] for r in some
            ]
            cells.append(f"{_signed(min(change))} to {_signed(max(change))}")
        lines.append((name, *cells))
    return Listing(
        columns=("finger", *(f"whole frame less crop, at {t:g} [% of the true area]" for t in AUTHORS)),
        rows=lines,
        caption="Effect of the crop at fixed levels: the whole frame's area less that of a window around the finger,"
        f" {2 * WINDOW_MM:g} mm a side; extremes over materials and forces. The rest is specks and glow"
        " beyond the window.",
    )


def _ranking(
    table: Sequence[tuple[str, float, float, float]], clear: Sequence[tuple[str, float, float, float]]
) -> Listing:
    other = {entry[0]: entry for entry in clear}
    return Listing(
        columns=("setting", "median |error| [%]", "RMS [%]", "worst [%]", "RMS without glow [%]", "worst [%]"),
        rows=[
            (name, *(f"{100 * v:.1f}" for v in (median, rms, worst, other[name][2], other[name][3])))
            for name, median, rms, worst in table
        ],
        caption="All fingers, materials and forces; fixed levels by number.",
    )


def _card_table(card: Mapping[str, Any]) -> Listing:
    lines = [(f"{t:g}", _signed(e)) for t, e in zip(card["thresholds"], card["scale_error"], strict=True)]
    lines.append((f"half-way, {card['halfway_threshold']:.3f}", _signed(card["halfway"])))
    return Listing(
        columns=("threshold on the card", "error of the area per pixel [%]"),
        rows=lines,
        caption="The square card through the same chain; what it adds to every area. Height of the print over the glass"
        " included.",
    )


STUDY = Part("threshold", "Threshold, blob size, blur and crop", 10, run)
