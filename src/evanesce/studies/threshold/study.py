"""Area error of the reference segmentation by threshold, blob size, blur and crop, and by rules that set it.

Lens distortion is undone without error and the pixel's area is the true one, so that the error is that of
the segmentation alone. The effect of the card's threshold on that area per pixel is a table of its own.
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
from evanesce.studies.ledger import Ledger
from evanesce.studies.registry import Progress
from evanesce.studies.scenes import Finger, check_studied, every_finger

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]

FORCES = (0.5, 1.0, 2.0, 5.0)  # [N]
QUICK_FORCES = (0.5, 5.0)  # [N]
THESIS_THRESHOLDS = (0.0375, 0.15, 0.35, 0.6)
"""Grey levels that an eye may pick from a histogram (thesis, appendix 3, which prints no level)."""

THRESHOLDS = tuple(
    sorted(
        {*THESIS_THRESHOLDS, *(round(0.025 * k, 4) for k in range(2, 13)), *(round(0.05 * k, 4) for k in range(6, 16))}
    )
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
    """Return the area of one image by several settings of the segmentation.

    Parameters
    ----------
    image : ndarray of uint8 (rows, cols)
        [DN].
    chains : sequence of Chain
    mm2_per_px : float
        Area of a pixel [mm^2].

    Returns
    -------
    list of float
        [mm^2].
    """
    return [segment(image, chain).pixels * mm2_per_px for chain in chains]


def frame_row(image: Image, truth: float, mm2_per_px: float, window: Crop) -> dict[str, Any]:
    """Return the areas of one frame by every setting of the study [mm^2].

    Parameters
    ----------
    image : ndarray of uint8 (rows, cols)
        Undistorted [DN].
    truth : float
        True area [mm^2].
    mm2_per_px : float
    window : Crop
        Around the finger.

    Returns
    -------
    dict
        True area and areas by threshold, blob size, blur and rule.
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
        "manual_whole_frame": chain_areas(image, [Chain(threshold=t) for t in THESIS_THRESHOLDS], mm2_per_px),
        "blob": chain_areas(image, [Chain(threshold=FIXED, min_blob=n) for n in BLOBS], mm2_per_px),
        "blur": chain_areas(image, [Chain(threshold=FIXED, blur=s, crop=window) for s in BLURS], mm2_per_px),
        "rules": rules,
    }


def flat_range(thresholds: Sequence[float], areas: Sequence[float], span: float = 0.02) -> tuple[float, float]:
    """Return the widest range of thresholds over which the area varies by no more than a share of its mean.

    Parameters
    ----------
    thresholds, areas : sequence of float (n,)
        Grey levels [1], ascending, and areas.
    span : float
        Share of the mean [1].

    Returns
    -------
    low, high : float
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
    """Return the smallest threshold from which on more than ``loss`` of the true area is missing; NaN if there is none.

    Parameters
    ----------
    thresholds, areas : sequence of float (n,)
        Grey levels [1], ascending, and areas.
    truth : float
        In the same unit.
    loss : float
        Share of the true area [1].

    Returns
    -------
    float
        [1].
    """
    missing = np.asarray(areas) < (1.0 - loss) * truth
    if not missing[-1]:
        return float("nan")
    return float(thresholds[len(missing) - int(np.argmin(missing[::-1])) if not missing.all() else 0])


def errors_by_setting(rows: Mapping[tuple[Finger, float], Mapping[str, Any]]) -> dict[str, Floats]:
    """Return the relative area error of each fixed threshold and each rule, over all frames.

    Parameters
    ----------
    rows : mapping
        Of :func:`frame_row`, by finger and force [N].

    Returns
    -------
    dict of str to ndarray (frames,)
        [1].
    """
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

    Parameters
    ----------
    errors : mapping of str to ndarray (frames,)
        Of :func:`errors_by_setting`.

    Returns
    -------
    list of tuple
    """
    table = [
        (name, float(np.median(np.abs(e))), float(np.sqrt((e**2).mean())), float(np.abs(e).max()))
        for name, e in errors.items()
    ]
    return sorted(table, key=lambda entry: entry[2])


def compute(
    scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1
) -> tuple[dict[tuple[Finger, float], dict[str, Any]], dict[str, Any]]:
    """Measure every finger at every force, and the square card.

    Parameters
    ----------
    scene, out, progress, quick, seed
        See :meth:`evanesce.studies.registry.Study.run`.

    Returns
    -------
    rows : dict
        Of :func:`frame_row`, by finger and force [N].
    card : dict
        Threshold on the card [1] and the relative error of the area per pixel.
    """
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
    return rows, card


def _frame(view: PerfectView, camera: FastCamera | None, force: float, seed: int) -> dict[str, Any]:
    assert camera is not None  # made whenever a row is missing
    _, state = solve_contact(camera.scene, force, seed=seed)
    assert state is not None  # a force was given
    image = view.straight(camera.press(force, seed=seed).data)
    return frame_row(image, state.nominal_contact_area, view.mm2_per_px, view.window(WINDOW_MM))


def _card(scene: Scene, view: PerfectView, out: Path, seed: int) -> dict[str, Any]:
    """Return the relative error of the area per pixel by the card's threshold."""
    path = out / "square.png"
    frame = simulate_card(scene, "square", seed=seed, **CARD_PATHS)
    write_png(path, frame.data)
    straight = view.straight(read_image(path).data)
    side = scene.card.square_side_mm

    def scale_error(chain: Chain | None) -> float:
        colour: Literal["white", "black"] = "black" if scene.card.square_inverted else "white"
        try:
            return square_scale(straight, side, chain, square=colour).mm2_per_px / view.mm2_per_px - 1.0
        except InputError:  # at this level the card is not a square
            return float("nan")

    return {
        "halfway_threshold": halfway_threshold(straight),
        "halfway": scale_error(None),
        "thresholds": CARD_THRESHOLDS,
        "scale_error": [scale_error(Chain(threshold=t)) for t in CARD_THRESHOLDS],
    }
