"""``evanesce demo``: the whole loop on the thesis's rig, one table and a report."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    chosen_variant,
    console,
    handles_errors,
    out_dir,
    progress,
    write_json,
)
from evanesce.cli.compare import comparison_table
from evanesce.cli.render import VariantOption, check_variant


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    @handles_errors
    def demo(
        quick: Annotated[bool, typer.Option("--quick", help="One force and fewer paths: under a minute.")] = False,
        reference: Annotated[
            bool, typer.Option("--reference", help="Path trace every frame of the table: some minutes more.")
        ] = False,
        variant: VariantOption = "auto",
        seed: Annotated[int, typer.Option("--seed", min=0)] = 1,
        json_file: JsonOption = None,
        out: OutOption = None,
    ) -> None:
        """Simulate, calibrate, measure and compare with the truth: smooth and ridged finger at 1, 2 and 5 N."""
        from dataclasses import replace

        from evanesce.report.html import write
        from evanesce.studies.demo.page import demo_page
        from evanesce.studies.demo.run import DemoSettings, run_demo
        from evanesce.studies.demo.slip import slip_sequence

        check_json_target(json_file)
        check_variant(variant)
        folder = out_dir(out, "demo")
        settings = replace(DemoSettings.quick() if quick else DemoSettings(), seed=seed)
        started = time.monotonic()
        info = chosen_variant(variant)
        record = {"renderer": "path" if reference else "transport"} | info.record()
        with progress() as bar:
            tasks = {}

            def tick(what: str, done: int, total: int) -> None:
                if what not in tasks:
                    tasks[what] = bar.add_task(what, total=total)
                bar.update(tasks[what], completed=done)

            found = run_demo(folder, settings, variant=variant, reference=reference, record=record, tick=tick)
            tick("slip", 0, 1)
            slip = slip_sequence(seed, every=4 if quick else 2)
            tick("slip", 1, 1)
        result = found.as_dict() | {"seconds": time.monotonic() - started}
        report = write(folder / "report.html", demo_page(found, slip))
        write_json(folder / "result.json", result)
        write_json(json_file, result)
        console.print(comparison_table([frame.row() for frame in found.frames], ("finger", "force_N")))
        console.print(f"{info.name}, {result['seconds']:.0f} s. Report: {report}", highlight=False, soft_wrap=True)
