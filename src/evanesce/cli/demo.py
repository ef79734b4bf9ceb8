"""``evanesce demo``: the whole loop on the thesis's rig, one table and a report."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    console,
    handles_errors,
    out_dir,
    progress,
    write_json,
)
from evanesce.cli.render import FastOption, VariantOption

if TYPE_CHECKING:
    from evanesce.validation.demo import Demo


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    @handles_errors
    def demo(
        quick: Annotated[bool, typer.Option("--quick", help="One force and fewer paths: under a minute.")] = False,
        fast: FastOption = False,
        variant: VariantOption = "auto",
        seed: Annotated[int, typer.Option("--seed", min=0)] = 1,
        json_file: JsonOption = None,
        out: OutOption = None,
    ) -> None:
        """Render, photograph, calibrate, measure and compare: smooth and ridged finger at 1, 2 and 5 N."""
        from dataclasses import replace

        from evanesce.render.variant import select
        from evanesce.report.demo_page import demo_page
        from evanesce.report.html import write
        from evanesce.validation.demo import DemoSettings, run_demo

        check_json_target(json_file)
        folder = out_dir(out, "demo")
        settings = replace(DemoSettings.quick() if quick else DemoSettings(), seed=seed)
        started = time.monotonic()
        info = select(variant)
        renderer, record = None, {"renderer": "path", "variant": info.name}
        if fast:
            from evanesce.render.transport import render_fast

            renderer, record["renderer"] = render_fast, "transport"
        with progress() as bar:
            tasks = {}

            def tick(what: str, done: int, total: int) -> None:
                if what not in tasks:
                    tasks[what] = bar.add_task(what, total=total)
                bar.update(tasks[what], completed=done)

            found = run_demo(folder, settings, variant=variant, renderer=renderer, record=record, tick=tick)
        result = found.as_dict() | {"seconds": time.monotonic() - started}
        report = write(folder / "report.html", demo_page(found))
        write_json(folder / "result.json", result)
        write_json(json_file, result)
        console.print(_table(found))
        console.print(f"{info.name}, {result['seconds']:.0f} s. Report: {report}", highlight=False, soft_wrap=True)


def _table(found: Demo) -> Table:
    table = Table(
        title="Contact area by the author's chain against the truth",
        caption="Error and its parts in percent of the true area; 'scale' is the square card's, 'blur' the lens's.",
    )
    for column in ("finger", "force [N]", "true [mm²]", "measured [mm²]", "error [%]"):
        table.add_column(column, justify="left" if column == "finger" else "right")
    rows = [frame.row() for frame in found.frames]
    parts = list(rows[0]["split_percent"])
    for part in parts:
        table.add_column(f"{part} [%]", justify="right")
    for row in rows:
        table.add_row(
            row["finger"],
            f"{row['force_N']:g}",
            f"{row['true_area_mm2']:.3f}",
            f"{row['measured_area_mm2']:.3f}",
            f"{row['error_percent']:+.2f}",
            *(f"{row['split_percent'][part]:+.2f}" for part in parts),
        )
    return table
