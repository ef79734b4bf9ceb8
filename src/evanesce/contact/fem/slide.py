"""Press a finger and slide it over the glass along +x (three-dimensional, the half y >= 0)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from evanesce.contact.fem.material import Rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize
from evanesce.contact.fem.mesh_half import finger_half
from evanesce.contact.fem.plane import Glass
from evanesce.contact.fem.result import SolvedRun
from evanesce.contact.fem.runs import Progress, check_friction, run_inputs, solved
from evanesce.contact.fem.state import surface_state
from evanesce.contact.fem.steps import Goal, StepSizes
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid

SLIDE_MESH = MeshSize(contact=0.55, growth=1.3, coarsest=3.0)
SLIDE_STEPS = StepSizes(largest=0.75, first=0.1, smallest=1e-3)


def slide_goals(
    force: float | None, depth: float | None, distances: Sequence[float], hold: Literal["force", "depth"]
) -> tuple[Goal, ...]:
    """Return the stages of a slide: one press, then each distance in turn.

    Raises
    ------
    InputError
        For both or neither of force and depth, or a value out of range.
    """
    if (force is None) == (depth is None):
        raise InputError("give a force or a depth to press to", key="slide", allowed="one of the two")
    wanted = force if force is not None else depth
    if wanted is None or not np.isfinite(wanted) or wanted <= 0:
        raise InputError(f"{wanted!r}", key="force" if force is not None else "depth", allowed="above 0, finite")
    if not all(np.isfinite(d) for d in distances):
        raise InputError(f"{list(distances)!r}", key="distances", allowed="finite [mm]")
    return (
        Goal("force" if force is not None else "depth", float(wanted)),
        *(Goal("slide", float(d), hold=hold) for d in distances),
    )


def slide(
    shape: FingerShape,
    material: Rubber,
    *,
    force: float | None = None,
    depth: float | None = None,
    distances: Sequence[float] = (10.0,),
    friction: float,
    hold: Literal["force", "depth"] = "force",
    size: MeshSize = SLIDE_MESH,
    sizes: StepSizes = SLIDE_STEPS,
    penalty: float | None = None,
    cache: Path | None = None,
    on_step: Progress | None = None,
) -> SolvedRun:
    """Press to a force or depth, then slide the finger's top along +x over the glass.

    Parameters
    ----------
    shape : FingerShape
    material : Rubber
    force, depth : float
        What to press to before sliding: one of the two [N] or [mm].
    distances : sequence of float
        Slides [mm], measured from the press, at each of which a step ends; backwards is allowed.
    friction : float
        Coulomb's coefficient.
    hold : {"force", "depth"}
        What stays while sliding.
    size, sizes : optional
    penalty : float, optional
        [MPa/mm]; by default 1000 shear moduli per mm (30 MPa/mm at least).
    cache, on_step : optional
        As in :func:`evanesce.contact.fem.press.press`.

    Raises
    ------
    LimitReached
        With the steps before, also in the cache.
    """
    goals = slide_goals(force, depth, distances, hold)
    stiff = penalty if penalty is not None else max(30.0, 1000.0 * material.shear_modulus)
    glass = Glass(friction=check_friction(friction), penalty=stiff, softness=0.002)
    inputs = run_inputs("slide", shape, size, material, glass, goals, sizes)
    return solved(inputs, finger_half(shape, size), material, glass, goals, sizes, cache=cache, on_step=on_step)


def slide_contact_state(
    run: SolvedRun, index: int, grid: PlateGrid, *, centre: tuple[float, float] = (0.0, 0.0), time: float = 0.0
) -> ContactState:
    """Return step ``index`` of a slide on a grid that rests with the glass; the finger sets out from ``centre``.

    Needs no finite-element library.

    Raises
    ------
    InputError
        If the contact does not fit on the grid.
    """
    state = run.history.steps[index].state
    moved = (centre[0] + state.slide, centre[1])
    return surface_state(
        grid, moved, run.footprint(index), depth=state.depth, normal_force=state.normal_force,
        tangential_force=state.tangential_force, beyond=float(run.inputs["shape"]["length"]),
        parameters={"inputs": dict(run.inputs), "step": index + 1, "slide_mm": state.slide}, time=time,
    )  # fmt: skip
