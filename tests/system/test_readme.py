"""Every command of the README runs, in its order, in an empty folder; the make targets it names exist."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from evanesce.cli.app import app

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PYTHON = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
CONSOLE = [
    line.strip()
    for block in re.findall(r"```console\n(.*?)```", README, flags=re.DOTALL)
    for line in block.splitlines()
    if line.strip()
]


@pytest.mark.slow  # two minutes; CI runs it beside the others
@pytest.mark.system
def test_readme_commands_run_one_after_the_other(tmp_path: Path) -> None:
    assert len(CONSOLE) >= 6
    path = str(Path(sys.executable).parent)
    environment = os.environ | {"PATH": path + os.pathsep + os.environ["PATH"]}
    for line in CONSOLE:
        done = subprocess.run(
            ["bash", "-c", line],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=1500,
            check=False,
        )
        assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr
    made = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()}
    assert {"demo/report.html", "calibration.json", "measured/area.csv", "rendered/light_000000.exr"} <= made


@pytest.mark.system
def test_readme_python_runs_as_it_stands(capsys: pytest.CaptureFixture[str]) -> None:
    (snippet,) = PYTHON
    exec(compile(snippet, "README.md", "exec"), {})
    areas, errors = capsys.readouterr().out.splitlines()
    true, found = map(float, areas.split()[:2])
    assert found == pytest.approx(true, rel=0.2)
    assert float(errors.split()[0]) == pytest.approx(100 * (found / true - 1), abs=0.1)


def test_readme_stays_short() -> None:
    assert len(README.split()) <= 900


def test_readme_make_targets_exist() -> None:
    targets = re.findall(r"^ {4}make (\w+)", README, flags=re.MULTILINE)
    assert targets
    for target in targets:
        # -n prints what would be done and does nothing
        done = subprocess.run(["make", "-n", target], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def test_readme_links_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)", README)
    assert links
    for link in links:
        assert (ROOT / link).exists(), link


def test_every_command_that_a_page_names_exists() -> None:
    """`evanesce WORD` in the README, the changelog and all pages: one was written and never registered."""
    known = {command.name or command.callback.__name__ for command in app.registered_commands}
    known |= {group.name for group in app.registered_groups}
    pages = [ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")]
    pattern = re.compile(r"(?:`|^ {4}|^\$ )evanesce ([a-z][a-z-]+)", re.MULTILINE)
    named = {
        (page.relative_to(ROOT).as_posix(), word)
        for page in pages
        for word in pattern.findall(page.read_text(encoding="utf-8"))
    }
    assert len(named) > 20
    assert {entry for entry in named if entry[1] not in known} == set()
