"""``evanesce fem``: press and slide with finite elements, the study of the mesh, import of foreign results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import typer

from evanesce.cli import fem_output as output
from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    console,
    handles_errors,
    messages,
    out_dir,
    progress,
    write_figure,
    write_json,
)
from evanesce.core.errors import InputError

if TYPE_CHECKING:
    from evanesce.contact.fem.material import Rubber
    from evanesce.contact.fem.mesh import FingerShape
    from evanesce.contact.fem.result import SolvedRun

Hold = Literal["force", "depth"]
OnStep = Callable[[Any, int], None]
MaterialOption = Annotated[str, typer.Option("--material", help="A silicone with a hyperelastic fit.")]
RadiusOption = Annotated[float, typer.Option("--tip-radius-mm", help="Radius of the tip.")]
DiameterOption = Annotated[float, typer.Option("--diameter-mm", help="Diameter of the shaft.")]
LengthOption = Annotated[float, typer.Option("--length-mm", help="From the apex to the top face.")]
BoneOption = Annotated[float, typer.Option("--bone-radius-mm", help="Rigid bone; 0 for none.")]
CubicOption = Annotated[
    float, typer.Option("--c30-MPa", help="Third-order term that widens the stable range; NOT the thesis's material.")
]
CarryOption = Annotated[
    bool,
    typer.Option("--carry-on", help="Stiffen the material where its fit loses stability; NOT the thesis's material."),
]
ForcesOption = Annotated[list[float] | None, typer.Option("--force-N", help="Normal force to reach; repeatable.")]
FrictionOption = Annotated[float, typer.Option("--friction", help="Coulomb's coefficient.")]
SizeOption = Annotated[float | None, typer.Option("--element-mm", help="Element size at the contact.")]
VtkOption = Annotated[bool, typer.Option("--vtk", help="Write the last step as VTK as well.")]
CacheOption = Annotated[bool, typer.Option("--cache/--no-cache", help="Cache solved steps and resume from them.")]


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
    carry_on: CarryOption = False,
    element: SizeOption = None,
    vtk: VtkOption = False,
    cache: CacheOption = True,
    out: OutOption = None,
    json_file: JsonOption = None,
) -> None:
    """Press a finger straight onto the glass (axisymmetric) and print depth, area and modulus at each force."""
    from evanesce.contact.fem.mesh import FingerShape, MeshSize
    from evanesce.contact.fem.programme import press as solve
    from evanesce.contact.fem.programme import press_goals

    check_json_target(json_file)
    goals = press_goals(forces := force or ([] if depth else [1.0]), depth or [])
    size = None if element is None else MeshSize(contact=element)
    chosen = _rubber(material, c30, carry_on=carry_on)
    work = _work(
        solve, FingerShape(tip_radius, diameter, length, bone_radius), chosen,
        friction, cache, forces=forces, depths=depth or [], size=size,
    )  # fmt: skip
    output.solve_and_report("press", work, len(goals), out, json_file, vtk, _published(material, chosen))


def slide(
    material: MaterialOption = "silskin_0",
    force: Annotated[float | None, typer.Option("--force-N", help="Force to press to.")] = None,
    depth: Annotated[float | None, typer.Option("--depth-mm", help="Depth to press to, instead of a force.")] = None,
    distance: Annotated[list[float] | None, typer.Option("--distance-mm", help="Slide to reach; repeatable.")] = None,
    friction: FrictionOption = 0.67,
    hold: Annotated[str, typer.Option("--hold", help="Held constant while sliding: force or depth.")] = "force",
    tip_radius: RadiusOption = 7.5,
    diameter: DiameterOption = 15.0,
    length: LengthOption = 25.0,
    bone_radius: BoneOption = 0.0,
    c30: CubicOption = 0.0,
    carry_on: CarryOption = False,
    element: SizeOption = None,
    vtk: VtkOption = False,
    cache: CacheOption = True,
    out: OutOption = None,
    json_file: JsonOption = None,
) -> None:
    """Press a finger and slide it over the glass (three-dimensional): forces, area and stick against the distance."""
    from evanesce.contact.fem.mesh import FingerShape, MeshSize
    from evanesce.contact.fem.programme import SLIDE_MESH, slide_goals
    from evanesce.contact.fem.programme import slide as solve

    check_json_target(json_file)
    if hold not in get_args(Hold):
        raise InputError(f"{hold!r}", key="--hold", allowed="force, depth")
    if force is None and depth is None:
        force = 1.0
    distances = distance or [10.0]
    kept: Hold = "force" if hold == "force" else "depth"
    slide_goals(force, depth, distances, kept)
    size = SLIDE_MESH
    if element is not None:
        size = MeshSize(element, SLIDE_MESH.fine_extent, SLIDE_MESH.growth, max(SLIDE_MESH.coarsest, element))
    chosen = _rubber(material, c30, carry_on=carry_on)
    work = _work(
        solve, FingerShape(tip_radius, diameter, length, bone_radius), chosen,
        friction, cache, force=force, depth=depth, distances=distances, size=size, hold=kept,
    )  # fmt: skip
    output.solve_and_report("slide", work, 1 + len(distances), out, json_file, vtk, _published(material, chosen))


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
    """Press on a series of meshes, from 3.75 mm to the thesis's 0.33 mm and finer; plot area against element size."""
    from evanesce.contact.fem.convergence import FINER_SIZES, THESIS_SIZES, MeshResult, check_sizes
    from evanesce.contact.fem.convergence import convergence as study
    from evanesce.contact.fem.mesh import FingerShape
    from evanesce.contact.fem.programme import press_goals
    from evanesce.core import provenance

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
    output.print_rows(f"area at {force:g} N against element size", [output.with_units(row) for row in rows])
    at = found.converged_at
    console.print("not converged to 1 %" if at is None else f"area within 1 % of the finest mesh from {at:g} mm on")
    result = {
        "force_N": force,
        "meshes": [output.with_units(row) for row in rows],
        "converged_at_mm": at,
        "tolerance": found.tolerance,
        "provenance": dict(provenance.record(config={"shape": asdict(shape), "material": chosen.identity()})),
    }
    write_figure(folder / "convergence.png", output.convergence_figure(found))
    write_json(folder / "convergence.json", result)
    write_json(json_file, result)
    console.print(f"written to {folder}")


def import_(
    file: Annotated[Path, typer.Argument(help="CSV with x, y, pressure, gap (units in the headings), or VTK.")],
    force: Annotated[float | None, typer.Option("--force-N", help="Integral of the pressure that is expected.")] = None,
    length_unit: Annotated[float, typer.Option("--length-unit-mm", help="Of a VTK file: mm per unit.")] = 1.0,
    pressure_unit: Annotated[float, typer.Option("--pressure-unit-MPa", help="Of a VTK file: MPa per unit.")] = 1.0,
    pressure_name: Annotated[str, typer.Option("--pressure-name", help="Point data of a VTK file.")] = "",
    gap_name: Annotated[str, typer.Option("--gap-name", help="Point data of a VTK file.")] = "",
    pitch: Annotated[float, typer.Option("--pitch-mm", help="Spacing of the plate grid written.")] = 0.05,
    out: OutOption = None,
    json_file: JsonOption = None,
) -> None:
    """Check finite-element results of another program, and write them as a contact on a plate grid."""
    import numpy as np

    from evanesce.contact.fem.importer import read_foreign, summary
    from evanesce.contact.fem.result import write_npz
    from evanesce.core import provenance
    from evanesce.core.states import PlateGrid

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
    output.print_rows(f"{file.name}", [summary(found)])
    console.print(f"written to {folder}")


def _published(name: str, chosen: Rubber) -> bool:
    from evanesce.contact.fem.material import rubber

    return chosen == rubber(name)


def _rubber(name: str, c30: float, *, carry_on: bool = False) -> Rubber:
    from evanesce.contact.fem.material import carried_on, rubber

    chosen = rubber(name, c30=c30)
    if c30:
        messages.print(
            f"note: c30 = {c30:g} MPa is added for stability; results are not those of the thesis's material"
        )
    if not carry_on:
        return chosen
    carried = carried_on(chosen)
    low, high = chosen.stable_stretches()
    messages.print(
        f"note: the fit is stable for stretches of {low:.3g} to {high:.3g}"
        + (f"; stiffened from I1 - 3 = {carried.beyond_from:.3g} on" if carried != chosen else ": nothing to carry on")
    )
    return carried


def _work(
    solve: Callable[..., SolvedRun], shape: FingerShape, rubber: Rubber, friction: float, cache: bool, **loads: Any
) -> Callable[[OnStep], SolvedRun]:
    """Return the solution of a press or a slide as a function of what is called at each step."""
    from evanesce.contact.fem.runs import check_friction

    check_friction(friction)
    return lambda on_step: solve(shape, rubber, friction=friction, cache=_cache(cache), on_step=on_step, **loads)


def _cache(wanted: bool) -> Path | None:
    from evanesce.contact.fem.runs import cache_folder

    return cache_folder() if wanted else None
