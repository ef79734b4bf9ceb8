"""No wrong area without a warning: each planted mistake, and what the program says of it.

The table is docs/validation/planted-mistakes.md.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from support.planted import ALWAYS, MISTAKES, SMALL, Made, Mistake, truth
from support.walk import calibrate_args

pytestmark = pytest.mark.system
PAGE = Path(__file__).resolve().parents[2] / "docs" / "validation" / "planted-mistakes.md"
WRONG = 0.02
"""Relative error of an area from which it is wrong: four times what a faultless measurement may be off."""

UNTOLD = {
    "camera moved 4 % nearer after calibration",
    "calibration of another camera of the same resolution",
    "another picture profile (grey levels to the power 0.7)",
    "zoom that creeps by 6 % during the film",
}
"""Mistakes that make areas wrong and that no file shows."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    made = Made(tmp_path_factory.mktemp("planted"))
    assert CliRunner().invoke(app, calibrate_args(SMALL, made.folder)).exit_code == 0
    return made


def case(mistake: Mistake) -> object:
    marks = () if mistake.quick else pytest.mark.slow  # two seconds each, a minute together
    return pytest.param(mistake, id=mistake.what, marks=marks)


@pytest.mark.parametrize("mistake", [case(m) for m in MISTAKES])
def test_no_wrong_area_without_a_warning(
    mistake: Mistake, made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(made.folder)
    mistake.plant(made)
    done = CliRunner().invoke(app, [*mistake.args, "--json", str(tmp_path / "o.json")])
    assert done.exit_code == mistake.code, done.output
    said = [line for line in done.stderr.splitlines() if line.startswith(("warning:", "error:"))]
    said = [line for line in said if not any(code in line for code in ALWAYS)]
    for word in mistake.says:
        assert any(word in line for line in said), said
    if mistake.code == 2:
        assert len([line for line in said if line.startswith("error:")]) == 1
        assert not (tmp_path / "o.json").exists()
        return
    frames = json.loads((tmp_path / "o.json").read_text())["frames"]
    error = frames[-1]["area_mm2"] / truth(made) - 1
    if mistake.what == "none":
        assert said == [], "no false alarm"
        assert abs(error) < 0.005
    if not mistake.says and mistake.what not in UNTOLD:
        assert abs(error) < WRONG
    if abs(error) > WRONG and mistake.what not in UNTOLD:
        assert said, "a wrong area without a warning"


def test_the_page_names_every_mistake() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert len(MISTAKES) - 2 >= 40
    for mistake in MISTAKES:
        assert f"| {mistake.what} |" in page
