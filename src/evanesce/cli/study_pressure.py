"""``evanesce study pressure``: pressure from grey levels against the true pressure."""

from __future__ import annotations

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
from evanesce.cli.render import SetOption, parse_overrides
from evanesce.cli.study_voltage import parse_forces

if TYPE_CHECKING:
    from evanesce.studies.pressure.colour import ColourPressure


def register(group: typer.Typer) -> None:
    """Add the command to the group of studies."""

    @group.command()
    @handles_errors
    def pressure(
        scene: Annotated[str, typer.Argument(help="Scene with a smooth finger; its skin gets a roughness.")] = "thesis",
        forces: Annotated[str, typer.Option("--forces", help="Normal forces [N], separated by commas.")] = "1,3",
        seed: Annotated[int, typer.Option("--seed", min=0)] = 1,
        settings: SetOption = None,
        json_file: JsonOption = None,
        out: OutOption = None,
    ) -> None:
        """Pressure by the inverted roughness model and by the thesis's map: errors, halo, saturation.

        Of a scene with a colour camera: maps of grey, single channels and raw values against the true pressure.
        """
        check_json_target(json_file)
        loads, changes = parse_forces(forces), parse_overrides(settings)
        from evanesce.report.html import write
        from evanesce.rig import load_scene
        from evanesce.studies.pressure.colour import run_colour
        from evanesce.studies.pressure.page import number, page, page_in_colour
        from evanesce.studies.pressure.study import run_study

        loaded = load_scene(scene, changes)
        folder = out_dir(out, "study-pressure")
        if loaded.camera.colour is not None:
            with progress() as bar:
                task = bar.add_task("maps", total=None)
                maps = run_colour(
                    loaded, forces=loads, seed=seed, tick=lambda done, n: bar.update(task, completed=done, total=n)
                )
            report = write(folder / "report.html", page_in_colour(maps))
            write_json(folder / "result.json", maps.as_dict())
            write_json(json_file, maps.as_dict())
            _show_colour(maps)
            console.print(f"Report: {report}", highlight=False, soft_wrap=True)
            return
        with progress() as bar:
            task = bar.add_task("frames", total=None)
            found = run_study(
                loaded, forces=loads, seed=seed, tick=lambda done, total: bar.update(task, completed=done, total=total)
            )
        report = write(folder / "report.html", page(found))
        write_json(folder / "result.json", found.as_dict())
        write_json(json_file, found.as_dict())
        table = Table(title="Pressure map: RMS error [% of the true peak], correlation, force beside the contact [%]")
        for heading in (
            "slope",
            "force [N]",
            "voltage [V]",
            "saturated",
            "RMS",
            "reference",
            "corr.",
            "reference",
            "halo",
            "reference",
        ):
            table.add_column(heading, justify="right")
        for r in found.rows:
            table.add_row(
                f"{r.rms_slope:g}", f"{r.force_N:g}", f"{r.voltage_V:g}", f"{r.saturated_share:.2f}",
                f"{r.rms_percent:.1f}", f"{r.reference_rms_percent:.1f}", number(r.correlation),
                number(r.reference_correlation), f"{r.halo_percent:.1f}", f"{r.reference_halo_percent:.1f}",
            )  # fmt: skip
        console.print(table)
        console.print(f"Report: {report}", highlight=False, soft_wrap=True)


def _show_colour(found: ColourPressure) -> None:
    table = Table(title="Pressure map in colour, over the true contact's pixels")
    for heading in ("slope", "force [N]", "exposure x gain [ms]", "map of", "corr.", "RMS [% of peak]", "full [%]"):
        table.add_column(heading, justify="left" if heading == "map of" else "right")
    for r in found.rows:
        table.add_row(
            f"{r.rms_slope:g}", f"{r.force_N:g}", f"{r.exposure:.3g}", r.what,
            "flat" if r.correlation is None else f"{r.correlation:.3f}", f"{r.rms_percent:.1f}",
            f"{100 * r.full_share:.0f}",
        )  # fmt: skip
    console.print(table)
