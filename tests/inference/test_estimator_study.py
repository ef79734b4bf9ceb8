"""The studies of estimator, budget and pressure: blind runs on the small rig, the command line, bad input."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.evaluation.calibrated_rig import calibrated, with_board_blur
from evanesce.measurement.calibration.model import save_calibration
from evanesce.measurement.refined.subsurface import Scattering, spread
from evanesce.report.html import write
from evanesce.rig import load_scene
from evanesce.studies.budget import page as budget_page
from evanesce.studies.budget import study as budget_study
from evanesce.studies.estimator import page as estimator_page
from evanesce.studies.estimator import study as estimator_study
from evanesce.studies.ledger import Ledger
from evanesce.studies.pressure import page as pressure_page
from evanesce.studies.pressure import study as pressure_study
from support.tiny import TINY

# Half the thesis's scale on a quarter of its pixels: the same contacts, cheaper.
SMALL = {
    "camera.resolution_px": [1000, 750],
    "camera.scale_px_per_mm": 29.2,
    "camera.pixel.pitch_um": 6.2,
    "camera.exposure_ms": 1.5,
    "grid.samples": 640,
    "grid.size_mm": 12.8,
}

# A quarter of the scale: for what does not depend on it.


def test_command_refined_prints_the_interval(tmp_path):
    """An ellipse of known area on a thesis-like camera: the interval is printed and holds it."""
    scene = load_scene("thesis", SMALL | {"camera.lens.distortion": {"k1": 0.0, "k2": 0.0}})
    save_calibration(tmp_path / "calibration.json", calibrated(scene, np.random.default_rng(2)))
    y, x = np.mgrid[: 750 * 4, : 1000 * 4] / 4 - 0.375
    share = cv2.resize(
        (((x - 510.3) / 61.2) ** 2 + ((y - 360.9) / 47.7) ** 2 < 1).astype(np.float32), (1000, 750),
        interpolation=cv2.INTER_AREA,
    )  # fmt: skip
    light = 0.4 * cv2.GaussianBlur(share, (0, 0), 1.1)
    level = np.where(light < 0.018, 4.5 * light, 1.099 * np.maximum(light, 0.018) ** 0.45 - 0.099)
    frames = tmp_path / "frames"
    frames.mkdir()
    cv2.imwrite(str(frames / "f0.png"), np.floor(255 * level + 0.5).astype(np.uint8))
    arguments = [
        "measure", str(frames), "--calibration", str(tmp_path / "calibration.json"), "--fps", "30",
        "--estimator", "refined", "--json", str(tmp_path / "found.json"),
    ]  # fmt: skip
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert "95 % interval" in done.output
    frame = json.loads((tmp_path / "found.json").read_text())["frames"][0]
    # the scale on the axis; the glass changes it by less than 2e-4 over this ellipse
    true = np.pi * 61.2 * 47.7 / 29.2**2
    assert frame["area_mm2"] == pytest.approx(true, rel=2e-3)
    assert frame["area_low_mm2"] < true < frame["area_high_mm2"]


@pytest.mark.slow  # 8 s; the fit itself has quick tests
def test_command_fits_the_edge_of_a_contact_and_keeps_it_in_the_record(tmp_path):
    """A calibration with a board's edge profile, clear silicone 1.5 to 4 times above full scale, light that rises in
    two steps at the edge: tuned on a press that does not saturate the command is right to 0.5 %, else it errs by over
    1 %. Rationale: the profile could not be written as JSON, and the command did not pass it on."""
    scene = load_scene("thesis", SMALL | {"camera.lens.distortion": {"k1": 0.0, "k2": 0.0}})
    calibration = with_board_blur(calibrated(scene, np.random.default_rng(2)), scene, 3)
    assert "edge" in calibration.details["blur_px"][0]
    save_calibration(tmp_path / "calibration.json", calibration)
    y, x = np.mgrid[: 750 * 4, : 1000 * 4] / 4 - 0.375

    def written(name: str, over: float, middle: tuple[float, float]):
        share = np.zeros((750, 1000))
        for more in (0.0, 1.1):
            inside = ((x - middle[0]) / (71.2 + more)) ** 2 + ((y - middle[1]) / (57.7 + more)) ** 2 < 1
            share += 0.5 * cv2.resize(inside.astype(np.float32), (1000, 750), interpolation=cv2.INTER_AREA)
        light = np.clip(over * cv2.GaussianBlur(share, (0, 0), 1.4), 0, 1)
        level = np.where(light < 0.018, 4.5 * light, 1.099 * np.maximum(light, 0.018) ** 0.45 - 0.099)
        cv2.imwrite(str(tmp_path / name), np.floor(255 * level + 0.5).astype(np.uint8))
        return str(tmp_path / name)

    def measured(path: str, *more: str):
        target = tmp_path / "found.json"
        done = CliRunner().invoke(
            app, ["measure", path, "--calibration", str(tmp_path / "calibration.json"), "--fps", "30", "--estimator",
                  "refined", "--json", str(target), *more],
        )  # fmt: skip
        assert done.exit_code == 0, done.output
        return json.loads(target.read_text())

    teacher = written("teach.png", 0.6, (531.6, 350.2))
    halfway = measured(teacher)["frames"][0]["area_mm2"]
    for over in (1.5, 4.0):
        frame = written("over.png", over, (497.3, 383.9))
        tuned, blind = measured(frame, "--tune", teacher), measured(frame)
        assert tuned["frames"][0]["area_mm2"] == pytest.approx(halfway, rel=0.005)
        assert abs(blind["frames"][0]["area_mm2"] / halfway - 1) > 0.01
        assert tuned["settings"]["camera_blur"]["origin"] == "board"
        fitted, board = (run["settings"]["camera_blur"]["edge"] for run in (tuned, blind))
        assert fitted != board
        assert np.interp(0.0, fitted["positions_px"], fitted["light"]) == pytest.approx(0.5, abs=0.03)


def scattering_frame(path, over: float, middle: tuple[float, float]):
    """Write a frame of an ellipse in silicone that scatters, so many times over full scale; return the area."""
    y, x = np.mgrid[: 750 * 4, : 1000 * 4] / 4 - 0.375
    share = (((x - middle[0]) / 71.2) ** 2 + ((y - middle[1]) / 57.7) ** 2 < 1).astype(np.float32)
    light = spread(
        cv2.resize(share, (1000, 750), interpolation=cv2.INTER_AREA).astype(float), Scattering(20.0, 0.1), 1.13
    )
    light = np.clip(over * light / light.max(), 0, 1)
    level = np.where(light < 0.018, 4.5 * light, 1.099 * np.maximum(light, 0.018) ** 0.45 - 0.099)
    cv2.imwrite(str(path), np.floor(255 * level + 0.5).astype(np.uint8))
    return np.pi * 71.2 * 57.7 / 29.2**2


@pytest.mark.slow  # 7 s; the fit itself has quick tests
def test_command_fits_the_scattering_length_to_an_unsaturated_frame(tmp_path):
    """Rationale: scattered light beside a saturated contact cannot be separated from contact without the scattering
    length. Tuned on another press of the same finger the command is right to 1 %; otherwise it errs by over 5 %."""
    scene = load_scene("thesis", SMALL | {"camera.lens.distortion": {"k1": 0.0, "k2": 0.0}})
    save_calibration(tmp_path / "calibration.json", calibrated(scene, np.random.default_rng(2)))
    true = scattering_frame(tmp_path / "over.png", 1.8, (497.3, 383.9))
    scattering_frame(tmp_path / "teach.png", 0.6, (531.6, 350.2))

    def measured(name: str, *more: str):
        target = tmp_path / "found.json"
        arguments = [
            "measure", str(tmp_path / name), "--calibration", str(tmp_path / "calibration.json"), "--fps", "30",
            "--estimator", "refined", "--json", str(target), *more,
        ]  # fmt: skip
        done = CliRunner().invoke(app, arguments)
        return done, json.loads(target.read_text()) if done.exit_code == 0 else {}

    _, blind = measured("over.png")
    done, tuned = measured("over.png", "--tune", str(tmp_path / "teach.png"))
    assert done.exit_code == 0, done.output
    assert blind["frames"][0]["area_mm2"] > 1.05 * true
    assert tuned["frames"][0]["area_mm2"] == pytest.approx(true, rel=0.01)
    assert tuned["settings"]["tune"].endswith("teach.png")
    assert tuned["settings"]["scattering"]["length_px"] > 5.0  # along a valley with its return, so no more is asked
    assert blind["settings"]["tune"] is None
    assert "blur_not_known" in [w["code"] for w in tuned["warnings"]]
    # the budget is in the file: its parts add in squares, and those of the conversion factor are some of them
    budget = tuned["budget"]
    parts = {row["name"]: row for row in budget["components"]}
    assert {"card print", "scale fit", "saturated edge", "subsurface scattering", "camera's blur"} <= set(parts)
    assert 0.01 * budget["together"]["area_percent"] * budget["area_mm2"] == pytest.approx(budget["standard_mm2"])
    assert parts["card print"]["factor_percent"] == pytest.approx(100 * 2 * 0.002 / np.sqrt(3), rel=1e-2)
    assert parts["subsurface scattering"]["factor_percent"] is None
    assert 0 < budget["together"]["factor_percent"] < budget["together"]["area_percent"]
    # a frame that cannot teach is refused, by name
    refused, _ = measured("over.png", "--tune", str(tmp_path / "over.png"))
    assert refused.exit_code == 2
    assert "--tune" in refused.output


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["measure", ".", "--tune", "t.png"], "--tune"),
        (["measure", ".", "--estimator", "best"], "--estimator"),
        (["measure", ".", "--dark", "d"], "--dark"),
        (["measure", ".", "--estimator", "refined"], "--calibration"),
        (["study", "estimator", "--volts", "8,8"], "--volts"),
        (["study", "estimator", "--volts", "two"], "--volts"),
        (["study", "estimator", "--threshold", "1.5"], "--threshold"),
        (["study", "budget", "--measurements", "3"], "--measurements"),
        (["study", "budget", "--fingers", "smooth; rough"], "--fingers"),
        (["study", "budget", "--volts", "9,nine"], "--volts"),
        (["study", "pressure", "--forces", "-1"], "--forces"),
    ],
)
def test_bad_input_ends_with_2_and_names_its_key(arguments, part):
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 2
    assert part in done.output


@pytest.mark.system
@pytest.mark.slow  # 8 s each: frames rendered, calibrated and read
@pytest.mark.parametrize(("finger", "goal"), [("smooth", 0.5), ("smooth, scattering", 1.0)])
def test_rendered_frames_are_read_blind(finger, goal):
    """One press on the small rig at 9 V, off the middle; the reference segmentation at 0.15 errs several times more."""
    scenes = [load_scene(name, SMALL) for name in ("thesis", "thesis_ridged")]
    scene = estimator_study.placed(estimator_study.fingers_of(*scenes)[finger], (1.7, -1.1))
    calibration = calibrated(scenes[0], np.random.default_rng(5))
    (row,) = estimator_study.rows_of(finger, "near", scene, calibration, (9.0,), (2.3,), threshold=0.15, seed=4)
    assert abs(row.refined_percent) < goal
    assert abs(row.reference_percent) > 3 * goal


@pytest.mark.slow
def test_blind_error_of_both_estimators(tmp_path):
    """The goal: under 0.5 % smooth, under 2 % ridged, at the frame's centre, where the reference errs by over 2 %."""
    scenes = [load_scene(name, SMALL) for name in ("thesis", "thesis_ridged")]
    options = {"voltages": (8.0, 9.0), "forces": (3.0,), "fingers": ("smooth", "ridged")}
    found = estimator_study.run_study(*scenes, **options, keep=Ledger(tmp_path / "rows.jsonl", "a run").row)
    for row in found.rows:
        assert abs(row.refined_percent) < (0.5 if row.finger == "smooth" else 2.0)
        assert abs(row.reference_percent) > 2.0
    again = estimator_study.run_study(
        *scenes, **options, keep=Ledger(tmp_path / "rows.jsonl", "a run").row
    )  # from the kept rows
    assert again.rows == found.rows
    assert write(tmp_path / "e.html", estimator_page.page(found)).read_text().count("data:image/png") == 1


@pytest.mark.slow
def test_coverage_of_a_reduced_run(tmp_path):
    """200 measurements: the interval's share within 4 standard errors of 93 to 97 %."""
    scenes = [load_scene(name, SMALL) for name in ("thesis", "thesis_ridged")]
    found = budget_study.run_study(
        *scenes, measurements=200, forces=(1.7,), voltages=(9.0,), fingers=("smooth",), positions=("centre",)
    )
    error = 4 * np.sqrt(0.05 * 0.95 / 200)
    assert 0.93 - error < found.classes[0].refined_covered < 0.97 + error
    assert "covered" in write(tmp_path / "b.html", budget_page.page(found)).read_text()


@pytest.mark.slow
def test_pressure_of_a_rough_skin(tmp_path):
    """The inverted model errs by a fraction of what the thesis's map does."""
    scene = load_scene("thesis", SMALL)
    found = pressure_study.run_study(scene, slopes=(0.5,), forces=(2.0,), voltages=(9.0,))
    row = found.rows[0]
    assert row.rms_percent < 0.5 * row.reference_rms_percent
    assert row.correlation > 0.99
    assert "RMS slope" in write(tmp_path / "p.html", pressure_page.page(found)).read_text()


class Killed(Exception):
    """Stands for the end of a process between two steps."""


@pytest.mark.slow  # the part runs three times: 10 s
def test_budget_goes_on_after_a_kill(tmp_path, monkeypatch):
    """Killed after the first block, its next line cut short: the rest alone is done, the result is that of one run."""
    scenes = [load_scene(name, TINY) for name in ("thesis", "thesis_ridged")]
    options = {
        "measurements": 10, "forces": (1.3,), "voltages": (9.0,), "fingers": ("smooth",), "positions": ("centre",),
    }  # fmt: skip
    monkeypatch.setattr(budget_study, "BLOCK", 4)
    whole = budget_study.run_study(*scenes, **options)
    path = tmp_path / "budget.jsonl"
    made: list[str] = []

    def keeping(stop_at: int):
        ledger = Ledger(path, "a run")

        def keep(key, make):
            if key not in ledger:
                if len(made) == stop_at:
                    raise Killed
                made.append(key)
            return ledger.row(key, make)

        return keep

    with pytest.raises(Killed):
        budget_study.run_study(*scenes, **options, keep=keeping(2))
    with path.open("a") as stream:
        stream.write('{"key": "measurements from 4", "row": {"ro')
    again = budget_study.run_study(*scenes, **options, keep=keeping(99))
    assert made == [
        "frames: smooth, centre", "measurements from 0", "measurements from 4", "measurements from 8",
    ]  # fmt: skip
    assert again.classes == whole.classes
    assert whole.classes[0].measurements == 10


@pytest.mark.slow  # the part runs three times: 6 s
def test_pressure_part_goes_on_after_a_kill(tmp_path, monkeypatch):
    """Killed at the third press: the first two are not pressed again; rows and picture are those of one run."""
    scene = load_scene("thesis", TINY)
    (tmp_path / "whole").mkdir()
    (tmp_path / "cut").mkdir()
    pressed: list[float] = []
    real, stop = pressure_study.LitPress.of, [99]

    def of(rig, force, seed):
        if len(pressed) == stop[0]:
            raise Killed
        pressed.append(force)
        return real(rig, force, seed)

    monkeypatch.setattr(pressure_study.LitPress, "of", staticmethod(of))
    whole = pressure_page.run(scene, tmp_path / "whole", lambda *a: None)
    pressed.clear()
    stop[0] = 2
    with pytest.raises(Killed):
        pressure_page.run(scene, tmp_path / "cut", lambda *a: None)
    pressed.clear()
    stop[0] = 99
    again = pressure_page.run(scene, tmp_path / "cut", lambda *a: None)
    assert len(pressed) == 2
    assert again.data == whole.data
    assert len(whole.data["rows"]) == 12
    assert [len(part.rows) for part in whole.maps] == [2, 2]  # one clear frame and one that is lost: maps and errors
    pairs = [
        (mine, theirs)
        for part, other in zip(again.maps, whole.maps, strict=True)
        for row, its in zip(part.rows, other.rows, strict=True)
        for mine, theirs in zip(row, its, strict=True)
    ]
    assert all(np.array_equal(mine.values, theirs.values) for mine, theirs in pairs)
