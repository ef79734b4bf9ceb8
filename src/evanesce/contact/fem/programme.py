"""Loading programmes of a finger on glass: press to forces or depths; press, then slide.

Both are a sequence of goals (:class:`~evanesce.contact.fem.steps.Goal`) for the same solver
(:func:`~evanesce.contact.fem.runs.solved`). A press is axisymmetric; a slide along +x is three-dimensional, its mesh
the half y >= 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from evanesce.contact.fem.material import Rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize, finger_section
from evanesce.contact.fem.mesh_half import finger_half
from evanesce.contact.fem.plane import Glass
from evanesce.contact.fem.result import SolvedRun
from evanesce.contact.fem.runs import Progress, check_friction, run_inputs, solved
from evanesce.contact.fem.state import press_state, profile_of, surface_state
from evanesce.contact.fem.steps import Goal, StepSizes
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid

SLIDE_MESH = MeshSize(contact=0.55, growth=1.3, coarsest=3.0)
SLIDE_STEPS = StepSizes(largest=0.75, first=0.1, smallest=1e-3)


def press_goals(forces: Sequence[float] = (), depths: Sequence[float] = ()) -> tuple[Goal, ...]:
    """Return the goals of a press.

    Parameters
    ----------
    forces, depths : sequence of float
        Normal forces [N] or depths [mm], one of the two, each above 0, in the order in which they are reached.

    Returns
    -------
    tuple of Goal

    Raises
    ------
    InputError
        For both, neither, or a value that is not positive and finite.
    """
    if bool(len(forces)) == bool(len(depths)):
        raise InputError("give forces or depths", key="press", allowed="one of the two")
    values, key, unit = (forces, "force", "N") if len(forces) else (depths, "depth", "mm")
    for value in values:
        if not np.isfinite(value) or value <= 0:
            raise InputError(f"{value!r}", key=key, allowed=f"above 0, finite [{unit}]")
    return tuple(Goal("force" if len(forces) else "depth", float(value)) for value in values)


def slide_goals(
    force: float | None, depth: float | None, distances: Sequence[float], hold: Literal["force", "depth"]
) -> tuple[Goal, ...]:
    """Return the goals of a slide: one press, then each distance in turn.

    Parameters
    ----------
    force, depth : float or None
        What to press to: one of the two [N] or [mm], above 0.
    distances : sequence of float
        Slides from the press [mm].
    hold : {"force", "depth"}
        What is kept while sliding.

    Returns
    -------
    tuple of Goal

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


def press(
    shape: FingerShape,
    material: Rubber,
    *,
    forces: Sequence[float] = (),
    depths: Sequence[float] = (),
    friction: float = 0.0,
    size: MeshSize | None = None,
    sizes: StepSizes | None = None,
    penalty: float | None = None,
    cache: Path | None = None,
    on_step: Progress | None = None,
) -> SolvedRun:
    """Press a finger whose top is held against glass that comes up (axisymmetric).

    Parameters
    ----------
    shape : FingerShape
    material : Rubber
    forces, depths : sequence of float
        Normal forces [N], or depths [mm], at each of which a step ends.
    friction : float
        Coulomb's coefficient between skin and glass.
    size : MeshSize, optional
        0.12 mm at the contact unless given.
    sizes : StepSizes, optional
    penalty : float, optional
        [MPa/mm]; by default 5000 shear moduli per mm (50 MPa/mm at least), below 0.5 % of a usual element's size.
    cache : Path, optional
        Folder in which the run is kept and found again.
    on_step : callable, optional
        Called with the run so far and the goal's index after each step.

    Returns
    -------
    SolvedRun
        ``run.reached()`` are the steps at which a force or depth was reached.

    Raises
    ------
    LimitReached
        The material or the step control came to its end; the steps before are kept.
    """
    goals = press_goals(forces, depths)
    size, sizes = size or MeshSize(), sizes or StepSizes()
    stiff = penalty if penalty is not None else max(50.0, 5000.0 * material.shear_modulus)
    glass = Glass(friction=check_friction(friction), penalty=stiff)
    inputs = run_inputs("press", shape, size, material, glass, goals, sizes)
    mesh = finger_section(shape, size)
    return solved(inputs, mesh, material, glass, goals, sizes, cache=cache, on_step=on_step)


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
    """Press to a force or depth, then slide the finger's top along +x over the glass (three-dimensional).

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
        What is kept while sliding.
    size, sizes : optional
    penalty : float, optional
        [MPa/mm]; by default 1000 shear moduli per mm (30 MPa/mm at least).
    cache, on_step : optional
        As in :func:`press`.

    Returns
    -------
    SolvedRun

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


def run_state(
    run: SolvedRun, index: int, grid: PlateGrid, *, centre: tuple[float, float] = (0.0, 0.0), time: float = 0.0
) -> ContactState:
    """Sample one step of a press or slide on a grid that rests with the glass; needs no finite-element library.

    Parameters
    ----------
    run : SolvedRun
    index : int
        Step, from 0; negative from the end.
    grid : PlateGrid
    centre : tuple of float
        Plate point (x, y) under the finger's axis before a slide [mm].
    time : float
        [s].

    Returns
    -------
    ContactState
        Of a slide, the finger has moved by ``parameters["slide_mm"]`` along +x.

    Raises
    ------
    InputError
        If the contact does not fit on the grid.
    """
    state, print_ = run.history.steps[index].state, run.footprint(index)
    parameters = {"inputs": dict(run.inputs), "step": index + 1}
    length = float(run.inputs["shape"]["length"])
    if run.mesh.dim == 2:
        profile = profile_of(print_, state.depth, state.normal_force)
        return press_state(grid, centre, profile, beyond=length, parameters=parameters, time=time)
    return surface_state(
        grid, (centre[0] + state.slide, centre[1]), print_, depth=state.depth, normal_force=state.normal_force,
        tangential_force=state.tangential_force, beyond=length,
        parameters=parameters | {"slide_mm": state.slide}, time=time,
    )  # fmt: skip
