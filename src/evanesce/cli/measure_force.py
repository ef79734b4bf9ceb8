"""``evanesce measure --force``: areas joined with a load cell's forces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from evanesce.cli.common import console, messages, write_text
from evanesce.cli.measure_job import Job
from evanesce.cli.measure_output import NAMES, TABLE_ROWS
from evanesce.core.errors import InputError
from evanesce.measurement.force import AreaForce, area_force
from evanesce.measurement.io.force import ForceLog, read_force
from evanesce.measurement.plots import force_figure, save_figure
from evanesce.measurement.reference.area import AreaRow


def read(path: Path | None, offset: str) -> tuple[ForceLog | None, float | None]:
    """Read the log and the offset [s]; None of ``auto``.

    Raises
    ------
    InputError
        If either cannot be read, or an offset is given without forces.
    """
    found: float | None = None
    if offset.strip().lower() != "auto":
        try:
            found = float(offset)
        except ValueError:
            found = math.nan
        if not math.isfinite(found):
            raise InputError(f"'{offset}'", key="--offset-s", allowed="auto, or a finite number of seconds")
        if path is None:
            raise InputError("there are no forces", key="--offset-s", allowed="with --force")
    return (None if path is None else read_force(path)), found


def join(rows: Sequence[AreaRow], log: ForceLog, offset_s: float | None) -> AreaForce:
    """Join areas and forces, see :func:`~evanesce.measurement.force.area_force`."""
    return area_force(rows, log, offset_s)


def write_files(folder: Path, job: Job, joined: AreaForce | None) -> None:
    """Write ``area_force.csv`` and its plot."""
    if joined is None:
        return
    lines = ["index,time_s,force_N,area_mm2,area_low_mm2,area_high_mm2"]
    lines += [
        f"{r.index},{r.time_s!r},{f!r},{float(r.area_mm2)!r},{float(r.area_low_mm2)!r},{float(r.area_high_mm2)!r}"
        for r, f in zip(joined.rows, joined.force_N, strict=True)
    ]
    write_text(folder / "area_force.csv", "\n".join(lines) + "\n")
    save_figure(force_figure(joined, NAMES[job.pipeline.estimator]), folder / "area_force.png")


def show(joined: AreaForce | None, log: ForceLog | None) -> None:
    """Print areas against force, the offset of the clocks and both laws."""
    if joined is None or log is None:
        return
    table = Table(title="contact area against force", title_justify="left")
    for name in ("frame", "force [N]", "area [mm²]", "95 % interval [mm²]"):
        table.add_column(escape(name), justify="right")
    pairs = sorted(zip(joined.force_N, joined.rows, strict=True), key=lambda pair: (pair[0], pair[1].index))
    for force, row in pairs[:: max(1, math.ceil(len(pairs) / TABLE_ROWS))]:
        between = f"{row.area_low_mm2:.3f} to {row.area_high_mm2:.3f}"
        table.add_row(str(row.index), f"{force:.3f}", f"{row.area_mm2:.3f}", between)
    console.print(table)
    found = (
        f" ± {joined.offset_standard_s:.4f} s (standard, from the loading)" if joined.offset_standard_s else " s, given"
    )
    h, p = joined.hertz, joined.power
    for line in (
        f"the load cell's clock is the frames' {joined.offset_s:+.4f}{found}",
        f"Hertz: A = {h.factor:.4g} ({h.factor_low:.4g} to {h.factor_high:.4g}) F^(2/3), RMS {h.rms_mm2:.3f} mm²",
        f"power law: A = {p.factor:.4g} ({p.factor_low:.4g} to {p.factor_high:.4g}) F^{p.exponent:.4f}"
        f" ({p.exponent_low:.4f} to {p.exponent_high:.4f}), RMS {p.rms_mm2:.3f} mm²",
    ):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    for warning in (*log.warnings, *joined.warnings()):
        line = f"warning: {warning.code}: {warning.text}"
        messages.print(line, style="yellow", markup=False, highlight=False, soft_wrap=True)
