"""The critic on the bright rig of 2000 x 1500 pixels that `evanesce simulate thesis --bundle` writes: a first try.

Its bins are quieter than the noise below which no bin is believed, and a departure of some per cent is loud there.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.rig import dump_scene, load_scene

pytestmark = pytest.mark.whole_case


def criticised(folder: Path, seed: int, *settings: str, coarser: int = 1) -> dict:
    """Return the answer to a simulated bundle whose believed rig lacks what was set."""
    bundle, found, runner = folder / "bundle", folder / "found.json", CliRunner()
    more = [part for setting in settings for part in ("--set", setting)] + ["--camera-coarser", str(coarser)]
    done = runner.invoke(app, ["simulate", "thesis", "--bundle", str(bundle), "--seed", str(seed), *more])
    assert done.exit_code == 0, done.output
    if settings:
        (bundle / "scene.toml").write_text(dump_scene(load_scene("thesis")))
    done = runner.invoke(app, ["criticise", str(bundle), "--json", str(found)])
    shutil.rmtree(bundle)
    assert done.exit_code == 0, done.output
    return json.loads(found.read_text())


def test_a_bright_bundle_with_nothing_hidden_is_none(tmp_path: Path) -> None:
    """Rationale: it was called unknown with p 0.0003; draws of noise below the floor were all zero."""
    answer = criticised(tmp_path, 3)
    assert answer["verdict"] == "none", (answer["global_p"], answer["unknown"])
    assert answer["false_alarm_control"]


def test_a_bundle_of_larger_pixels_with_nothing_hidden_is_none(tmp_path: Path) -> None:
    """Rationale: the lens was blurred on the large pixels, and frames without noise passed for JPEG: `tone_curve`."""
    answer = criticised(tmp_path, 1, coarser=5)
    assert answer["verdict"] == "none", (answer["global_p"], answer["effects"], answer["notes"])
    assert not any("smoothed" in note for note in answer["notes"])
    assert "frame_rate" in {entry["id"] for entry in answer["not_judged"]}


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "coarser"), [(2, 5), (4, 2), (3, 10), (1, 1)])
def test_quiet_bundles_with_nothing_hidden_are_none(seed: int, coarser: int, tmp_path: Path) -> None:
    """Rationale: bins are far quieter than their weights; 3 um of the finger's place were creep, 1 um a defocus."""
    answer = criticised(tmp_path, seed, coarser=coarser)
    assert answer["verdict"] == "none", (answer["global_p"], answer["effects"], answer["unknown"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "parameter", "value", "error"),
    [("vignetting", "k", 0.02, 0.001), ("modulus", "relative", 0.03, 0.003), ("led_droop", "droop", 0.05, 0.02)],
)
def test_a_loud_cause_in_a_bright_rig_is_named_with_its_size(
    effect: str, parameter: str, value: float, error: float, tmp_path: Path
) -> None:
    """Rationale: 3 % of modulus was named a stiffening bone, by derivatives of a moving edge."""
    answer = criticised(tmp_path, 6, f"effects.{effect}.{parameter}={value}")
    assert answer["effects"][0]["id"] == effect
    assert answer["effects"][0]["parameters"][parameter]["value"] == pytest.approx(value, abs=error)
    assert answer["gain"]["log_score"][1] > 0.0
