"""Errors of form of fitted effects: shares by what is left, and intervals that hold the truth because of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import development_rigs as rigs
import numpy as np
import pytest

from evanesce.bundle import read_bundle
from evanesce.inference.calibration.fit import LOAD, _loads, _sizes_known
from evanesce.inference.calibration.form_error import form_errors, form_rows
from evanesce.inference.calibration.intervals import intervals
from evanesce.inference.causes import causes_of
from evanesce.inference.data import data_vector
from evanesce.inference.discrepancy import Discrepancy
from evanesce.inference.joint import Fitter
from evanesce.inference.joint_fit import JointFit, Taken
from evanesce.inference.model import AnchoredModel
from evanesce.prediction.observe import observe

KEY, TRUE = "modulus:relative", 0.1


@pytest.fixture(scope="module")
def model(tmp_path_factory: Any) -> AnchoredModel:
    folder: Path = tmp_path_factory.mktemp("rigs") / "tiny"
    rigs.write_rig("tiny", folder)
    observation = observe(read_bundle(folder))
    return AnchoredModel(observation, data_vector(observation))


def fitted(model: AnchoredModel, share: float) -> JointFit:
    """Draw frames of a stiffer finger whose change of light is off by a wave over the frame, and fit the stiffness."""
    stiffer, nominal = (np.nan_to_num(model.cube(point)) for point in ({KEY: TRUE}, {}))
    cols = stiffer.shape[2]
    wave = np.sqrt(2.0) * np.cos(np.pi * (np.arange(cols) + 0.5) / cols)
    noise = model.data.sd * np.random.default_rng(3).standard_normal(stiffer.shape)
    model.data = replace(model.data, cube=stiffer + share * (stiffer - nominal) * wave + noise)
    cause = next(c for c in causes_of(model.observation)[0] if c.id == "modulus")
    fitter = _sizes_known(Fitter(model))
    return fitter.fitted([Taken(cause, cause.parameters)], {}, metric=fitter.jitter_metric({}))


def test_a_form_that_is_right_has_next_to_no_error(model: AnchoredModel) -> None:
    """Below the least share that is tried: the others are improbable, not impossible."""
    found = fitted(model, 0.0)
    rows, shares = form_errors(Discrepancy(model), found)
    assert 0.0 <= shares["modulus"] < 0.01
    within, alone = intervals(found, rows)[KEY], intervals(found, rows[:0])[KEY]
    assert alone.low < TRUE < alone.high
    assert within.high - within.low < 2.0 * (alone.high - alone.low)


def test_an_interval_holds_the_truth_though_the_form_is_wrong(model: AnchoredModel) -> None:
    found = fitted(model, 0.1)
    rows, shares = form_errors(Discrepancy(model), found)
    assert 0.02 < shares["modulus"] <= 0.2
    within, alone = intervals(found, rows)[KEY], intervals(found, rows[:0])[KEY]
    assert within.low < TRUE < within.high
    assert not alone.low < TRUE < alone.high


def test_rows_of_a_form_are_as_large_as_its_change(model: AnchoredModel) -> None:
    """Their outer products have the change's own square at each place, but for what waves vary about it."""
    change = np.nan_to_num(model.cube({KEY: TRUE}) - model.cube({}))
    rows, own = form_rows(model.data, change), model.data.whitened(change)
    assert float(np.square(rows).sum()) == pytest.approx(float(np.square(own).sum()), rel=0.5)
    assert not form_rows(model.data, np.zeros_like(change)).any()


def test_loads_of_single_frames_are_errors_and_no_figures(model: AnchoredModel) -> None:
    found = fitted(model, 0.0)
    assert any(p.name.startswith(LOAD) for p in Fitter(model).jitter)
    assert not any(p.name.startswith(LOAD) for p in _sizes_known(Fitter(model)).jitter)
    loads = _loads(model, found)
    assert len(loads) == sum(model.data.views[k].touches for k in model.data.open)
    narrow, wide = intervals(found, loads[:0])[KEY], intervals(found, loads)[KEY]
    # 0.3 % of load is 0.3 % of stiffness, less the root of how many frames there are
    assert wide.high - wide.low > 1.2 * (narrow.high - narrow.low)
