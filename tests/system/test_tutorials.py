"""The tutorials run as they stand: every file, snippet and command of a page, in its order, in an empty folder."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from support.tutorials import blocks, run_page, same_text

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = sorted(path for path in (ROOT / "docs" / "tutorials").glob("*.md") if path.stem != "index")
QUICK = ("your-own-rig", "new-effect")
"""Run by ``make test``; the others take minutes."""

IN_A_CHECKOUT = ("new-effect",)
"""Pages that change the source: they get a copy of it."""


@pytest.mark.system
@pytest.mark.parametrize(
    "path",
    [pytest.param(p, id=p.stem, marks=() if p.stem in QUICK else pytest.mark.slow) for p in TUTORIALS],
)
def test_tutorial_runs_as_it_stands(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    environ = {}
    if path.stem in IN_A_CHECKOUT:
        for name in ("src", "scenes", "calibration"):
            shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
        environ["PYTHONPATH"] = str(tmp_path / "src")
    monkeypatch.syspath_prepend(str(tmp_path))
    for written in run_page(path.read_text(encoding="utf-8"), tmp_path, environ, path.name):
        assert written.is_file()


def test_every_tutorial_has_a_picture_and_something_to_run() -> None:
    assert len(TUTORIALS) == 6
    for path in TUTORIALS:
        page = path.read_text(encoding="utf-8")
        run = [block for block in blocks(page) if block.language in ("python", "console") and block.note != "not run"]
        assert len(run) >= 2, path.name
        assert "](../pictures/" in page, path.name


def test_an_output_agrees_only_with_the_same_words_and_close_numbers() -> None:
    assert same_text("area 18.01 mm², 3 px\n", "area 18.02 mm²,  3 px")
    assert not same_text("area 18.01 mm²", "area 19.01 mm²")
    assert not same_text("area 18.01 mm²", "area 18.01 px")
    assert not same_text("area 18.01 mm²", "area 18.01 mm² 3")
