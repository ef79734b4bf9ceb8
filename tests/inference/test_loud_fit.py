"""Fits that begin far off: steps in units of the priors, dark frames first, errors of the light by what is left."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import development_rigs as rigs
import numpy as np
import pytest

from evanesce.bundle import read_bundle
from evanesce.inference.calibration.area_start import area_start
from evanesce.inference.calibration.own_error import (
    OwnError,
    alike,
    at_first,
    light_of,
    own_errors,
    reweighed,
    voltage_rows,
    with_errors,
)
from evanesce.inference.causes import causes_of
from evanesce.inference.dark_start import dark_start
from evanesce.inference.data import DataVector, data_vector
from evanesce.inference.gauss_newton import RADIUS, Prior, bounded_step, fit, step_within
from evanesce.inference.joint import Fitter
from evanesce.inference.model import AnchoredModel
from evanesce.inference.patch import PlateReader
from evanesce.inference.removal import Removal, everything_marginalised
from evanesce.inference.trials import Trials
from evanesce.prediction.linear import Metric
from evanesce.prediction.nuisance import nuisance_parameters
from evanesce.prediction.observe import observe
from evanesce.prediction.predict import Predictor


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

    def jacobian(v: Any, predicted: Any, width: Any) -> Any:
        slope = 1e3 / np.cosh(v[0] * x + v[1] * (x + 0.02 * x**2)) ** 2
        return np.array([slope * x, slope * (x + 0.02 * x**2)]), predicted

    true = np.array([1.0, 1.0])
    data, none = predict(true), Metric.of(np.zeros((0, 50)), np.zeros(0))
    prior = Prior(np.zeros(2), np.ones(2), np.full(2, -np.inf), np.full(2, np.inf))
    rows, _ = jacobian(np.zeros(2), None, None)
    free = bounded_step(rows @ rows.T, rows @ data, prior.low, prior.high)
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


def test_the_covered_lens_says_how_a_black_level_is_entered(model: AnchoredModel) -> None:
    """A camera of little noise, black as the scale goes: by its derivative there, which is that of one side alone."""
    causes, _ = causes_of(model.observation)
    model = AnchoredModel(model.observation, replace(model.data, scale=0.02))
    fitter = Fitter(model)
    base = fitter.relinearised([], {})

    def entered(**keys: Any) -> Removal:
        trials = Trials(fitter, causes, SimpleNamespace(departures=lambda cause: []), **keys)  # type: ignore[arg-type]
        found = trials._entered(base, "black_level", *everything_marginalised(base))
        assert found is not None
        return found

    straight, shown = entered(), entered(shown=partial(dark_start, model))
    name = "black_level:offset_DN"
    assert straight.entry.point(straight.coordinates)[name] < 7.0
    assert shown.entry.point(shown.coordinates)[name] == pytest.approx(8.0, abs=0.7)
    assert shown.removed > straight.removed


def test_an_edge_that_is_pixels_away_is_found_by_forms_drawn_as_far_off(model: AnchoredModel) -> None:
    """A finger half as stiff again: the derivative by its modulus moves light at the edge that is believed."""
    causes, _ = causes_of(model.observation)
    fitter, name = Fitter(model), "modulus:relative"
    fitter.observed = model.vector({name: 0.5})
    base = fitter.relinearised([], {})
    row = model.vector({name: 0.3}) - model.vector({})

    def promised(drawn: Any) -> Removal:
        trials = Trials(fitter, causes, SimpleNamespace(departures=lambda cause: drawn))  # type: ignore[arg-type]
        entered = trials._entered(base, "modulus", *everything_marginalised(base))
        assert entered is not None
        return entered

    straight, along = promised([]), promised([({name: 0.3}, row)])
    assert straight.removed < 0.2 * base.misfit
    assert along.removed > 0.6 * base.misfit
    assert along.entry.point(along.coordinates)[name] == pytest.approx(0.5, abs=0.1)


@pytest.fixture(scope="module")
def drawn_errors(model: AnchoredModel) -> Any:
    """Return frames drawn with errors at other voltages and of the level besides noise, as a function of both."""

    def drawn(voltage: float, level_DN: float) -> DataVector:
        data, cube = model.data, np.nan_to_num(model.cube({}))
        rng = np.random.default_rng(6)
        lit = np.array([view.touches for view in data.views])[:, None, None]
        volts = np.array([view.voltage_V for view in data.views])
        most = np.median(volts[lit[:, 0, 0]])
        # Brighter and darker by turns, each by the whole size: then that is their standard deviation.
        off = {v: voltage * sign for v, sign in zip(sorted(set(volts) - {most}), (1, -1, 1, -1, 1, -1), strict=False)}
        share = np.array([off.get(v, 0.0) for v in volts])[:, None, None]
        # Of the model's own light: the finger of the data is softer, and its rim lies elsewhere.
        error = share * light_of(replace(data, cube=cube)) + level_DN * rng.standard_normal(cube.shape)
        return replace(data, cube=cube + data.sd * rng.standard_normal(cube.shape) + np.where(lit, error, 0.0))

    return drawn


@pytest.mark.parametrize(("voltage", "level_DN"), [(0.1, 0.0), (0.0, 2.0), (0.05, 1.0)])
def test_errors_of_the_light_are_as_large_as_what_is_left_says(
    model: AnchoredModel, drawn_errors: Any, voltage: float, level_DN: float
) -> None:
    data = drawn_errors(voltage, level_DN)
    found = own_errors(data, model.cube({}))
    assert found["presses"].voltage == pytest.approx(voltage, rel=0.4, abs=0.01)
    assert found["presses"].level_DN == pytest.approx(level_DN, rel=0.3, abs=0.3)
    assert not found["dark frames"]
    weighed = with_errors(data, found)
    left = weighed.whitened(data.cube - model.cube({}))
    rows = voltage_rows(weighed, found, left.size)
    assert len(rows) == (len({v.voltage_V for v in data.views if v.touches}) - 1 if found["presses"].voltage else 0)
    metric = Metric.of(rows, np.ones(len(rows)))
    assert 0.8 < float(metric.project(left) @ left) / left.size < 1.2
    assert alike(weighed, with_errors(data, found))
    assert ("%" in found["presses"].sentence("presses")) is (found["presses"].voltage > 0)


def test_noise_alone_is_no_error_of_the_light(model: AnchoredModel, drawn_errors: Any) -> None:
    data = drawn_errors(0.0, 0.0)
    found = own_errors(data, model.cube({}))
    assert not any(found.values())
    assert with_errors(data, found) is data
    assert at_first(found)["dark frames"] == OwnError()


def test_rows_weighed_anew_are_those_of_the_new_weights(model: AnchoredModel, drawn_errors: Any) -> None:
    before = with_errors(model.data, {"presses": OwnError(0.1, 1.0), "cards": OwnError(0.0, 2.0)})
    after = with_errors(model.data, {"presses": OwnError(0.0, 0.3)})
    change = np.random.default_rng(2).standard_normal(model.data.cube.shape)
    found = reweighed(before.whitened(change)[None], before, after)
    assert found is not None
    assert found[0] == pytest.approx(after.whitened(change))
    # A series that follows the bins keeps its own weight.
    longer = reweighed(np.append(before.whitened(change), 3.0)[None], before, after)
    assert longer is not None
    assert longer[0] == pytest.approx(np.append(found[0], 3.0))


def test_stiffness_is_begun_with_where_areas_show_it(model: AnchoredModel) -> None:
    """The frames are predicted with another finger and half the light: areas say the finger, whatever the light is."""
    causes, _ = causes_of(model.observation)
    true = {"modulus:relative": 0.3, "force_offset:offset_N": 0.1}
    views = range(len(model.data.views))
    dimmer = np.array([model.coarse.image({**true, "@light": np.log(0.5)}, k) for k in views])
    seen = AnchoredModel(replace(model.observation, images=dimmer), model.data)
    found = area_start(seen, {}, [c for c in causes if c.id in ("modulus", "force_offset")])
    assert set(found) == set(true)
    assert found["modulus:relative"] == pytest.approx(0.3, abs=0.05)
    plate = PlateReader(model.observation.scene)
    for k, view in enumerate(model.data.views):
        if view.kind == "press":
            there, here = plate.patch(dimmer[k]), plate.patch(model.coarse.image(found, k))
            assert there is not None
            assert here is not None
            assert here.area_mm2 == pytest.approx(there.area_mm2, rel=0.015)
    assert area_start(seen, {}, []) == {}


def test_ink_that_is_no_darker_than_believed_is_no_cause(model: AnchoredModel) -> None:
    """What glass mirrors on a card is up to its surroundings: a nuisance, in units of what lights the card."""
    view = replace(model.data.views[0], kind="checkerboard", force_N=None)
    coarse = Predictor(model.observation.scene, [view])
    assert "@card_veil[checkerboard]" in [p.name for p in nuisance_parameters([view], 0.0)]
    frames = [coarse.image({"@card_veil[checkerboard]": veil}, 0) for veil in (-1.0, -0.05, 0.0, 0.05)]
    dark = [float(np.quantile(frame, 0.02)) for frame in frames]
    assert np.isfinite(frames[0]).all()
    assert dark[1] + 3.0 < dark[2] < dark[3] - 3.0
