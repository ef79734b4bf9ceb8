"""Parts of the study as they run: what comes out against closed forms and bounds that the parts do not use."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.rig import Camera, load_scene
from evanesce.studies.threshold import page as threshold_page
from evanesce.studies.threshold import study as threshold_study
from evanesce.studies.time import page as time_page
from evanesce.studies.time import study as time_study
from support.tiny import TINY

RULES = ("Otsu", "2.5 x Otsu", "Li", "Yen", "mean", "triangle")


def silent(what: str, done: int, total: int) -> None:
    """Show no progress."""


def check_threshold(data: dict, *, best: float) -> None:
    """Areas fall with the threshold; half-way the contact has its own area; scattering only adds area."""
    levels = np.array(data["thresholds"])
    frames = {(f["material"], f["finger"], f["force_N"]): f for f in data["frames"]}
    for (material, finger, force), frame in frames.items():
        ratio = np.array(frame["manual"]) / frame["true_area_mm2"]
        assert (np.diff(ratio) <= 1e-12).all()
        if "scattering" in finger:
            clear = frames[material, finger.removesuffix(", scattering and specks"), force]
            low = levels <= 0.3
            assert (np.array(frame["manual"])[low] > np.array(clear["manual"])[low]).all()
        else:
            assert abs(np.interp(0.5 * 0.67, levels, ratio) - 1) < best
            assert ratio[0] > 1.0
    named = {row["setting"].partition(",")[0].lower() for row in data["ranking"]}
    assert {rule.lower() for rule in RULES} <= named
    assert abs(data["card"]["halfway"]) < best


def check_time(data: dict, camera: Camera, *, late_ms: float, rows: float) -> None:
    """A clock of 25 for 30 slows all by 5/6; rows change a length by 1/(1 - v/v_rows); a smear adds at most a strip."""
    onset = {row["camera"]: np.array(row["onset_s"]) for row in data["onset"] if row["speed_mm_per_s"] == 25.0}
    assert onset["30 Hz read as 25"] == pytest.approx(1.2 * onset["30 Hz"], rel=1e-9)
    true = next(row["true_onset_s"] for row in data["onset"] if row["speed_mm_per_s"] == 25.0)
    assert np.abs(onset["30 Hz"] - true).max() < 1e-3 * late_ms
    growth = {row["camera"]: np.mean(row["growth"]) for row in data["area_read"]}
    assert growth["30 Hz read as 25"] / growth["30 Hz"] == pytest.approx(25 / 30, rel=0.03)
    readout_s, height_mm = 22.75e-3, camera.resolution_px[1] / camera.scale_px_per_mm
    for row in data["rows"]:
        expected = 1 / (1 - row["velocity_mm_per_s"][1] * readout_s / height_mm) - 1
        assert row["change"] == pytest.approx(expected, abs=rows)
    ways, areas = np.array(data["smear"]["way_mm"]), np.array(data["smear"]["area_mm2"])
    strip = ways[:, None] * 2 * np.sqrt(areas[:1] / np.pi)
    assert (areas - areas[0] >= -1e-9).all()
    assert (areas - areas[0] <= strip + 0.02 * areas[0]).all()


def rerun_without_work(part, scene, folder: Path, module, name: str, monkeypatch: pytest.MonkeyPatch) -> dict:
    """Return the data of a second run, for which nothing may be rendered again."""

    def never(*arguments: object, **options: object) -> None:
        raise AssertionError(f"{name} was called again")

    monkeypatch.setattr(module, name, never)
    return dict(part.run(scene, folder, silent, quick=True, seed=1).data)


@pytest.mark.slow  # 8 s: a study from end to end
@pytest.mark.system
def test_threshold_part_of_a_small_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene("thesis", TINY)
    found = threshold_page.STUDY.run(scene, tmp_path, silent, quick=True, seed=1)
    check_threshold(json.loads(json.dumps(dict(found.data))), best=0.045)  # a pixel is 0.08 mm here
    again = rerun_without_work(threshold_page.STUDY, scene, tmp_path, threshold_study, "_frame", monkeypatch)
    assert again["frames"] == found.data["frames"]


@pytest.mark.slow  # 9 s
@pytest.mark.system
def test_time_part_of_a_small_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene("thesis", TINY)
    found = time_page.STUDY.run(scene, tmp_path, silent, quick=True, seed=1)
    check_time(json.loads(json.dumps(dict(found.data))), scene.camera, late_ms=25.0, rows=5e-3)
    again = rerun_without_work(time_page.STUDY, scene, tmp_path, time_study, "render_fast", monkeypatch)
    assert again["onset"] == found.data["onset"]


@pytest.mark.slow
def test_every_part_at_full_size(tmp_path: Path) -> None:
    """``study all --quick`` (some 5 minutes): goals of the estimator, coverage within 4 standard errors, page whole."""
    done = CliRunner().invoke(app, ["study", "all", "thesis", "--quick", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    check_threshold(result["threshold"], best=0.03)
    check_time(result["time"], load_scene("thesis").camera, late_ms=20.0, rows=2e-3)
    for row in result["estimator"]["rows"]:
        goal = 0.5 if row["finger"].startswith("smooth") else 2.0
        if "scattering" in row["finger"]:  # at 12 V nearly all of it is at full scale
            goal = 6.0 if row["voltage_V"] > 11 else goal
        assert abs(row["refined_percent"]) < goal
        assert abs(row["reference_percent"]) > abs(row["refined_percent"])
    for one in result["budget"]["classes"]:
        error = 4 * np.sqrt(0.05 * 0.95 / one["measurements"])
        assert 0.93 - error < one["refined_covered"] <= 0.97 + error
        assert 0.4 < one["refined_half_width_percent"] < 0.8
        assert one["reference_half_width_percent"] > 2 * one["refined_half_width_percent"]
    for row in result["pressure"]["rows"]:
        assert row["rms_percent"] < row["reference_rms_percent"]
        assert row["saturated_share"] > 0.5 or row["rms_percent"] < 2.0
    for figure in result["thesis"]["figures"]:
        if figure["simulated"]:
            assert figure["low"] <= figure["value"] <= figure["high"]
            assert figure["low"] <= figure["thesis"] <= figure["high"] or figure["reason"]
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert text.count("data:image/png") >= len(list(tmp_path.glob("*.png")))
    assert not re.search(r'(src|href)="(?!data:|#)', text)
    assert "slider-picture" in text
