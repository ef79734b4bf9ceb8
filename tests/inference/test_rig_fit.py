"""``evanesce fit``: intervals within bounds, refusals in one line, and planted figures found on a small rig."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import development_rigs as rigs
import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.effects import all_effects
from evanesce.inference.calibration.figures import FIGURES
from evanesce.inference.calibration.intervals import cut_interval
from evanesce.inference.causes import changes_plate_light
from evanesce.prediction.candidates import candidates_of
from evanesce.rig import load_scene

runner = CliRunner()


def test_every_figure_is_a_parameter_of_an_effect() -> None:
    for name, figure in FIGURES.items():
        entries = {entry.name for entry in all_effects()[name].candidate_parameters()}
        assert set(figure.names) <= entries, name
        assert set(figure.begin) <= entries, name


def test_no_figure_asks_for_the_plates_paths_anew() -> None:
    """Each free figure moves at each step of a fit: none may take seconds. A polish of the edges would."""
    scene = load_scene("thesis")
    found = {
        c.id: c for c in candidates_of(scene, {need for effect in all_effects().values() for need in effect.needs})
    }
    assert not [name for name in FIGURES if changes_plate_light(scene, found[name])]
    assert changes_plate_light(scene, found["edge_finish"])


@pytest.mark.parametrize(
    ("mean", "bounds", "ends"),
    [(0.3, (-np.inf, np.inf), ()), (0.5, (0.0, 9.0), (0,)), (-0.7, (0.0, 9.0), (0,)), (1.2, (-9.0, 1.0), (1,)),
     (-1.5, (-9.0, 1.0), ()), (2.0, (0.0, np.inf), ())],
)  # fmt: skip
def test_an_interval_is_the_shortest_that_holds_ninety_per_cent_of_what_the_bounds_leave(
    mean: float, bounds: tuple[float, float], ends: tuple[int, ...]
) -> None:
    drawn = np.random.default_rng(1).normal(mean, 1.0, 1_000_000)
    drawn = np.sort(drawn[(drawn >= bounds[0]) & (drawn <= bounds[1])])
    found = cut_interval(mean, 1.0, bounds)
    # twenty standard errors of a share and of a quantile of a hundred thousand draws are less
    assert np.mean((drawn >= found[0]) & (drawn <= found[1])) == pytest.approx(0.9, abs=0.02)
    count = int(0.9 * len(drawn))
    assert found[1] - found[0] == pytest.approx(float((drawn[count:] - drawn[:-count]).min()), abs=0.02)
    # An effect that grows from nothing may well be absent.
    assert all(found[k] == bounds[k] for k in ends)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["nothing"], ["nothing"]),
        (["nothing", "--scene", "cal.json"], ["--scene", ".toml"]),
        (["nothing", "--report", "cal.txt"], ["--report", ".html"]),
        (["nothing", "--json", "no/such/x.json"], ["--json", "no/such"]),
        (["nothing", "--exclude", "led_ded"], ["--exclude", "led_bin"]),
    ],
)
def test_bad_input_is_one_line(
    options: list[str], words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = runner.invoke(app, ["fit", *options])
    assert done.exit_code == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert all(word in done.stderr for word in words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_planted_figures_are_within_their_intervals(tmp_path: Path) -> None:
    """Modulus +15 %, black level +8 DN, droop 0.15, of seven figures: inside the 90 % intervals; areas get better."""
    folder, answer, scene = tmp_path / "tiny", tmp_path / "fit.json", tmp_path / "cal.toml"
    rigs.write_rig("tiny", folder)
    fitted = ("modulus", "force_offset", "led_bin", "led_droop", "black_level", "tone_curve")
    without = [option for name in FIGURES if name not in fitted for option in ("--exclude", name)]
    done = runner.invoke(app, ["fit", str(folder), "--json", str(answer), "--scene", str(scene), *without])
    assert done.exit_code == 0, done.output
    found = json.loads(answer.read_text(encoding="utf-8"))
    rows = {row["key"].removeprefix("effects."): row for row in found["figures"]}
    for key, planted in (("modulus.relative", 0.15), ("black_level.offset_DN", 8.0), ("led_droop.droop", 0.15)):
        assert rows[key]["lo"] <= planted <= rows[key]["hi"], key
    for key in ("force_offset.offset_N", "led_bin.offset_V", "tone_curve.gamma", "tone_curve.contrast"):
        assert rows[key]["lo"] <= 0.0 <= rows[key]["hi"], key
    before, after = found["held_out"]["area_error_percent"]
    assert after < 1.0 < before
    assert "effects" in load_scene(scene).as_dict()
    # Without frames in the dark, black level and droop are known less well, and the answer says what is missing.
    shutil.rmtree(folder / "lens_cap")
    shutil.rmtree(folder / "led_off")
    done = runner.invoke(app, ["fit", str(folder), "--json", str(answer), *without])
    assert done.exit_code == 0, done.output
    less = json.loads(answer.read_text(encoding="utf-8"))
    wider = {row["key"].removeprefix("effects."): row for row in less["figures"]}["black_level.offset_DN"]
    known = rows["black_level.offset_DN"]
    assert wider["hi"] - wider["lo"] > 1.1 * (known["hi"] - known["lo"])
    assert wider["lo"] <= 8.0 <= wider["hi"]
    assert any("no dark frame" in warning for warning in less["warnings"])
    assert not any("no dark frame" in warning for warning in found["warnings"])
