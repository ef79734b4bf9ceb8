"""Parameters that a fit may vary, nuisances and effects alike, and derivatives of the prediction by them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.effects.inference_hints import ITSELF, Coordinate
from evanesce.prediction.point import Point
from evanesce.prediction.predict import Predictor

Array = NDArray[Any]

STEP_SHARE = 0.25
"""A derivative's step over the prior's standard deviation."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of a point.

    Attributes
    ----------
    name : str
        ``effect:parameter`` or ``@nuisance``.
    unit : str
        Of its values.
    coordinate : Coordinate
        In which a point has it, and all that follows here is told.
    null : float
        That of the believed rig.
    deviation : float
        Prior standard deviation about ``null``.
    bounds : tuple of float
    step : float
        Of differences; below 0, of differences to one side, to the lower one.
    views : tuple of int, optional
        The only views that it touches; None: all.
    linear : bool
        So small that its derivative says all: no prediction is made for it.
    one_sided : bool
        Differences to one side, of first order, at half the price: over a step within which the model is linear.
    template : ndarray (views, rows, cols), optional
        Its derivative, where that is not made by differences [DN per unit].
    """

    name: str
    unit: str = "1"
    coordinate: Coordinate = ITSELF
    null: float = 0.0
    deviation: float
    bounds: tuple[float, float] = (-np.inf, np.inf)
    step: float
    views: tuple[int, ...] | None = None
    linear: bool = False
    one_sided: bool = False
    template: Array | None = field(default=None, compare=False, repr=False)


def value_of(point: Point, parameter: Parameter) -> float:
    """Return a parameter's value at a point."""
    return float(point.get(parameter.name, parameter.null))


def moved(point: Point, changes: Point) -> dict[str, float]:
    """Return a point with some values replaced."""
    return {**point, **changes}


def derivative(
    predictor: Predictor, point: Point, parameter: Parameter, views: Sequence[int], base: Array | None = None
) -> Array:
    """Return d(prediction)/d(parameter) (views of the predictor, rows, cols) [DN per unit]; 0 in other views.

    Central differences; at a bound, or beside values that the rig cannot have, three points of one side, which are as
    exact: over a share of a prior's deviation one-sided differences of first order would find sensitivity where there
    is none.

    Parameters
    ----------
    predictor : Predictor
    point : mapping
    parameter : Parameter
    views : sequence of int
        Wanted.
    base : ndarray, optional
        The prediction at ``point``, if it is known.

    Raises
    ------
    InputError
        If the rig can have no value on either side.
    """
    if parameter.template is not None:
        return parameter.template
    only = [v for v in views if parameter.views is None or v in parameter.views]
    at, h, (low, high) = value_of(point, parameter), parameter.step, parameter.bounds

    def cube(value: float) -> Array:
        return predictor.cube(moved(point, {parameter.name: value}), only)

    if not only:
        raise ValueError(f"{parameter.name} touches none of the views {list(views)}")

    def towards(side: float) -> Array:
        first = predictor.cube(point, only) if base is None else base
        if parameter.one_sided:
            return (cube(at + side) - first) / side
        return (4 * cube(at + side) - cube(at + 2 * side) - 3 * first) / (2 * side)

    reach = 1 if parameter.one_sided else 2
    sides = [side for side in (h, -h) if low <= at + reach * side <= high] or [-h]
    ways: list[Callable[[], Array]] = [partial(towards, side) for side in sides]
    if not parameter.one_sided and at - h >= low and at + h <= high:
        ways = [lambda: (cube(at + h) - cube(at - h)) / (2 * h), *ways]
    found = _first_possible(ways)
    return np.nan_to_num(found, nan=0.0)


def _first_possible(ways: Sequence[Callable[[], Array]]) -> Array:
    """Return the result of the first of several ways that asks for nothing that the rig cannot have."""
    for way in ways[:-1]:
        try:
            return way()
        except InputError:
            continue
    return ways[-1]()
