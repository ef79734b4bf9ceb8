"""Step control on its own, over a toy body whose equilibria are known: halving, growing, taking back, giving up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from evanesce.contact.fem import steps
from evanesce.contact.fem.newton import Equilibrium, StepFailed, Target
from evanesce.contact.fem.steps import Goal, History, LimitReached, MaterialLimits, StepSizes, advance

SIZES = StepSizes(largest=0.4, first=0.1, smallest=0.003)
LIMITS = MaterialLimits((0.36, 2.6), lambda stretches: np.ones(len(stretches), dtype=bool))


def state(depth: float) -> Equilibrium:
    contact: Any = None
    return Equilibrium(np.zeros((1, 2)), depth, 0.0, contact, 2.0 * depth, 0.0, 1)


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch):
    """Return ``press(fails, depth)``: ``fails(before, depth)`` says which steps do not converge."""

    def press(fails: Any, depth: float) -> History:
        def equilibrium(model: Any, before: Equilibrium, target: Target, *, guess: Any = None) -> Equilibrium:
            assert target.depth is not None
            if fails(before, target.depth):
                raise StepFailed
            return state(target.depth)

        monkeypatch.setattr(steps, "equilibrium", equilibrium)
        solid = SimpleNamespace(stretches=lambda displacement: np.array([[1.2, 0.95, 0.9]]))
        model: Any = SimpleNamespace(start=lambda: state(0.0), solid=solid)
        return advance(model, [Goal("depth", depth)], History(), sizes=SIZES, limits=LIMITS)

    return press


def test_steps_grow_to_the_largest_and_end_at_the_goal(toy: Any) -> None:
    moves = np.diff([0.0, *(s.state.depth for s in toy(lambda before, depth: False, 1.73).steps)])
    np.testing.assert_allclose(moves[:4], [0.1, 0.15, 0.225, 0.3375])
    assert moves.max() <= 0.4 * 1.001
    assert moves.sum() == pytest.approx(1.73)


def test_a_step_that_fails_is_halved_and_grows_again(toy: Any) -> None:
    history = toy(lambda before, depth: 0.5 < depth < 0.9 and depth - before.depth > 0.06, 1.73)
    places = np.array([s.state.depth for s in history.steps])
    moves = np.diff([0.0, *places])
    assert (moves[(places > 0.5) & (places < 0.9)] <= 0.06).all()
    assert moves[places > 1.2].max() > 0.15


def test_a_state_that_no_step_leaves_is_taken_back_and_reached_by_smaller_ones(toy: Any) -> None:
    stuck: list[float] = []

    def fails(before: Equilibrium, depth: float) -> bool:
        # the first state beyond 0.45 is a dead end; any other one is not
        if before.depth > 0.45 and not stuck:
            stuck.append(before.depth)
        return bool(stuck) and before.depth == stuck[0]

    history = toy(fails, 1.73)
    places = [s.state.depth for s in history.steps]
    assert history.complete
    assert places[-1] == pytest.approx(1.73)
    assert stuck[0] not in places
    assert (np.diff(places) > 0).all()


def test_a_wall_ends_the_run_and_the_furthest_steps_are_kept(toy: Any) -> None:
    with pytest.raises(LimitReached, match="step limit reached: no equilibrium beyond depth") as caught:
        toy(lambda before, depth: depth > 1.0, 1.73)
    places = [s.state.depth for s in caught.value.history.steps]
    assert 1.0 - SIZES.smallest <= places[-1] <= 1.0
    assert (np.diff(places) > 0).all()
