"""Derivatives of a fit's parameters, as exactly as its intervals ask for.

Parameters that stand in for each other are told apart by small differences of large derivatives: what is wrong with
those would count as information.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.inference.model import Model
from evanesce.prediction.parameters import Parameter, value_of

Array = NDArray[Any]
Point = Mapping[str, float]

ALIKE = 0.5
"""Standard deviations of the data by which a parameter's derivatives to both sides may differ over its posterior
deviation: a quarter of the information that it has."""
SMALLER, LARGER = 0.25, 4.0
"""Steps in posterior deviations that are tried where they differ by more: the smaller one for laws that bend, and where
that differs by more still, the larger one, because predictions are too rough for steps as small."""


def exact_slopes(model: Model, point: Point, widths: Mapping[Parameter, float]) -> dict[str, Array]:
    """Return whitened derivatives (d,) by parameter: central, over steps to which the prediction is nearly a line.

    Parameters
    ----------
    model : Model
    point : mapping of str to float
    widths : mapping of Parameter to float
        Posterior deviations.

    Raises
    ------
    InputError
        If the rig cannot have the values of a step.
    """
    rows, rough = _two_sided(model, point, widths)
    asked = {p: width for p, width in widths.items() if rough[p.name] > ALIKE}
    for factor in (SMALLER, LARGER):
        others, rougher = _two_sided(model, point, asked, factor)
        better = [name for name in others if rougher[name] < rough[name]]
        rows |= {name: others[name] for name in better}
        rough |= {name: rougher[name] for name in better}
        asked = {p: width for p, width in asked.items() if p.name not in better}
    return {name: _possible(row) for name, row in rows.items()}


def _two_sided(
    model: Model, point: Point, widths: Mapping[Parameter, float], factor: float = 1.0
) -> tuple[dict[str, Array | InputError], dict[str, float]]:
    """Return derivatives (d,) over steps to both sides, and half of what they differ by over the width.

    A step is ``factor`` times the width. Of what a bound leaves one side, over one and two steps to that. Why the rig
    cannot have one, where it cannot, and then no end to how much they differ.
    """
    asked, beside = [], []
    for p, width in widths.items():
        at, (low, high) = value_of(point, p), p.bounds
        step = min(factor * width, (high - low) / 4.0)
        first = step if at + step <= high else -step
        second = -first if low <= at - first <= high else 2.0 * first
        beside.append(second == 2.0 * first)
        asked += [replace(p, step=size, one_sided=True) for size in (first, second)]
    made = model.derivatives([(point, p) for p in asked])
    rows: dict[str, Array | InputError] = {}
    rough: dict[str, float] = {}
    for k, (p, width) in enumerate(widths.items()):
        one, other = made[2 * k : 2 * k + 2]
        if isinstance(one, InputError) or isinstance(other, InputError):
            rows[p.name], rough[p.name] = (one if isinstance(one, InputError) else other), np.inf
        else:
            one, other = one.astype(float), other.astype(float)
            rows[p.name] = 2.0 * one - other if beside[k] else 0.5 * (one + other)
            rough[p.name] = 0.5 * width * float(np.linalg.norm(one - other))
    return rows, rough


def _possible(row: Array | InputError) -> Array:
    if isinstance(row, InputError):
        raise row
    return row
