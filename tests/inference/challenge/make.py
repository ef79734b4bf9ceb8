"""A case becomes a bundle: a folder of random name, the truth kept elsewhere."""

from __future__ import annotations

import functools
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from evanesce.bundle.folder import new_folder, write_frame, write_shots
from evanesce.rig import dump_scene

from .camera import CORRELATED, Knee, binned, noisy_frame
from .cases import CaseSpec
from .chain import Causes, Exposure, Nuisances, curve_of, draw_nuisances, expose, knee_of, rig_of
from .codec import FILMED, by_jpeg, by_video
from .consequence import consequences, noise_of_spares, unknown_left
from .hidden import Hidden, Rig
from .library import NAMED, NOT_IN_LIBRARY, make_cause
from .rig import View
from .strength import (
    OutOfReach,
    Ruler,
    amplitude_for,
    base_levels,
    departure,
    levels,
    ruler,
    strength_of,
    variances,
    within_bins,
)  # fmt: skip

VIDEO = {"h264": 18, "h264-strong": 26}
JPEG = {"jpeg": 92}
TRIES = 6
DRAWS = 4
"""Pairs of bundles from which is read what a codec leaves: its scatter is known to a quarter, from eight of them."""
CLOSE, ATTEMPTS = 0.15, 3
"""Relative error of the strength behind a codec that is left as it is, and amplitudes tried for it."""
REACHED = 0.04
"""Relative error of strengths that are drawn at random anyway."""


@dataclass(frozen=True)
class Made:
    """A case with its causes at their strengths.

    Attributes
    ----------
    rig : Rig
    causes : sequence of (Hidden, float)
    nuisances : Nuisances
    truth : dict
    """

    rig: Rig
    causes: Causes
    nuisances: Nuisances
    truth: dict[str, Any]


def prepare(spec: CaseSpec) -> Made:
    """Draw shapes and nuisances, and solve the amplitudes.

    Raises
    ------
    OutOfReach
        If a cause cannot be as strong as asked for.
    """
    rig = rig_of(spec.nominal, spec.pose)
    measure = ruler(spec.nominal, spec.pose)
    lacking = measure.without(spec.drop, rig.views) if spec.drop else measure
    rng = np.random.default_rng([spec.seed, 1])
    nuisances = draw_nuisances(rng, [view.shot.index for view in rig.views if view.touches])
    causes = _many(spec, rig, lacking) if spec.group == "rig" else _few(spec, rig, lacking)
    seen: list[float] = []
    if spec.noise in (*VIDEO, *JPEG) and causes:
        causes, seen = _behind_codec(spec, rig, lacking, causes)
    changes = [departure(rig, lacking, [pair]) for pair in causes]
    together = departure(rig, lacking, causes) if causes else np.zeros_like(measure.base)
    outside = [(c, a) for c, a in causes if c.id in NOT_IN_LIBRARY or c.id in spec.exclude]
    truth = spec.as_dict() | {
        "pose": spec.pose,
        "causes": [c.id for c, _ in causes],
        "outside": [c.id for c, _ in outside],
        "recipes": [type(c).__module__.rpartition("recipes")[1] != "" for c, _ in causes],
        "amplitudes": [a for _, a in causes],
        "units": [c.unit for c, _ in causes],
        "parameters": [c.parameter(a) for c, a in causes],
        "strengths_made": seen or [strength_of(rig, lacking, [pair], spec.noise) for pair in causes],
        "strength_together": lacking.norm(together),
        "overlap": _cosine(lacking, changes) if len(changes) == 2 else None,
        "oracle_gain": oracle_gain(spec, rig, lacking, together),
        "consequences": consequences(rig, causes, nuisances),
        "unknown_DN2": unknown_left(rig, lacking, causes, outside),
    }
    return Made(rig, tuple(causes), nuisances, truth)


def _few(spec: CaseSpec, rig: Rig, measure: Ruler) -> list[tuple[Hidden, float]]:
    """Return the causes of a case at exactly their strengths."""
    causes: list[tuple[Hidden, float]] = []
    for k, (name, strength) in enumerate(zip(spec.causes, spec.strengths, strict=True)):
        for attempt in range(TRIES):
            cause = make_cause(
                name, rig, spec.seed + 1000 * attempt + k, spec.form, spec.group == "decoy", recipe=spec.recipe(k)
            )
            a = amplitude_for(rig, measure, cause, strength, noise=spec.noise)
            if not (spec.cancelling and k):
                break
            if measure.inner(departure(rig, measure, [(cause, a)]), departure(rig, measure, causes[:1])) < 0:
                break
        else:
            raise OutOfReach(f"{name} takes nothing from {spec.causes[0]} in any of {TRIES} draws")
        causes.append((cause, a))
    return causes


def _many(spec: CaseSpec, rig: Rig, measure: Ruler) -> list[tuple[Hidden, float]]:
    """Return the causes of a rig; one that cannot be so strong is replaced by another of the same kind at random."""
    rng = np.random.default_rng([spec.seed, 4])
    causes: list[tuple[Hidden, float]] = []
    for k, (name, strength) in enumerate(zip(spec.causes, spec.strengths, strict=True)):
        kind = NOT_IN_LIBRARY if name in NOT_IN_LIBRARY else NAMED
        others = [str(o) for o in rng.permutation(sorted(set(kind) - set(spec.causes) - {c.id for c, _ in causes}))]
        for other in (name, *others):
            cause = make_cause(other, rig, spec.seed + k, spec.form, recipe=spec.recipe(k))
            try:
                causes.append((cause, amplitude_for(rig, measure, cause, strength, REACHED, spec.noise)))
            except OutOfReach:
                continue
            break
    return causes


def _behind_codec(
    spec: CaseSpec, rig: Rig, measure: Ruler, causes: list[tuple[Hidden, float]]
) -> tuple[list[tuple[Hidden, float]], list[float]]:
    """Return a single cause at its strength behind the codec, and that strength.

    Raises
    ------
    OutOfReach
        If the cause's largest amplitude is weaker than that behind the codec.
    """
    ((cause, a),) = causes
    aim = spec.strengths[0]
    tried: list[tuple[float, float]] = []
    for attempt in range(ATTEMPTS):
        found = strength_behind(rig, measure, (cause, a), spec.noise)
        if a >= 0.999 * cause.limit and found < (1 - CLOSE) * aim:
            raise OutOfReach(f"{cause.id}: {found:.2f} behind {spec.noise} at its limit, asked for {aim:g}")
        if abs(found / aim - 1) < CLOSE or attempt + 1 == ATTEMPTS:
            break
        tried.append((np.log(a), np.log(max(found, 0.1 * aim))))
        # A power of the amplitude, of the steepness that the last two show: a codec swallows small changes.
        (x, y), (x0, y0) = tried[-1], tried[0]
        steep = float(np.clip((y - y0) / (x - x0), 0.5, 4.0)) if attempt else 1.5
        a = min(float(np.exp(x + np.clip((np.log(aim) - y) / steep, -1.6, 1.6))), cause.limit)
    return [(cause, a)], [found]


@functools.lru_cache(maxsize=DRAWS)
def _without(name: str, pose: int, noise: str, seed: int) -> dict[int, list[np.ndarray]]:
    return pictures(Made(rig_of(name, pose), (), Nuisances(), {}), noise, seed)


def strength_behind(rig: Rig, measure: Ruler, pair: tuple[Hidden, float], noise: str) -> float:
    """Return the strength that a codec leaves of a cause.

    The matched filter of the change before the codec looks at pairs of drawn bundles behind it, with and without the
    cause, from the same noise: the mean difference of its outputs over their scatter. Before the codec that would be
    the strength itself, up to what the nuisances take; so it is scaled.
    """
    change = departure(rig, measure, [pair])
    left = measure.left(change)
    whole = levels(rig, [pair]) - base_levels(rig.name, rig.pose) if pair[0].mark else None

    def output(frames: dict[int, list[np.ndarray]]) -> float:
        total = 0.0
        for k, weight in enumerate(measure.weight):
            if weight.any():
                seen = np.mean(frames[k], axis=0, dtype=np.float64)
                total += float((weight * left[k] * binned(seen)).sum())
                if whole is not None:
                    total += float((weight * (binned(whole[k] * seen) - binned(whole[k]) * binned(seen))).sum())
        return total

    made = Made(rig, (pair,), Nuisances(), {})
    outputs = np.array([
        [output(_without(rig.name, rig.pose, noise, n)), output(pictures(made, noise, n))] for n in range(DRAWS)
    ])  # fmt: skip
    behind = (outputs[:, 1] - outputs[:, 0]).mean() / np.sqrt(outputs.var(axis=0, ddof=1).mean())
    inside = within_bins(rig, measure, whole, "plain") if whole is not None else 0.0
    squared = measure.inner(change, change) + inside
    before = squared / np.sqrt(float((measure.weight * left**2).sum()) + inside)
    return float(max(behind, 0.0) * np.sqrt(squared) / before)


def _cosine(measure: Ruler, changes: Sequence[np.ndarray]) -> float:
    one, other = changes
    return measure.inner(one, other) / (measure.norm(one) * measure.norm(other))


def oracle_gain(spec: CaseSpec, rig: Rig, measure: Ruler, change: np.ndarray) -> float:
    """Return the log score that knowing the truth gains on the press frames held back, on average [nat].

    Over the believed rig as whoever does not know the truth has it: its nuisances fitted to all other frames, where
    they take what they may of the change.
    """
    held_back = measure.held_back(rig.views, variances(spec.nominal, spec.pose))
    return 0.5 * held_back.norm(measure.left(change)) ** 2


def pictures(made: Made, noise: str, seed: int) -> dict[int, list[np.ndarray]]:
    """Return the frames of each view, noise and codec included, uint8."""
    rig, curve, knee = made.rig, curve_of(made.rig, made.causes), knee_of(made.causes)
    rng = np.random.default_rng([seed, 2])
    found: dict[int, list[np.ndarray]] = {}
    film: list[np.ndarray] = []
    for k, view in enumerate(rig.views):
        exposure = expose(rig, view, made.causes, made.nuisances)
        repeats = FILMED if noise in VIDEO else 1
        frames = []
        for _ in range(view.frames * repeats):
            flicker = np.exp(0.002 * rng.standard_normal()) if view.frames > 1 and view.touches else 1.0
            frames.append(_shoot(rig, exposure, flicker, curve, rng, CORRELATED.get(noise, 0.0), knee))
        if noise in VIDEO:
            film += frames
        found[k] = [by_jpeg(f, JPEG[noise]) for f in frames] if noise in JPEG else frames
    if noise in VIDEO:
        back = iter(by_video(film, VIDEO[noise]))
        found = {k: [next(back) for _ in frames][FILMED - 1 :: FILMED] for k, frames in found.items()}
    return found


def _shoot(
    rig: Rig,
    exposure: Exposure,
    flicker: float,
    curve: np.ndarray,
    rng: np.random.Generator,
    correlated: float,
    knee: Knee | None,
) -> np.ndarray:
    charge = flicker * exposure.charge_e
    return noisy_frame(rig.electronics, charge, exposure.offset_DN, curve, rng, correlated=correlated, knee=knee)


def write_case(spec: CaseSpec, folder: Path) -> tuple[Path, dict[str, Any]]:
    """Write a case as a bundle and return its path and the truth, which is not in it."""
    made = prepare(spec)
    frames = pictures(made, spec.noise, spec.seed)
    noise = noise_of_spares(made.rig, made.causes, made.nuisances, frames)
    truth = made.truth | {"unexplainable_DN2": noise + made.truth["unknown_DN2"]}
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / secrets.token_hex(8)
    with new_folder(path) as part:
        (part / "scene.toml").write_text(dump_scene(made.rig.scene), encoding="utf-8")
        (part / "measurement.toml").write_text(tomli_w.dumps({"scene": "scene.toml"}), encoding="utf-8")
        views: Sequence[View] = made.rig.views
        press = [(k, view) for k, view in enumerate(views) if view.kind == "press"]
        write_shots(part / "press.csv", [view.shot for _, view in press])
        for k, view in press:
            write_frame(part, "press", view.shot.index, frames[k][0])
        for k, view in enumerate(views):
            if view.kind == "press" or view.kind in spec.drop:
                continue
            name = "replicates" if view.kind == "replicate" else view.kind
            for number, frame in enumerate(frames[k]):
                write_frame(part, name, number, frame)
            if view.kind == "replicate":
                held = [replace(view.shot, index=n, time_s=view.shot.time_s + n / 30.0) for n in range(len(frames[k]))]
                write_shots(part / name / "replicates.csv", held)
    return path, truth
