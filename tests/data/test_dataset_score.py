"""Predictions scored by hand; what a file of predictions must not be."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce import dataset
from evanesce.cli.app import app
from evanesce.core.errors import InputError
from evanesce.dataset.run import make
from evanesce.dataset.score import _scored, read_predictions, score
from evanesce.dataset.slip_scores import Series
from support.datasets import tiny_job


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("score") / "d"
    kinds = {"slide": 1.0, **dict.fromkeys(("wiggle", "rotation", "ramp", "release", "change", "load_stop"), 0.0)}
    make(folder, tiny_job(frames=96, trial={"frames": 24, "frame_rate_hz": 20.0}, kinds=kinds, trials_per_shard=2))
    return folder


def write(path, rows):
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    return path


def truth_rows(folder, late=0):
    """Return a perfect detector, ``late`` frames behind."""
    rows = [("key", "slip", "stick_ratio")]
    with dataset.open(folder) as data:
        for indices in data.trials().values():
            ratio = [data[i].scalars["stick_ratio"] for i in indices]
            for k, i in enumerate(indices):
                seen = ratio[max(k - late, 0)]
                rows.append((data[i].key, 1.0 - seen, ratio[k]))
    return rows


def test_a_perfect_detector_has_no_error_and_a_late_one_its_lateness(folder, tmp_path):
    for late in (0, 2):
        file = write(tmp_path / f"{late}.csv", truth_rows(folder, late))
        every = score(folder, read_predictions(file), threshold=0.05)[-1]
        assert (every.split, every.trials) == ("all", 4)
        assert every.slips == every.found >= 3
        assert every.onset_error_ms == pytest.approx(50.0 * late, abs=1e-6)  # frames of 50 ms
        assert every.onset_bias_ms == pytest.approx(50.0 * late, abs=1e-6)
        assert every.stick_ratio_error == 0.0
        if not late:
            assert every.false_per_minute == 0.0


def test_every_slip_counts_and_an_alarm_that_is_kept_up_is_false():
    """Three slips of 0.5 s, 0.5 s apart: an alarm that never ends finds the first and is false wherever all sticks."""
    time = np.arange(60) / 20.0
    stick = np.where((time * 2).astype(int) % 2, 0.4, 1.0)
    seen = stick < 0.9
    evidences = {
        "latch": time >= 0.5, "good": seen, "slack": np.append(False, seen[:-1]), "early": np.append(seen[1:], True),
        "too early": np.append(seen[4:], [True] * 4), "blinking": np.arange(60) % 2 == 0,
    }  # fmt: skip
    alarms = {}
    for name, evidence in evidences.items():
        one = Series(time, np.where(evidence, 1.0, 0.0), stick, 0.5, math.nan)
        alarms[name] = _scored("all", [(one, np.zeros(60), np.ones(60, bool))], 1)
    assert {alarms[n].slips for n in alarms} == {3}
    assert {n: alarms[n].found for n in alarms} == {
        "latch": 1, "good": 3, "slack": 3, "early": 3, "too early": 0, "blinking": 3
    }  # fmt: skip
    minutes = 1.5 / 60.0
    # of 15 frames in which all sticks before a slip the last two are the slip's
    wrong = {"latch": 2, "good": 0, "slack": 0, "early": 0, "too early": 3, "blinking": 12}
    assert {n: alarms[n].false_per_minute * minutes for n in alarms} == pytest.approx(wrong)
    assert alarms["slack"].onset_bias_ms == pytest.approx(50.0)
    assert alarms["early"].onset_bias_ms == pytest.approx(-50.0)


def test_errors_and_false_alarms_by_hand(folder, tmp_path):
    rows = truth_rows(folder)
    with dataset.open(folder) as data:
        scalars = [data[i].scalars for i in range(len(data))]
        step, still = 1 / 20.0, [s["stick_ratio"] >= 0.95 for s in scalars]
        first = next(i for i in range(1, len(data)) if still[i] and still[i - 1] and still[i + 1])
    wrong = [rows[0]]
    wrong += [(key, 1.0 if i == first else 0.0, float(np.clip(ratio - 0.1, 0, 1))) for i, (key, _, ratio) in
              enumerate(rows[1:])]  # fmt: skip
    every = score(folder, read_predictions(write(tmp_path / "w.csv", wrong)))[-1]
    assert every.found == 0
    assert np.isnan(every.onset_error_ms)
    assert every.minutes == pytest.approx(sum(still) * step / 60.0)
    assert every.false_per_minute == pytest.approx(1.0 / every.minutes)
    held = np.array([s["Fz_N"] > 0 for s in scalars]).reshape(4, 24)
    off = np.array([min(0.1, s["stick_ratio"]) for s in scalars]).reshape(4, 24)
    by_trial = [row[here].mean() for row, here in zip(off, held, strict=True)]
    assert every.stick_ratio_error == pytest.approx(np.mean(by_trial))
    assert every.stick_ratio_se == pytest.approx(np.std(by_trial, ddof=1) / 2)


def test_the_command_prints_each_split(folder, tmp_path):
    file, out = write(tmp_path / "p.csv", truth_rows(folder)), tmp_path / "s.json"
    found = CliRunner().invoke(app, ["dataset", "score", str(folder), str(file), "--json", str(out)])
    assert found.exit_code == 0, found.output
    splits = json.loads(out.read_text())["splits"]
    with dataset.open(folder) as data:
        assert {row["split"] for row in splits} == {row["split"] for row in data.rows()} | {"all"}
    assert "false alarms" in found.output


BROKEN = {
    "no key": ([("frame", "slip"), ("0", "1")], "line 1"),
    "unknown": ([("key", "slip", "score"), ("0", "1", "1")], "line 1"),
    "only keys": ([("key",), ("0",)], "line 1"),
    "word": ([("key", "slip"), ("0", "yes")], "line 2"),
    "nan": ([("key", "slip"), ("0", "nan")], "line 2"),
    "ratio": ([("key", "stick_ratio"), ("0", "1.2")], "0 to 1"),
    "twice": ([("key", "slip"), ("0", "1"), ("000000000", "1")], "line 3"),
    "long": ([("key", "slip"), ("0", "1", "2")], "line 2"),
    "short": ([("key", "slip"), ("0",)], "line 2"),
    "path": ([("key", "slip"), ("../0", "1")], "line 2"),
    "empty": ([("key", "slip")], "no predictions"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_one_line(tmp_path, name):
    rows, said = BROKEN[name]
    with pytest.raises(InputError, match=said):
        read_predictions(write(tmp_path / "b.csv", rows))


def test_predictions_of_other_frames_or_of_parts_are_refused(folder, tmp_path):
    with pytest.raises(InputError, match="no frame of"):
        score(folder, read_predictions(write(tmp_path / "a.csv", [("key", "slip"), ("999", "1")])))
    with pytest.raises(InputError, match="no prediction of frame 000000000"):
        score(folder, read_predictions(write(tmp_path / "b.csv", [("key", "slip"), ("1", "1")])))
    (tmp_path / "c.csv").write_bytes(b"key,slip\n\xff\xfe,1\n")
    with pytest.raises(InputError, match="not a CSV"):
        read_predictions(tmp_path / "c.csv")
