"""Answers that need no critic: what a score has to beat. They see the bundle and what the rig is believed to be."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from evanesce.bundle import Bundle, read_bundle

from .camera import binned
from .chain import rig_of
from .library import NAMED, make_cause
from .rig import BELIEVED, POSES, believed
from .strength import OutOfReach, Ruler, amplitude_for, departure, ruler

Answer = dict[str, Any]


def largest_prior(path: Path, exclude: tuple[str, ...] = ()) -> Answer:
    """Always say what is likeliest before any data: nothing is hidden."""
    return {"verdict": "none", "probabilities": {"none": 1.0}, "effects": []}


def picture_stack(bundle: Bundle) -> dict[str, list[np.ndarray]]:
    """Return binned frames by kind."""
    kinds = ("press", "replicates", "led_off", "lens_cap", "checkerboard", "square")
    return {kind: [binned(frame.astype(float)) for frame in bundle.frames(kind)] for kind in kinds}


def _residuals(path: Path) -> tuple[str, int, Ruler, np.ndarray, np.ndarray]:
    """Return set, pose, ruler, residuals (views, 75, 100) against the belief there, and which views are there.

    Of the few poses at which a finger is ever put down, the one that leaves least: nuisances are straight lines here.
    """
    bundle = read_bundle(path)
    name = next(n for n in BELIEVED if believed(n) == bundle.scene)
    frames = picture_stack(bundle)
    poses = []
    for pose in range(POSES):
        rig, measure = rig_of(name, pose), ruler(name, pose)
        press = iter(frames["press"])
        found, there = np.zeros_like(measure.base), np.zeros(len(rig.views), bool)
        for k, view in enumerate(rig.views):
            own = [next(press)] if view.kind == "press" else frames["replicates" if view.touches else view.kind]
            if own:
                found[k], there[k] = np.mean(own, axis=0) - measure.base[k], True
        poses.append((measure.norm(found), pose, measure, found, there))
    _, pose, measure, found, there = min(poses, key=lambda entry: entry[0])
    return name, pose, measure, found, there


def plain_chi_square(path: Path, exclude: tuple[str, ...] = ()) -> Answer:
    """Compare the pictures with the belief as it stands: independent noise, nothing fitted."""
    _, _, measure, residual, there = _residuals(path)
    weight = measure.weight[there]
    chi2, count = float((weight * residual[there] ** 2).sum()), int((weight > 0).sum())
    p = float(stats.chi2.sf(chi2, count))
    verdict = "none" if p >= 0.01 else "unknown"
    return {"global_p": p, "verdict": verdict, "probabilities": {"none": p, "unknown": 1 - p}, "effects": []}


@functools.lru_cache(maxsize=8)
def signatures(name: str, pose: int) -> dict[str, np.ndarray]:
    """Return one drawn shape of every cause at strength 10, by development's forms."""
    rig, measure = rig_of(name, pose), ruler(name, pose)
    found = {}
    for cause in NAMED:
        hidden = make_cause(cause, rig, 5, 0)
        try:
            a = amplitude_for(rig, measure, hidden, 10.0, tolerance=0.05)
        except OutOfReach:
            continue
        found[cause] = departure(rig, measure, [(hidden, a)]).astype(np.float32)
    return found


def nearest_signature(path: Path, exclude: tuple[str, ...] = ()) -> Answer:
    """Name the cause whose one drawn shape is most like the residual once the nuisances are taken off."""
    name, pose, measure, residual, there = _residuals(path)
    residual[~there] = 0.0
    cosine = {}
    for cause, change in signatures(name, pose).items():
        own = np.where(there[:, None, None], change, 0.0)
        size = measure.norm(own)
        cosine[cause] = abs(measure.inner(own, residual)) / size if size > 0 else 0.0
    best = max(cosine, key=lambda k: cosine[k])
    weights = {k: float(np.exp(v - cosine[best])) for k, v in cosine.items()}
    shares = {k: weight / sum(weights.values()) for k, weight in weights.items()}
    return {"verdict": "named", "probabilities": shares, "effects": [{"id": best}]}


BASELINES: dict[str, Callable[[Path], Answer]] = {
    "largest-prior": largest_prior,
    "chi-square": plain_chi_square,
    "nearest-signature": nearest_signature,
}
