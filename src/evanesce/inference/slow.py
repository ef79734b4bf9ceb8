"""Parameters whose evaluation takes seconds, linear about where they were evaluated last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.gauss_newton import Slopes
from evanesce.inference.joint_fit import JointFit, Taken
from evanesce.inference.model import Model

Array = NDArray[Any]

LINEAR, LINEAR_SHARE = 0.5, 0.1
"""Over so many posterior standard deviations, or over that share of its distance from null, a parameter whose
evaluation takes seconds acts linearly (assumed: forms of other light hardly depend on how much there is of it)."""


class Linear:
    """Parameters whose evaluation takes seconds, linear about where they were evaluated last.

    Parameters
    ----------
    taken : sequence of Taken
        Causes with whitened derivatives (d,) by such parameters.
    evaluated : mapping of str to float
        Where, of these parameters and others; what was evaluated nowhere yet is at its null.
    """

    def __init__(self, taken: Sequence[Taken], evaluated: Mapping[str, float]) -> None:
        self.rows = slow_rows(taken)
        nulls = {p.name: p.null for t in taken for p in t.parameters}
        self.point = {name: evaluated.get(name, nulls[name]) for name in self.rows}

    def predicted(self, model: Model, point: Mapping[str, float]) -> Array:
        """Return the whitened prediction (d,) at a point."""
        found = model.vector({**point, **self.point})
        for name, row in self.rows.items():
            found = found + (point[name] - self.point[name]) * row
        return np.asarray(found)


def slow_rows(taken: Sequence[Taken]) -> dict[str, Array]:
    """Return the derivatives (bins,) of parameters whose evaluation takes seconds, by name."""
    return {name: row for t in taken for name, row in t.slow.items()}


def with_rows(slopes: Slopes, taken: Sequence[Taken], rows: Mapping[str, Array]) -> Slopes:
    """Return derivatives of causes' parameters, then of nuisances, with some rows replaced."""
    names = [p.name for t in taken for p in t.parameters]
    if not any(name in rows for name in names):
        return slopes
    found = slopes.rows.copy()
    for name, row in rows.items():
        found[names.index(name)] = row
    return replace(slopes, rows=found, made=found if slopes.fresh else slopes.made)


def left_line(fitted: JointFit, name: str, evaluated: float) -> bool:
    """Return whether a fit has moved a parameter from where it was evaluated by more than its line reaches."""
    place = [p.name for p in fitted.parameters].index(name)
    sd = float(np.sqrt(fitted.solution.covariance[place, place]))
    return beyond(fitted.point[name], evaluated, fitted.parameters[place].null, sd)


def beyond(value: float, evaluated: float, null: float, width: float) -> bool:
    """Return whether a value is farther from where a parameter was evaluated than a straight line reaches."""
    return abs(value - evaluated) > LINEAR * width and not is_near(value, evaluated, null)


def is_near(value: float, evaluated: float, null: float) -> bool:
    """Return whether a value is as near where a parameter was evaluated as a straight line reaches."""
    return bool(abs(value - evaluated) <= LINEAR_SHARE * abs(evaluated - null))
