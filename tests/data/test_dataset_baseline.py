"""A baseline on anybody's data set: features of known motion, and a detector that beats a constant."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.core.errors import InputError
from evanesce.dataset.config import KINDS
from evanesce.dataset.run import make
from evanesce.dataset.score import read_predictions, score
from evanesce.dataset.slip_baseline import HOLD, baseline, held_out
from evanesce.dataset.slip_features import WIDTH_PX, frame_features
from support.datasets import tiny_job

pytest.importorskip("sklearn")


def patch(shift: float = 0.0, inner: float = 0.0, cols: int = 160) -> np.ndarray:
    """Return a textured disc moved along x, its inner half by less, [DN]."""
    y, x = np.mgrid[:120, :cols].astype(float)
    r = np.hypot(x - 80 - shift, y - 60)
    moved = np.where(r < 22, inner, shift)
    texture = 0.5 + 0.25 * np.sin((x - moved) / 2.0) * np.cos(y / 2.5)
    return (255 * np.where(r < 40, 0.3 + 0.7 * texture, 0.02)).clip(0, 255).astype(np.uint8)


FIRST = 4
"""Features of a frame before those of its first lag."""


def test_features_are_the_motion_of_patch_and_skin():
    still = [patch()] * 8
    moved = frame_features([*still, patch(0.6, 0.0)])
    radius, (motion, growth), change = moved[-1][0], moved[-1][FIRST : FIRST + 2], moved[-1][FIRST + 4 : FIRST + 9]
    share_moved, core, rim = moved[-1][FIRST + 14], *moved[-1][FIRST + 17 : FIRST + 19]
    assert radius == pytest.approx(40.0, rel=0.03)
    assert motion == pytest.approx(0.6, abs=0.1)
    assert growth == pytest.approx(0.0, abs=0.1)
    assert np.all(np.diff(change) >= 0.0)
    assert core < 0.05
    assert rim == pytest.approx(0.6, abs=0.1)
    # skin beyond a radius of 22 px moves, of 40 px less the edge
    assert share_moved == pytest.approx(1.0 - (22.0 / 38.0) ** 2, abs=0.1)
    assert np.abs(moved[5][FIRST:]).max() < 1e-3


def test_a_lit_room_is_no_contact_and_a_contact_that_appears_has_not_moved():
    rng = np.random.default_rng(3)
    room = [np.clip(rng.normal(50.0, 2.0, (120, 160)), 0, 255).astype(np.uint8) for _ in range(8)]
    found = frame_features(room)
    assert not found[:, 0].any()
    touched = [np.where(patch() > 40, patch(), frame) for frame in room[:3]]
    assert not frame_features([*room, touched[0]])[-1][FIRST:].any()
    assert frame_features([*room, touched[0]])[-1][0] == pytest.approx(40.0, rel=0.03)


def test_features_look_back_as_long_at_any_rate_and_do_not_look_ahead():
    frames = [patch(0.1 * k, 0.05 * k) for k in range(14)]
    slow, fast = frame_features(frames), frame_features([f for f in frames for _ in range(2)], 60.0)
    np.testing.assert_allclose(fast[1::2][8:], slow[8:], atol=1e-9)
    np.testing.assert_array_equal(frame_features(frames[:9]), slow[:9])
    wide = cv2.resize(frames[0], None, fx=2.5, fy=2.5)
    assert frame_features([wide])[0][0] == pytest.approx(40.0 * WIDTH_PX / 160, rel=0.05)


def test_predictions_held_out_come_from_other_friction_and_other_rigs():
    class Remembers:
        """Predicts the share of its training frames that have the asked frame's friction or rig."""

        def fit(self, x, y):
            self.seen = x
            return self

        def predict(self, x):
            return np.array([(self.seen == row).any(axis=1).mean() for row in x])

    friction, rig = (values.ravel() for values in np.meshgrid(np.linspace(0.3, 0.9, 9), np.arange(4.0)))
    x, trial = np.stack([friction, 10.0 + rig], axis=1), np.arange(36)
    assert not held_out(Remembers(), x, np.ones(36), friction, rig.astype(int), trial).any()
    # one rig: trials; one friction: rigs alone
    assert not held_out(
        Remembers(), np.stack([friction, 10.0 + trial], 1), np.ones(36), friction, 0 * trial, trial
    ).any()
    assert not held_out(Remembers(), 10.0 + rig[:, None], np.ones(36), np.ones(36), rig.astype(int), trial).any()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    job = tiny_job(
        24 * 12, 5, trial={"frames": 24, "frame_rate_hz": 15.0}, trials_per_shard=4,
        kinds={**dict.fromkeys(KINDS, 0.0), "slide": 0.7, "load_stop": 0.3},
        labels={"grid_samples": 96, "grid_size_mm": 12.0, "frame": (), "plate": ()},
        finger={"ridged_share": 1.0}, rig={"count": 4, "draw": {"camera.exposure_ms": {"uniform": (0.02, 0.04)}}},
        split={"validation": 0.0, "test": 0.25},
    )  # fmt: skip
    found = tmp_path_factory.mktemp("baseline") / "d"
    make(found, job)
    return found


@pytest.mark.slow  # 18 s: makes 288 frames and trains twice
def test_a_detector_learns_the_stick_ratio(folder, tmp_path):
    out, report = tmp_path / "p.csv", tmp_path / "r.json"
    result = CliRunner().invoke(app, ["dataset", "baseline", str(folder), "--out", str(out), "--json", str(report)])
    assert result.exit_code == 0, result.output
    found = json.loads(report.read_text())
    rows = {row["split"]: row for row in found["splits"]}
    assert rows["train"]["stick_ratio_error"] < 0.1
    assert rows["test"]["stick_ratio_error"] < 0.8 * found["constant_error"]
    # the file is judged as any detector's
    again = score(folder, read_predictions(out), threshold=found["threshold"], hold=HOLD)
    assert [row.as_dict()["found"] for row in again] == [row["found"] for row in found["splits"]]
    # and the same data set gives the same detector
    other = baseline(folder)
    assert other.threshold == pytest.approx(found["threshold"], rel=1e-12)


def test_too_few_trials_are_refused(tmp_path):
    make(tmp_path / "d", tiny_job(12, 5))
    with pytest.raises(InputError, match=r"training split.*allowed: at least 4"):
        baseline(tmp_path / "d")
