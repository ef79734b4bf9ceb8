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

from .camera import Knee, noisy_frame
from .cases import FORM, CaseSpec
from .chain import Causes, Exposure, Nuisances, curve_of, draw_nuisances, expose, knee_of, rig_of
from .codec import FILMED, by_jpeg, by_video
from .hidden import Hidden, Rig
from .library import make_cause
from .rig import View
from .strength import OutOfReach, Ruler, amplitude_for, departure, ruler, variances

CORRELATED = {"lowpass": 0.6}
VIDEO = {"h264": 18, "h264-strong": 26}
JPEG = {"jpeg": 92}
TRIES = 6


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
    rig = rig_of(spec.set, spec.pose)
    measure = ruler(spec.set, spec.pose)
    lacking = measure.without(spec.drop, rig.views) if spec.drop else measure
    causes: list[tuple[Hidden, float]] = []
    changes: list[np.ndarray] = []
    for k, (name, strength) in enumerate(zip(spec.causes, spec.strengths, strict=True)):
        for attempt in range(TRIES):
            cause = make_cause(name, rig, spec.seed + 1000 * attempt + k, FORM[spec.set], spec.group == "decoy")
            a = amplitude_for(rig, lacking, cause, strength)
            change = departure(rig, lacking, [(cause, a)])
            if not (spec.cancelling and k) or lacking.inner(change, changes[0]) < 0:
                break
        else:
            raise OutOfReach(f"{name} takes nothing from {spec.causes[0]} in any of {TRIES} draws")
        causes.append((cause, a))
        changes.append(change)
    rng = np.random.default_rng([spec.seed, 1])
    nuisances = draw_nuisances(rng, [view.shot.index for view in rig.views if view.touches])
    together = departure(rig, lacking, causes) if causes else np.zeros_like(measure.base)
    truth = spec.as_dict() | {
        "pose": spec.pose,
        "amplitudes": [a for _, a in causes],
        "units": [c.unit for c, _ in causes],
        "strength_together": lacking.norm(together),
        "overlap": _cosine(lacking, changes) if len(changes) == 2 else None,
        "oracle_gain": oracle_gain(spec, rig, lacking, together),
    }
    return Made(rig, tuple(causes), nuisances, truth)


def _cosine(measure: Ruler, changes: Sequence[np.ndarray]) -> float:
    one, other = changes
    return measure.inner(one, other) / (measure.norm(one) * measure.norm(other))


def oracle_gain(spec: CaseSpec, rig: Rig, measure: Ruler, change: np.ndarray) -> float:
    """Return the log score that knowing the truth gains on the press frames held back, on average [nat].

    Over the believed rig as whoever does not know the truth has it: its nuisances fitted to all other frames, where
    they take what they may of the change.
    """
    held_back = measure.held_back(rig.views, variances(spec.set, spec.pose))
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
