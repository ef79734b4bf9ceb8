"""Answers that need no critic: what a score has to beat. They see the bundle and what the rig is believed to be."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from evanesce.bundle import Bundle, read_bundle

from .camera import binned
from .chain import rig_of
from .library import NAMED, make_cause
from .rig import BELIEVED, believed
from .strength import OutOfReach, Ruler, amplitude_for, means, ruler

Answer = dict[str, Any]


def largest_prior(path: Path, exclude: tuple[str, ...] = ()) -> Answer:
    """Always name what the list of causes holds most of: one cause, whatever the data."""
    return {"verdict": "named", "probabilities": {next(iter(NAMED)): 1.0}, "effects": [{"id": next(iter(NAMED))}]}


def picture_stack(bundle: Bundle) -> dict[str, list[np.ndarray]]:
    """Return binned frames by kind."""
    kinds = ("press", "replicates", "led_off", "lens_cap", "checkerboard", "square")
    return {kind: [binned(frame.astype(float)) for frame in bundle.frames(kind)] for kind in kinds}


def _residuals(path: Path) -> tuple[str, Ruler, np.ndarray, np.ndarray]:
    """Return the set's name, its ruler, residuals (views, 75, 100) against the belief, and which views are there."""
    bundle = read_bundle(path)
    name = next(n for n in BELIEVED if believed(n) == bundle.scene)
    rig, measure = rig_of(name, 0), ruler(name, 0)
    frames = picture_stack(bundle)
    press = iter(frames["press"])
    found, there = np.zeros_like(measure.base), np.zeros(len(rig.views), bool)
    for k, view in enumerate(rig.views):
        own = [next(press)] if view.kind == "press" else frames["replicates" if view.touches else view.kind]
        if own:
            found[k], there[k] = np.mean(own, axis=0) - measure.base[k], True
    return name, measure, found, there


def plain_chi_square(path: Path, exclude: tuple[str, ...] = ()) -> Answer:
    """Compare the pictures with the belief as it stands: independent noise, nothing fitted."""
    _, measure, residual, there = _residuals(path)
    weight = measure.weight[there]
    chi2, count = float((weight * residual[there] ** 2).sum()), int((weight > 0).sum())
    p = float(stats.chi2.sf(chi2, count))
    verdict = "none" if p >= 0.01 else "unknown"
    return {"global_p": p, "verdict": verdict, "probabilities": {"none": p, "unknown": 1 - p}, "effects": []}


_SIGNATURES: dict[str, dict[str, np.ndarray]] = {}


def signatures(name: str) -> dict[str, np.ndarray]:
    """Return one drawn shape of every cause at strength 10, by development's forms."""
    if name not in _SIGNATURES:
        rig, measure = rig_of(name, 0), ruler(name, 0)
        _SIGNATURES[name] = {}
        for cause in NAMED:
            hidden = make_cause(cause, rig, 5, 0)
            try:
                a = amplitude_for(rig, measure, hidden, 10.0, tolerance=0.05)
            except OutOfReach:
                continue
            _SIGNATURES[name][cause] = (means(rig, [(hidden, a)]) - measure.base).astype(np.float32)
    return _SIGNATURES[name]


def nearest_signature(path: Path, exclude: tuple[str, ...] = ()) -> Answer:
    """Name the cause whose one drawn shape is most like the residual once the nuisances are taken off."""
    name, measure, residual, there = _residuals(path)
    residual[~there] = 0.0
    cosine = {}
    for cause, change in signatures(name).items():
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
