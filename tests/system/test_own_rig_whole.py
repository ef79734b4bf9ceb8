"""The tutorial "your own rig" on a lab that NumPy drew: from pictures and presses to a calibrated scene and page."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.inference.calibration.fit import EDGE_PX
from evanesce.rig import dump_scene, load_scene
from support import foreign_rig as lab

run = CliRunner().invoke


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab") / "mine"
    lab.measure(folder)
    done = run(app, [
        "init", str(folder / "scene.toml"), "--plate-mm", "90x60", "--thickness-mm", "8", "--material", "pmma",
        "--edges", "left,right", "--voltage-V", "9.5", "--camera", "machine_vision", "--pixel-um", f"{lab.PITCH_UM}",
        "--focal-mm", f"{lab.FOCAL_MM}", "--finger", "ball", "--radius-mm", f"{lab.RADIUS_MM}", "--modulus-MPa", "0.3",
        "--board", "15x11", "--board-square-mm", f"{lab.SQUARE_MM}", "--checkerboard", str(folder / "checkerboard"),
        "--forces-N", "0.5,2,4", "--exposure-ms", "0.4",
    ])  # fmt: skip
    assert done.exit_code == 0, done.output
    return folder


def test_pictures_and_presses_make_a_bundle(mine: Path) -> None:
    scene = load_scene(mine / "scene.toml")
    scale = lab.FOCAL_PX / (lab.CLEAR_MM + lab.THICKNESS_MM / lab.INDEX)
    assert scene.camera.scale_px_per_mm == pytest.approx(scale, rel=2e-3)
    assert scene.camera.lens.distortion.k1 == pytest.approx(lab.K1, abs=0.03)
    assert scene.card.checkerboard_inverted
    done = run(app, ["bundle", "check", str(mine)])
    assert done.exit_code == 0, done.output
    assert "20 frame(s)" in done.output


@pytest.mark.slow  # ten seconds; a bundle of its own
def test_squares_of_another_side_are_noticed(tmp_path: Path, mine: Path) -> None:
    wrong = tmp_path / "wrong"
    shutil.copytree(mine, wrong)
    scale = load_scene(wrong / "scene.toml").camera.scale_px_per_mm
    changed = load_scene(wrong / "scene.toml", {
        "camera.scale_px_per_mm": lab.SQUARE_MM * scale, "card.checkerboard_side_mm": 1.0,
    })  # fmt: skip
    (wrong / "scene.toml").write_text(dump_scene(changed), encoding="utf-8")
    done = run(app, ["fit", str(wrong)])
    assert done.exit_code != 0
    assert "not the rig of the scene" in done.output + done.stderr


@pytest.mark.slow
@pytest.mark.whole_case  # minutes
def test_presses_make_a_scene_that_predicts_areas_it_has_not_seen(mine: Path) -> None:
    twin, page, told = (mine.parent / name for name in ("twin.toml", "twin.html", "twin.json"))
    done = run(app, ["fit", str(mine), "--scene", str(twin), "--report", str(page), "--json", str(told)])
    assert done.exit_code == 0, done.output
    found = json.loads(told.read_text(encoding="utf-8"))
    before, after = found["held_out"]["area_error_percent"]
    assert before > 1.5
    assert after < 0.5
    (stiffer,) = (row for row in found["figures"] if row["key"] == "effects.modulus.relative")
    assert stiffer["lo"] < lab.MODULUS_MPA / 0.3 - 1.0 < stiffer["hi"]
    # 0.11: what no figure stands for may be light that moves the contact's edge, which widens it
    assert stiffer["hi"] - stiffer["lo"] < 0.15
    # what the drawing has and no figure stands for is said: its light is an even field, not that of LEDs
    assert any("no figure stands for" in said for said in (*found["reasons"], *found["remarks"]))
    # The contact itself, Hertz's circle, held-out ones too, but for its rim's light, which is of another form:
    # one and a half times what edges are allowed.
    pixel_mm = (lab.CLEAR_MM + lab.THICKNESS_MM / lab.INDEX) / lab.FOCAL_PX
    for row in found["areas"]:
        radius = lab.contact_radius(row["force_N"])
        assert math.sqrt(row["contact_mm2"] / math.pi) == pytest.approx(radius, abs=1.5 * EDGE_PX * pixel_mm)
    assert load_scene(twin).effects["modulus"]["relative"] == pytest.approx(stiffer["value"])
    text = page.read_text(encoding="utf-8")
    assert text.count("<img") + text.count("<svg") >= 3
    assert "mm" in text
    assert "http://" not in text.replace("http://www.w3.org", "")
