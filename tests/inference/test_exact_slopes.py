"""Derivatives for intervals: told apart from what is wrong with them, by models whose derivatives are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from evanesce.core.errors import InputError
from evanesce.inference.exact_slopes import exact_slopes
from evanesce.inference.model import one_by_one
from evanesce.prediction.parameters import Parameter, derivative


class Toy:
    """A model of plain functions: ``parts`` maps a parameter to its part of the prediction."""

    def __init__(self, parts: dict[str, Any]) -> None:
        self.parts, self.steps = parts, []

    def derivative(self, point: Any, parameter: Parameter) -> Any:
        assert parameter.one_sided
        self.steps.append((parameter.name, parameter.step))
        part, at = self.parts[parameter.name], point[parameter.name]
        return (part(at + parameter.step) - part(at)) / parameter.step

    derivatives = one_by_one


def slope(
    part: Any, at: float, width: float, bounds: tuple[float, float] = (-np.inf, np.inf)
) -> tuple[Any, list[float]]:
    model: Any = Toy({"a": part})
    own = Parameter(name="a", deviation=1.0, step=0.25, bounds=bounds)
    found = exact_slopes(model, {"a": at}, {own: width})["a"]
    return found, [step for _, step in model.steps]


def test_a_gentle_law_takes_two_predictions() -> None:
    found, steps = slope(lambda x: np.array([3.0 * x + 0.2 * x * x, 1.0]), 1.0, 0.5)
    np.testing.assert_allclose(found, [3.4, 0.0])
    assert steps == [0.5, -0.5]


def test_a_bent_law_is_differentiated_over_less() -> None:
    """By a step of 0.5 exp(8 x) rises sevenfold as steeply as its slope: sinh(4) / 4."""
    found, steps = slope(lambda x: np.array([np.exp(8.0 * x)]), 0.0, 0.5)
    assert min(np.abs(steps)) == pytest.approx(0.125)
    assert found[0] == pytest.approx(8.0, rel=0.2)


def test_a_rough_prediction_is_differentiated_over_more() -> None:
    """Numbers rounded to 1.5 standard deviations of the data: less of a step shows their stairs."""
    true = np.linspace(0.8, 1.2, 50)
    part = lambda x: 1.5 * np.round(true * x / 1.5 + np.linspace(0.0, 1.0, 50))  # noqa: E731
    found, steps = slope(part, 0.3, 1.0)
    assert max(np.abs(steps)) == pytest.approx(4.0)
    assert np.linalg.norm(found - true) < 0.5 * np.linalg.norm(0.5 * (part(1.3) - part(-0.7)) - true)


@pytest.mark.parametrize(("at", "side"), [(0.0, 1.0), (9.0, -1.0)])
def test_at_a_bound_it_is_made_of_two_steps_inside(at: float, side: float) -> None:
    found, steps = slope(lambda x: np.array([x + 0.1 * x * x]), at, 0.5, (0.0, 9.0))
    np.testing.assert_allclose(steps, [side * 0.5, side * 1.0])
    assert found[0] == pytest.approx(1.0 + 0.2 * at)


def test_no_step_leaves_the_bounds_however_little_the_data_say() -> None:
    _, steps = slope(lambda x: np.array([1e-3 * x]), 170.0, 500.0, (-180.0, 180.0))
    assert all(-180.0 <= 170.0 + step <= 180.0 for step in steps)


def test_what_the_rig_cannot_have_is_stepped_over_or_told() -> None:
    def refused(x: float) -> Any:
        if abs(x) > limit:
            raise InputError("no such rig", key="a", allowed="less")
        return np.array([2.0 * x])

    limit = 0.3
    found, _ = slope(refused, 0.0, 1.0)
    assert found[0] == pytest.approx(2.0)
    limit = 0.01
    with pytest.raises(InputError, match="no such rig"):
        slope(refused, 0.0, 1.0)


def test_two_figures_that_do_the_same_are_not_told_apart_by_the_bend_of_their_law() -> None:
    """Both move one edge, over other steps; one-sided derivatives would tell them apart by what they have wrong."""
    x = np.linspace(-4.0, 4.0, 60)
    edge = lambda place: 100.0 * np.tanh(x - place)  # noqa: E731
    model: Any = Toy({"a": edge, "b": lambda v: edge(0.03 * v)})
    a, b = (Parameter(name=name, deviation=1.0, step=0.25) for name in "ab")
    widths, point = {a: 0.1, b: 1.0}, {"a": 0.0, "b": 0.0}
    rows = exact_slopes(model, point, widths)

    def information(one: Any, other: Any) -> float:
        """Return what is left of one that the other does not make, over a posterior deviation of it."""
        rest = one - other * (one @ other) / (other @ other)
        return float(0.1 * np.linalg.norm(rest))

    coarse = [(edge(0.1) - edge(0.0)) / 0.1, edge(0.03) - edge(0.0)]
    assert information(*coarse) > 0.9
    assert information(rows["a"], rows["b"]) < 0.2


@pytest.mark.parametrize(("most", "at"), [(np.inf, 0.3), (0.31, 0.3)])
@pytest.mark.parametrize("one_sided", [False, True])
def test_what_a_rig_cannot_have_on_one_side_is_differentiated_on_the_other(most: float, at: float, one_sided: bool):
    """Two contrasts may add to less than 1: their bounds do not say so. Rationale: a run ended there."""

    class Rig:
        def cube(self, point: Any, only: Any) -> Any:
            value = point["e:x"]
            if value >= most:
                raise InputError("contrasts add to more than 1")
            return np.array([value**2, 3.0 * value])[None, :, None]

    own = Parameter(name="e:x", deviation=1.0, step=0.02, bounds=(-1.0, 1.0), one_sided=one_sided)
    found = derivative(Rig(), {"e:x": at}, own, [0])  # type: ignore[arg-type]
    np.testing.assert_allclose(found[0, :, 0], [2 * at, 3.0], atol=0.021 if one_sided else 1e-9)
    if np.isfinite(most):
        with pytest.raises(InputError, match="contrasts"):
            derivative(Rig(), {"e:x": most + 0.1}, own, [0])  # type: ignore[arg-type]
