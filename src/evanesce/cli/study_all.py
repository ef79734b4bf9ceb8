"""``evanesce study all`` and its parts ``threshold``, ``time`` and ``thesis``: figures, tables and one HTML report."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    console,
    handles_errors,
    out_dir,
    progress,
    write_bytes,
    write_json,
)
from evanesce.cli.render import SetOption, parse_overrides

PARTS = {
    "threshold": "Area error of the reference segmentation by threshold, rules that set it, blob size, blur and crop.",
    "time": "What clock, exposure, rolling shutter and frame rate do to areas and to the onset of slip.",
    "thesis": "The thesis's experiments in simulation: predictions stated first, then a table per figure.",
}
SceneArgument = Annotated[str, typer.Argument(help="Scene file or name of a shipped scene.")]
QuickOption = Annotated[bool, typer.Option("--quick", help="Fewer forces and speeds.")]
SeedOption = Annotated[int, typer.Option("--seed", min=0)]


def register(group: typer.Typer) -> None:
    """Add the commands to the group of studies."""
    for name, text in PARTS.items():
        _add_part(group, name, text)

    @group.command(name="all")
    @handles_errors
    def every(
        scene: SceneArgument,
        quick: QuickOption = False,
        only: Annotated[
            list[str] | None, typer.Option("--only", help="Name of a part; may be given several times.")
        ] = None,
        seed: SeedOption = 1,
        settings: SetOption = None,
        json_file: JsonOption = None,
        out: OutOption = None,
    ) -> None:
        """Run every part of the measurement's study; one self-contained HTML report with a threshold slider.

        An interrupted run resumes from the rows in its output folder.
        """
        _run(scene, only, "all", quick, seed, settings, json_file, out)


def _add_part(group: typer.Typer, name: str, text: str) -> None:
    @group.command(name=name, help=text)
    @handles_errors
    def part(
        scene: SceneArgument,
        quick: QuickOption = False,
        seed: SeedOption = 1,
        settings: SetOption = None,
        json_file: JsonOption = None,
        out: OutOption = None,
    ) -> None:
        _run(scene, [name], name, quick, seed, settings, json_file, out)


def _run(
    scene: str, only: list[str] | None, title: str, quick: bool, seed: int, settings: list[str] | None,
    json_file: Path | None, out: Path | None,
) -> None:  # fmt: skip
    check_json_target(json_file)
    from evanesce.core import provenance
    from evanesce.core.errors import InputError
    from evanesce.report.html import write
    from evanesce.rig import load_scene
    from evanesce.studies.page import page, pictures
    from evanesce.studies.registry import Findings, Study, studies
    from evanesce.studies.scenes import check_studied
    from evanesce.studies.threshold.slider import slider, slider_frames

    known = {study.name: study for study in studies()}
    if unknown := sorted(set(only or ()) - set(known)):
        raise InputError(f"{unknown[0]!r}", key="--only", allowed=", ".join(known))
    loaded = load_scene(scene, parse_overrides(settings))
    check_studied(loaded)
    folder = out_dir(out, f"study-{title}")
    parts: list[tuple[Study, Findings]] = []
    seconds: dict[str, float] = {}
    with progress() as bar:
        all_parts = bar.add_task("parts", total=len(only or known) + (title == "all"))
        for study in known.values():
            if only is None or study.name in only:
                started = time.monotonic()
                parts.append((study, study.run(loaded, folder, bar.report, quick=quick, seed=seed)))
                seconds[study.name] = time.monotonic() - started
                bar.advance(all_parts)
        widget = None
        if title == "all":
            started = time.monotonic()
            widget = slider(slider_frames(loaded, seed=seed))
            seconds["slider"] = time.monotonic() - started
            bar.advance(all_parts)
    source = provenance.code_digest()
    origin = dict(
        provenance.record(seed=seed, config=loaded.as_dict(), quick=quick, seconds=seconds, source_sha256=source)
    )
    result = {study.name: {"verdict": list(f.verdict)} | dict(f.data) for study, f in parts} | {"provenance": origin}
    lead = f"{loaded.title or scene}{'; quick: fewer forces and speeds' if quick else ''}."
    heading = "The measurement under test" if title == "all" else parts[0][0].title
    made = page(heading, parts, origin, widget, lead)
    for name, png in pictures(parts).items():
        write_bytes(folder / f"{name}.png", png)
    report = write(folder / "report.html", made)
    write_json(folder / "result.json", result)
    write_json(json_file, result)
    _show(parts)
    console.print(f"{sum(seconds.values()):.0f} s. Report: {report}", highlight=False, soft_wrap=True)


def _show(parts: list[tuple[Any, Any]]) -> None:
    """Print each part's verdict and, of a single part, its tables."""
    for study, found in parts:
        console.print(f"[bold]{escape(study.title)}[/bold]")
        for sentence in found.verdict:
            console.print(f"  {escape(sentence)}", highlight=False, soft_wrap=True)
        for table in found.tables if len(parts) == 1 else ():
            shown = Table(title=escape(re.sub(r"\s+", " ", table.caption)), title_justify="left")
            for heading in table.columns:
                shown.add_column(escape(heading), justify="left" if heading is table.columns[0] else "right")
            for row in table.rows:
                shown.add_row(*(escape(cell) for cell in row))
            console.print(shown)
