"""Errors of form of fitted effects: intervals that hold the truth because of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import development_rigs as rigs
import numpy as np
import pytest

from evanesce.bundle import read_bundle
from evanesce.inference.calibration.fit import EDGE_PX, LOAD, _edges, _sizes_known
from evanesce.inference.calibration.form_error import FORM_SHARE, form_errors, form_rows
from evanesce.inference.calibration.intervals import intervals
from evanesce.inference.causes import causes_of
from evanesce.inference.data import data_vector
from evanesce.inference.discrepancy import Discrepancy
from evanesce.inference.joint import Fitter
from evanesce.inference.joint_fit import JointFit, Taken
from evanesce.inference.model import AnchoredModel
from evanesce.prediction.linear import CovarianceRows
from evanesce.prediction.observe import observe

KEY, TRUE = "modulus:relative", 0.1


def no_rows(found: JointFit) -> Any:
    """Return no rows."""
    return CovarianceRows(np.zeros((0, found.residual.size), np.float32))


def rows_of(model: AnchoredModel, found: JointFit) -> CovarianceRows:
    """Return the rows of all causes' errors of form."""
    return CovarianceRows.joined(*Discrepancy(model, form_errors).tied(found).values())


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


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_an_interval_holds_the_truth_whether_the_form_is_right_or_not(model: AnchoredModel, share: float) -> None:
    """Alone it holds it where the form is right, and not where that is off by a tenth."""
    found = fitted(model, share)
    within, alone = (intervals(found, rows)[KEY] for rows in (rows_of(model, found), no_rows(found)))
    assert within.low < TRUE < within.high
    assert (alone.low < TRUE < alone.high) is (share == 0.0)
    # A form that may be off by 0.15 makes a change of 0.1 no less certain than that.
    assert within.high - within.low < 2.0 * 1.645 * FORM_SHARE * TRUE + (alone.high - alone.low)


def test_what_changes_nothing_has_no_errors(model: AnchoredModel) -> None:
    found = fitted(model, 0.0)
    # But for what finer pixels add
    assert len(rows_of(model, replace(found, point={**found.point, KEY: 0.0}))) == 1


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
    *loads, shift = _edges(model, found).dense()
    assert len(loads) == sum(model.data.views[k].touches for k in model.data.open)
    some = (no_rows(found), CovarianceRows(np.array(loads)), CovarianceRows(shift[None]))
    narrow, wide, shifted = (intervals(found, rows)[KEY] for rows in some)
    # 0.3 % of load is 0.3 % of stiffness, less the root of how many frames there are
    assert wide.high - wide.low > 1.2 * (narrow.high - narrow.low)
    # A contact whose radius is off by a share is as one of three times that share of stiffness.
    radius_px = np.sqrt(33.6 / np.pi) * model.observation.scene.camera.scale_px_per_mm
    assert shifted.high - shifted.low == pytest.approx(2 * 1.645 * 3.0 * EDGE_PX / radius_px, rel=0.3)
