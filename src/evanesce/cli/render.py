"""``evanesce render``: a scene to frames, linear light and truth."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    console,
    handles_errors,
    out_dir,
    progress,
    write_json,
    write_text,
)
from evanesce.errors import InputError

VariantOption = Annotated[str, typer.Option("--variant", help="auto, llvm, scalar or cuda.")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="Override a key of the scene, e.g. leds.voltage_V=10 (repeatable).")
]


def parse_overrides(pairs: list[str] | None) -> dict[str, Any]:
    """Read ``key=value`` pairs; the value is a TOML literal."""
    overrides: dict[str, Any] = {}
    for pair in pairs or []:
        key, sign, text = pair.partition("=")
        if not sign or not key.strip():
            raise InputError(f"{pair!r} is not key=value", key="--set", allowed="e.g. leds.voltage_V=10")
        try:
            overrides[key.strip()] = tomllib.loads(f"value = {text}")["value"]
        except (tomllib.TOMLDecodeError, KeyError):
            raise InputError(
                f"{text!r} is not a TOML value", key=f"--set {key.strip()}", allowed='a number, true, "text" or [list]'
            ) from None
    return overrides


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    @handles_errors
    def render(
        scene: Annotated[str, typer.Argument(help="Scene file, or the name of a shipped scene (thesis, thesis_ridged).")],
        force: Annotated[
            list[float] | None, typer.Option("--force", help="Normal force [N] instead of the programme (repeatable).")
        ] = None,
        variant: VariantOption = "auto",
        spp: Annotated[int | None, typer.Option("--spp", help="Paths per pixel in the contact's surroundings.")] = None,
        passes: Annotated[int | None, typer.Option("--passes", help="Independent passes to average.")] = None,
        seed: Annotated[int | None, typer.Option("--seed", help="Seed of light and noise.")] = None,
        settings: SetOption = None,
        exr: Annotated[bool, typer.Option("--exr/--no-exr", help="Write linear light and truth as OpenEXR.")] = True,
        video: Annotated[
            str | None, typer.Option("--video", help="Also write the frames as a video: h264 or ffv1.")
        ] = None,
        json_file: JsonOption = None,
        out: OutOption = None,
    ) -> None:
        """Render a scene's loading programme: PNG frames, raw, OpenEXR with radiance, variance, gap, pressure, mask."""
        from evanesce.cli import render_job

        check_json_target(json_file)
        overrides = parse_overrides(settings)
        if force:
            overrides["press.forces_N"] = list(force)
        job = render_job.prepare(
            scene, overrides, variant=variant, samples_per_pixel=spp, passes=passes, seed=seed, video=video
        )
        folder = out_dir(out, f"render-{Path(scene).stem}")
        with progress() as bar:
            result = render_job.run(job, folder, exr=exr, bar=bar)
        write_text(folder / "scene.toml", render_job.scene_text(job))
        write_json(json_file, result)
        render_job.show(result, console)
