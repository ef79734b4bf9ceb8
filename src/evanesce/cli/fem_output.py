"""Run, tables, figure and files of ``evanesce fem``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from evanesce.cli.common import console, out_dir, progress, write_json
from evanesce.core.extras import require

if TYPE_CHECKING:
    from evanesce.contact.fem.convergence import Convergence
    from evanesce.contact.fem.result import SolvedRun


def solve_and_report(
    kind: str,
    work: Callable[[Callable[[Any, int], None]], SolvedRun],
    goals: int,
    out: Path | None,
    json_file: Path | None,
    vtk: bool,
    published: bool,
) -> None:
    """Solve, and write the steps; where a limit ended the run its steps are written before the error is raised."""
    from evanesce.contact.fem.steps import LimitReached

    if vtk:
        require("fem", "--vtk", "meshio")
    folder = out_dir(out, f"fem-{kind}")
    limit: LimitReached | None = None
    with progress() as bar:
        task = bar.add_task(kind, total=goals)

        def on_step(run: SolvedRun, goal: int) -> None:
            last = run.history.steps[-1].state
            where = f"step {len(run)}: {last.depth:.3f} mm, {last.normal_force:.3f} N, slide {last.slide:.2f} mm"
            bar.update(task, completed=goal + int(run.history.steps[-1].reached), description=where)

        try:
            run = work(on_step)
        except LimitReached as error:
            limit = error
            run = error.run
            if not len(run):
                raise
    _write_run(kind, run, folder, json_file, vtk, published, str(limit) if limit else "")
    if limit is not None:
        raise limit


def _write_run(
    kind: str, run: SolvedRun, folder: Path, json_file: Path | None, vtk: bool, published: bool, limit: str
) -> None:
    from evanesce.contact.fem.result import save_run, write_vtk
    from evanesce.core import provenance

    rows = [run.row(i) for i in range(len(run))]
    shown = rows if kind == "slide" else [rows[i] for i in run.reached()] or rows[-1:]
    keep = ("step", "depth_mm", "slide_mm", "normal_force_N", "tangential_force_N", "area_mm2", "peak_pressure_MPa")
    more = ("stick_force_share",) if kind == "slide" else ("reduced_modulus_MPa",)
    print_rows(kind, [{key: row[key] for key in keep + more} for row in shown])
    save_run(folder / f"{kind}.npz", run)
    if vtk:
        write_vtk(folder / f"{kind}.vtu", run, -1)
    result = {
        "kind": kind, "inputs": dict(run.inputs), "steps": rows, "limit": limit, "is_thesis_material": published,
        "provenance": dict(provenance.record(config=dict(run.inputs))),
    }  # fmt: skip
    write_json(folder / f"{kind}.json", result)
    write_json(json_file, result)
    console.print(f"written to {folder}")


_UNITS = {
    "element_size": "element_size_mm",
    "area": "area_mm2",
    "depth": "depth_mm",
    "reduced_modulus": "reduced_modulus_MPa",
}


def with_units(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row with the unit in each key."""
    return {_UNITS.get(key, key): value for key, value in row.items()}


def print_rows(title: str, rows: Sequence[dict[str, Any]]) -> None:
    """Print rows as a table."""
    table = Table(title=title)
    for key in rows[0]:
        table.add_column(key, justify="right")
    for row in rows:
        table.add_row(*(f"{value:.4g}" if isinstance(value, float) else str(value) for value in row.values()))
    console.print(table)


def convergence_figure(found: Convergence) -> Any:
    """Return the plot of area against element size, with 1 % about the finest mesh."""
    from matplotlib.figure import Figure

    size = [mesh.element_size for mesh in found.meshes]
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    axes.semilogx(size, [mesh.area for mesh in found.meshes], "o-", color="#1f4e79")
    finest = found.meshes[-1].area
    axes.axhspan(finest * (1 - found.tolerance), finest * (1 + found.tolerance), color="#9ecae1", alpha=0.5)
    axes.invert_xaxis()
    axes.set_xlabel("element size at the contact [mm]")
    axes.set_ylabel(f"contact area at {found.force:g} N [mm²]")
    axes.annotate("finest ± 1 %", (size[0], finest), xytext=(0, 6), textcoords="offset points", fontsize=8)
    axes.set_xticks(size, [f"{s:g}" for s in size])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    return figure
