"""What each hidden cause does to the area that the reference segmentation reads, and what of it could be explained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evanesce.bundle.area import contact_area

from .camera import binned
from .chain import Causes, Nuisances, development, expose
from .hidden import Rig
from .strength import Ruler, means


def areas(rig: Rig, causes: Causes, nuisances: Nuisances) -> dict[float, float]:
    """Return the area in the mean frame at each force [mm^2], nominal voltage, frames that are held back left out."""
    table, found = development(rig, causes), dict[float, float]()
    for view in rig.views:
        nominal = abs(view.shot.voltage_V - rig.scene.leds.voltage_V) < 0.05
        if view.kind != "press" or view.spare or not nominal or view.shot.force_N in found:
            continue
        level = expose(rig, view, causes, nuisances).level(table)
        frame = np.floor(np.clip(level, 0, 255) + 0.5).astype(np.uint8)
        found[view.shot.force_N] = contact_area(frame, rig.scene)
    return found


def consequences(rig: Rig, causes: Causes, nuisances: Nuisances) -> list[dict[str, Any]]:
    """Return for each cause what it changes, all others there: forces [N], areas [mm^2], shares [%], largest [1]."""
    whole, found = areas(rig, causes, nuisances), []
    for k in range(len(causes)):
        less = areas(rig, [*causes[:k], *causes[k + 1 :]], nuisances)
        change = {force: whole[force] - less[force] for force in whole}
        percent = [100 * change[f] / less[f] if less[f] > 0 else None for f in whole]
        found.append({
            "force_N": list(whole), "mm2": list(change.values()), "percent": percent,
            "largest": max((abs(p) for p in percent if p is not None), default=0.0) / 100,
        })  # fmt: skip
    return found


def unknown_left(rig: Rig, measure: Ruler, causes: Causes, unknown: Causes) -> float:
    """Return the mean square in the frames held back of what unknown ones of the causes change [DN^2 of a bin].

    Nuisances are fitted to all other frames. It is what no cause of a library takes.
    """
    spare = [k for k, view in enumerate(rig.views) if view.spare]
    known = [pair for pair in causes if pair not in unknown]
    own = measure.left(means(rig, causes) - means(rig, known)) if unknown else np.zeros_like(measure.base)
    return float((own[spare] ** 2).mean())


def noise_of_spares(
    rig: Rig, causes: Causes, nuisances: Nuisances, frames: Mapping[int, Sequence[np.ndarray]]
) -> float:
    """Return the mean square of noise in the frames held back [DN^2 of a bin], a codec's included.

    Near black causes change how loud noise is, so that it is read off the frames themselves.
    """
    table, found = development(rig, causes), []
    for k, view in enumerate(rig.views):
        if view.spare:
            mean = binned(expose(rig, view, causes, nuisances).level(table))
            found += [float(((binned(np.asarray(frame, float)) - mean) ** 2).mean()) for frame in frames[k]]
    return float(np.mean(found))
