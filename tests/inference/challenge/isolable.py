"""Which causes could be told apart at all, by the injector's own signatures.

A cause of strength s is isolable from another if no mixture of four drawn shapes of the other comes nearer to it than
3 standard deviations: s^2 sin^2 >= 9, by the whitened angle with the nuisances taken off. A library effect whose shape
can bend more than that comes nearer still, so this is an upper bound on what is isolable.
"""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np

from .chain import rig_of
from .library import NAMED, make_cause
from .rig import CACHE
from .strength import OutOfReach, Ruler, amplitude_for, departure, ruler

DRAWS = ((11, False), (12, False), (13, True), (14, True))
"""Seeds, and whether the shape is a recipe's."""
LEAST = 9.0


def table(name: str) -> dict[str, Any]:
    """Return for each cause the nearest other and the sine squared to it; computed once, kept on disk."""
    path = CACHE / f"isolable-{name}.json"
    if path.is_file():
        return dict(json.loads(path.read_text(encoding="utf-8")))
    rig, measure = rig_of(name, 0), ruler(name, 0)
    changes: dict[tuple[str, int], np.ndarray] = {}
    for cause in NAMED:
        for seed, recipe in DRAWS:
            hidden = make_cause(cause, rig, seed, 0 if name == "dev" else 1, recipe=recipe)
            try:
                a = amplitude_for(rig, measure, hidden, 10.0, tolerance=0.05)
            except OutOfReach:
                continue
            changes[cause, seed] = departure(rig, measure, [(hidden, a)]).astype(np.float32)
    found = nearest_others(measure, changes)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}")
    part.write_text(json.dumps(found, indent=1), encoding="utf-8")
    os.replace(part, path)
    return found


def nearest_others(measure: Ruler, changes: dict[tuple[str, int], np.ndarray]) -> dict[str, Any]:
    """Return for each cause the other whose shapes' span comes nearest, and the least sine squared to it."""
    keys = list(changes)
    gram = np.array([[measure.inner(changes[a], changes[b]) for b in keys] for a in keys])
    found: dict[str, Any] = {}
    for cause in NAMED:
        own = [k for k, key in enumerate(keys) if key[0] == cause]
        if not own:
            found[cause] = {"nearest": "nuisances", "sine2": 0.0}
            continue
        worst = ("", 1.0)
        for other in dict.fromkeys(key[0] for key in keys if key[0] != cause):
            span = [k for k, key in enumerate(keys) if key[0] == other]
            inverse = np.linalg.pinv(gram[np.ix_(span, span)], rcond=1e-6, hermitian=True)
            sines = [1 - float(gram[k, span] @ inverse @ gram[k, span]) / gram[k, k] for k in own]
            if min(sines) < worst[1]:
                worst = (other, max(min(sines), 0.0))
        found[cause] = {"nearest": worst[0], "sine2": worst[1]}
    return found


def isolable(known: dict[str, Any], cause: str, strength: float) -> bool:
    """Tell whether a cause of that strength could be told from every other."""
    return cause in known and strength**2 * known[cause]["sine2"] >= LEAST
