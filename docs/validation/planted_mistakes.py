"""Plant each mistake in a drawn lab, measure, and print the table of the page: a quarter of an hour on two cores.

    python docs/validation/planted_mistakes.py [--write]

``--write`` puts the table into docs/validation/planted-mistakes.md, between its two marks.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path

from typer.testing import CliRunner

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from evanesce.cli.app import app  # noqa: E402
from support.planted import ALWAYS, MISTAKES, SMALL, Made, Mistake, truth  # noqa: E402
from support.walk import calibrate_args  # noqa: E402

PAGE = ROOT / "docs" / "validation" / "planted-mistakes.md"
BEGIN, END = "<!-- table -->", "<!-- end of table -->"
LONGEST = 40


def row(mistake: Mistake, code: int, said: list[str], error: float | None) -> str:
    """Return the table's row of a mistake."""
    lines = [line for line in said if not any(name in line for name in ALWAYS)]
    chosen = [line for line in lines if any(word in line for word in mistake.says)][:1] if mistake.says else []
    text = chosen[0] if chosen else ""
    text = text.removeprefix("warning: ").removeprefix("error: ").replace("|", "/")
    text = text if len(text) <= LONGEST else text[:LONGEST].rsplit(" ", 1)[0] + " ..."
    says = f"`{text}`" if text else f"nothing: {mistake.why}" if mistake.why else "nothing"
    return f"| {mistake.what} | {code} | {says} | {'' if error is None else f'{100 * error:+.1f}'} |"


def rows() -> list[str]:
    """Plant, measure and return all rows."""
    found = []
    with tempfile.TemporaryDirectory() as name:
        made = Made(Path(name))
        os.chdir(name)
        assert CliRunner().invoke(app, calibrate_args(SMALL, made.folder)).exit_code == 0
        for mistake in MISTAKES:
            mistake.plant(made)
            target = made.folder / "o.json"
            target.unlink(missing_ok=True)
            done = CliRunner().invoke(app, [*mistake.args, "--json", str(target)])
            said = [line for line in done.stderr.splitlines() if line.startswith(("warning:", "error:"))]
            frames = json.loads(target.read_text())["frames"] if target.exists() else []
            error = frames[-1]["area_mm2"] / truth(made) - 1 if frames and done.exit_code == 0 else None
            found.append(row(mistake, done.exit_code, said, error))
            print(found[-1], flush=True)
        os.chdir(ROOT)
    return found


def write(found: list[str]) -> None:
    """Put the rows into the page."""
    page = PAGE.read_text(encoding="utf-8")
    before, after = page.split(BEGIN)[0], page.split(END)[1]
    head = ["| mistake | exit code | what `evanesce measure` says first of it | area error, last frame [%] |",
            "|---|---|---|---|"]  # fmt: skip
    PAGE.write_text(before + "\n".join([BEGIN, "", *head, *found, "", END]) + after, encoding="utf-8")


if __name__ == "__main__":
    table = rows()
    if "--write" in sys.argv[1:]:
        write(table)
