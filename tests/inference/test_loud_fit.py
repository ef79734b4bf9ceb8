"""Fits that begin far off: steps in units of the priors, dark frames first, errors of the light by what is left."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import development_rigs as rigs
import numpy as np
import pytest

from evanesce.bundle import read_bundle
from evanesce.inference.calibration.own_error import own_error, told_error
from evanesce.inference.causes import causes_of
from evanesce.inference.dark_start import dark_start
from evanesce.inference.data import data_vector
from evanesce.inference.discrepancy import cosines
from evanesce.inference.gauss_newton import RADIUS, Prior, bounded_step, fit, step_within
from evanesce.inference.joint import Fitter
from evanesce.inference.model import AnchoredModel
from evanesce.prediction.linear import Metric
from evanesce.prediction.observe import observe


@pytest.fixture(scope="module")
def model(tmp_path_factory: Any) -> AnchoredModel:
    folder: Path = tmp_path_factory.mktemp("rigs") / "tiny"
    rigs.write_rig("tiny", folder)
    observation = observe(read_bundle(folder))
    return AnchoredModel(observation, data_vector(observation))


@pytest.mark.parametrize("radius", [0.01, 0.3, 2.0])
def test_a_step_goes_no_farther_than_its_radius_in_prior_deviations(radius: float) -> None:
    rng = np.random.default_rng(4)
    root, deviation = rng.standard_normal((9, 6)), np.geomspace(1e-3, 1e3, 6)
    precision, gradient = root.T @ root / np.outer(deviation, deviation), 5.0 * rng.standard_normal(6) / deviation
    low, high = np.full(6, -np.inf), np.full(6, np.inf)
    whole = bounded_step(precision, gradient, low, high)
    found = step_within(radius, deviation, whole, precision, gradient, low, high)
    assert np.abs(whole / deviation).max() > 2.0
    assert 0.9 * radius < np.abs(found / deviation).max() <= radius
    assert found @ gradient > 0
    assert step_within(1e9, deviation, whole, precision, gradient, low, high) is whole


def test_a_model_far_off_does_not_leave_its_priors_at_once() -> None:
    """Two figures of nearly one effect: the data promise most by far amounts of either, and bend before they get there.

    Without a radius the first trial lies beyond thirty deviations.
    """
    tried: list[Any] = []
    x = np.linspace(0.0, 1.0, 50)

    def predict(v: Any) -> Any:
        tried.append(v)
        return 1e3 * np.tanh(v[0] * x + v[1] * (x + 0.02 * x**2))

    def jacobian(v: Any, predicted: Any) -> Any:
        slope = 1e3 / np.cosh(v[0] * x + v[1] * (x + 0.02 * x**2)) ** 2
        return np.array([slope * x, slope * (x + 0.02 * x**2)])

    true = np.array([1.0, 1.0])
    data, none = predict(true), Metric.of(np.zeros((0, 50)), np.zeros(0))
    prior = Prior(np.zeros(2), np.ones(2), np.full(2, -np.inf), np.full(2, np.inf))
    free = bounded_step(jacobian(np.zeros(2), None) @ jacobian(np.zeros(2), None).T, jacobian(np.zeros(2), None) @ data,
                        prior.low, prior.high)  # fmt: skip
    assert np.abs(free).max() > 30
    tried.clear()
    found = fit(predict, jacobian, data, prior, np.zeros(2), metric=none, renewals=5)
    assert max(np.abs(v).max() for v in tried[:2]) <= RADIUS
    assert max(np.abs(v).max() for v in tried) < 10
    assert found.values.sum() == pytest.approx(2.0, abs=0.05)


def test_black_is_begun_with_where_the_covered_lens_shows_it(model: AnchoredModel) -> None:
    """The rig has 8 raw DN more black than believed: as brightness predicted at the black level has no derivative."""
    causes, _ = causes_of(model.observation)
    found = dark_start(model, {"@black": 0.9}, causes)
    assert found["black_level:offset_DN"] == pytest.approx(8.0, abs=0.5)
    assert found["@black"] == 0.0
    assert dark_start(model, {}, [c for c in causes if c.id != "black_level"]).keys() <= {
        "ambient_light:radiance_W_per_mm2_sr", "@black",
    }  # fmt: skip


@pytest.mark.parametrize("size", [0.0, 0.1])
def test_errors_of_the_light_are_as_large_as_what_is_left_says(model: AnchoredModel, size: float) -> None:
    data, fitter = model.data, Fitter(model)
    rng = np.random.default_rng(6)
    cube = model.cube({})
    wave = cosines(cube.shape[1:], 3)[4]
    lit = np.array([view.touches for view in data.views])[:, None, None]
    drawn = np.where(lit, cube * (1.0 + size * wave), cube) + data.sd * rng.standard_normal(cube.shape)
    fitter.observed = data.whitened(np.nan_to_num(drawn))
    start = {p.name: 0.0 for p in fitter.nuisances}
    fitted = fitter.fitted([], start, metric=fitter.jitter_metric(start), rounds=0)
    found = own_error(model, fitted)
    if size == 0.0:
        assert not any(found.strengths.values())
        assert found.rows.shape == (0, fitter.observed.size)
        return
    alike = "light, alike in all views"
    # One wave of nine has the strength of all: a random sum of nine with 0.1 times one of them is a third of that.
    assert found.strengths[alike] in (0.03, 0.1)
    assert found.strengths["level, each view's own"] == 0.0
    assert told_error(alike, 0.03) == f"{alike}: 3 %"
    again = replace(fitted, metric=fitted.metric.with_rows(found.rows))
    left = float(again.metric.project(again.residual) @ again.residual)
    # The drawn error goes by the level and not by the light, which the tone curve bends.
    assert left - fitter.observed.size < 0.1 * (fitted.misfit - fitter.observed.size)
