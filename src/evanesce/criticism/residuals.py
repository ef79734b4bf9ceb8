"""From a fit to what the battery looks at: whitened cubes with their covariates, and noise treated in the same way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.contact.solve import contact_state
from evanesce.core.errors import InputError
from evanesce.criticism.battery_data import Draws, Residuals
from evanesce.criticism.problem import Fit, Problem
from evanesce.criticism.score import metric_of
from evanesce.optics.projection import Projection
from evanesce.prediction.noise import chunks
from evanesce.prediction.predict import Point
from evanesce.prediction.views import BIN_PX, View, binned
from evanesce.rig import Scene

Array = NDArray[Any]

CHUNK = 37
"""Draws at a time."""


def residuals_of(problem: Problem, fitted: Fit) -> Residuals:
    """Return a fit's residuals with all that the battery asks of their places and conditions."""
    cube = problem.unwhitened(fitted.residual).astype(np.float32)
    return with_places(problem, fitted.point, problem.views, fitted.predicted, cube)


def with_places(problem: Problem, point: Point, chosen: Sequence[int], predicted: Array, cube: Array) -> Residuals:
    """Return whitened residuals of some views with their places and conditions.

    Parameters
    ----------
    problem : Problem
    point : mapping
        At which the finger stands.
    chosen : sequence of int
        Numbers of the views.
    predicted : ndarray (all views, rows, cols)
        [DN].
    cube : ndarray (chosen views, rows, cols)
    """
    scene, places = problem.predictor.scene, list(chosen)
    views = tuple(problem.predictor.views[k] for k in places)
    x, y = bin_places(scene)
    level = predicted[places]
    down, right = np.gradient(level, axis=(1, 2))
    rows, cols = x.shape
    projection = Projection.of(scene.camera, scene.plate)
    u, v = (np.arange(n) * BIN_PX + (BIN_PX - 1) / 2 for n in (cols, rows))
    from_axis = np.hypot(u[None, :] - projection.principal_point[0], v[:, None] - projection.principal_point[1])
    return Residuals(
        cube=cube,
        valid=problem.valid[places],
        level=level,
        gradient=np.stack([right, down], axis=1),
        x_mm=x,
        y_mm=y,
        distance_mm=np.array([edge_distance(scene, v, point, x, y) for v in views]),
        radius=from_axis / (np.hypot(cols, rows) * BIN_PX / 2),
        covariates=covariates(views),
        kinds=tuple(v.kind for v in views),
        ridge=ridge_vector(scene),
    )


def covariates(views: tuple[View, ...]) -> dict[str, Array]:
    """Return what is known of each view's state; NaN where nothing touches."""
    return {
        "force_N": np.array([np.nan if v.force_N is None else v.force_N for v in views]),
        "voltage_V": np.array([v.voltage_V for v in views]),
        "time_s": np.array([v.time_s for v in views]),
        "displacement_mm": np.array([v.displacement_mm for v in views]),
    }


def bin_places(scene: Scene) -> tuple[Array, Array]:
    """Return the plate coordinates (rows, cols) [mm] of the bins' middles."""
    projection = Projection.of(scene.camera, scene.plate)
    rows, cols = projection.shape
    x, y = projection.to_plate(*np.meshgrid(np.arange(cols), np.arange(rows)))
    return binned(x), binned(y)


def edge_distance(scene: Scene, view: View, point: dict[str, float] | Any, x: Array, y: Array) -> Array:
    """Return the distance [mm] of plate points from the predicted edge of contact, positive outside; inf: none."""
    if not view.touches or view.force_N is None:
        return np.full(x.shape, np.inf)
    try:
        state = contact_state(scene, view.force_N, time_s=view.time_s if scene.slide is not None else 0.0)
    except InputError:
        return np.full(x.shape, np.inf)
    touching = np.asarray(state.contact_mask) > 0.5
    if not touching.any():
        return np.full(x.shape, np.inf)
    pitch = state.grid.pitch
    distance = (ndimage.distance_transform_edt(~touching) - ndimage.distance_transform_edt(touching)) * pitch
    dx, dy = (float(point.get(f"@pose_{axis}[{view.session}]", 0.0)) for axis in "xy")
    row, col = state.grid.index(x - dx, y - dy)
    near = ndimage.map_coordinates(distance, [row, col], order=1, mode="nearest")
    (rows, cols) = state.grid.shape
    beyond = np.hypot(
        np.maximum(np.maximum(-row, row - rows + 1), 0.0), np.maximum(np.maximum(-col, col - cols + 1), 0.0)
    )
    return np.asarray(near + beyond * pitch)


def ridge_vector(scene: Scene) -> Array | None:
    """Return the wave vector of parallel ridges [rad/mm]; None for others and for a smooth finger."""
    ridges = scene.finger.ridges
    if ridges is None or ridges.pattern != "parallel":
        return None
    along = np.deg2rad(ridges.orientation_deg)
    return np.array([-np.sin(along), np.cos(along)]) * (2 * np.pi / (1e-3 * ridges.pitch_um))


def noise_draws(problem: Problem, fitted: Fit, count: int, rng: np.random.Generator) -> Iterator[Draws]:
    """Yield draws of noise, and of nuisances by their priors, from which the fit took what it took from the data.

    A prior as narrow as the data are exact leaves a share of its nuisance in the residuals: light that flickers by two
    deviations of a frame's mean leaves twice as much of it as noise alone would.
    """
    metric = metric_of(fitted)
    shape = (len(problem.views), *problem.data.shape[1:])
    mask = problem.valid[list(problem.views)]
    for size in chunks(count, CHUNK):
        cubes = _drawn(problem, shape, size, rng)
        basis = metric.rows.astype(np.float32)
        rows = cubes[:, mask] + rng.standard_normal((size, len(basis)), np.float32) @ basis
        taken = np.linalg.solve(np.eye(len(basis)) + metric.rows @ metric.rows.T, (basis @ rows.T).astype(float))
        rows = rows - taken.T.astype(np.float32) @ basis
        cubes[:] = 0.0
        cubes[:, mask] = rows
        yield Draws(cubes)


def _drawn(problem: Problem, shape: tuple[int, int, int], count: int, rng: np.random.Generator) -> Array:
    """Return cubes (count, views, rows, cols) of whitened noise."""
    if problem.coded is None:
        return problem.noise.draws(shape, count, rng)
    chosen = list(problem.views)
    fields = problem.coded.every[:, chosen] / problem.sd[chosen].astype(np.float32)
    cubes = np.tensordot(problem.coded.drawn(count, rng).astype(np.float32), fields, 1)
    beside = (np.sqrt(problem.numerics) / problem.sd)[chosen].astype(np.float32)
    return np.asarray(cubes + beside * rng.standard_normal(cubes.shape, np.float32))
