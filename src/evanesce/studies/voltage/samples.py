"""Areas of all samples of the unknowns, computed by the reduced rig and kept in a file."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.provenance import digest
from evanesce.rig import Scene
from evanesce.studies.voltage.colour_rig import OTHERS, SAMPLED, ColourRig
from evanesce.studies.voltage.colour_unknowns import SETTINGS
from evanesce.studies.voltage.reduced_rig import LitPresses, ReducedRig
from evanesce.studies.voltage.unknowns import (
    GRID_MM,
    GRID_SAMPLES,
    RATIOS,
    SHAPING,
    THRESHOLD,
    THRESHOLDS,
    Plan,
    Samples,
    independent_rows,
)


def run_samples(
    scene: Scene, plan: Plan, *, keep: Path | None = None, tick: Callable[[int, int], None] = lambda done, total: None
) -> Samples:
    """Compute all samples.

    Parameters
    ----------
    scene : Scene
        Ridged; the plan's unknowns take the place of its own figures, effects are left out.
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
    values = np.stack([u.value(shares[:, k]) for k, u in enumerate(plan.unknowns)], axis=1)
    total, forces, colour = len(values), len(plan.forces), scene.camera.colour is not None
    settings: list[Any] = [THRESHOLDS, RATIOS, GRID_MM, GRID_SAMPLES]
    if colour:
        settings += [SETTINGS, [asdict(reading) for reading in OTHERS]]
    key = digest([scene.as_dict(), values.tolist(), plan.forces, plan.voltages, *settings])
    empty = _empty((total, forces, len(plan.voltages), len(THRESHOLDS) + 1), len(OTHERS) if colour else 0)
    found = _resume(keep, key, empty)
    independent = set(independent_rows(total, len(plan.unknowns)).tolist())
    done = found["done"]
    rig = None if done.all() else (ColourRig(scene, plan) if colour else ReducedRig(scene, plan))
    _, group = np.unique(values[:, :SHAPING], axis=0, return_inverse=True)
    for number in range(int(group.max()) + 1):
        members = np.flatnonzero((group.ravel() == number) & ~done)
        if rig is None or not members.size:
            continue
        lit = rig.light(values[members[0]])
        found["truth"][members], found["by_ratio"][members] = lit.true_area, lit.by_ratio
        found["opened"][members] = lit.open_middle
        if isinstance(rig, ColourRig):
            _in_colour(rig, lit, values, members, independent, found)
        else:
            for row in members:
                found["areas"][row] = rig.areas(lit, values[row])
        done[members] = True
        tick(int(done.sum()), total)
        if keep is not None and number % 16 == 15:
            _keep(keep, key, found)
    if keep is not None:
        _keep(keep, key, found)
    areas = found["areas"]
    plain = Samples(plan, values, found["truth"], areas[..., -1], areas[..., :-1], found["by_ratio"], found["opened"])
    if not colour:
        return plain
    other = dict(zip((reading.name for reading in OTHERS), found["other"], strict=True))
    return replace(plain, contact=found["contact"], other=other)


def _in_colour(
    rig: ColourRig, lit: LitPresses, values: NDArray[np.float64], members: NDArray[np.intp], independent: set[int],
    found: dict[str, NDArray[Any]],
) -> None:  # fmt: skip
    """Fill in the rows of one finger: as sampled at every threshold, otherwise at their own."""
    lights = rig.lights(lit)
    for row in members:
        own = float(values[row, THRESHOLD])
        found["areas"][row], found["contact"][row] = rig.read(lights, values[row], SAMPLED, (*THRESHOLDS, own))
        found["by_ratio"][row] = rig.by_ratio(lights, values[row])
        if int(row) in independent:
            for k, reading in enumerate(OTHERS):
                found["other"][k, row] = rig.read(lights, values[row], reading, (own,))[0][..., 0]


def _empty(shape: tuple[int, int, int, int], readings: int) -> dict[str, NDArray[Any]]:
    """Return arrays for the samples, with other readings than the sampled one where there are any."""
    empty: dict[str, NDArray[Any]] = {
        "areas": np.zeros(shape),
        "truth": np.zeros(shape[:2]),
        "by_ratio": np.zeros((*shape[:2], len(RATIOS))),
        "opened": np.zeros(shape[:2], bool),
        "done": np.zeros(shape[0], bool),
    }
    if readings:
        empty |= {"contact": np.zeros(shape[:3]), "other": np.zeros((readings, *shape[:3]))}
    return empty


def _resume(keep: Path | None, key: str, empty: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
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
