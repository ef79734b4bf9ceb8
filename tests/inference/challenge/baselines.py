"""What a score has to beat: matched filters and localised tests, which know nominal rig and injector's nuisances.

After Anau Montel, Alvey and Weniger, Phys. Rev. D 111 (2025) 083013: a bank of distortions, one test of each, beside
tests of each place by itself; the largest of all is compared with its own distribution over null draws, which gives one
global p. The bank holds one drawn shape of each cause, of the families and of the recipes. It is let off lightly: it
knows the few poses at which a finger is ever put down.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage, special

from evanesce.bundle import Bundle, read_bundle

from .camera import binned
from .chain import Nuisances, rig_of
from .library import NAMED, make_cause
from .rig import BELIEVED, CACHE, POSES, believed
from .strength import OutOfReach, Ruler, amplitude_for, departure, means, ruler

Answer = dict[str, Any]
KINDS = ("press", "replicates", "led_off", "lens_cap", "checkerboard", "square")
DRAWS = 400
PATCH = 3
"""Side of a localised test [bins]."""
ROUNDS = 3
STRENGTH = 10.0


def _frames(bundle: Bundle) -> dict[str, list[np.ndarray]]:
    return {kind: [binned(frame.astype(float)) for frame in bundle.frames(kind)] for kind in KINDS}


def _residual(name: str, pose: int, frames: dict[str, list[np.ndarray]]) -> tuple[Ruler, np.ndarray, tuple[str, ...]]:
    """Return ruler of what there is, residual with light, offset and targets' light fitted, and kinds that lack."""
    rig, press = rig_of(name, pose), iter(frames["press"])
    found, lacking = np.zeros_like(ruler(name, pose).base), []
    for k, view in enumerate(rig.views):
        own = [next(press)] if view.kind == "press" else frames["replicates" if view.touches else view.kind]
        if own:
            found[k] = np.mean(own, axis=0)
        else:
            lacking.append(view.kind)
    measure = ruler(name, pose).without(lacking, rig.views)
    log_light = card_light = black = 0.0
    slope, residual = [0.0, 0.0], found - measure.base
    for _ in range(ROUNDS):
        log_light += measure.nuisance("light", residual)
        black += measure.nuisance("black", residual)
        names = [n for n in measure.names if n.startswith(("card_light", "slope_x", "slope_y"))]
        fitted = {n.partition("[")[0]: measure.nuisance(n, residual) for n in names}
        card_light += fitted.get("card_light", 0.0)
        slope = [slope[i] + fitted.get(f"slope_{c}", 0.0) for i, c in enumerate("xy")]
        now = Nuisances(log_light=log_light, black_DN=black, card_light=card_light, card_slope=(slope[0], slope[1]))
        residual = found - means(rig, (), now)
    return measure, residual, tuple(lacking)


@functools.lru_cache(maxsize=1)
def bank(name: str, pose: int) -> dict[str, np.ndarray]:
    """Return the bank's shapes, "cause/kind" to float32 (views, bin rows, bin cols); made once, kept on disk."""
    path = CACHE / "bank" / f"{name}-{pose}.npz"
    if not path.is_file():
        rig, measure, found = rig_of(name, pose), ruler(name, pose), {}
        for cause in NAMED:
            for recipe in (False, True):
                hidden = make_cause(cause, rig, 5, 0, recipe=recipe)
                try:
                    a = amplitude_for(rig, measure, hidden, STRENGTH, tolerance=0.05)
                except OutOfReach:
                    continue
                key = f"{cause}/{'recipe' if recipe else 'family'}"
                found[key] = departure(rig, measure, [(hidden, a)]).astype(np.float32)
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}.npz")
        np.savez(part, **found)
        os.replace(part, path)
    with np.load(path) as kept:
        return {key: kept[key] for key in kept.files}


def _localised(measure: Ruler, left: np.ndarray) -> float:
    """Return the largest standardised sum over a patch of bins of one view."""
    whitened = left * np.sqrt(measure.weight)
    return float(np.abs(ndimage.uniform_filter(whitened, (1, PATCH, PATCH), mode="constant")).max() * PATCH)


@functools.lru_cache(maxsize=3)
def _tests(name: str, pose: int, lacking: tuple[str, ...]) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray]:
    """Return the bank's names, its filters (tests, data), and the largest of each kind of test over null draws."""
    measure = ruler(name, pose).without(lacking, rig_of(name, pose).views)
    names, filters = [], []
    for key, change in bank(name, pose).items():
        norm = measure.norm(change)
        if norm > 1e-3:
            names.append(key)
            filters.append((measure.weight * measure.left(change) / norm).ravel().astype(np.float32))
    stacked, rng = np.array(filters), np.random.default_rng([9, pose])
    deviation = np.where(measure.weight > 0, 1 / np.sqrt(np.where(measure.weight > 0, measure.weight, 1.0)), 0.0)
    nulls = np.zeros((2, DRAWS))
    for n in range(DRAWS):
        noise = deviation * rng.standard_normal(measure.base.shape, dtype=np.float32)
        nulls[:, n] = np.abs(stacked @ noise.ravel()).max(), _localised(measure, measure.left(noise))
    return names, stacked, nulls[0], nulls[1]


def matched_filters(path: Path, exclude: tuple[str, ...] = ()) -> Answer:
    """Answer by the most significant of all tests; ``unknown`` where it is one of a place."""
    bundle = read_bundle(path)
    name, frames = next(n for n in BELIEVED if believed(n) == bundle.scene), _frames(bundle)
    every = [(pose, *_residual(name, pose, frames)) for pose in range(POSES)]
    pose, measure, residual, lacking = min(every, key=lambda e: e[1].norm(e[2]))
    names, filters, null_bank, null_place = _tests(name, pose, lacking)
    outputs = np.abs(filters @ residual.ravel().astype(np.float32))
    here = np.array([n.partition("/")[0] not in exclude for n in names])
    outputs, names = outputs[here], [n.partition("/")[0] for n, one in zip(names, here, strict=True) if one]
    place = _localised(measure, measure.left(residual))
    # Each kind of test by its own null; the smaller p of the two, by the null of that.
    p_bank, p_place = ((1 + int((null >= value).sum())) / (1 + DRAWS)
                       for null, value in ((null_bank, outputs.max()), (null_place, place)))  # fmt: skip
    p = min(1.0, 2 * min(p_bank, p_place))
    log = {cause: 0.5 * max(o for n, o in zip(names, outputs, strict=True) if n == cause) ** 2 for cause in names}
    share = special.softmax(list(log.values()))
    inclusion = {n: float((1 - p) * s) for n, s in zip(log, share, strict=True)}
    best = max(inclusion, key=lambda n: inclusion[n])
    verdict = "none" if p >= 0.01 else "unknown" if place > outputs.max() else "causes"
    causes = [{"id": best, "probability": inclusion[best], "credible_set": [best], "misfit_share": 1.0}]
    return {
        "verdict": verdict, "global_p": p, "causes": causes if verdict == "causes" else [],
        "posterior": {"inclusion": inclusion},
    }  # fmt: skip


BASELINES: dict[str, Callable[..., Answer]] = {"matched-filters": matched_filters}
