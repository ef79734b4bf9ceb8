"""Press a finger straight onto the glass (axisymmetric), to forces or to depths."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evanesce.contact.fem.material import Rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize, finger_section
from evanesce.contact.fem.plane import Glass
from evanesce.contact.fem.result import SolvedRun
from evanesce.contact.fem.runs import Progress, check_friction, run_inputs, solved
from evanesce.contact.fem.state import press_state, profile_of
from evanesce.contact.fem.steps import Goal, StepSizes
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid


def press_goals(forces: Sequence[float] = (), depths: Sequence[float] = ()) -> tuple[Goal, ...]:
    """Return the stages of a press: either forces [N] or depths [mm], each above 0, in the order given.

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
    """Press a finger whose top is held against glass that comes up.

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


def press_contact_state(
    run: SolvedRun, index: int, grid: PlateGrid, *, centre: tuple[float, float] = (0.0, 0.0), time: float = 0.0
) -> ContactState:
    """Return step ``index`` of a press on a plate grid; needs no finite-element library.

    Raises
    ------
    InputError
        If the contact does not fit on the grid.
    """
    step = run.history.steps[index]
    profile = profile_of(run.footprint(index), step.state.depth, step.state.normal_force)
    parameters = {"inputs": dict(run.inputs), "step": index + 1}
    length = float(run.inputs["shape"]["length"])
    return press_state(grid, centre, profile, beyond=length, parameters=parameters, time=time)
