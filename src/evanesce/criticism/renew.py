"""Loud causes: the fine prediction made anew where each of them ended, before they are compared.

What finer pixels change (:mod:`evanesce.prediction.fine`) is put right where the believed rig was fitted. A cause that
moves the edge of contact by a pixel leaves it behind, and so do its derivatives: some hundredths of the change are
wrong then. Where noise is larger, nobody sees them. Where it is not, they decide between causes that share a shape, a
softer finger and a stiffening bone, by which of the two happens to have the better derivative.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.criticism.case import Case
from evanesce.criticism.extend import Extension, extend_again
from evanesce.criticism.problem import Fit, Problem, predicted_part
from evanesce.criticism.score import Scored
from evanesce.prediction.fine import FineFrames
from evanesce.prediction.frozen import FROZEN
from evanesce.prediction.observe import model_factor

Array = NDArray[Any]

MORE = 3
"""Times that the best cause is predicted anew beyond the first."""

SETTLED_NATS = 0.5
"""Evidence that such a time has to bring for another one."""


def is_loud(gained: float) -> bool:
    """Tell whether evidence [nats] is so large that the quick prediction may decide between its causes."""
    return gained > FROZEN.search["renew_nats"]


def undecided(change: Array) -> float:
    """Return the evidence [nats] that the quick prediction of a whitened change (bins,) may get wrong."""
    return 0.5 * FROZEN.search["quick_share"] * float(np.sum(np.square(change, dtype=float)))


def change_of(scored: Scored) -> Array:
    """Return the whitened change that a score test ascribes to its candidate, by a straight line."""
    rows = scored.signature.rows
    rows = rows if scored.start < 0 else rows[[scored.start]]
    return np.asarray(np.atleast_1d(scored.result.estimate) @ rows)


def renewed(
    case: Case,
    problem: Problem,
    base: Fit,
    known: Extension | None,
    tried: Sequence[tuple[Scored, Extension]],
) -> list[Extension]:
    """Return extensions, those fitted again that may be the best once computation is put right.

    Parameters
    ----------
    case : Case
    problem : Problem
        Of the base model.
    base : Fit
    known : Extension, optional
        What the base model already has beyond the believed rig.
    tried : sequence of tuple of Scored, Extension
    """
    before = 0.0 if known is None else known.log_bayes
    if not any(is_loud(e.log_bayes - before) for _, e in tried):
        return [e for _, e in tried]
    found: list[Extension] = []
    best = -np.inf
    for scored, extension in sorted(tried, key=lambda t: -t[1].log_bayes):
        may_win = extension.log_bayes + undecided(extension.cause.signal) > best
        # What enters by a straight line only has no point at which it could be predicted anew.
        scaled = any(p.linear and p.template is None for p in extension.fitted.parameters if _is_effects(p.name))
        again = quick = extension
        if may_win and not scaled:
            try:
                again = anew(case, problem, base, known, scored, extension)
                for _ in range(MORE):
                    # One that is well ahead has to end where it was predicted, or its values are those of its start.
                    if again.log_bayes < best or again.log_bayes - extension.log_bayes < SETTLED_NATS:
                        break
                    extension, again = again, anew(case, problem, base, known, scored, again)
            except InputError as error:
                case.notes.append(f"{extension.cause.id} could not be predicted anew: {error}")
        found.append(again)
        # What was predicted quickly only is no bar for what would be predicted well.
        best = best if again is quick else max(best, again.log_bayes)
    return found


def anew(
    case: Case, problem: Problem, base: Fit, known: Extension | None, scored: Scored, extension: Extension
) -> Extension:
    """Return an extension fitted again by what is predicted where it ended."""
    return extend_again(at_fitted(case, problem, extension.fitted), base, known, scored, extension)


def at_fitted(case: Case, problem: Problem, fitted: Fit) -> Problem:
    """Return the problem with a predictor whose fine part is that of a fit's own point."""
    predictor = copy(problem.predictor)
    point = predicted_part(fitted.point, fitted.parameters)
    predictor.correction = None
    quick = predictor.cube(point)
    believed = case.observation.believed
    frames = FineFrames(
        believed,
        predictor.views,
        model_factor(believed),
        point,
        noise_scale=predictor.noise_scale,
        fixed=predictor.fixed,
    )
    predictor.correction = np.nan_to_num(frames.cube() - quick, nan=0.0)
    if problem.coded is not None:
        predictor.correction = predictor.correction + problem.coded.bias
    return replace(problem, predictor=predictor)


def _is_effects(name: str) -> bool:
    return not name.startswith("@")
