"""``evanesce study thesis-jointly``: which mechanisms explain all that the thesis published of both fingers."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.markup import escape
from rich.table import Table

from evanesce.cli.common import (
    JsonOption,
    check_json_target,
    console,
    handles_errors,
    messages,
    write_json,
)
from evanesce.core.errors import InputError

SD_TIMES = (0.2, 5.0)


def register(group: typer.Typer) -> None:
    """Add the command to the group of studies."""

    @group.command(name="thesis-jointly")
    @handles_errors
    def thesis_jointly(
        folders: Annotated[
            list[Path], typer.Argument(help="Bundles with outcomes.toml: one for each finger.", metavar="BUNDLE...")
        ],
        json_file: JsonOption = None,
        report: Annotated[Path | None, typer.Option("--report", help="Write an HTML page to this file.")] = None,
        sd_times: Annotated[
            float, typer.Option("--sd-times", help="Factor of all standard deviations: none is printed in the thesis.")
        ] = 1.0,
    ) -> None:
        """Judge mechanisms of optics, mechanics and reading jointly on the published outcomes of both fingers.

        All sets of the listed mechanisms are fitted: some minutes.
        """
        from evanesce.core.provenance import record
        from evanesce.report.html import write
        from evanesce.studies.thesis_jointly.answer import criticise_thesis
        from evanesce.studies.thesis_jointly.data import read_outcomes
        from evanesce.studies.thesis_jointly.page import page

        if report is not None and report.suffix.lower() != ".html":
            raise InputError(
                f"ends in {report.suffix!r}", file=report, key="--report", allowed="a file ending in .html"
            )
        for target in (json_file, report):
            check_json_target(target)
        if not SD_TIMES[0] <= sd_times <= SD_TIMES[1]:
            raise InputError(f"{sd_times:g}", key="--sd-times", allowed=f"{SD_TIMES[0]:g} to {SD_TIMES[1]:g}")
        outcomes, began = replace(read_outcomes(folders), times=sd_times), time.monotonic()

        def tell(line: str) -> None:
            messages.print(escape(f"{time.monotonic() - began:4.0f} s  {line}"), highlight=False)

        result = criticise_thesis(outcomes, tell)
        result["seconds"] = time.monotonic() - began
        result["provenance"] = dict(record())
        write_json(json_file, result)
        if report is not None:
            write(report, page(result, record()))
        _show(result)


def _show(result: dict[str, Any]) -> None:
    from evanesce.studies.thesis_jointly import page

    console.print(escape(result["first_line"]), soft_wrap=True)
    for made in (
        page.mechanism_table(result), page.set_table(result), page.parameter_table(result),
        page.outcome_table(result), page.alternative_table(result), page.menu_table(result),
    ):  # fmt: skip
        shown = Table(title=escape(made.caption), title_justify="left", box=box.SIMPLE_HEAD)
        left_out = [k for k, name in enumerate(made.columns) if name.startswith(("prior of", "origin", "what"))]
        for k, heading in enumerate(made.columns):
            if k not in left_out:
                shown.add_column(heading, justify="left" if k == 0 else "right", overflow="fold")
        for row in made.rows:
            shown.add_row(*(escape(cell) for k, cell in enumerate(row) if k not in left_out))
        console.print(shown)
    console.print(escape(f"Next: {result['next_measurement']['advice']}."), highlight=False, soft_wrap=True)
