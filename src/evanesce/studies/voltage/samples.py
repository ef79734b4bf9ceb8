"""Areas of all samples of the unknowns, computed by the reduced rig and kept in a file."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.provenance import digest
from evanesce.rig import Scene
from evanesce.studies.voltage.reduced_rig import ReducedRig
from evanesce.studies.voltage.unknowns import (
    GRID_MM,
    GRID_SAMPLES,
    RATIOS,
    SHAPING,
    THRESHOLDS,
    UNKNOWNS,
    Plan,
    Samples,
)


def run_samples(
    scene: Scene, plan: Plan, *, keep: Path | None = None, tick: Callable[[int, int], None] = lambda done, total: None
) -> Samples:
    """Compute all samples.

    Parameters
    ----------
    scene : Scene
        Ridged; ``UNKNOWNS`` take the place of its own figures, effects are left out.
    plan : Plan
    keep : Path, optional
        File in which finished samples are kept, and from which an interrupted run goes on.
    tick : callable
        ``tick(done, total)`` samples.

    Returns
    -------
    Samples

    Raises
    ------
    InputError
        If the scene has no ridges, or LEDs of different voltages.
    """
    shares = plan.shares()
    values = np.stack([u.value(shares[:, k]) for k, u in enumerate(UNKNOWNS)], axis=1)
    total, forces = len(values), len(plan.forces)
    key = digest(
        [scene.as_dict(), values.tolist(), plan.forces, plan.voltages, THRESHOLDS, RATIOS, GRID_MM, GRID_SAMPLES]
    )
    shape = (total, forces, len(plan.voltages), len(THRESHOLDS) + 1)
    found = _resume(keep, key, shape)
    areas, done = found["areas"], found["done"]
    rig = ReducedRig(scene, plan) if not done.all() else None
    _, group = np.unique(values[:, :SHAPING], axis=0, return_inverse=True)
    for number in range(int(group.max()) + 1):
        members = np.flatnonzero((group.ravel() == number) & ~done)
        if rig is None or not members.size:
            continue
        lit = rig.light(values[members[0]])
        found["truth"][members], found["by_ratio"][members] = lit.true_area, lit.by_ratio
        found["opened"][members] = lit.open_middle
        for row in members:
            areas[row] = rig.areas(lit.images, values[row])
        done[members] = True
        tick(int(done.sum()), total)
        if keep is not None and number % 16 == 15:
            _keep(keep, key, found)
    if keep is not None:
        _keep(keep, key, found)
    return Samples(
        plan, values, found["truth"], areas[..., -1], areas[..., :-1], found["by_ratio"], found["opened"]
    )  # fmt: skip


def _resume(keep: Path | None, key: str, shape: tuple[int, int, int, int]) -> dict[str, NDArray[Any]]:
    empty: dict[str, NDArray[Any]] = {
        "areas": np.zeros(shape),
        "truth": np.zeros(shape[:2]),
        "by_ratio": np.zeros((*shape[:2], len(RATIOS))),
        "opened": np.zeros(shape[:2], bool),
        "done": np.zeros(shape[0], bool),
    }
    if keep is None or not keep.is_file():
        return empty
    try:
        with np.load(keep, allow_pickle=False) as data:
            same = str(data["key"]) == key
            found = {name: np.array(data[name]) for name in empty}
    except (OSError, ValueError, KeyError, EOFError):
        return empty
    fits = all(found[name].shape == empty[name].shape and found[name].dtype == empty[name].dtype for name in empty)
    return found if same and fits else empty


def _keep(path: Path, key: str, found: dict[str, NDArray[Any]]) -> None:
    handle, part = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as stream:
            np.savez_compressed(stream, key=np.array(key), **found)  # type: ignore[arg-type]
        os.replace(part, path)
    except BaseException:
        Path(part).unlink(missing_ok=True)
        raise
