"""What each candidate would change in the data: whitened derivatives, or finite departures where there is none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.criticism.problem import Fit, Problem, derivatives, predicted_part
from evanesce.prediction.candidates import Candidate
from evanesce.prediction.parameters import moved
from evanesce.prediction.predict import Point

Array = NDArray[Any]

INVISIBLE = 0.1
"""A direction whose prior departure moves the whitened data by less than this cannot be seen [1]."""

TAKEN, SHORT = 100.0, 0.1
"""A departure so many times longer than what nuisances leave of it is taken at this share, where it is straight."""


@dataclass(frozen=True)
class Signature:
    """Of one candidate.

    Attributes
    ----------
    candidate : Candidate
    rows : ndarray (k, bins)
        Whitened change per unit of each parameter; of a candidate with starts, whitened change from nothing to each
        start.
    deviations : ndarray (k,)
        Prior standard deviations of the rows' amplitudes.
    joint : bool
        Whether the rows are parameters of one model (True) or rival ways to enter it (False).
    note : str
        Why it cannot be judged; empty if it can.
    """

    candidate: Candidate
    rows: Array
    deviations: Array
    joint: bool
    note: str = ""

    @property
    def id(self) -> str:
        """Of the effect."""
        return self.candidate.id


def signature_of(problem: Problem, base: Fit, candidate: Candidate) -> Signature:
    """Return the signature of one candidate at a fitted base model.

    An amplitude at its null silences the effect's other parameters, which then have no derivative; such rows are zero
    and take no part.
    """
    nothing = np.zeros((0, base.residual.size), np.float32)
    if candidate.missing:
        return Signature(candidate, nothing, np.zeros(0), True, "needs " + ", ".join(candidate.missing))
    if candidate.unseen:
        return Signature(candidate, nothing, np.zeros(0), True, candidate.unseen)
    at = predicted_part(base.point, base.parameters)
    try:
        if candidate.starts:
            return _seen(_rivals(problem, base, candidate))
        rows = derivatives(problem, at, candidate.parameters, base.predicted)
    except (InputError, ValueError) as error:
        return Signature(candidate, nothing, np.zeros(0), True, f"cannot be predicted here: {error}")
    deviations = np.array([p.deviation for p in candidate.parameters])
    return _seen(Signature(candidate, rows, deviations, True))


def _seen(signature: Signature) -> Signature:
    """Return a signature, with a note where no plausible departure would show: it is not judged then."""
    return signature if visible(signature) else replace(signature, note="no plausible amount of it shows in these data")


def _rivals(problem: Problem, base: Fit, candidate: Candidate) -> Signature:
    """Return the signature of a candidate with starts; those that this rig cannot have are left out.

    Raises
    ------
    InputError
        If it can have none of them.
    """
    rows, starts, refused = [], [], None
    for start in candidate.starts:
        try:
            rows.append(_departure(problem, base, candidate, start))
            starts.append(start)
        except InputError as error:
            refused = error
    if refused is not None and not starts:
        raise refused
    return Signature(replace(candidate, starts=tuple(starts)), np.array(rows), np.ones(len(rows)), False)


def _departure(problem: Problem, base: Fit, candidate: Candidate, start: Point) -> Array:
    """Return the whitened change from nothing to a start; taken shorter where nuisances take nearly all of it."""
    at = predicted_part(base.point, base.parameters)

    def change(share: float) -> Array:
        point = moved(at, shortened(candidate, start, share))
        return problem.whitened(problem.predictor.cube(point, problem.views) - base.predicted) / share

    whole = change(1.0)
    left = float(base.metric(base.parameters).project(whole) @ whole)
    # What is left of so large a step is how the prediction bends along the nuisances, which is no cause.
    return (change(SHORT) if left < float(whole @ whole) / TAKEN**2 else whole).astype(np.float32)


def shortened(candidate: Candidate, start: Point, share: float) -> dict[str, float]:
    """Return a start at a share of its amplitudes, its other parameters as they are."""
    amplitudes = {f"{candidate.id}:{name}" for name in candidate.effect.amplitudes}
    null = {p.name: p.null for p in candidate.parameters if p.name in amplitudes}
    return {name: null[name] + share * (value - null[name]) if name in null else value for name, value in start.items()}


def visible(signature: Signature) -> bool:
    """Tell whether any plausible departure would show in the data, nuisances left alone."""
    sizes = np.sqrt(np.einsum("kd,kd->k", signature.rows, signature.rows, dtype=float)) * signature.deviations
    return bool(sizes.size and sizes.max() > INVISIBLE)


def signatures_of(
    problem: Problem, base: Fit, candidates: Sequence[Candidate], tick: Callable[[str], None] = lambda name: None
) -> tuple[Signature, ...]:
    """Return the signatures of all candidates; ``tick`` is told each one's name when it is done."""
    found = []
    for candidate in candidates:
        found.append(signature_of(problem, base, candidate))
        tick(candidate.id)
    return tuple(found)
