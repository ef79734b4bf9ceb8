"""Where the fine model is evaluated anew, on a prediction of one number whose addition is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from evanesce.inference.anchors import STAYS, UNSEEN, Anchors, Evaluated


class Counted:
    """A fine model that adds a function of the coarse prediction, and how often it was evaluated."""

    def __init__(self, addition: Callable[[float], float]) -> None:
        self.addition, self.evaluations = addition, 0
        self.anchors = Anchors(lambda bins: float(np.linalg.norm(bins)))

    def at(self, coarse: float, unexplained: float = 0.0) -> float:
        def evaluate() -> Evaluated:
            self.evaluations += 1
            one = np.full((1, 1, 1), self.addition(coarse))
            return Evaluated(np.full((1, 1, 1), coarse), one, one, 0.0 * one)

        return float(self.anchors.at(np.full((1, 1, 1), coarse), evaluate, unexplained).correction[0, 0, 0])


@pytest.mark.parametrize("rate", [0.01, 0.2])
def test_what_is_kept_is_off_by_no_more_than_it_may_be(rate: float) -> None:
    model = Counted(lambda coarse: rate * coarse)
    for coarse in np.random.default_rng(3).uniform(0.0, 100.0, 200):
        assert abs(model.at(coarse) - rate * coarse) <= STAYS
    # Within STAYS / rate of an evaluation nothing is evaluated; no more are kept than four.
    assert model.evaluations < 200
    assert (model.evaluations < 10) == (rate == 0.01)


def test_one_evaluation_says_nothing_of_the_rate() -> None:
    model = Counted(lambda coarse: 0.001 * coarse)
    for coarse, evaluations in ((1.0, 1), (1.0, 1), (1.001, 2), (1.0015, 2)):
        model.at(coarse)
        assert model.evaluations == evaluations


def test_a_rate_is_trusted_as_far_as_it_was_seen() -> None:
    """Two near points that add the same say nothing of a far one; a change between two raises the rate."""
    model = Counted(lambda coarse: 0.0 if coarse < 50.0 else 40.0)
    assert [model.at(coarse) for coarse in (10.0, 20.0, 60.0)] == [0.0, 0.0, 40.0]
    before = model.evaluations
    assert [model.at(coarse) for coarse in (45.0, 55.0)] == [0.0, 40.0]
    assert model.evaluations == before + 2


def test_while_much_is_unexplained_an_anchor_is_as_exact_as_that_asks_for() -> None:
    places = np.random.default_rng(3).uniform(0.0, 100.0, 200)
    exact, rough = (Counted(lambda coarse: 0.2 * coarse) for _ in range(2))
    for coarse in places:
        exact.at(coarse)
        assert abs(rough.at(coarse, unexplained=300.0) - 0.2 * coarse) <= UNSEEN * 300.0
    assert rough.evaluations < 0.3 * exact.evaluations
    before = rough.evaluations
    assert rough.at(float(places[0])) == pytest.approx(0.2 * places[0], abs=STAYS)
    assert rough.evaluations <= before + 1


def test_a_fit_may_stay_with_what_was_added_at_its_anchor() -> None:
    """Then nothing is evaluated where it ended, and other points go by the rate as before."""
    model = Counted(lambda coarse: 0.2 * coarse)
    model.at(10.0)
    here, there = (np.full((1, 1, 1), coarse) for coarse in (10.0, 40.0))
    model.anchors.stay(there, Evaluated(here, 0.2 * here, 0.2 * here, 0.0 * here))
    assert model.at(40.0) == pytest.approx(2.0)
    assert model.evaluations == 1
    assert model.at(80.0) == pytest.approx(16.0)
    assert model.evaluations == 2
