"""The twin of a contact frame from the command line, on a frame whose causes are known. Whole fits: some minutes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.chain.simulate import simulate
from evanesce.cli.app import app
from evanesce.render.fast.transport import render_fast
from evanesce.rig import dump_scene, load_scene
from evanesce.sensor.codec import write_png
from evanesce.studies.contact_twin.record import contact_level

BELIEVED = {"finger.ridges": None, "camera.scale_px_per_mm": 10.0}


@pytest.mark.whole_case
def test_a_hazy_frame_through_the_command(tmp_path: Path) -> None:
    """Haze of 0.6 % and the believed filters; no spill, no backdrop, no reflections."""
    believed = load_scene("thesis_ridged_red").with_(BELIEVED)
    view = {"camera.resolution_px": [318, 252], "finger.position_mm": [1.0, -0.7]}
    scene = believed.with_({"surroundings": {"haze": {"top_share": 0.006, "contrast": 0.0}}, **view})
    write_png(tmp_path / "frame.png", simulate(scene, 8.0, seed=1, render=render_fast).frame.data)
    (tmp_path / "believed.toml").write_text(dump_scene(believed))
    arguments = ["twin", str(tmp_path / "frame.png"), "--contact", "--scene", str(tmp_path / "believed.toml")]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "twin"), "--json", str(tmp_path / "twin.json")])
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "twin.json").read_text())
    assert {"exposure", "colour", "plate_haze"} <= set(found["final"]["causes"])
    assert found["final"]["gain_nat"] > 5 * found["final"]["gain_error_nat"]
    for both in found["medians_DN"].values():
        np.testing.assert_allclose(both["simulated"], both["frame"], atol=10.0)
    frame, simulated = found["grey_peaks"]["frame"], found["grey_peaks"]["simulated"]
    np.testing.assert_allclose(simulated[:2], frame[:2], atol=0.01)
    figures = {one["name"]: one for one in found["figures"]}
    assert figures["scale"]["value"] == pytest.approx(10.0, rel=0.02)
    assert figures["contact level"]["value"] == pytest.approx(contact_level(scene, 8.0), rel=0.15)
    assert figures["haze"]["value"] == pytest.approx(0.006, rel=0.2)
    assert (tmp_path / "twin" / "report.html").stat().st_size > 20_000
    calibrated = load_scene(tmp_path / "twin" / "twin_scene.toml")
    assert contact_level(calibrated, found["force_N"]) == pytest.approx(figures["contact level"]["value"], rel=0.02)
    assert calibrated.camera.scale_px_per_mm == pytest.approx(10.0, rel=0.02)
