"""Derivatives of a prediction by differences, over a step and to the side that a parameter asks for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from evanesce.core.errors import InputError
from evanesce.prediction.parameters import Parameter, derivative


class Root:
    """A prediction that goes by a parameter's root, as a contact does by the work of adhesion; notes where it was."""

    def __init__(self) -> None:
        self.asked: list[float] = []

    def cube(self, point: Any, only: Any = None) -> Any:
        self.asked.append(point["a"])
        return np.full((1, 2, 2), np.sqrt(point["a"]))


WORK = Parameter(name="a", deviation=1.0, step=0.25, bounds=(0.0, 4.0))


def test_differences_over_what_the_data_allow_are_the_slope_there() -> None:
    """At 0.04 the slope is 2.5; three points over a quarter of the prior's deviation make 1.9 of it."""
    root: Any = Root()
    near = replace(WORK, step=0.001, one_sided=True)
    assert derivative(root, {"a": 0.04}, near, [0]).mean() == pytest.approx(2.5, rel=0.01)
    assert sorted(root.asked) == [0.04, pytest.approx(0.041)]
    assert abs(derivative(root, {"a": 0.04}, WORK, [0]).mean() / 2.5 - 1.0) > 0.2


def test_one_side_is_the_one_within_bounds() -> None:
    root: Any = Root()
    near = replace(WORK, step=0.001, one_sided=True)
    assert derivative(root, {"a": 4.0}, near, [0]).mean() == pytest.approx(0.25, rel=0.01)
    assert max(root.asked) == 4.0


def test_a_side_that_the_rig_cannot_have_is_left_for_the_other() -> None:
    """Shares that add to one at most: above 1.2 there is no such rig, far inside the parameter's own bounds."""

    class Shares(Root):
        def cube(self, point: Any, only: Any = None) -> Any:
            if point["a"] > 1.2:
                raise InputError("led.imbalance: the shares add to more than 1")
            return super().cube(point, only)

    root: Any = Shares()
    near = replace(WORK, step=0.01, one_sided=True)
    assert derivative(root, {"a": 1.195}, near, [0]).mean() == pytest.approx(0.5 / np.sqrt(1.195), rel=0.01)
    assert derivative(root, {"a": 1.195}, replace(near, one_sided=False), [0]).mean() == pytest.approx(
        0.5 / np.sqrt(1.195), rel=0.001
    )
    with pytest.raises(InputError, match="more than 1"):
        derivative(root, {"a": 1.3}, near, [0])
