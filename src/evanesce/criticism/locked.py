"""The locked part, opened once: what the extension gains on conditions that took part in no choice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.rng import generator
from evanesce.criticism.extend import Extension
from evanesce.criticism.numerics import is_numerics
from evanesce.criticism.problem import Fit, Problem, fit, predicted_part
from evanesce.criticism.residuals import with_places
from evanesce.criticism.unknown import Flexible
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.prediction.linear import Metric
from evanesce.prediction.nuisance import nuisance_parameters
from evanesce.prediction.observe import Observation
from evanesce.prediction.parameters import derivative
from evanesce.prediction.scores import area_error_percent, bootstrap_sum, log_scores, rmse

Array = NDArray[Any]

BOOTSTRAPS = 2000
REFITS = 3
"""Predictions by which a fit settles without the nuisances of computation."""
THRESHOLD = 0.15
LEAST_BLOB_SHARE = 2000 / 3.0e6
"""The author's smallest blob, 2000 of 2000 x 1500 pixels."""


@dataclass(frozen=True)
class LockedGain:
    """On the locked part.

    Attributes
    ----------
    log_score : tuple of float
        Gain, and its 95 % interval [nats].
    rmse_DN, area_error_percent : tuple of float
        Before and after.
    views : int
    """

    log_score: tuple[float, float, float]
    rmse_DN: tuple[float, float]
    area_error_percent: tuple[float, float]
    views: int

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""
        return {
            "log_score": list(self.log_score),
            "rmse_dn": list(self.rmse_DN),
            "area_error_pct": list(self.area_error_percent),
            "views": self.views,
        }


def locked_gain(
    observation: Observation, problem: Problem, base: Fit, best: Extension | None, flexible: Flexible | None
) -> LockedGain | None:
    """Return the gain on the locked views; None where none is locked.

    Each view's own jitter of light and load cell is marginalised, for both models alike. Two rigs that a user can
    render are compared: both are fitted without the nuisances of computation first, behind which a wrong model hides
    farther than computation is ever wrong. With a flexible term, which was fitted beside those nuisances, both models
    keep them; what the term predicts is added, and what made way for it in the open part makes way here, too.
    """
    views = [int(v) for v in observation.locked]
    if not views:
        return None
    extended, own = (None, problem) if best is None else (best.fitted, best.problem)
    if flexible is None:
        base = without_numerics(problem, base)
        extended = None if extended is None else without_numerics(own, extended)
    extended = extended or base
    cubes, points = [], []
    for one, of in ((base, problem), (extended, own)):
        points.append(shared_part(one))
        cubes.append(of.predictor.cube(points[-1], views))
        for p in one.parameters:
            if p.template is not None:
                cubes[-1] = cubes[-1] + one.point.get(p.name, 0.0) * p.template
    if flexible is not None:
        cubes[1] = cubes[1] + flexible_part(own, extended, flexible, cubes[1], views)
    left = [_residual(problem, cube, point, views) for cube, point in zip(cubes, points, strict=True)]
    valid = problem.valid[views]
    difference = log_scores(left[1], valid) - log_scores(left[0], valid)
    score = bootstrap_sum(difference, level=0.95, count=BOOTSTRAPS, rng=generator(0, "criticism", "gain"))
    data = problem.data[views]
    images = [observation.images[v] for v in views]
    frames = [[problem.predictor.image(p, v) for v in views] for p in points]
    return LockedGain(
        log_score=score,
        rmse_DN=(rmse(data, cubes[0][views]), rmse(data, cubes[1][views])),
        area_error_percent=(
            area_error_percent(images, frames[0], chain_area),
            area_error_percent(images, frames[1], chain_area),
        ),
        views=len(views),
    )


def flexible_part(problem: Problem, fitted: Fit, flexible: Flexible, predicted: Array, views: list[int]) -> Array:
    """Return what a flexible term changes in some views (all views, rows, cols) [DN]."""

    def term(chosen: Sequence[int], level: Array) -> Array:
        nothing = np.zeros((len(chosen), *level.shape[1:]), np.float32)
        return flexible.predict(with_places(problem, fitted.point, chosen, level, nothing))

    found = np.zeros_like(predicted)
    found[views] = term(views, predicted)
    seen = np.zeros_like(predicted)
    seen[list(problem.views)] = term(problem.views, fitted.predicted)
    metric = fitted.metric(fitted.parameters)
    at = predicted_part(fitted.point, fitted.parameters)
    moved_by = -metric.nuisances_of(problem.whitened(seen))
    for p, way in zip(fitted.parameters, moved_by, strict=True):
        if p.template is not None:
            found[views] += way * p.deviation * p.template[views]
        elif not p.linear and (p.views is None or set(p.views) & set(views)):
            found[views] += way * p.deviation * derivative(problem.predictor, at, p, views)[views]
    return found


def without_numerics(problem: Problem, fitted: Fit) -> Fit:
    """Return a model fitted again without the nuisances of computation (:mod:`evanesce.criticism.numerics`)."""
    kept = [k for k, p in enumerate(fitted.parameters) if not is_numerics(p)]
    if len(kept) == len(fitted.parameters):
        return fitted
    left = {p.name for p in fitted.parameters if is_numerics(p)}
    start = {name: value for name, value in fitted.point.items() if name not in left}
    # What a template adds is no part of the prediction, which is the same without it.
    parameters = [fitted.parameters[k] for k in kept]
    return fit(problem, parameters, start, rows=fitted.rows[kept], predicted=fitted.predicted, rounds=REFITS)


def shared_part(fitted: Fit) -> dict[str, float]:
    """Return a fit's values without those of single views, and without those that only a template carries."""
    own = {p.name for p in fitted.parameters if p.linear and (p.template is not None or p.views is not None)}
    return {name: value for name, value in fitted.point.items() if name not in own}


def chain_area(image: Array) -> float:
    """Return the pixels that the reference segmentation counts in a frame [DN]."""
    whole = np.floor(np.clip(image, 0, 255) + 0.5).astype(np.uint8)
    return float(segment(whole, Chain(threshold=THRESHOLD, min_blob=round(LEAST_BLOB_SHARE * image.size))).pixels)


def _residual(problem: Problem, cube: Array, point: dict[str, float], views: list[int]) -> Array:
    """Return standardised residuals of views (views, rows, cols) with each view's own jitter taken off."""
    parameters = [
        p
        for p in nuisance_parameters(problem.predictor.views, problem.noise.flicker)
        if p.linear and p.views is not None and p.views[0] in views
    ]
    rows = np.array([problem.whitened(derivative(problem.predictor, point, p, views), views) for p in parameters])
    residual = problem.residual(cube, views)
    metric = Metric.of(rows, np.array([p.deviation for p in parameters]))
    return problem.unwhitened(metric.whiten(residual), views)
