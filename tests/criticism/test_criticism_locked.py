"""What a flexible term predicts of views that it never saw, and how the nuisances make way for it there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from evanesce.criticism.features import cosine_features
from evanesce.criticism.locked import flexible_part, locked_gain, without_numerics
from evanesce.criticism.numerics import EDGE
from evanesce.criticism.problem import Problem, fit
from evanesce.criticism.residuals import residuals_of
from evanesce.criticism.score import metric_of
from evanesce.criticism.unknown import fit_flexible
from evanesce.prediction.noise import noise_of
from evanesce.prediction.parameters import Parameter
from evanesce.prediction.views import View
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


class Effect(Toy):
    """A second map, that a rig the user believes in does not have."""

    def __init__(self, effect: np.ndarray) -> None:
        super().__init__(np.zeros(SHAPE))
        self.effect = effect

    def cube(self, point: Any, only: Any = None) -> np.ndarray:
        chosen = list(range(len(VIEWS)) if only is None else only)
        return super().cube(point, only) + np.where(
            np.isin(np.arange(len(VIEWS)), chosen)[:, None, None], point.get("e:a", 0.0) * self.effect, np.nan
        )

    def image(self, point: Any, view: int) -> np.ndarray:
        return self.cube(point, [view])[view]


def test_a_gain_is_not_hidden_behind_nuisances_of_computation() -> None:
    """A wrong model that takes 20 deviations of a nuisance of computation is no rig that anybody can render."""
    rng = np.random.default_rng(8)
    basis_y, basis_x = cosine_features(SHAPE)
    effect = np.outer(basis_y[1], basis_x[2])
    effect *= 2.0 / np.abs(effect).max()
    other = np.outer(basis_y[2], basis_x[1])
    # Half of the effect's power looks as an edge would that is in the wrong place.
    alike = 1.0 * effect + other * np.linalg.norm(effect) / np.linalg.norm(other)
    toy = Effect(effect)
    truth = np.broadcast_to(50.0 + effect, (len(VIEWS), *SHAPE))
    data = truth + rng.standard_normal(truth.shape)
    tone: Any = SimpleNamespace(variance_at=lambda level: np.ones_like(level))
    noise = noise_of({}, tone, SHAPE, floor_DN=1e-3, flicker=0.0)
    problem = Problem.of(toy, data, noise, np.zeros_like(data), OPEN, toy.cube({}))  # type: ignore[arg-type]
    template = np.broadcast_to(alike, truth.shape)
    edge = Parameter(name=EDGE, deviation=0.025, step=0.1, linear=True, views=tuple(range(7)), template=template)
    cause = Parameter(name="e:a", deviation=3.0, step=0.1)
    base, named = fit(problem, [edge], {}), fit(problem, [cause, edge], {})
    assert base.point[EDGE] > 10 * edge.deviation
    observation: Any = SimpleNamespace(locked=LOCKED, images=list(data))
    best: Any = SimpleNamespace(fitted=named, problem=problem)
    found = locked_gain(observation, problem, base, best, None)
    assert found is not None
    # The residual of the believed rig is the whole effect, its mean square over two, in bins whose noise is
    # one; what the fitted cause is off by costs next to nothing. Spread: that of a projection of the noise.
    sd = problem.sd[LOCKED]
    expected = 0.5 * float(np.sum((effect / sd) ** 2))
    assert found.log_score[0] == pytest.approx(expected, abs=4 * np.sqrt(2 * expected))
    assert EDGE not in without_numerics(problem, base).point
    nothing = locked_gain(observation, problem, base, None, None)
    assert nothing is not None
    assert nothing.log_score == (0.0, 0.0, 0.0)


def test_an_extension_predicts_locked_views_by_what_it_was_fitted_by() -> None:
    """A loud cause is fitted by pictures made anew where it ended; with the quick ones its gain would be another."""
    rng = np.random.default_rng(11)
    basis_y, basis_x = cosine_features(SHAPE)
    quick = np.outer(basis_y[1], basis_x[2])
    quick *= 3.0 / np.abs(quick).max()
    bent = np.outer(basis_y[2], basis_x[3])
    bent *= 1.5 / np.abs(bent).max()
    toys = [Effect(quick), Effect(quick + bent)]
    truth = np.broadcast_to(50.0 + quick + bent, (len(VIEWS), *SHAPE))
    data = truth + 0.25 * rng.standard_normal(truth.shape)  # a bin is the mean of 16 pixels
    tone: Any = SimpleNamespace(variance_at=lambda level: np.ones_like(level))
    noise = noise_of({}, tone, SHAPE, floor_DN=1e-3, flicker=0.0)
    problems = [Problem.of(t, data, noise, np.zeros_like(data), OPEN, t.cube({})) for t in toys]  # type: ignore[arg-type]
    cause = Parameter(name="e:a", deviation=3.0, step=0.1)
    base = fit(problems[0], [Parameter(name="@n", deviation=1.0, step=0.1)], {})
    observation: Any = SimpleNamespace(locked=LOCKED, images=list(data))
    gains = []
    for own in problems:
        best: Any = SimpleNamespace(fitted=fit(own, [cause], {}), problem=own)
        found = locked_gain(observation, problems[0], base, best, None)
        assert found is not None
        gains.append(found.log_score[0])
    sd = problems[0].sd[LOCKED]
    more = 0.5 * float(np.sum((bent / sd) ** 2))
    assert gains[1] - gains[0] == pytest.approx(more, abs=4 * np.sqrt(2 * more))
