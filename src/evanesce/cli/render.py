"""``evanesce render``: a scene to frames, linear light and truth."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    chosen_variant,
    console,
    handles_errors,
    messages,
    out_dir,
    progress,
    write_json,
    write_text,
)
from evanesce.core.errors import InputError

if TYPE_CHECKING:
    from evanesce.api.camera import Shot

VariantOption = Annotated[str, typer.Option("--variant", help="Mitsuba variant: auto, llvm, scalar or cuda.")]
MAX_BANDS = 14
VARIANTS = ("auto", "llvm", "scalar", "cuda")
FastOption = Annotated[bool, typer.Option("--fast/--reference", help="Fast renderer, or path tracer (the reference).")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="Override a key of the scene, e.g. leds.voltage_V=10 (repeatable).")
]


def check_variant(variant: str) -> None:
    """Refuse an unknown variant, even where none is needed."""
    if variant not in VARIANTS:
        raise InputError(f"{variant!r} is not known", key="--variant", allowed=", ".join(VARIANTS))


WORD = re.compile(r"[A-Za-z][\w.+-]*")
"""What is taken for text without quotation marks, which a shell takes off."""


def parse_overrides(pairs: list[str] | None) -> dict[str, Any]:
    """Read ``key=value`` pairs; the value is a TOML literal, or a word."""
    overrides: dict[str, Any] = {}
    for pair in pairs or []:
        key, sign, text = pair.partition("=")
        if not sign or not key.strip():
            raise InputError(f"{pair!r} is not key=value", key="--set", allowed="e.g. leds.voltage_V=10")
        try:
            overrides[key.strip()] = tomllib.loads(f"value = {text}")["value"]
        except (ValueError, RecursionError, KeyError):
            if WORD.fullmatch(text.strip()):
                overrides[key.strip()] = text.strip()
                continue
            raise InputError(
                f"{text!r} is not a TOML value", key=f"--set {key.strip()}", allowed="a number, true, a word or [list]"
            ) from None
    return overrides


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(handles_errors(render))


def render(
    scene: Annotated[str, typer.Argument(help="Scene file, or the name of a shipped scene (thesis, thesis_ridged).")],
    force: Annotated[
        list[float] | None, typer.Option("--force", help="Normal force [N] instead of the programme (repeatable).")
    ] = None,
    fast: FastOption = False,
    bands: Annotated[
        int, typer.Option("--bands", help="Number of wavelength bands of the LEDs' light; 1: one wavelength.")
    ] = 1,
    variant: VariantOption = "auto",
    spp: Annotated[int | None, typer.Option("--spp", min=1, help="Paths per pixel around the contact.")] = None,
    passes: Annotated[int | None, typer.Option("--passes", min=2, help="Independent passes to average.")] = None,
    until_error: Annotated[
        float | None,
        typer.Option("--until-error", help="Add passes until this relative standard error, e.g. 0.01."),
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Seed of light and noise.")] = None,
    settings: SetOption = None,
    exr: Annotated[bool, typer.Option("--exr/--no-exr", help="Write linear light and truth as OpenEXR.")] = True,
    video: Annotated[str | None, typer.Option("--video", help="Also a video: h264, h264-pi4, h264-pi5, ffv1.")] = None,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Render a scene's loading programme: frames, raw, OpenEXR with radiance, variance, gap, pressure and mask."""
    from evanesce.contact.slide import slide_warnings
    from evanesce.contact.solve import check_skin
    from evanesce.effects import active_effects
    from evanesce.rig import copy_scene_files, dump_scene, load_scene, scene_path

    check_json_target(json_file)
    check_variant(variant)
    if video not in (None, "h264", "h264-pi4", "h264-pi5", "ffv1"):
        raise InputError(f"{video!r} is not a codec", key="--video", allowed="h264, h264-pi4, h264-pi5, ffv1")
    overrides = parse_overrides(settings)
    if force:
        overrides["press"] = {"forces_N": list(force)}
    loaded = load_scene(scene, overrides)
    active_effects(loaded, scene_path(scene))  # refused before anything is written
    check_skin(loaded)
    if not 1 <= bands <= MAX_BANDS:
        raise InputError(f"{bands}", key="--bands", allowed=f"1 to {MAX_BANDS}")
    options = _sampling(fast, spp, passes, until_error)
    warnings = list(slide_warnings(loaded))
    show_warnings(warnings)  # before frames that take hours
    folder = out_dir(out, f"render-{Path(scene).stem}")
    result = _run(
        loaded, folder, seed=loaded.render.seed if seed is None else seed, fast=fast, variant=variant, bands=bands,
        options=options, exr=exr, video=video,
    )  # fmt: skip
    flooded = _flooded(result["frames"])
    result["warnings"] = warnings + flooded
    copy_scene_files(loaded, folder)
    write_text(folder / "scene.toml", dump_scene(loaded))
    write_text(folder / "README.txt", _README)
    write_json(folder / "result.json", result)
    write_json(json_file, result)
    _show(result, folder)
    show_warnings(flooded)


def _sampling(fast: bool, spp: int | None, passes: int | None, until_error: float | None) -> dict[str, Any]:
    """Return the options of the path tracer; the fast renderer has none."""
    if until_error is not None and not 0 < until_error < 1:
        raise InputError(f"{until_error:g}", key="--until-error", allowed="above 0, below 1")
    if not fast:
        return {"samples": spp, "passes": passes, "until_error": until_error}
    for flag, given in (("--spp", spp), ("--passes", passes), ("--until-error", until_error)):
        if given is not None:
            raise InputError("the fast renderer samples no paths", key=flag, allowed="with --reference only")
    return {}


MOST_FULL_SCALE = 0.001
"""Share of a frame's pixels at full scale that noise and single glints may make."""

_README = """frame_NNNNNN.png   8-bit frame, as the measurement pipeline reads it
raw/NNNNNN.png     raw numbers in a 16-bit PNG [DN]; of a colour camera its mosaic, for evanesce measure --raw
light_NNNNNN.exr   radiance, its variance, gap [mm], pressure [MPa], contact mask on the distortion-free pinhole view
times.csv          time stamps of the frames [s], in raw as well
scene.toml         the scene as rendered; height_map.* and spectrum.csv beside it if it has them
result.json        true areas [mm^2], provenance
"""


def _run(
    scene: Any,
    folder: Path,
    *,
    seed: int,
    fast: bool,
    variant: str,
    bands: int,
    options: dict[str, Any],
    exr: bool,
    video: Any,
) -> dict[str, Any]:
    from evanesce.api.camera import Camera
    from evanesce.contact.programme import press_programme
    from evanesce.render.exr import write_light
    from evanesce.sensor.codec import VideoWriter, write_png

    if not fast:
        chosen_variant(variant)  # prints a note where it is a slower one
    camera = Camera(scene, "fast" if fast else "reference", bands=bands, variant=variant, **options)
    origin = camera.provenance(seed=seed)
    programme = press_programme(scene)
    numbers = folder / "raw"
    rows = []
    with ExitStack() as stack:
        bar = stack.enter_context(progress())
        task = bar.add_task("frames", total=len(programme))
        film = None
        if video is not None:
            target = folder / ("frames.mkv" if video == "ffv1" else "frames.mp4")
            film = stack.enter_context(VideoWriter(target, codec=video, frame_rate_hz=scene.press.frame_rate_hz))
        for index, (time_s, force_N) in enumerate(programme):
            shot = camera.shoot(force_N, seed=seed, time_s=time_s, index=index)
            assert shot.contact is not None  # a programme always presses
            # Each frame is written at once, so that an interrupted run leaves all earlier frames.
            if exr:
                write_light(folder / f"light_{index:06d}.exr", shot.scene, shot.plate_light, shot.contact, origin)
            write_png(folder / f"frame_{index:06d}.png", shot.frame)
            numbers.mkdir(exist_ok=True)
            write_png(numbers / f"{index:06d}.png", shot.raw)
            if film is not None:
                film.add(shot.as_frame())
            rows.append(_row(shot, force_N))
            bar.advance(task)
    for place, name in ((folder, "frame_"), (numbers, "")):
        times = "".join(f"{name}{row['index']:06d}.png,{row['index']},{row['time_s']!r}\n" for row in rows)
        write_text(place / "times.csv", "file,index,time_s\n" + times)
    return {"frames": rows, "provenance": origin}


def _row(shot: Shot, force_N: float) -> dict[str, Any]:
    """Return the row of one frame in the table and in ``result.json``."""
    from evanesce.render.reference.passes import relative_error

    assert shot.contact is not None
    slides = {
        name: shot.contact.parameters[key]
        for name, key in (
            ("tip_displacement_mm", "tip_displacement_mm"),
            ("tip_aside_mm", "tip_aside_mm"),
            ("rotation_deg", "rotation_deg"),
            ("torque_N_mm", "torque_N_mm"),
            ("liquid_left_uL", "liquid_left_uL"),
        )
        if key in shot.contact.parameters
    } | ({"tangential_force_N": list(shot.contact.tangential_force)} if shot.contact.traction is not None else {})
    return {
        "index": shot.index, "time_s": shot.time_s, "force_N": force_N, "true_area_mm2": shot.truth.area_mm2,
        "law": shot.contact.law, "brightest_DN": int(shot.frame.max()),
        "full_scale_share": full_scale_share(shot.frame), "paths_per_px": shot.plate_light.samples,
        "relative_error": relative_error(shot.plate_light), **slides, **shot.simulated.frame.chosen,
    }  # fmt: skip


def full_scale_share(frame: Any) -> float:
    """Return the share of a frame's pixels of which a channel is at full scale, 255."""
    levels = frame if frame.ndim == 2 else frame.max(axis=2)
    return float((levels == 255).mean())


def chosen_renderer(fast: bool, variant: str) -> tuple[Any, dict[str, Any]]:
    """Return the renderer, and its record for the provenance."""
    if fast:
        from evanesce.render.fast.transport import render_fast

        return render_fast, {"renderer": "transport"}
    import functools

    from evanesce.render.reference.path import render as trace

    info = chosen_variant(variant)
    return functools.partial(trace, variant=variant), {"renderer": "path"} | info.record()


def _show(result: dict[str, Any], folder: Path) -> None:
    table = Table(title=f"Rendered into {folder}")
    for column in ("frame", "time [s]", "force [N]", "true area [mm²]", "brightest [DN]", "paths per px", "error [%]"):
        table.add_column(column, justify="right")
    for row in result["frames"]:
        table.add_row(
            str(row["index"]),
            f"{row['time_s']:.3f}",
            f"{row['force_N']:g}",
            f"{row['true_area_mm2']:.3f}",
            str(row["brightest_DN"]),
            str(row["paths_per_px"]),
            f"{100 * row['relative_error']:.2f}",
        )
    console.print(table)
    warn_of_saturation({row["index"]: row["full_scale_share"] for row in result["frames"]})


def _flooded(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a warning where a liquid finds no room about the contact."""
    left = max((row.get("liquid_left_uL", 0.0) for row in rows), default=0.0)
    return [f"liquid: {left:.3g} uL find no room on the sampled plane (grid.size_mm)"] if left else []


def show_warnings(warnings: Iterable[str]) -> None:
    """Print warnings, a line each."""
    for text in warnings:
        messages.print(f"warning: {text}", style="yellow", markup=False, highlight=False, soft_wrap=True)


def warn_of_saturation(shares: Mapping[int, float]) -> None:
    """Warn of frames with pixels at full scale, by their share in each frame."""
    full = {index: share for index, share in shares.items() if share > MOST_FULL_SCALE}
    if full:
        worst = max(full, key=lambda index: full[index])
        text = (
            f"warning: saturation: over {100 * MOST_FULL_SCALE:g} % of the pixels at full scale (255) in {len(full)}"
            f" of {len(shares)} frame(s), {100 * full[worst]:.1f} % in frame {worst}:"
            " lower leds.voltage_V or expose less"
        )
        messages.print(text, style="yellow", markup=False, highlight=False, soft_wrap=True)
