"""Presses and slides as runs: inputs with a digest, a cache, a checkpoint after each step, resumed after a kill."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from evanesce.contact.fem.material import Rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize, SolidMesh
from evanesce.contact.fem.newton import Model
from evanesce.contact.fem.plane import Glass
from evanesce.contact.fem.result import SolvedRun, load_run, save_run
from evanesce.contact.fem.steps import Goal, History, LimitReached, MaterialLimits, Step, StepSizes, advance
from evanesce.core.errors import InputError
from evanesce.core.provenance import digest

SOLVER = 2  # raised whenever the same inputs would give other numbers
Progress = Callable[[SolvedRun, int], None]


def cache_folder() -> Path:
    """Return the folder of solved runs: under EVANESCE_CACHE or the user's cache folder.

    Returns
    -------
    Path
    """
    return Path(os.environ.get("EVANESCE_CACHE") or platformdirs.user_cache_dir("evanesce")) / "fem"


def check_friction(value: float) -> float:
    """Return Coulomb's coefficient; refuse what is negative or not finite.

    Parameters
    ----------
    value : float

    Returns
    -------
    float
    """
    if not np.isfinite(value) or value < 0:
        raise InputError(f"{value!r}", key="friction", allowed="0 or more, finite")
    return float(value)


def run_inputs(
    kind: str,
    shape: FingerShape,
    size: MeshSize,
    material: Rubber,
    glass: Glass,
    goals: Sequence[Goal],
    sizes: StepSizes,
) -> dict[str, Any]:
    """Return all that a run depends on as JSON-able data.

    Parameters
    ----------
    kind : str
        ``"press"`` or ``"slide"``.
    shape : FingerShape
    size : MeshSize
    material : Rubber
    glass : Glass
    goals : sequence of Goal
    sizes : StepSizes

    Returns
    -------
    dict
    """
    return {
        "kind": kind,
        "solver": SOLVER,
        "shape": asdict(shape),
        "mesh": asdict(size),
        "material": material.identity(),
        "glass": asdict(glass),
        "goals": [asdict(goal) for goal in goals],
        "steps": asdict(sizes),
    }


def solved(
    inputs: dict[str, Any],
    mesh: SolidMesh,
    material: Rubber,
    glass: Glass,
    goals: Sequence[Goal],
    sizes: StepSizes,
    *,
    cache: Path | None,
    on_step: Progress | None = None,
) -> SolvedRun:
    """Return a run from the cache, resume one that was interrupted, or solve it.

    Parameters
    ----------
    inputs : dict
        From :func:`run_inputs`; their digest names the file in the cache.
    cache : Path or None
        Folder; None keeps nothing.
    on_step : callable, optional
        Called with the run so far and the index of the goal in work after each step that is solved.

    Returns
    -------
    SolvedRun

    Raises
    ------
    LimitReached
        The steps before are in ``error.run`` and in the cache.
    InputError
        Without the extra ``fem``, if there is anything left to solve.
    """
    file = None if cache is None else cache / f"{digest(inputs)}.npz"
    history, limit = History(), ""
    if file is not None and file.is_file():
        try:
            kept = load_run(file)
        except InputError:
            file.unlink()  # a file of the cache that cannot be read is worth no more than none
        else:
            history, limit = kept.history, kept.limit
    if limit:
        ended = LimitReached(limit, history)
        ended.run = SolvedRun(mesh, inputs, history, limit)
        raise ended
    if history.complete:
        return SolvedRun(mesh, inputs, history)
    from evanesce.contact.fem.felupe_adapter import Body, linear_solver

    model = Model(mesh, Body(mesh, material), glass, linear_solver())

    def keep(step: Step, _: int) -> None:
        run = SolvedRun(mesh, inputs, history)
        if file is not None:
            save_run(file, run)
        if on_step is not None:
            on_step(run, step.goal)

    limits = MaterialLimits(material.stable_stretches(), material.is_stable)
    try:
        advance(model, goals, history, sizes=sizes, limits=limits, on_step=keep)
    except LimitReached as error:
        error.run = SolvedRun(mesh, inputs, history, str(error))
        if file is not None:
            save_run(file, error.run)
        raise
    run = SolvedRun(mesh, inputs, history)
    if file is not None:
        save_run(file, run)
    return run
