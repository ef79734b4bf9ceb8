"""``evanesce bench``: stiffness, DMA, friction, surface and sensor files to figures, fits and plots."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from evanesce.cli import bench_output as output
from evanesce.cli.bench_sensor import sensor
from evanesce.cli.common import JsonOption, OutOption, check_json_target, handles_errors
from evanesce.core.errors import InputError

FileArgument = Annotated[Path, typer.Argument(help="CSV file with units in its headings.")]


def register(app: typer.Typer) -> None:
    """Add the group ``bench``."""
    bench = typer.Typer(help="Evaluate bench tests: stiffness, DMA, friction, profile, sensor.", no_args_is_help=True)
    app.add_typer(bench, name="bench")
    bench.command()(handles_errors(stiffness))
    bench.command()(handles_errors(dma))
    bench.command()(handles_errors(friction))
    bench.command()(handles_errors(profile))
    bench.command()(handles_errors(sensor))


def stiffness(
    file: FileArgument,
    test: Annotated[str, typer.Option("--test", help="indentation or compression.")] = "indentation",
    scene: Annotated[
        str | None, typer.Option("--scene", help="Scene whose finger was tested: the keys to put into it are written.")
    ] = None,
    finger_radius: Annotated[
        float | None, typer.Option("--finger-radius-mm", help="Indentation; the scene's, or 7.5.")
    ] = None,
    indenter_diameter: Annotated[float, typer.Option("--indenter-diameter-mm", help="Steel cylinder.")] = 25.45,
    poisson: Annotated[float, typer.Option("--poisson-ratio", min=0.0, max=0.5)] = 0.49,
    height: Annotated[float | None, typer.Option("--height-mm", help="Compression: undeformed height.")] = None,
    area: Annotated[float | None, typer.Option("--area-mm2", help="Compression: undeformed section.")] = None,
    terms: Annotated[int, typer.Option("--terms", min=1, max=3, help="Compression: C10, C01, C11.")] = 3,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Modulus against force from an indentation (force, displacement), or Mooney-Rivlin from a compression test."""
    check_json_target(json_file)
    loaded = None
    if scene is not None:
        from evanesce.rig import load_scene

        loaded = load_scene(scene)
    if finger_radius is None:
        finger_radius = 7.5 if loaded is None else loaded.finger.tip_radius_mm
    if test not in ("indentation", "compression"):
        raise InputError(f"{test!r}", key="--test", allowed="indentation, compression")
    if not (0 < finger_radius < 1e4 and 0 < indenter_diameter < 1e4):
        raise InputError(
            "radii must be positive", key="--finger-radius-mm, --indenter-diameter-mm", allowed="0 to 10 m"
        )
    if test == "indentation":
        result, folder = output.write_indentation(file, finger_radius, indenter_diameter / 2.0, poisson, out)
    else:
        result, folder = output.write_compression(file, height, area, terms, out)
    if loaded is not None:
        result |= output.write_finger(loaded, result, folder)
    output.finish({"file": file.name, **result}, json_file, folder)


def dma(
    file: FileArgument,
    reference: Annotated[float | None, typer.Option("--reference-C", help="Temperature of the master curve.")] = None,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Prony series and time-temperature shift from frequency, storage modulus and loss factor."""
    check_json_target(json_file)
    if reference is not None and not -150 <= reference <= 400:
        raise InputError(f"{reference:g}", key="--reference-C", allowed="-150 to 400 degC")
    result, folder = output.write_dma(file, reference, out)
    output.finish({"file": file.name, **result}, json_file, folder)


def friction(
    files: Annotated[list[Path], typer.Argument(help="One CSV file a slide: time_s, Fx_N, Fy_N, Fz_N.")],
    group: Annotated[
        list[str] | None, typer.Option("--group", help="Group of each file, in their order (repeatable).")
    ] = None,
    smoothing: Annotated[float | None, typer.Option("--smoothing-s", help="Window for the static peak.")] = None,
    speed: Annotated[
        list[float] | None,
        typer.Option("--speed-mm-per-s", help="Of the drive, for each file: tells stick-slip from the machine."),
    ] = None,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Static and dynamic coefficient, stick-slip and its significance; repeatability and ANOVA over several slides."""
    check_json_target(json_file)
    groups = group or ["all"] * len(files)
    if len(groups) != len(files):
        raise InputError(f"{len(groups)} groups for {len(files)} files", key="--group", allowed="one for each file")
    if smoothing is not None and not smoothing > 0:
        raise InputError(f"{smoothing:g}", key="--smoothing-s", allowed="above 0 s")
    if speed and len(speed) != len(files):
        raise InputError(
            f"{len(speed)} speeds for {len(files)} files", key="--speed-mm-per-s", allowed="one for each file"
        )
    if speed and not all(0.0 < v < 1e4 for v in speed):
        raise InputError(", ".join(f"{v:g}" for v in speed), key="--speed-mm-per-s", allowed="above 0, to 10000 mm/s")
    result, folder = output.write_friction(files, groups, smoothing, speed or [], out)
    output.finish(result, json_file, folder)


def profile(
    file: Annotated[Path, typer.Argument(help="Profile (CSV: x_mm, z_um) or height map (CSV matrix, TIFF, EXR).")],
    pitch: Annotated[float | None, typer.Option("--pitch-um", help="Sample distance of a height map.")] = None,
    unit: Annotated[str, typer.Option("--z-unit", help="Unit of a height map's figures.")] = "um",
    form: Annotated[
        int,
        typer.Option(
            "--form-degree", min=1, max=6, help="Degree of the form that is removed first; 2 for a round finger."
        ),
    ] = 1,
    height: Annotated[float | None, typer.Option("--design-height-um")] = None,
    width: Annotated[float | None, typer.Option("--design-width-um")] = None,
    design_pitch: Annotated[float | None, typer.Option("--design-pitch-um")] = None,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Ridge height, width, pitch and rounding with their spread against the design; a height map for the finger."""
    check_json_target(json_file)
    wanted = {"height": height, "width": width, "pitch": design_pitch}
    for name, value in wanted.items():
        if value is not None and not value > 0:
            raise InputError(f"{value:g}", key=f"--design-{name}-um", allowed="above 0 um")
    design = {name: 1e-3 * value for name, value in wanted.items() if value is not None}
    scale = None if pitch is None else 1e-3 * pitch
    result, folder = output.write_profile(file, scale, unit, form, design, out)
    output.finish({"file": file.name, **result}, json_file, folder)
