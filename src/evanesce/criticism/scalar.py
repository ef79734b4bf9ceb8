"""Criticism of scalar series alone: area against force and the like, where no frame was kept.

A lab's old table is the poorest bundle there is. Each candidate is fitted to the logarithm of the series, compared by
what it predicts of points left out, and all that fit alike are named together: a curve of a dozen points seldom tells
more. Areas are predicted by the whole chain, the author's threshold included.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from evanesce.bundle.area import AreaReading, contact_area
from evanesce.bundle.layout import SERIES_FOLDER, Series
from evanesce.chain.simulate import solve_contact
from evanesce.core.errors import InputError
from evanesce.prediction.fine import FinePredictor
from evanesce.prediction.observe import model_factor, model_scene
from evanesce.prediction.parameters import Parameter
from evanesce.prediction.predict import Nuisances, Point, Predictor, scene_with
from evanesce.prediction.views import View
from evanesce.render.fast.rig_fields import unit_digest
from evanesce.rig import Scene

Array = NDArray[Any]

READING_SHARE = 0.1
"""Of what larger pixels read wrongly at the believed rig: so much may be left of it elsewhere."""

ASSUMED_SIGMA = 0.05
"""Relative standard deviation of a series that states none."""

LEAST_AREA_MM2, LEAST_FORCE_N = 0.05, 1e-3
FORCES_FOR_DEPTH = np.geomspace(0.02, 12.0, 14)
DEFAULT_FORCE_N = 3.0


@dataclass(frozen=True)
class Table:
    """Series put into one row of logarithms.

    Attributes
    ----------
    series : tuple of Series
    log_y, sigma : ndarray (points,)
    assumed : bool
        Whether any sigma had to be assumed.
    """

    series: tuple[Series, ...]
    log_y: Array
    sigma: Array
    assumed: bool

    @classmethod
    def of(cls, series: Sequence[Series]) -> Table:
        """Gather series; values of 0 or less carry no logarithm and are left out.

        Raises
        ------
        InputError
            If a series has no value that is large enough.
        """
        kept = []
        for one in series:
            least = LEAST_AREA_MM2 if one.y_name == "area" else LEAST_FORCE_N
            keep = np.asarray(one.y) > least
            if not keep.any():
                raise InputError(
                    f"holds nothing to compare: no {one.y_name} above {least:g} {one.y_unit}",
                    file=Path(SERIES_FOLDER) / f"{one.name}.csv", key=f"column {one.y_name}_{one.y_unit}",
                    allowed="values of a finger that touches",
                )  # fmt: skip
            sigma = None if one.sigma is None else np.asarray(one.sigma)[keep]
            kept.append(replace(one, x=np.asarray(one.x)[keep], y=np.asarray(one.y)[keep], sigma=sigma))
        parts = [
            np.full(len(one), ASSUMED_SIGMA) if one.sigma is None else np.asarray(one.sigma) / one.y for one in kept
        ]
        return cls(
            tuple(kept),
            np.log(np.concatenate([one.y for one in kept])),
            np.concatenate(parts),
            any(one.sigma is None for one in kept),
        )

    def widened(self, spread: Array) -> Table:
        """Return the table with what a prediction may be off by (points,) added to each value's standard deviation."""
        return replace(self, sigma=np.hypot(self.sigma, spread))


class SeriesPredictor:
    """Predicts series of a believed rig with departures.

    Parameters
    ----------
    scene : Scene
        Believed.
    series : sequence of Series
    """

    def __init__(self, scene: Scene, series: Sequence[Series]) -> None:
        self.series = tuple(series)
        self._factor = model_factor(scene)
        self.scene = model_scene(scene)
        self._frames = Predictor(self.scene, ())
        self._kept: dict[tuple[Any, ...], Array] = {}
        self._scaled: dict[str, tuple[float, Array]] = {}
        self._correction: Array | float = 0.0

    def __call__(self, point: Point) -> Array:
        """Return the logarithm of all series at a point (points,)."""
        near = {name: value for name, value in point.items() if name not in self._scaled}
        key = tuple(sorted(near.items()))
        if key not in self._kept:
            self._kept[key] = self._correction + np.concatenate([np.log(self.values(one, near)) for one in self.series])
        found = self._kept[key]
        for name, (null, slope) in self._scaled.items():
            if name in point:
                found = found + (point[name] - null) * slope
        return found

    def refine(self, believed: Scene) -> Array:
        """From now on put right what larger pixels read of areas, by pictures of the believed rig as fine as simulated.

        Parameters
        ----------
        believed : Scene
            With the real camera.

        Returns
        -------
        ndarray (points,)
            Standard deviation of the logarithm: a share of what was put right.
        """
        fine = FinePredictor(believed, (), self._factor)
        found = []
        for one in self.series:
            near = np.log(self.values(one, {}))
            read = partial(self._areas, believed, one, frames=fine, factor=1)
            found.append(np.log(read()) - near if one.y_name == "area" else np.zeros(len(one)))
        self._correction = np.concatenate(found)
        self._kept.clear()
        return READING_SHARE * np.abs(self._correction)

    def scale(self, parameter: Parameter, start: Point) -> None:
        """From now on scale the response to a parameter along its change from nothing to a point.

        For what changes the plate's own light: each value of it costs seconds.
        """
        change = self(start) - self({})
        self._scaled[parameter.name] = (parameter.null, change / (start[parameter.name] - parameter.null))

    def changes_plate_light(self, point: Point) -> bool:
        """Tell whether a departure changes the guided light itself."""
        return unit_digest(solve_contact(scene_with(self.scene, point), None, seed=0)[0]) != unit_digest(
            solve_contact(self.scene, None, seed=0)[0]
        )

    def values(self, series: Series, point: Point) -> Array:
        """Return one series [unit of its y]."""
        scene = scene_with(self.scene, point)
        if series.y_name == "force":
            return self._force(scene, np.asarray(series.x, float))
        return self._areas(scene, series, frames=self._frames, factor=self._factor)

    def _areas(self, scene: Scene, series: Series, *, frames: Predictor, factor: int) -> Array:
        """Return areas by the reference segmentation of predicted frames, pixels that many times as large [mm^2]."""
        held = series.held
        force = np.full(len(series), held.get("force_N", DEFAULT_FORCE_N))
        voltage = np.full(len(series), held.get("voltage_V", self.scene.leds.voltage_V))
        time = np.full(len(series), held.get("time_s", 0.0))
        if series.x_name == "displacement":
            force = self._force(scene, np.asarray(series.x, float))
        else:
            {"force": force, "voltage": voltage, "time": time}[series.x_name][:] = series.x
        reading = AreaReading(
            threshold=held.get("threshold", AreaReading.threshold),
            # Pixels of the critic's camera are larger, the blur's are the lab's.
            blur_px=held.get("blur_px", AreaReading.blur_px) / factor,
            min_blob_mm2=held.get("min_blob_mm2", AreaReading.min_blob_mm2),
        )
        found = []
        for f, v, t in zip(force, voltage, time, strict=True):
            view = View(kind="press", force_N=float(f), voltage_V=float(v), time_s=float(t))
            frame = np.rint(frames.picture(scene, view, Nuisances())).astype(np.uint8)
            found.append(contact_area(frame, frames.scene, reading))
        return np.maximum(np.array(found) * self._card_scale(scene), LEAST_AREA_MM2)

    def _card_scale(self, scene: Scene) -> float:
        """Return what areas are off by, where the square that set mm^2 per pixel has not the side it is believed to."""
        rig, _ = solve_contact(scene, None, seed=0)
        return (self.scene.card.square_side_mm / rig.card.square_side_mm) ** 2

    def _force(self, scene: Scene, depth_mm: Array) -> Array:
        """Return the noted force at depths, by turning the law's depth at forces around [N]."""
        forces, depths = [], []
        for force in FORCES_FOR_DEPTH:
            try:
                _, state = solve_contact(scene, float(force), seed=0)
            except InputError:
                continue  # beyond what the law knows
            if state is not None and np.isfinite(state.depth):
                forces.append(float(force))
                depths.append(float(state.depth))
        if len(forces) < 2:
            raise InputError(
                "has no depth", key="contact.law", allowed="a law with a depth, for series of displacement"
            )
        order = np.argsort(depths)
        log_force = np.interp(depth_mm, np.array(depths)[order], np.log(np.array(forces)[order]))
        return np.maximum(np.exp(log_force), LEAST_FORCE_N)


@dataclass(frozen=True)
class SeriesFit:
    """One model fitted to the series.

    Attributes
    ----------
    ids : tuple of str
        Effects; empty for the believed rig.
    parameters : tuple of Parameter
    point : mapping
    predicted : ndarray (points,)
        Logarithm.
    covariance : ndarray (parameters, parameters)
    chi_square : float
        Of the data alone.
    log_evidence : float
        Laplace's, without the part that all models share.
    left_out : ndarray (points,)
        Log predictive density of each point from the others [nats].
    """

    ids: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    point: Mapping[str, float]
    predicted: Array
    covariance: Array
    chi_square: float
    log_evidence: float
    left_out: Array

    @property
    def within_bounds(self) -> bool:
        """Whether no parameter has been pushed to its bound."""
        return all(
            p.bounds[0] + 1e-3 * p.deviation < self.point[p.name] < p.bounds[1] - 1e-3 * p.deviation
            for p in self.parameters
        )


Prediction = Callable[[Point], Array]


def fit_series(
    predict: Prediction, table: Table, ids: tuple[str, ...], parameters: Sequence[Parameter], start: Point
) -> SeriesFit:
    """Fit parameters with their priors to the series.

    Parameters
    ----------
    predict : callable
        From a point to log values (points,).
    table : Table
    ids : tuple of str
    parameters : sequence of Parameter
    start : mapping
        Values to start from; null where it has none.
    """
    names = [p.name for p in parameters]
    null, deviation = (np.array([getattr(p, n) for p in parameters]) for n in ("null", "deviation"))
    low, high = (np.array([p.bounds[k] for p in parameters]) for k in (0, 1))

    def at(values: Array) -> dict[str, float]:
        return dict(zip(names, map(float, values), strict=True))

    def residual(values: Array) -> Array:
        left = (table.log_y - predict(at(values))) / table.sigma
        return np.concatenate([left, (null - values) / deviation])

    def jacobian(values: Array) -> Array:
        columns = []
        for k, p in enumerate(parameters):
            up, down = values.copy(), values.copy()
            up[k], down[k] = min(values[k] + p.step, high[k]), max(values[k] - p.step, low[k])
            columns.append((residual(up) - residual(down)) / (up[k] - down[k]))
        return np.array(columns).T

    if not names:
        found = np.zeros(0)
        slopes = np.zeros((table.log_y.size, 0))
    else:
        first = np.clip([start.get(n, float(v)) for n, v in zip(names, null, strict=True)], low, high)
        # On a bound there is no room for a derivative's two sides.
        first = np.clip(first, low + 1e-6 * (high - low), high - 1e-6 * (high - low))
        solved = optimize.least_squares(
            residual, first, jac=jacobian, bounds=(low, high), x_scale=deviation, max_nfev=9, ftol=1e-3, xtol=1e-3
        )
        found = solved.x
        slopes = -solved.jac[: table.log_y.size]
    predicted = predict(at(found))
    return _summary(table, ids, tuple(parameters), at(found), predicted, slopes, (found - null) / deviation)


def _summary(
    table: Table,
    ids: tuple[str, ...],
    parameters: tuple[Parameter, ...],
    point: Point,
    predicted: Array,
    slopes: Array,
    pulls: Array,
) -> SeriesFit:
    """Return a fit with evidence and left-out densities from its whitened slopes (points, parameters)."""
    deviation = np.array([p.deviation for p in parameters])
    left = (table.log_y - predicted) / table.sigma
    precision = slopes.T @ slopes + np.diag(1.0 / deviation**2)
    covariance = np.linalg.inv(precision) if parameters else np.zeros((0, 0))
    leverage = np.einsum("ij,jk,ik->i", slopes, covariance, slopes) if parameters else np.zeros(left.size)
    free = np.clip(1.0 - leverage, 1e-6, None)
    # A linear model's left-out residual is r/(1 - h), its variance 1/(1 - h) (Allen 1974).
    left_out = -0.5 * (left**2 / free) + 0.5 * np.log(free) - np.log(table.sigma) - 0.5 * np.log(2 * np.pi)
    occam = 0.5 * np.linalg.slogdet(precision * np.outer(deviation, deviation))[1] if parameters else 0.0
    evidence = -0.5 * float((left**2).sum()) - 0.5 * float((pulls**2).sum()) - float(occam)
    return SeriesFit(
        ids, parameters, point, predicted, covariance, float((left**2).sum()), evidence, np.asarray(left_out)
    )


def alike(a: SeriesFit, b: SeriesFit, table: Table, limit: float) -> bool:
    """Tell whether two fitted models differ by less than ``limit`` in squared whitened distance."""
    return float((((a.predicted - b.predicted) / table.sigma) ** 2).sum()) < limit


def gain_of(fit: SeriesFit, base: SeriesFit) -> tuple[float, float]:
    """Return the left-out log score over another model's, and its standard error [nats]."""
    difference = fit.left_out - base.left_out
    return float(difference.sum()), float(np.sqrt(difference.size) * difference.std(ddof=1))


def chi_square_p(fit: SeriesFit, table: Table) -> float:
    """Return the probability that noise alone misfits as much; runs of one sign count, too (Fisher's combination)."""
    p = float(stats.chi2.sf(fit.chi_square, table.log_y.size - len(fit.parameters)))
    sign = table.log_y > fit.predicted
    up, down = int(sign.sum()), int((~sign).sum())
    if min(up, down) == 0:
        runs_p = 2.0 * 0.5**sign.size
    else:
        mean = 2 * up * down / sign.size + 1
        spread = np.sqrt(max((mean - 1) * (mean - 2) / (sign.size - 1), 1e-9))
        runs = 1 + int((sign[1:] != sign[:-1]).sum())
        runs_p = float(stats.norm.cdf((runs + 0.5 - mean) / spread))
    return float(stats.combine_pvalues([max(p, 1e-300), min(max(runs_p, 1e-12), 1.0)])[1])


def pairs_of(fits: Sequence[SeriesFit], most: int) -> list[tuple[SeriesFit, SeriesFit]]:
    """Return all pairs of the few single causes with the largest evidence."""
    best = sorted(fits, key=lambda f: -f.log_evidence)[:most]
    return list(itertools.combinations(best, 2))
