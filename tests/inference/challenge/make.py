"""A case becomes a bundle: a folder of random name, the truth kept elsewhere."""

from __future__ import annotations

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
from .consequence import consequences, unexplainable
from .hidden import Hidden, Rig
from .library import NAMED, NOT_IN_LIBRARY, make_cause
from .rig import View
from .strength import OutOfReach, Ruler, amplitude_for, base_levels, departure, levels, ruler, strength_of, variances

VIDEO = {"h264": 18, "h264-strong": 26}
JPEG = {"jpeg": 92}
TRIES = 6
DRAWS = 5
"""Pairs of bundles from which is read what a codec leaves: its scatter is known to a quarter, from ten of them."""
CLOSE = 0.15
"""Relative error of the strength behind a codec that is left as it is."""
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
    variance = variances(spec.nominal, spec.pose)
    outside = [(c, a) for c, a in causes if c.id in NOT_IN_LIBRARY or c.id in spec.exclude]
    truth = spec.as_dict() | {
        "pose": spec.pose,
        "causes": [c.id for c, _ in causes],
        "recipes": [type(c).__module__.rpartition("recipes")[1] != "" for c, _ in causes],
        "amplitudes": [a for _, a in causes],
        "units": [c.unit for c, _ in causes],
        "parameters": [c.parameter(a) for c, a in causes],
        "strengths_made": seen or [strength_of(rig, lacking, [pair], spec.noise) for pair in causes],
        "strength_together": lacking.norm(together),
        "overlap": _cosine(lacking, changes) if len(changes) == 2 else None,
        "oracle_gain": oracle_gain(spec, rig, lacking, together),
        "consequences": consequences(rig, causes, nuisances),
        "unexplainable_DN2": unexplainable(rig, lacking, causes, outside, variance),
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
    for attempt in range(3):
        found = strength_behind(rig, measure, (cause, a), spec.noise, spec.seed + 7 * attempt)
        if abs(found / aim - 1) < CLOSE:
            break
        if a >= 0.999 * cause.limit and found < aim:
            raise OutOfReach(f"{cause.id}: {found:.2f} behind {spec.noise} at its limit, asked for {aim:g}")
        if attempt < 2:
            a = min(a * float(np.clip(aim / max(found, 0.1 * aim), 0.2, 4.0)), cause.limit)
    return [(cause, a)], [found]


def strength_behind(rig: Rig, measure: Ruler, pair: tuple[Hidden, float], noise: str, seed: int) -> float:
    """Return the strength that a codec leaves of a cause.

    The matched filter of the change before the codec looks at pairs of drawn bundles, with and without the cause, from
    the same noise. The mean difference of its outputs over their scatter, behind the codec over before it, is what the
    codec leaves of the strength.
    """
    cause, _ = pair
    made = [Made(rig, causes, Nuisances(), {}) for causes in ((pair,), ())]
    binned_filter = measure.weight * measure.left(departure(rig, measure, [pair]))
    whole = levels(rig, [pair]) - base_levels(rig.name, rig.pose) if cause.mark else None
    outputs = np.zeros((2, DRAWS, 2))
    for n in range(DRAWS):
        for with_cause, one in enumerate(reversed(made)):
            for coded, kind in enumerate(("plain", noise)):
                frames = pictures(one, kind, seed + n)
                for k in range(len(rig.views)):
                    if not measure.weight[k].any():
                        continue
                    seen = np.mean(frames[k], axis=0, dtype=np.float64)
                    outputs[coded, n, with_cause] += float((binned_filter[k] * binned(seen)).sum())
                    if whole is not None:
                        inside = binned(whole[k] * seen) - binned(whole[k]) * binned(seen)
                        outputs[coded, n, with_cause] += float((measure.weight[k] * inside).sum())
    shift = (outputs[:, :, 1] - outputs[:, :, 0]).mean(axis=1)
    scatter = np.sqrt(outputs.var(axis=1, ddof=1).mean(axis=1))
    left = (shift[1] / scatter[1]) / (shift[0] / scatter[0])
    return float(max(left, 0.0) * strength_of(rig, measure, [pair]))


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
    return path, made.truth
