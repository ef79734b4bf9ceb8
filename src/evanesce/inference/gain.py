"""The held-out conditions, opened once: residual and area error of the nominal and of the extended model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.rng import generator
from evanesce.inference.consequence import AreaReader
from evanesce.inference.constants import LEAST_AREA
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.model import AnchoredModel
from evanesce.prediction.linear import Metric
from evanesce.prediction.nuisance import nuisance_parameters
from evanesce.prediction.parameters import derivative
from evanesce.prediction.scores import bootstrap_sum, log_scores, rmse
from evanesce.prediction.views import binned

Array = NDArray[Any]
Interval = tuple[float, float, float]
"""Value, and both ends."""

BOOTSTRAPS = 2000
"""Ends of a 95 % interval are then good to a fiftieth of its width."""


@dataclass(frozen=True)
class HeldOut:
    """Gain on held-out views.

    Attributes
    ----------
    log_score : tuple of float
        Gain, and its 95 % interval by bootstrap over views and blocks [nats].
    rms_DN, area_percent : tuple of float
        Root mean square residual of the bins; mean absolute error of the area over the measured one: before, after.
    views : int
    by_cause : mapping of str to tuple of float
        What each cause adds to the log score, and its interval [nats].
    """

    log_score: Interval
    rms_DN: tuple[float, float]
    area_percent: tuple[float, float]
    views: int
    by_cause: Mapping[str, Interval] = field(default_factory=dict)

    @property
    def worse(self) -> bool:
        """Whether the extension makes the area worse."""
        return areas_worse(*self.area_percent)

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""
        return {
            "log_score": list(self.log_score), "rms_DN": list(self.rms_DN),
            "area_error_percent": list(self.area_percent), "area_worse": self.worse, "views": self.views,
        }  # fmt: skip


def areas_worse(before: float, after: float) -> bool:
    """Return whether errors of areas [%] grew by more than areas are repeated; not where there are none (NaN)."""
    return bool(after - before > 100.0 * LEAST_AREA)


def held_out(
    model: AnchoredModel,
    areas: AreaReader,
    base: JointFit,
    best: JointFit,
    lacking: Mapping[str, JointFit],
    seed: int = 0,
) -> HeldOut | None:
    """Return the gain by the fine model of both; None where no view is held out.

    The light and load of each view by itself are marginalised, for both models alike. What each cause adds is by the
    coarse model's change from the extended fit, about which the model is anchored.

    Parameters
    ----------
    model : AnchoredModel
    areas : AreaReader
    base, best : JointFit
    lacking : mapping of str to JointFit
        The extended fit without each cause.
    seed : int
        Of the bootstrap.
    """
    data, views = model.data, list(model.data.held_out)
    if not views:
        return None
    measured = [areas.read(model.observation.images[k]) for k in views]
    scores, errors, off = [], [], []
    for fitted in (base, best):
        frames = {k: frame for k, frame in zip(views, model.frames(fitted.point, views), strict=True)}
        cube = np.full_like(data.cube, np.nan)
        for k, frame in frames.items():
            cube[k] = binned(frame) + model.codec_bias[k]
        errors.append(rmse(data.cube[views], cube[views]))
        left = _standardised(model, fitted.point, cube, views)
        scores.append(log_scores(left, data.valid[views]))
        read = [areas.read(frames[k]) for k in views]
        off.append([abs(r / m - 1.0) for r, m in zip(read, measured, strict=True) if m > 0])
    before, after = (100.0 * float(np.mean(o)) if o else float("nan") for o in off)

    def gained(scored: Array) -> Interval:
        drawn = generator(seed, "inference", "gain")
        return bootstrap_sum(scores[1] - scored, level=0.95, count=BOOTSTRAPS, rng=drawn)

    def without(fitted: JointFit) -> Array:
        there = np.where(data.valid, cube + model.cube(fitted.point, views) - model.cube(best.point, views), np.nan)
        return log_scores(_standardised(model, fitted.point, there, views), data.valid[views])

    by_cause = {name: gained(without(fitted)) for name, fitted in lacking.items()}
    return HeldOut(gained(scores[0]), (errors[0], errors[1]), (before, after), len(views), by_cause)


def _standardised(model: AnchoredModel, point: Mapping[str, float], cube: Array, views: list[int]) -> Array:
    """Return residuals (views, rows, cols) with each view's own light and load taken off, and squares kept right."""
    data = model.data
    parameters = [
        p
        for p in nuisance_parameters(data.views, data.noise.flicker)
        if p.linear and p.views is not None and p.views[0] in views
    ]
    rows = np.array([data.whitened(derivative(model.coarse, point, p, views), views) for p in parameters])
    metric = Metric.of(rows, np.array([p.deviation for p in parameters]))
    return data.unwhitened(metric.whiten(data.whitened(data.cube - cube, views)), views)
