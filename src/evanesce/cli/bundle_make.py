"""``evanesce bundle make``: a bundle of a lab's film, its force log, its calibration and its scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evanesce.cli.common import JsonOption, check_json_target, console, handles_errors, messages, progress, write_json
from evanesce.core.errors import InputError

if TYPE_CHECKING:
    from evanesce.bundle import Bundle
    from evanesce.bundle.make import Recording
    from evanesce.measurement.calibration.model import Calibration
    from evanesce.measurement.io.force import ForceLog
    from evanesce.rig import Scene

UNLIKE_SCALE = 0.02
"""Relative difference of calibration's and scene's scale above which it is told: what `calibrate` allows its cards."""

FolderOption = Path | None


def register(group: typer.Typer) -> None:
    """Add the command to the group ``bundle``."""
    group.command()(handles_errors(make))


def make(
    path: Annotated[Path, typer.Argument(help="Video, or folder of pictures, of the press.")],
    force: Annotated[Path, typer.Option("--force", help="CSV of the load cell: time and force, at its own rate.")],
    calibration: Annotated[Path, typer.Option("--calibration", help="JSON of `evanesce calibrate`.")],
    scene: Annotated[str, typer.Option("--scene", help="Nominal model: scene file, or the name of a shipped scene.")],
    out: Annotated[Path, typer.Option("--out", help="New or empty folder.")],
    offset_s: Annotated[
        str, typer.Option("--offset-s", help="Added to a frame's time to get the load cell's \\[s]; auto: found.")
    ] = "auto",
    fps: Annotated[float | None, typer.Option("--fps", help="Frame rate where the source states none [Hz].")] = None,
    frames: Annotated[
        str, typer.Option("--frames", help="Press frames that are kept, spread over force and time; or all.")
    ] = "24",
    voltage: Annotated[
        float | None,
        typer.Option("--voltage-V", min=0.0, max=60.0, help="Supply of the LEDs; the scene's if not given."),
    ] = None,
    lens_cap: Annotated[FolderOption, typer.Option("--lens-cap", help="Pictures with the lens covered (dark).")] = None,
    led_off: Annotated[FolderOption, typer.Option("--led-off", help="Pictures with LEDs off, finger away.")] = None,
    checkerboard: Annotated[
        FolderOption, typer.Option("--checkerboard", help="Pictures of the board on the glass.")
    ] = None,
    square: Annotated[FolderOption, typer.Option("--square", help="Pictures of the square on the glass.")] = None,
    replicates: Annotated[
        FolderOption, typer.Option("--replicates", help="Pictures of one held state: they give the noise.")
    ] = None,
    title: Annotated[str, typer.Option("--title", help="Of the measurement.")] = "",
    json_file: JsonOption = None,
) -> None:
    """Make a bundle of a film or a folder of pictures, with the load cell's forces at its frames.

    The board and the square must be the scene's card. Nothing is left behind where something does not fit.
    """  # fmt: skip
    from evanesce.bundle.check import contents
    from evanesce.cli.measure_force import read
    from evanesce.measurement.calibration.model import load_calibration
    from evanesce.rig import load_scene

    check_json_target(json_file)
    if not path.exists():
        raise InputError("no such file or folder", file=path, allowed="a video or a folder of pictures")
    count = _count(frames)
    log, given = read(force, offset_s)
    assert log is not None
    given_pictures = {
        "lens_cap": lens_cap, "led_off": led_off, "checkerboard": checkerboard, "square": square,
        "replicates": replicates,
    }  # fmt: skip
    pictures = {kind: found for kind, found in given_pictures.items() if found is not None}
    for kind, source in pictures.items():
        if not source.exists():
            key = "--" + kind.replace("_", "-")
            raise InputError("no such file or folder", file=source, key=key, allowed="a picture or a folder of them")
    rig = Rig.read(load_scene(scene), load_calibration(calibration), calibration)
    recording, standard = _recording(path, log, given, fps, rig)
    bundle, notes = _written(out, recording, rig, force, count, voltage, pictures, title)
    found = contents(bundle) | {"offset_s": recording.offset_s, "offset_standard_s": standard}
    found["warnings"] = [{"code": w.code, "text": w.text} for w in (*log.warnings, *rig.warnings)]
    write_json(json_file, found)
    _show(found, notes, standard)


@dataclass(frozen=True)
class Rig:
    """The nominal model and the calibration, which agree."""

    scene: Scene
    calibration: Calibration
    file: Path
    mm2_per_px: float
    warnings: tuple[Any, ...] = ()

    @staticmethod
    def read(scene: Scene, calibration: Calibration, file: Path) -> Rig:
        """Compare both; the area of a pixel is the scene's where the calibration knows none.

        Raises
        ------
        InputError
            If they are of other resolutions.
        """
        from evanesce.measurement.warnings import Warning

        if calibration.image_size != scene.camera.resolution_px:
            (a, b), (c, d) = calibration.image_size, scene.camera.resolution_px
            raise InputError(
                f"{a} x {b} pixels; the scene's camera has {c} x {d}", file=file, key="image_size",
                allowed="one resolution: set camera.resolution_px and camera.scale_px_per_mm in the scene",
            )  # fmt: skip
        nominal = scene.camera.scale_px_per_mm
        found = None if calibration.mm2_per_px is None else calibration.mm2_per_px**-0.5
        warnings = []
        if found is not None and abs(found / nominal - 1) > UNLIKE_SCALE:
            text = f"the calibration has {found:.4g} px/mm, the scene {nominal:.4g} (camera.scale_px_per_mm)"
            warnings.append(Warning("scale_of_scene", text))
        return Rig(scene, calibration, file, (found or nominal) ** -2, tuple(warnings))


def _count(text: str) -> int | None:
    if text.strip().lower() == "all":
        return None
    if not (text.strip().isdecimal() and 1 <= int(text) <= 100_000):
        raise InputError(f"'{text}'", key="--frames", allowed="a whole number from 1 to 100000, or all")
    return int(text)


def _recording(
    path: Path, log: ForceLog, offset: float | None, fps: float | None, rig: Rig
) -> tuple[Recording, float | None]:
    """Return the frames with their forces, and the found offset's standard uncertainty [s]."""
    from evanesce.bundle.make import joined
    from evanesce.cli import measure_job
    from evanesce.measurement.force import area_force
    from evanesce.measurement.io.frames import open_frames
    from evanesce.measurement.reference.segment import Chain, Crop

    if offset is not None:
        stream = open_frames(path, fps)
        with progress() as bar:
            task = bar.add_task("read", total=stream.count)
            places = []
            for frame in stream:
                places.append((frame.index, frame.time))
                bar.advance(task)
        stream.finish()
        return joined(path, [k for k, _ in places], [t for _, t in places], log, offset), None
    known = rig.calibration.mm2_per_px
    try:
        job = measure_job.prepare(
            path, Chain(threshold=0.15, min_blob=2000, blur=1.0, radius=10, crop=Crop()), calibration=rig.file, fps=fps,
            mm2_per_px=None if known else rig.mm2_per_px, undistort=True, out=None, auto_threshold=True,
        )  # fmt: skip
    except InputError as error:
        if error.key != "--threshold":
            raise
        raise InputError(
            f"{error.what}, so that the offset is not found", file=path, key="--offset-s",
            allowed="a film of a press, or a finite number of seconds",
        ) from None  # fmt: skip
    rows = measure_job.run(job).rows
    job.stream.finish()
    found = area_force(rows, log)
    recording = joined(path, [r.index for r in rows], [r.time_s for r in rows], log, found.offset_s)
    return recording, found.offset_standard_s


def _written(
    out: Path, recording: Recording, rig: Rig, force: Path, count: int | None, voltage: float | None,
    pictures: Mapping[str, Path], title: str,
) -> tuple[Bundle, list[str]]:  # fmt: skip
    """Write the bundle; return it and what was left out."""
    from evanesce.bundle.board import calibrated_boards, calibrated_plane
    from evanesce.bundle.make import make_bundle
    from evanesce.core import provenance

    with progress() as bar:
        task = bar.add_task("write", total=None)
        bundle = make_bundle(
            out, recording, rig.scene, to_plate=calibrated_plane(rig.calibration, rig.mm2_per_px), frames=count,
            voltage_V=voltage, pictures=pictures, boards=calibrated_boards(rig.calibration),
            square_mm=rig.calibration.square_side_mm, title=title,
            files={"calibration.json": rig.file, "force_log.txt": force},
            provenance=provenance.record(
                config=rig.scene.as_dict(), source=recording.path.name, offset_s=recording.offset_s
            ),
            tick=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    force_N = recording.force_N
    outside = int((force_N != force_N).sum())
    notes = [f"{len(bundle.press)} of {len(force_N)} frames kept, spread over force and time (--frames)"]
    if outside:
        notes.append(f"{outside} frame(s) lie outside the load cell's log and are left out")
    return bundle, notes


def _show(found: dict[str, Any], notes: list[str], standard: float | None) -> None:
    from evanesce.cli.bundle import show

    show(found)
    how = "given" if standard is None else f"± {standard:.4f} s (standard, from the loading)"
    lines = [f"the load cell's clock is the frames' {found['offset_s']:+.4f} s, {how}", *notes]
    for line in (*lines, f"Written: {found['path']}"):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    for warning in found["warnings"]:
        line = f"warning: {warning['code']}: {warning['text']}"
        messages.print(line, style="yellow", markup=False, highlight=False, soft_wrap=True)
