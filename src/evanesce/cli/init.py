"""``evanesce init``: a commented scene of one's own rig, from a preset, options or questions."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich import box
from rich.table import Table

from evanesce.cli.common import (
    JsonOption,
    check_json_target,
    console,
    handles_errors,
    messages,
    named_options,
    warn,
    working,
    write_json,
    write_text,
)
from evanesce.cli.init_ask import Asked, ask, numbers, words
from evanesce.cli.render import SetOption, parse_overrides
from evanesce.core.errors import InputError, WorkError

if TYPE_CHECKING:
    from evanesce.api.own_answers import RigAnswers
    from evanesce.api.own_exposure import RigFigures
    from evanesce.measurement.calibration.board_images import BoardPictures
    from evanesce.measurement.calibration.model import Calibration
    from evanesce.rig import Scene

NAMES = "glass, low_iron_glass, pmma, pc"
FloatOption = float | None
TextOption = str | None

OPTIONS = {
    "plate_size_mm": "--plate-mm", "thickness_mm": "--thickness-mm", "material": "--material", "index": "--index",
    "absorption_per_mm": "--absorption-per-mm", "spectrum": "--spectrum", "led_pitch_mm": "--led-pitch-mm",
    "package": "--package", "edges": "--edges", "voltage_V": "--voltage-V", "current_mA": "--current-mA",
    "camera": "--camera", "resolution_px": "--resolution", "pixel_um": "--pixel-um", "focal_mm": "--focal-mm",
    "f_number": "--f-number", "scale_px_per_mm": "--scale-px-per-mm", "field_mm": "--field-mm",
    "distance_mm": "--distance-mm", "exposure_ms": "--exposure-ms", "colour": "--colour", "noir": "--noir",
    "finger": "--finger", "tip_radius_mm": "--radius-mm", "modulus_MPa": "--modulus-MPa", "silicone": "--silicone",
    "ridge_height_um": "--ridge-height-um", "ridge_width_um": "--ridge-width-um", "ridge_pitch_um": "--ridge-pitch-um",
    "forces_N": "--forces-N", "board_squares": "--board", "board_square_mm": "--board-square-mm",
    "square_mm": "--square-card-mm", "preset": "--preset", "calibration": "--calibration",
}  # fmt: skip
"""Options by the answer they set."""

KEYS = {
    "plate.size_mm": "--plate-mm", "plate.thickness_mm": "--thickness-mm", "plate.refractive_index": "--index",
    "plate.absorption_coefficient_per_mm": "--absorption-per-mm", "leds.spectrum": "--spectrum",
    "leds.pitch_mm": "--led-pitch-mm", "leds.edges": "--edges", "leds.voltage_V": "--voltage-V",
    "camera.resolution_px": "--resolution", "camera.pixel.pitch_um": "--pixel-um",
    "camera.lens.focal_length_mm": "--focal-mm", "camera.lens.f_number": "--f-number",
    "camera.exposure_ms": "--exposure-ms", "finger.tip_radius_mm": "--radius-mm", "finger.modulus_MPa": "--modulus-MPa",
    "finger.material": "--silicone",
    "finger.ridges.height_um": "--ridge-height-um", "finger.ridges.width_um": "--ridge-width-um",
    "finger.ridges.pitch_um": "--ridge-pitch-um", "press.forces_N": "--forces-N",
    "card.checkerboard_squares": "--board", "card.checkerboard_side_mm": "--board-square-mm",
    "card.square_side_mm": "--square-card-mm",
}  # fmt: skip
"""Options by the key of the scene they set."""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(handles_errors(init))


def init(
    path: Annotated[Path, typer.Argument(help="Scene file to write (TOML).")],
    preset: Annotated[
        str, typer.Option(help="Where the rest comes from; `evanesce init --presets` lists them.")
    ] = "thesis",
    presets: Annotated[
        bool, typer.Option("--presets", is_eager=True, callback=lambda v: _list(v), help="List presets.")
    ] = False,
    asked: Annotated[bool, typer.Option("--ask", help="Ask for everything that no option gives.")] = False,
    plate: Annotated[TextOption, typer.Option("--plate-mm", metavar="XxY", help="Size of the plate \\[mm].")] = None,
    thickness: Annotated[FloatOption, typer.Option("--thickness-mm", help="Of the plate \\[mm].")] = None,
    material: Annotated[TextOption, typer.Option(help=f"Of the plate: {NAMES}.")] = None,
    index: Annotated[FloatOption, typer.Option(help="Refractive index of the plate.")] = None,
    absorption: Annotated[FloatOption, typer.Option("--absorption-per-mm", help="Of the plate [1/mm].")] = None,
    spectrum: Annotated[TextOption, typer.Option(help="LEDs: white, red, infrared, or a CSV file.")] = None,
    led_pitch: Annotated[FloatOption, typer.Option("--led-pitch-mm", help="LED to LED \\[mm].")] = None,
    package: Annotated[TextOption, typer.Option(help="LEDs: 2835, 3528, 5050, 3014, 0805, 0603.")] = None,
    edges: Annotated[TextOption, typer.Option(help="Lit edges, e.g. left,right.")] = None,
    voltage: Annotated[FloatOption, typer.Option("--voltage-V", help="Supply of the LEDs [V].")] = None,
    current: Annotated[
        FloatOption, typer.Option("--current-mA", help="Of one segment, in place of volts \\[mA].")
    ] = None,
    camera: Annotated[TextOption, typer.Option(help="pi_hq, pi_3, pi_2, pi_gs, usb, machine_vision.")] = None,
    resolution: Annotated[TextOption, typer.Option(metavar="WxH", help="Of the frames \\[px].")] = None,
    pixel: Annotated[FloatOption, typer.Option("--pixel-um", help="Pixel pitch, binned as filmed \\[um].")] = None,
    focal: Annotated[FloatOption, typer.Option("--focal-mm", help="Of the lens \\[mm].")] = None,
    f_number: Annotated[FloatOption, typer.Option("--f-number", help="Of the lens.")] = None,
    scale: Annotated[FloatOption, typer.Option("--scale-px-per-mm", help="On the plate's upper face.")] = None,
    field: Annotated[FloatOption, typer.Option("--field-mm", help="Width of the frame on the plate \\[mm].")] = None,
    distance: Annotated[
        FloatOption, typer.Option("--distance-mm", help="Lens to the plate's lower face \\[mm].")
    ] = None,
    exposure: Annotated[FloatOption, typer.Option("--exposure-ms", help="None: found by simulation \\[ms].")] = None,
    colour: Annotated[bool, typer.Option("--colour", help="Frames in colour; otherwise grey.")] = False,
    noir: Annotated[bool, typer.Option("--noir", help="--colour: no infrared cut filter.")] = False,
    finger: Annotated[TextOption, typer.Option(help="smooth, ball, ridged, print (human) or pad.")] = None,
    radius: Annotated[
        FloatOption, typer.Option("--radius-mm", help="Of the finger's tip, or of a ball \\[mm].")
    ] = None,
    modulus: Annotated[FloatOption, typer.Option("--modulus-MPa", help="Young's modulus of the finger [MPa].")] = None,
    silicone: Annotated[TextOption, typer.Option(help="Named silicone, in place of the modulus.")] = None,
    ridge_height: Annotated[FloatOption, typer.Option("--ridge-height-um", help="From furrow to crest \\[um].")] = None,
    ridge_width: Annotated[FloatOption, typer.Option("--ridge-width-um", help="At half height \\[um].")] = None,
    ridge_pitch: Annotated[FloatOption, typer.Option("--ridge-pitch-um", help="From crest to crest \\[um].")] = None,
    forces: Annotated[TextOption, typer.Option("--forces-N", help="Held forces, e.g. 1,2,5 [N].")] = None,
    board: Annotated[TextOption, typer.Option(metavar="WxH", help="Squares of the checkerboard.")] = None,
    board_square: Annotated[FloatOption, typer.Option("--board-square-mm", help="Side of its squares \\[mm].")] = None,
    square: Annotated[FloatOption, typer.Option("--square-card-mm", help="Side of the square card \\[mm].")] = None,
    calibration: Annotated[Path | None, typer.Option(help="JSON of `evanesce calibrate`.")] = None,
    checkerboard: Annotated[
        list[Path] | None, typer.Option("--checkerboard", help="Pictures of the board on the glass, or a folder.")
    ] = None,
    on_glass: Annotated[
        TextOption, typer.Option(metavar="NAME", help="Picture whose board lay on the glass; else the flattest.")
    ] = None,
    title: Annotated[TextOption, typer.Option(help="Of the scene.")] = None,
    settings: SetOption = None,
    force: Annotated[bool, typer.Option("--overwrite", help="Replace the file if it exists.")] = False,
    json_file: JsonOption = None,
) -> None:
    """Write a commented scene of one's own rig, and print what that rig comes to.

    What no option gives is the preset's. Without options, on a terminal, questions are asked.
    """
    _check_target(path, force)
    check_json_target(json_file)
    given = {
        "plate_size_mm": numbers(plate, "--plate-mm", 2), "thickness_mm": thickness, "material": material,
        "index": index, "absorption_per_mm": absorption, "spectrum": spectrum, "led_pitch_mm": led_pitch,
        "package": package, "edges": words(edges), "voltage_V": voltage, "current_mA": current, "camera": camera,
        "resolution_px": numbers(resolution, "--resolution", 2, whole=True), "pixel_um": pixel, "focal_mm": focal,
        "f_number": f_number, "scale_px_per_mm": scale, "field_mm": field, "distance_mm": distance,
        "exposure_ms": exposure, "colour": colour, "noir": noir, "finger": finger,
        "tip_radius_mm": radius, "modulus_MPa": modulus, "silicone": silicone, "ridge_height_um": ridge_height,
        "ridge_width_um": ridge_width, "ridge_pitch_um": ridge_pitch,
        "forces_N": numbers(forces, "--forces-N", None), "board_squares": numbers(board, "--board", 2, whole=True),
        "board_square_mm": board_square, "square_mm": square, "title": title, "settings": parse_overrides(settings),
    }  # fmt: skip
    from evanesce.api.own_answers import is_given

    nothing = preset == "thesis" and not any(is_given(value) for value in given.values())
    wants = asked or (nothing and calibration is None and not checkerboard and sys.stdin.isatty())
    found = ask(preset, given) if wants else Asked(preset, given, [])
    pictures = [*(checkerboard or []), *found.pictures]
    if on_glass is not None and not pictures:
        raise InputError("is given without pictures", key="--on-glass", allowed="with --checkerboard")
    answers = _answers(found, calibration, pictures, on_glass)
    _write(path, answers, found.preset, json_file)


def _list(value: bool) -> None:
    if not value:
        return
    from evanesce.api.own_rig import PRESETS, preset_heading
    from evanesce.rig import load_scene

    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("preset")
    table.add_column("rig")
    for name in PRESETS:
        table.add_row(name, load_scene(name).title)
    console.print(table)
    console.print(preset_heading("prism_reader"), markup=False, highlight=False)
    raise typer.Exit


def _check_target(path: Path, force: bool) -> None:
    if path.suffix != ".toml":
        raise InputError("is no scene's name", file=path, allowed="a file that ends in .toml")
    if not path.parent.is_dir():
        raise InputError("its folder does not exist", file=path, allowed="a file in an existing folder")
    if path.exists() and not force:
        raise InputError("exists already", file=path, allowed="a new file, or --overwrite")


def _answers(found: Asked, calibration: Path | None, pictures: list[Path], on_glass: str | None) -> RigAnswers:
    """Return the answers with the camera's calibration, which is made here where pictures are given."""
    from evanesce.api.own_answers import RigAnswers
    from evanesce.measurement.calibration.model import load_calibration

    answers = RigAnswers(**found.given)
    if calibration is not None and pictures:
        raise InputError("is given beside --checkerboard", key="--calibration", allowed="one of them")
    if calibration is not None:
        return dataclasses.replace(
            answers, calibration=load_calibration(calibration), calibration_name=calibration.name
        )
    if not pictures:
        return answers
    from evanesce.api.calibrate import fit_calibration
    from evanesce.cli.calibrate import _checkerboards
    from evanesce.measurement.calibration.board_print import print_of

    shown, side = _checkerboards(pictures, []), answers.board_square_mm
    if side is None:
        raise InputError("is not given", key="--board-square-mm", allowed="the side of the board's squares [mm]")
    boards = _found(shown, side)
    with named_options({"checker_side_mm": "--board-square-mm", "on_glass": "--on-glass"}):
        fit = fit_calibration(boards.views, boards.image_size, pictures=boards, on_glass=on_glass)
    name = f"{len(boards.views)} picture(s) of the checkerboard, squares of {side:g} mm"
    squares = answers.board_squares
    flat = [k for k, view in enumerate(boards.views) if view.name == fit.calibration.details["flat_view"]]
    views, frames = [boards.views[k] for k in flat], [boards.frames[k] for k in flat]
    black = None if squares is None else print_of(views, frames, side, squares)
    return dataclasses.replace(
        answers, calibration=fit.calibration, calibration_name=name, board_square_mm=side, board_inverted=black
    )


def _found(pictures: list[Path], side: float) -> BoardPictures:
    from evanesce.cli.calibrate import _find

    try:
        return _find(pictures, side, None)
    except WorkError as error:  # no board in any: what was given is no picture of one
        where = str(pictures[-1].parent / str(error)) if str(error).startswith(pictures[-1].name) else str(error)
        raise InputError(where, key="--checkerboard", allowed="pictures of the board on the glass") from None


def _write(path: Path, answers: RigAnswers, preset: str, json_file: Path | None) -> None:
    from evanesce.api.own_exposure import exposed, figures
    from evanesce.api.own_rig import own_rig
    from evanesce.core import provenance
    from evanesce.effects import active_effects
    from evanesce.rig import copy_scene_files
    from evanesce.rig.commented import commented

    with named_options({**OPTIONS, **KEYS}):
        rig = own_rig(answers, preset)
    scene = rig.scene
    active_effects(scene, path)
    automatic = answers.exposure_ms is None and "camera.exposure_ms" not in answers.settings and not answers.is_empty
    with working("exposure and contact, by simulation"), named_options(KEYS):
        if automatic and scene.camera.auto_exposure is None:
            scene, _ = exposed(scene)
        found = figures(scene)
    copy_scene_files(scene, path.parent)
    write_text(path, commented(scene, rig.heading))
    warnings = [*_of_calibration(answers.calibration), *found.warnings()]
    record = dataclasses.asdict(found) | {
        "scene": scene.as_dict(), "notes": list(rig.notes), "warnings": warnings,
        "provenance": provenance.record(config=scene.as_dict(), preset=preset),
    }  # fmt: skip
    write_json(json_file, record)
    given = rig.changed | ({"camera.exposure_ms"} if automatic else set())
    _show(path, scene, found, preset, [*rig.notes, *_kept(scene, given, preset), *_of_preset(preset)], warnings)


def _of_calibration(calibration: Calibration | None) -> list[str]:
    """Return what a calibration warns of: pictures left out, views too alike."""
    said = [] if calibration is None else calibration.details.get("warnings", [])
    return [f"calibration: {one['code']}: {one['text']}" for one in said]


def _kept(scene: Scene, given: frozenset[str], preset: str) -> list[str]:
    """Return a note of the figures that an option would have set, and that are the preset's."""
    from evanesce.api.key_change import value_at
    from evanesce.cli.scene import text_of

    values = {key: value_at(scene, key) for key in KEYS}
    kept = [
        f"{key} = {text_of(value)} ({KEYS[key]})"
        for key, value in values.items()
        if value is not None and not any(key == k or key.startswith(f"{k}.") for k in given)
    ]
    return [f"not given, the figures of the preset {preset}: {'; '.join(kept)}"] if given and kept else []


def _of_preset(preset: str) -> list[str]:
    """Return what a preset does not simulate."""
    from evanesce.api.own_rig import preset_heading

    return [preset_heading(preset)] if preset == "prism_reader" else []


def _show(path: Path, scene: Scene, found: RigFigures, preset: str, notes: list[str], warnings: list[str]) -> None:
    table = Table(title=scene.title, box=box.SIMPLE_HEAD)
    for heading, justify in (("figure", "left"), ("value", "right"), ("unit", "left")):
        table.add_column(heading, justify=justify)  # type: ignore[arg-type]
    camera, plate = scene.camera, scene.plate
    leds = ", ".join(f"{edge} {count}" for edge, count in found.leds.items())
    for row in (
        ("plate", f"{plate.size_mm[0]:g} x {plate.size_mm[1]:g} x {plate.thickness_mm:g}", "mm"),
        ("refractive index of plate, of finger", f"{plate.refractive_index:g}, {scene.finger.refractive_index:g}", "1"),
        ("LEDs on the edges", leds, "1"),
        ("current of a segment", f"{found.segment_mA:.3g}", "mA"),
        ("radiant power of an LED", f"{found.led_mW:.3g}", "mW"),
        ("frame", f"{camera.resolution_px[0]} x {camera.resolution_px[1]}", "px"),
        ("field of view", f"{found.field_mm[0]:.3g} x {found.field_mm[1]:.3g}", "mm"),
        ("a pixel on the plate", f"{found.pixel_um:.3g}", "um"),
        ("lens below the plate", f"{found.distance_mm:.3g}", "mm"),
        ("exposure, gain", f"{camera.exposure_ms:g}, {camera.analogue_gain:g}", "ms, 1"),
        (f"contact area at {found.force_N:g} N", f"{found.area_mm2:.3g}", "mm^2"),
        ("contact over full scale, linear", f"{100 * found.level:.3g}", "%"),
    ):
        table.add_row(*row)
    console.print(table)
    for note in notes:
        messages.print(f"note: {note}", markup=False, highlight=False, soft_wrap=True)
    warn(warnings)
    console.print(
        f"Written: {path} (preset {preset}). Next: evanesce render {path} --fast", highlight=False, markup=False,
        soft_wrap=True,
    )  # fmt: skip
