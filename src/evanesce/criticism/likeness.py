"""Whether the frames show the contact at all that the believed rig has there.

Effects of the library change what is believed. Where none of that shows (another rig, another place, no contact, pixels
in another order) some effect always fits least badly, by thousands of nats, and its name means nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.criticism.problem import Fit, Problem

Array = NDArray[Any]

STRUCTURED = 10.0
"""A view counts where its believed structure is so many times what noise can differ by, as squares."""


@dataclass(frozen=True)
class Likeness:
    """How much the press frames look like the fitted prediction.

    Attributes
    ----------
    correlation : float
        Of frames and prediction over the bins of a view, noise taken off; median over the views, 1 where none has
        structure to compare.
    evidence : float
        Of frames without any structure over the fitted believed rig, at least 0 [nats].
    """

    correlation: float = 1.0
    evidence: float = 0.0


def likeness_of(problem: Problem, fitted: Fit, believed: Array) -> Likeness:
    """Compare the press frames with what the believed rig predicts at its best.

    Parameters
    ----------
    problem : Problem
    fitted : Fit
        Of the believed rig with its nuisances.
    believed : ndarray (views, rows, cols)
        The prediction before any fit [DN]: a fit to frames without contact may put the light out.
    """
    found = []
    evidence = 0.5 * (fitted.misfit - float((fitted.residual.astype(float) ** 2).sum()))
    residual = problem.unwhitened(fitted.residual)
    for k, view in enumerate(problem.kinds):
        if view.kind != "press":
            continue
        v = problem.views[k]
        mask = problem.valid[v]
        weight = 1.0 / problem.sd[v][mask]
        left = residual[k][mask].astype(float)
        data = problem.data[v][mask] * weight
        measured, predicted, expected = (
            _uneven(row, weight) for row in (data, data - left, believed[v][mask] * weight)
        )
        chance = np.sqrt(2.0 * mask.sum())
        if float(expected @ expected) < STRUCTURED * chance:
            continue
        evidence += 0.5 * (float(left @ left) - float(measured @ measured))
        structure = float(measured @ measured) - float(mask.sum())
        size = float(predicted @ predicted)
        shows = structure > chance and size > chance
        found.append(float(measured @ predicted) / np.sqrt(structure * size) if shows else 0.0)
    if not found:
        return Likeness()
    return Likeness(float(np.median(found)), max(evidence, 0.0))


def _uneven(row: Array, weight: Array) -> Array:
    """Return a whitened row without what an even picture explains of it."""
    return np.asarray(row - weight * float(row @ weight) / float(weight @ weight))
