"""``evanesce fem``: press and slide with finite elements, the study of the mesh, import of foreign results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import typer
from rich.table import Table

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    console,
    handles_errors,
    messages,
    out_dir,
    progress,
    write_json,
)
from evanesce.errors import InputError
from evanesce.extras import require

if TYPE_CHECKING:
    from evanesce.contact.fem.material import Rubber
    from evanesce.contact.fem.result import SolvedRun

Hold = Literal["force", "depth"]
MaterialOption = Annotated[str, typer.Option("--material", help="A silicone with a hyperelastic fit.")]
RadiusOption = Annotated[float, typer.Option("--tip-radius-mm", help="Radius of the tip.")]
DiameterOption = Annotated[float, typer.Option("--diameter-mm", help="Diameter of the shaft.")]
LengthOption = Annotated[float, typer.Option("--length-mm", help="From the apex to the top face.")]
BoneOption = Annotated[float, typer.Option("--bone-radius-mm", help="Rigid bone; 0 for none.")]
CubicOption = Annotated[
    float, typer.Option("--c30-MPa", help="Third-order term that widens the stable range; NOT the thesis's material.")
]
ForcesOption = Annotated[list[float] | None, typer.Option("--force-N", help="Normal force to reach; repeatable.")]
FrictionOption = Annotated[float, typer.Option("--friction", help="Coulomb's coefficient.")]
SizeOption = Annotated[float | None, typer.Option("--element-mm", help="Element size at the contact.")]
VtkOption = Annotated[bool, typer.Option("--vtk", help="Write the last step as VTK as well.")]
CacheOption = Annotated[bool, typer.Option("--cache/--no-cache", help="Keep solved steps and go on from them.")]


def register(app: typer.Typer) -> None:
    """Add the group ``fem``."""
    group = typer.Typer(help="Contact by finite elements (solving needs the extra 'fem').", no_args_is_help=True)
    group.command("press")(handles_errors(press))
    group.command("slide")(handles_errors(slide))
    group.command("convergence")(handles_errors(convergence))
    group.command("import")(handles_errors(import_))
    app.add_typer(group, name="fem")


def press(
    material: MaterialOption = "silskin_0",
    force: ForcesOption = None,
    depth: Annotated[list[float] | None, typer.Option("--depth-mm", help="Depth to reach; repeatable.")] = None,
    friction: FrictionOption = 0.0,
    tip_radius: RadiusOption = 7.5,
    diameter: DiameterOption = 15.0,
    length: LengthOption = 25.0,
    bone_radius: BoneOption = 0.0,
    c30: CubicOption = 0.0,
    element: SizeOption = None,
    vtk: VtkOption = False,
    cache: CacheOption = True,
    out: OutOption = None,
    json_file: JsonOption = None,
) -> None:
    """Press a finger straight onto the glass (axisymmetric) and print depth, area and modulus at each force."""
    from evanesce.contact.fem.mesh import FingerShape, MeshSize
    from evanesce.contact.fem.press import press as solve
    from evanesce.contact.fem.press import press_goals
    from evanesce.contact.fem.runs import check_friction

    check_json_target(json_file)
    check_friction(friction)
    shape = FingerShape(tip_radius, diameter, length, bone_radius)
    chosen = _rubber(material, c30)
    forces = force or ([] if depth else [1.0])
    goals = press_goals(forces, depth or [])
    size = None if element is None else MeshSize(contact=element)

    def work(on_step: Callable[[Any, int], None]) -> SolvedRun:
        return solve(
            shape, chosen, forces=forces, depths=depth or [], friction=friction, size=size,
            cache=_cache(cache), on_step=on_step,
        )  # fmt: skip

    _solve_and_report("press", work, len(goals), out, json_file, vtk, c30)


def slide(
    material: MaterialOption = "silskin_0",
    force: Annotated[float | None, typer.Option("--force-N", help="Force to press to.")] = None,
    depth: Annotated[float | None, typer.Option("--depth-mm", help="Depth to press to, instead of a force.")] = None,
    distance: Annotated[list[float] | None, typer.Option("--distance-mm", help="Slide to reach; repeatable.")] = None,
    friction: FrictionOption = 0.67,
    hold: Annotated[str, typer.Option("--hold", help="What is kept while sliding: force or depth.")] = "force",
    tip_radius: RadiusOption = 7.5,
    diameter: DiameterOption = 15.0,
    length: LengthOption = 25.0,
    bone_radius: BoneOption = 0.0,
    c30: CubicOption = 0.0,
    element: SizeOption = None,
    vtk: VtkOption = False,
    cache: CacheOption = True,
    out: OutOption = None,
    json_file: JsonOption = None,
) -> None:
    """Press a finger and slide it over the glass (three-dimensional): forces, area and stick against the way."""
    from evanesce.contact.fem.mesh import FingerShape, MeshSize
    from evanesce.contact.fem.runs import check_friction
    from evanesce.contact.fem.slide import SLIDE_MESH, slide_goals
    from evanesce.contact.fem.slide import slide as solve

    check_json_target(json_file)
    if hold not in get_args(Hold):
        raise InputError(f"{hold!r}", key="--hold", allowed="force, depth")
    shape, chosen = FingerShape(tip_radius, diameter, length, bone_radius), _rubber(material, c30)
    if force is None and depth is None:
        force = 1.0
    distances = distance or [10.0]
    kept: Hold = "force" if hold == "force" else "depth"
    check_friction(friction)
    slide_goals(force, depth, distances, kept)
    size = SLIDE_MESH
    if element is not None:
        size = MeshSize(element, SLIDE_MESH.fine_extent, SLIDE_MESH.growth, max(SLIDE_MESH.coarsest, element))

    def work(on_step: Callable[[Any, int], None]) -> SolvedRun:
        return solve(
            shape, chosen, force=force, depth=depth, distances=distances, friction=friction, size=size,
            hold=kept, cache=_cache(cache), on_step=on_step,
        )  # fmt: skip

    _solve_and_report("slide", work, 1 + len(distances), out, json_file, vtk, c30)


def convergence(
    material: MaterialOption = "silskin_0",
    force: Annotated[float, typer.Option("--force-N", help="Normal force.")] = 1.0,
    sizes: Annotated[
        list[float] | None, typer.Option("--element-mm", help="Element size, falling; repeatable.")
    ] = None,
    friction: FrictionOption = 0.0,
    tip_radius: RadiusOption = 7.5,
    diameter: DiameterOption = 15.0,
    length: LengthOption = 25.0,
    bone_radius: BoneOption = 0.0,
    cache: CacheOption = True,
    out: OutOption = None,
    json_file: JsonOption = None,
) -> None:
    """Press on ever finer meshes, from 3.75 mm down to the thesis's 0.33 mm and finer; plot area against size."""
    from evanesce import provenance
    from evanesce.contact.fem.convergence import FINER_SIZES, THESIS_SIZES, MeshResult, check_sizes
    from evanesce.contact.fem.convergence import convergence as study
    from evanesce.contact.fem.mesh import FingerShape
    from evanesce.contact.fem.press import press_goals

    check_json_target(json_file)
    press_goals([force])
    shape, chosen = FingerShape(tip_radius, diameter, length, bone_radius), _rubber(material, 0.0)
    wanted = tuple(sizes) if sizes else THESIS_SIZES + FINER_SIZES
    check_sizes(wanted)
    folder = out_dir(out, "fem-convergence")
    with progress() as bar:
        task = bar.add_task("meshes", total=len(wanted))

        def on_mesh(mesh: MeshResult) -> None:
            bar.update(task, advance=1, description=f"{mesh.element_size:g} mm: {mesh.area:.2f} mm^2")

        found = study(shape, chosen, force=force, sizes=wanted, friction=friction, cache=_cache(cache), on_mesh=on_mesh)
    rows = [
        {**asdict(mesh), "area_deviation": float(off)}
        for mesh, off in zip(found.meshes, found.deviation(), strict=True)
    ]
    _print_rows(f"area at {force:g} N against element size", [_renamed(row) for row in rows])
    at = found.converged_at
    console.print("not converged to 1 %" if at is None else f"area within 1 % of the finest mesh from {at:g} mm on")
    result = {
        "force_N": force,
        "meshes": [_renamed(row) for row in rows],
        "converged_at_mm": at,
        "tolerance": found.tolerance,
        "provenance": dict(provenance.record(config={"shape": asdict(shape), "material": chosen.identity()})),
    }
    _save_figure(_convergence_figure(found), folder / "convergence.png")
    write_json(folder / "convergence.json", result)
    write_json(json_file, result)
    console.print(f"written to {folder}")


def import_(
    file: Annotated[Path, typer.Argument(help="CSV with x, y, pressure, gap (units in the headings), or VTK.")],
    force: Annotated[float | None, typer.Option("--force-N", help="What the pressure should add up to.")] = None,
    length_unit: Annotated[float, typer.Option("--length-unit-mm", help="Of a VTK file: mm per unit.")] = 1.0,
    pressure_unit: Annotated[float, typer.Option("--pressure-unit-MPa", help="Of a VTK file: MPa per unit.")] = 1.0,
    pressure_name: Annotated[str, typer.Option("--pressure-name", help="Point data of a VTK file.")] = "",
    gap_name: Annotated[str, typer.Option("--gap-name", help="Point data of a VTK file.")] = "",
    pitch: Annotated[float, typer.Option("--pitch-mm", help="Spacing of the plate grid written.")] = 0.05,
    out: OutOption = None,
    json_file: JsonOption = None,
) -> None:
    """Check finite-element results of another program and write them as a contact on a plate grid."""
    import numpy as np

    from evanesce import provenance
    from evanesce.contact.fem.importer import read_foreign, summary
    from evanesce.contact.fem.result import write_npz
    from evanesce.states import PlateGrid

    check_json_target(json_file)
    if not 1e-3 <= pitch <= 5.0:
        raise InputError(f"{pitch:g} mm", key="--pitch-mm", allowed="0.001 to 5 mm")
    for key, unit in (("--length-unit-mm", length_unit), ("--pressure-unit-MPa", pressure_unit)):
        if not (np.isfinite(unit) and unit > 0):
            raise InputError(f"{unit:g}", key=key, allowed="above 0, finite")
    names = {key: name for key, name in (("pressure", pressure_name), ("gap", gap_name)) if name}
    found = read_foreign(file, force=force, names=names, length_unit_mm=length_unit, pressure_unit_MPa=pressure_unit)
    low, high = found.place.min(axis=0), found.place.max(axis=0)
    cols, rows = (int(np.ceil(extent / pitch)) + 2 for extent in high - low)
    if rows * cols > 4096**2:
        raise InputError(f"a grid of {rows} x {cols}", key="--pitch-mm", allowed="a wider pitch: at most 4096 x 4096")
    middle = (float(low[0] + high[0]) / 2, float(low[1] + high[1]) / 2)
    state = found.state(PlateGrid((rows, cols), pitch, middle))
    folder = out_dir(out, "fem-import")
    figures = {**summary(found), "file": str(file), "rows": rows, "cols": cols, "pitch_mm": pitch, "centre_mm": middle}
    write_npz(
        folder / "contact.npz",
        {
            "pressure_MPa": np.asarray(state.pressure), "gap_mm": np.asarray(state.gap),
            "contact_mask": np.asarray(state.contact_mask), "x_mm": state.grid.x, "y_mm": state.grid.y,
        },
        compressed=True,
    )  # fmt: skip
    result = {**figures, "provenance": dict(provenance.record())}
    write_json(folder / "import.json", result)
    write_json(json_file, result)
    _print_rows(f"{file.name}", [summary(found)])
    console.print(f"written to {folder}")


def _rubber(name: str, c30: float) -> Rubber:
    from evanesce.contact.fem.material import rubber

    chosen = rubber(name, c30=c30)
    if c30:
        messages.print(
            f"note: c30 = {c30:g} MPa is added for stability; results are not those of the thesis's material"
        )
    return chosen


def _cache(wanted: bool) -> Path | None:
    from evanesce.contact.fem.runs import cache_folder

    return cache_folder() if wanted else None


def _solve_and_report(
    kind: str,
    work: Callable[[Callable[[Any, int], None]], SolvedRun],
    goals: int,
    out: Path | None,
    json_file: Path | None,
    vtk: bool,
    c30: float,
) -> None:
    """Solve under a progress bar; write what was solved even where a limit ended it, then say so."""
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
    _write_run(kind, run, folder, json_file, vtk, c30, str(limit) if limit else "")
    if limit is not None:
        raise limit


def _write_run(
    kind: str, run: SolvedRun, folder: Path, json_file: Path | None, vtk: bool, c30: float, limit: str
) -> None:
    from evanesce import provenance
    from evanesce.contact.fem.result import save_run, write_vtk

    rows = [run.row(i) for i in range(len(run))]
    shown = rows if kind == "slide" else [rows[i] for i in run.reached()] or rows[-1:]
    keep = ("step", "depth_mm", "slide_mm", "normal_force_N", "tangential_force_N", "area_mm2", "peak_pressure_MPa")
    more = ("stick_force_share",) if kind == "slide" else ("reduced_modulus_MPa",)
    _print_rows(kind, [{key: row[key] for key in keep + more} for row in shown])
    save_run(folder / f"{kind}.npz", run)
    if vtk:
        write_vtk(folder / f"{kind}.vtu", run, -1)
    result = {
        "kind": kind, "inputs": dict(run.inputs), "steps": rows, "limit": limit, "is_thesis_material": c30 == 0.0,
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


def _renamed(row: dict[str, Any]) -> dict[str, Any]:
    return {_UNITS.get(key, key): value for key, value in row.items()}


def _print_rows(title: str, rows: Sequence[dict[str, Any]]) -> None:
    table = Table(title=title)
    for key in rows[0]:
        table.add_column(key, justify="right")
    for row in rows:
        table.add_row(*(f"{value:.4g}" if isinstance(value, float) else str(value) for value in row.values()))
    console.print(table)


def _convergence_figure(found: Any) -> Any:
    """Area and its deviation from the finest mesh, against element size."""
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


def _save_figure(figure: Any, path: Path) -> None:
    from evanesce.report.html import figure_png

    temporary = path.with_name(f".{path.name}.part")
    temporary.write_bytes(figure_png(figure))
    temporary.replace(path)
