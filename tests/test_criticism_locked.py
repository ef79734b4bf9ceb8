"""What a flexible term predicts of views that it never saw, and how the nuisances make way for it there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from evanesce.criticism.features import cosine_features
from evanesce.criticism.locked import flexible_part
from evanesce.criticism.noise import noise_of
from evanesce.criticism.parameters import Parameter
from evanesce.criticism.problem import Problem, fit
from evanesce.criticism.residuals import residuals_of
from evanesce.criticism.score import metric_of
from evanesce.criticism.unknown import fit_flexible
from evanesce.criticism.views import View
from evanesce.rig import load_scene

SHAPE = (24, 32)
VIEWS = tuple(View(kind="press", force_N=0.8 + 0.6 * k, voltage_V=9.0, index=k, condition=k) for k in range(7))
OPEN, LOCKED = [0, 1, 3, 4, 6], [2, 5]


class Toy:
    """Fifty grey values and so much of one nuisance's map."""

    def __init__(self, nuisance: np.ndarray) -> None:
        self.scene = load_scene(
            "thesis",
            {
                "camera.resolution_px": [128, 96],
                "camera.scale_px_per_mm": 3.7,
                "camera.pixel.pitch_um": 48.9,
                "finger.position_mm": [1.3, -0.7],
            },
        )
        self.views, self.nuisance = VIEWS, nuisance

    def cube(self, point: Any, only: Any = None) -> np.ndarray:
        found = np.full((len(VIEWS), *SHAPE), np.nan)
        chosen = list(range(len(VIEWS)) if only is None else only)
        found[chosen] = 50.0 + point.get("@n", 0.0) * self.nuisance
        return found


def test_a_flexible_term_predicts_locked_views_and_nuisances_make_way() -> None:
    rng = np.random.default_rng(3)
    basis_y, basis_x = cosine_features(SHAPE)
    pattern = np.outer(basis_y[1], basis_x[2]) + 0.8 * np.outer(basis_y[3], basis_x[0])
    pattern *= 5.0 / np.abs(pattern).max()
    # A good part of what is unknown looks like the nuisance, which takes it until the term is there.
    nuisance = 0.35 * pattern + np.outer(basis_y[0], basis_x[1]) * 12.0
    toy = Toy(nuisance)
    truth = np.broadcast_to(50.0 + 0.4 * nuisance + pattern, (len(VIEWS), *SHAPE))
    data = truth + rng.standard_normal(truth.shape)
    tone: Any = SimpleNamespace(variance_at=lambda level: np.full_like(level, 16.0))
    noise = noise_of({}, tone, SHAPE, floor_DN=1e-3, flicker=0.0)
    problem = Problem.of(toy, data, noise, np.zeros_like(data), OPEN, toy.cube({}))  # type: ignore[arg-type]
    base = fit(problem, [Parameter(name="@n", deviation=3.0, step=0.1)], {})
    metric, mask = metric_of(base), problem.valid[OPEN]

    def project(cubes: np.ndarray) -> np.ndarray:
        found = np.zeros_like(cubes)
        found[:, mask] = metric.project(cubes[:, mask])
        return found

    flexible = fit_flexible(residuals_of(problem, base), problem.sd[OPEN], project)
    predicted = toy.cube(base.point, LOCKED)
    better = predicted + flexible_part(problem, base, flexible, predicted, LOCKED)
    before, after = (np.sqrt(np.mean((cube - truth)[LOCKED] ** 2)) for cube in (predicted, better))
    assert before > 0.8
    # Some eighty coefficients from 5 x 768 bins of unit noise, shrunk: a tenth of a grey value each bin.
    assert after < 0.25
    assert np.isnan(better[OPEN]).all()
