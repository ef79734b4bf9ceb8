"""Step control: from goal to goal, halve a step that fails, let it grow again, keep every accepted step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.fem.descent import descended
from evanesce.contact.fem.newton import Equilibrium, Model, StepFailed, Target, equilibrium, extrapolated
from evanesce.core.errors import InputError, WorkError

Floats = NDArray[np.float64]


class Solver(Protocol):
    """Solves one step from the last accepted one, or raises StepFailed."""

    def __call__(
        self, model: Model, before: Equilibrium, target: Target, *, guess: Equilibrium | None = None
    ) -> Equilibrium:
        """Return the next state."""


APPROACH = (
    0.93  # of the force wanted that is reached by depth; from there on the glass is free and the force prescribed
)
FORCE_RATIO = 1.35  # largest change of force in one force-controlled step
DESCENT_AFTER = 2  # times that a step of a slide is halved before its equilibrium is sought by descent of energy too
TAKEN_BACK = 3  # steps undone and repeated with half their size before a run that fails ends


@dataclass(frozen=True)
class Goal:
    """One stage of a programme.

    Attributes
    ----------
    kind : {"depth", "force", "slide"}
        What is to reach ``value`` [mm, N, mm]. Depth and force keep the slide.
    value : float
    hold : {"force", "depth"}
        What is kept while sliding.
    """

    kind: Literal["depth", "force", "slide"]
    value: float
    hold: Literal["force", "depth"] = "force"


@dataclass(frozen=True)
class StepSizes:
    """Sizes of the steps of depth or slide.

    Attributes
    ----------
    largest, first, smallest : float
        [mm].
    growth : float
        Factor on a step after success.
    """

    largest: float = 0.3
    first: float = 0.02
    smallest: float = 2e-4
    growth: float = 1.5

    def __post_init__(self) -> None:
        if not 0 < self.smallest < self.largest:
            raise InputError(f"{self.smallest:g} to {self.largest:g} mm", key="steps", allowed="0 < smallest < largest")


@dataclass(frozen=True)
class MaterialLimits:
    """Range of stretches in which a material is solved.

    Attributes
    ----------
    range : tuple of float
        Smallest and largest principal stretch kept.
    is_stable : callable
        Principal stretches (n, 3) -> bool (n,).
    """

    range: tuple[float, float]
    is_stable: Callable[[Floats], NDArray[np.bool_]]


@dataclass(frozen=True)
class Step:
    """One accepted step.

    Attributes
    ----------
    state : Equilibrium
    stretch_min, stretch_max : float
        Principal stretches over all integration points.
    goal : int
        Index of the goal in work.
    reached : bool
        Whether the step ends that goal.
    next_size : float
        Step size to go on with [mm].
    """

    state: Equilibrium
    stretch_min: float
    stretch_max: float
    goal: int
    reached: bool
    next_size: float


@dataclass
class History:
    """Accepted steps of a run.

    Attributes
    ----------
    steps : list of Step
    complete : bool
        Whether the last goal is reached.
    """

    steps: list[Step] = field(default_factory=list)
    complete: bool = False


class LimitReached(WorkError):
    """The material or a step left the range in which it can be solved.

    Attributes
    ----------
    history : History
        The steps before.
    run : SolvedRun or None
        The same as a run, where one was being made.
    """

    def __init__(self, what: str, history: History) -> None:
        super().__init__(what)
        self.history = history
        self.run: Any = None


def advance(
    model: Model,
    goals: Sequence[Goal],
    history: History,
    *,
    sizes: StepSizes,
    limits: MaterialLimits,
    on_step: Callable[[Step, int], None] | None = None,
) -> History:
    """Solve the goals from the end of ``history`` on, and return it completed.

    Parameters
    ----------
    model : Model
    goals : sequence of Goal
    history : History
        Empty, or that of an interrupted run; it is extended in place.
    sizes : StepSizes
    limits : MaterialLimits
        Of the material: a step that leaves its range of stretches is not kept.
    on_step : callable, optional
        Called with each accepted step and its number (from 1).

    Returns
    -------
    History

    Raises
    ------
    LimitReached
        If a step leaves the range of stretches, or fails at the smallest size also after the steps before it were
        taken smaller.
    """
    start = model.start()
    furthest: list[Step] = []
    undone, size = 0, None
    while not history.complete:
        last = history.steps[-1] if history.steps else None
        goal_index = 0 if last is None else last.goal + int(last.reached)
        if goal_index >= len(goals):
            history.complete = True
            break
        if size is None:
            size = sizes.first if last is None or (last.reached and _turns(goals, goal_index)) else last.next_size
        before = history.steps[-2].state if len(history.steps) > 1 else start
        origin = last.state if last else start
        try:
            step = _one_step(model, goals, goal_index, origin, before, size, sizes, limits, history)
        except LimitReached:
            # where a node flickers between touching and not, no step out of a state converges, however small; a state
            # reached by smaller steps lets go
            if _way(history.steps) > _way(furthest):
                furthest = list(history.steps)
            if history.steps and undone < TAKEN_BACK:
                undone += 1
                size = 0.5 * _way(history.steps[-2:])
                history.steps.pop()
                continue
            history.steps[:] = furthest
            raise
        size = None
        number = len(history.steps) + 1
        low, high = limits.range
        if step.stretch_max > high or step.stretch_min < low:
            beyond = step.stretch_max if step.stretch_max > high else step.stretch_min
            text = (
                f"material limit reached: stretch {beyond:.3g} at step {number} (kept between {low:.3g} and {high:.3g})"
            )
            raise LimitReached(text, history)
        history.steps.append(step)
        if on_step is not None:
            on_step(step, number)
    return history


def _way(steps: Sequence[Step]) -> float:
    """Return how far the glass has moved over some steps [mm]; a single one counts from first contact."""
    places = [(0.0, 0.0)] * (len(steps) == 1) + [(step.state.depth, step.state.slide) for step in steps]
    return float(np.abs(np.diff(places, axis=0)).sum()) if len(places) > 1 else 0.0


def _turns(goals: Sequence[Goal], index: int) -> bool:
    """Return whether the direction of motion changes at a goal, so that the old step size does not apply."""
    return index == 0 or (goals[index].kind == "slide") != (goals[index - 1].kind == "slide")


def _one_step(
    model: Model,
    goals: Sequence[Goal],
    goal_index: int,
    last: Equilibrium,
    before: Equilibrium,
    size: float,
    sizes: StepSizes,
    limits: MaterialLimits,
    history: History,
) -> Step:
    """Take the largest step towards a goal that converges."""
    goal, failures = goals[goal_index], 0
    while True:
        target, ends, share = _proposal(goal, last, before, size)
        guesses = [extrapolated(before, last, share), None] if 0 < share <= 2.0 else [None]
        last_chance = failures >= DESCENT_AFTER or 0.5 * size < sizes.smallest
        for guess, solve in _ways(guesses, goal.kind == "slide" and last_chance):
            try:
                state = solve(model, last, target, guess=guess)
            except StepFailed:
                continue
            stretches = model.solid.stretches(state.displacement)
            low, high = float(stretches.min()), float(stretches.max())
            grown = min(size * sizes.growth, sizes.largest)
            return Step(state, low, high, goal_index, ends, grown)
        size, failures = 0.5 * size, failures + 1
        if size < sizes.smallest:
            raise LimitReached(_why(model.solid.stretches(last.displacement), last, sizes, limits, history), history)


def _ways(guesses: Sequence[Equilibrium | None], by_descent: bool) -> list[tuple[Equilibrium | None, Solver]]:
    """Return first guesses with what solves from each."""
    ways: list[tuple[Equilibrium | None, Solver]] = [(guess, equilibrium) for guess in guesses]
    return [*ways, *((guess, descended) for guess in guesses[:1] if by_descent)]


def _why(stretches: Floats, last: Equilibrium, sizes: StepSizes, limits: MaterialLimits, history: History) -> str:
    """Name the limit at which no smaller step helps: the material's where it has lost stability, else the step's."""
    number = len(history.steps) + 1
    where = f"no equilibrium beyond depth {last.depth:.4g} mm, slide {last.slide:.4g} mm"
    lost = stretches[~limits.is_stable(stretches)]
    if lost.size:
        worst = float(lost.ravel()[np.argmax(np.abs(np.log(lost)))])
        return (
            f"material limit reached: stretch {worst:.3g} at step {number} ({where}; the material is unstable at "
            f"{len(lost)} of {len(stretches)} integration points)"
        )
    return (
        f"step limit reached: {where} at step {number} (stretches so far {stretches.min():.3g} to "
        f"{stretches.max():.3g}, smallest step {sizes.smallest:g} mm)"
    )


def _proposal(goal: Goal, last: Equilibrium, before: Equilibrium, size: float) -> tuple[Target, bool, float]:
    """Return the next target, whether it ends the goal, and its distance as a multiple of the last step."""
    deeper, further = last.depth - before.depth, last.slide - before.slide
    if goal.kind == "slide":
        rest = goal.value - last.slide
        move = rest if abs(rest) <= size * 1.001 else size * (1 if rest > 0 else -1)
        hold = (
            Target(last.slide + move, None, last.normal_force)
            if goal.hold == "force"
            else Target(last.slide + move, last.depth)
        )
        return hold, move == rest, move / further if abs(further) > 1e-12 else 0.0
    share = 0.0 if abs(deeper) < 1e-12 or abs(further) > 1e-12 else 1.0 / deeper
    if goal.kind == "depth":
        rest = goal.value - last.depth
        move = rest if abs(rest) <= size * 1.001 else size * (1 if rest > 0 else -1)
        return Target(last.slide, last.depth + move), move == rest, move * share
    force, slope = last.normal_force, (last.normal_force - before.normal_force) / deeper if deeper else 0.0
    if force < APPROACH * goal.value:
        # aim at the approach, a little further than the slope so far predicts because contacts stiffen
        move = size if slope <= 0 else min(size, 1.02 * (goal.value - force) / slope)
        if slope <= 0 or force + slope * move * 1.02 < goal.value:
            return Target(last.slide, last.depth + move), False, move * share
    # step size bounds the estimated change of depth, so that halving works here as well
    bound = max(abs(slope) * size, 1e-9)
    change = max(-bound, min(bound, goal.value - force))
    wanted = min(max(force + change, force / FORCE_RATIO), max(force, 0.05 * goal.value) * FORCE_RATIO)
    ends = abs(wanted - goal.value) < 1e-12
    way = (wanted - force) / slope if slope > 0 else 0.0
    return Target(last.slide, None, goal.value if ends else wanted), ends, way * share
