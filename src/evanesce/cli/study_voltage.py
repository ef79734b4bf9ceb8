"""``evanesce study voltage``: estimated area against LED voltage at a fixed threshold."""

from __future__ import annotations

import math
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
from evanesce.cli.render import SetOption, VariantOption, check_variant, chosen_renderer, parse_overrides
from evanesce.core.errors import InputError
from evanesce.core.extras import require

if TYPE_CHECKING:
    from evanesce.studies.voltage.in_colour import InColour
    from evanesce.studies.voltage.study import VoltageStudy

MAX_VOLTAGES = 200
MAX_FORCES = 10


def parse_volts(text: str) -> tuple[float, ...]:
    """Read ``first:last:step``.

    Raises
    ------
    InputError
        If it has another form, or names fewer than 3 or too many voltages.
    """
    allowed = f"first:last:step in volts, 0 < first < last <= 60, 3 to {MAX_VOLTAGES} voltages, e.g. 7:12:0.25"
    try:
        first, last, step = (float(part) for part in text.split(":"))
    except ValueError:
        raise InputError(f"{text!r}", key="--volts", allowed=allowed) from None
    if not (0 < first < last <= 60 and step > 0 and math.isfinite(step)):
        raise InputError(f"{text!r}", key="--volts", allowed=allowed)
    steps = (last - first) / step
    if not 2 <= steps + 1e-9 < MAX_VOLTAGES:
        raise InputError(f"{text!r} names {int(steps + 1e-9) + 1} voltages", key="--volts", allowed=allowed)
    return tuple(round(first + k * step, 9) for k in range(int(steps + 1e-9) + 1))


def parse_forces(text: str) -> tuple[float, ...]:
    """Read forces [N], separated by commas.

    Raises
    ------
    InputError
        If one is not a force above 0, or there are too many.
    """
    allowed = f"1 to {MAX_FORCES} different forces above 0 in newtons, e.g. 1,5"
    try:
        forces = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"{text!r}", key="--forces", allowed=allowed) from None
    if len(set(forces)) != len(forces) or len(forces) > MAX_FORCES or not all(0 < f < math.inf for f in forces):
        raise InputError(f"{text!r}", key="--forces", allowed=allowed)
    return forces


def register(group: typer.Typer) -> None:
    """Add the command to the group of studies."""
    group.command()(handles_errors(voltage))


def voltage(
    scene: Annotated[str, typer.Argument(help="Scene file or name of a shipped scene; the finger has ridges.")],
    volts: Annotated[str, typer.Option("--volts", help="first:last:step [V].")] = "7:12:0.25",
    forces: Annotated[str, typer.Option("--forces", help="Normal forces [N], separated by commas.")] = "1,5",
    threshold: Annotated[float, typer.Option("--threshold", help="Grey level 0 to 1, fixed.")] = 0.15,
    samples: Annotated[
        int, typer.Option("--samples", help="Base N of the sample of unpublished values: 2, 4, 8, ...")
    ] = 64,
    fast: Annotated[
        bool,
        typer.Option(
            "--fast/--reference",
            help="Fast renderer, or path tracer, which has no subsurface scattering (lateral_glow).",
        ),
    ] = True,
    variant: VariantOption = "auto",
    seed: Annotated[int, typer.Option("--seed", min=0)] = 1,
    settings: SetOption = None,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Area against voltage, parts of its excess, sensitivity to unpublished values, and the best setting.

    A scene with a colour camera is read with and without colour, at fixed and at automatic exposure.

    An interrupted run resumes from the samples in its output folder.
    """
    check_json_target(json_file)
    check_variant(variant)
    voltages, loads = parse_volts(volts), parse_forces(forces)
    if not 0 < threshold < 1:
        raise InputError(f"{threshold:g}", key="--threshold", allowed="above 0, below 1")
    if samples < 2 or samples > 4096 or samples & (samples - 1):
        raise InputError(f"{samples}", key="--samples", allowed="a power of two, 2 to 4096")
    require("design", "the study of voltage", "SALib")
    from evanesce.report.html import write
    from evanesce.rig import load_scene
    from evanesce.studies.voltage.page import page
    from evanesce.studies.voltage.study import run_study

    loaded = load_scene(scene, parse_overrides(settings))
    render, record = chosen_renderer(fast, variant)
    folder = out_dir(out, "study-voltage")
    started = time.monotonic()
    with progress() as bar:
        found = run_study(
            loaded, loads, voltages, threshold=threshold, base=samples, seed=seed,
            keep=folder / "samples.npz", render=render, renderer=record, tick=bar.report,
        )  # fmt: skip
    result = found.as_dict() | {"seconds": time.monotonic() - started}
    report = write(folder / "report.html", page(found))
    write_json(folder / "result.json", result)
    write_json(json_file, result)
    _show(found)
    console.print(f"{result['seconds']:.0f} s. Report: {report}", highlight=False, soft_wrap=True)


def _show(found: VoltageStudy) -> None:
    from evanesce.studies.voltage.sources import SOURCES

    table = Table(title=f"Estimated area at threshold {found.threshold:g}, and parts of its excess [mm²]")
    columns = ("force [N]", "voltage [V]", "estimated", "true", *SOURCES, "residual", "interaction")
    for heading in columns:
        table.add_column(heading, justify="right")
    for force, rows in found.curves.items():
        for row in rows[:: max(1, len(rows) // 10)]:
            parts = [row.parts_mm2[s] for s in SOURCES]
            shown = (row.area_mm2, row.true_area_mm2, *parts, row.residual_mm2, row.interaction_mm2)
            table.add_row(f"{force:g}", f"{row.voltage_V:g}", *(f"{round(v, 2) + 0.0:.2f}" for v in shown))
    console.print(table)
    held = Table(title="Share of possible rigs that agree with the thesis's observations [%]")
    for heading in ("reading", "vanishes near 8 V", "rises", "converged by 9 V", "all three"):
        held.add_column(heading, justify="right")
    for name in found.readings:
        held.add_row(name, *(f"{100 * v:.0f}" for v in found.shares(name).values()))
    console.print(held)
    if found.colour is not None:
        _show_colour(found.colour)
    best = found.best
    console.print(
        f"Smallest error over the rigs: {best.voltage_V:g} V and threshold {best.threshold:g} (median "
        f"{100 * best.error:.0f} %); cut at {best.ratio:g} of the contact's own light: {100 * best.ratio_error:.1f} %.",
        highlight=False,
    )


def _show_colour(found: InColour) -> None:
    from evanesce.studies.voltage.page_colour import SHARE_COLUMNS, share_rows

    table = Table(title="With and without colour: share of rigs (95 % interval)")
    for heading in SHARE_COLUMNS:
        table.add_column(heading, justify="left" if heading is SHARE_COLUMNS[0] else "right")
    for row in share_rows(found):
        table.add_row(*row)
    console.print(table)
    table = Table(title="Clipped red, then green, then full?")
    for heading in ("what, at every force", "rigs"):
        table.add_column(heading, justify="left" if heading != "rigs" else "right")
    for name, share in found.hypothesis.items():
        table.add_row(name, str(share))
    console.print(table)
