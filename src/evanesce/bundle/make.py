"""Make a bundle of a lab's recording: frames chosen, forces joined, pictures copied; whole or not at all."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from evanesce.bundle.board import SeenBoard, ToPlate, other_card, other_square, seen_board
from evanesce.bundle.bundle import Bundle
from evanesce.bundle.folder import new_folder, write_shots
from evanesce.bundle.layout import AUXILIARY, MEASUREMENT_FILE, PRESS_FOLDER, PRESS_TABLE, REPLICATES_FOLDER, Shot
from evanesce.bundle.read import read_bundle
from evanesce.core.errors import InputError
from evanesce.measurement.io.force import ForceLog
from evanesce.measurement.io.frames import ImageStream, open_frames
from evanesce.measurement.io.images import read_image
from evanesce.rig import Scene, copy_scene_files, dump_scene
from evanesce.sensor.codec import write_png

Floats = NDArray[np.float64]

PRESSED = 0.02
"""Share of the largest force from which a frame counts as a press: a choice, above what a load cell's zero drifts."""

FRAMES = 24
"""Frames of a recording that are kept if nothing is said: a choice; the critic's time grows with them."""

MAX_PICTURES = 64
"""Frames of one kind that are taken of a video; more tell nothing that these do not."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Frames of a press with their times and forces.

    Attributes
    ----------
    path : Path
        Video, picture or folder of pictures.
    index : ndarray of int (n,)
        Number of each frame in it.
    time_s, force_N : ndarray (n,)
        Force is NaN outside the log.
    offset_s : float
        What was added to a frame's time to get the load cell's [s].
    """

    path: Path
    index: NDArray[np.int64]
    time_s: Floats
    force_N: Floats
    offset_s: float = 0.0


def joined(path: Path, index: Sequence[int], time_s: Sequence[float], log: ForceLog, offset_s: float) -> Recording:
    """Return a recording with the log's forces at the times of its frames, by straight lines.

    Parameters
    ----------
    path : Path
    index, time_s : sequence (n,)
        Of its frames.
    log : ForceLog
    offset_s : float
        Added to a frame's time to get the load cell's [s].

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        If the frames have no times.
    """
    times = np.asarray(time_s, dtype=np.float64)
    if not np.isfinite(times).all():
        raise InputError("the frames have no times", file=path, key="--fps", allowed="the frame rate, or times.csv")
    return Recording(
        path=path, index=np.asarray(index, dtype=np.int64), time_s=times, force_N=log.at(times + offset_s),
        offset_s=offset_s,
    )  # fmt: skip


def chosen(recording: Recording, count: int | None) -> NDArray[np.int64]:
    """Return places of the frames to keep: pressed, and spread evenly over the path that force and time run through.

    Length along the path adds force over its range and time over its, so that a ramp, a release and a hold all get
    frames.

    Parameters
    ----------
    recording : Recording
    count : int or None
        At most so many; None: all that are pressed.

    Returns
    -------
    ndarray of int
        Into the recording's arrays, rising.

    Raises
    ------
    InputError
        If no frame lies within the log and is pressed.
    """
    force = recording.force_N
    known = np.isfinite(force)
    most = float(force[known].max()) if known.any() else 0.0
    pressed = np.flatnonzero(known & (np.nan_to_num(force) > PRESSED * most)) if most > 0 else np.array([], np.int64)
    if not pressed.size:
        raise InputError(
            f"no frame has a force at an offset of {recording.offset_s:.3f} s", file=recording.path, key="--offset-s",
            allowed="one at which frames and forces overlap, or auto",
        )  # fmt: skip
    if count is None or pressed.size <= count:
        return pressed
    time, load = recording.time_s[pressed], force[pressed]
    steps = np.abs(np.diff(load)) / max(float(np.ptp(load)), 1e-12) + np.diff(time) / max(float(np.ptp(time)), 1e-12)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0.0, along[-1], count)
    return pressed[np.unique(np.abs(along[:, None] - wanted).argmin(axis=0))]


def make_bundle(
    folder: Path,
    recording: Recording,
    scene: Scene,
    *,
    to_plate: ToPlate,
    frames: int | None = FRAMES,
    voltage_V: float | None = None,
    pictures: Mapping[str, Path] | None = None,
    boards: Sequence[SeenBoard] = (),
    square_mm: float | None = None,
    title: str = "",
    files: Mapping[str, Path] | None = None,
    provenance: Mapping[str, Any] | None = None,
    tick: Callable[[int, int], None] = lambda done, total: None,
) -> Bundle:
    """Write a recording as a bundle; the folder appears when all of it is there and has been checked.

    Parameters
    ----------
    folder : Path
        Must not exist, or be empty.
    recording : Recording
    scene : Scene
        Nominal model.
    to_plate : callable
        Contact plane [mm] from pixels, by which the board in the pictures is measured.
    frames : int or None
        Of :func:`chosen`.
    voltage_V : float, optional
        Supply of the LEDs [V]; the scene's by default.
    pictures : Mapping of str to Path
        Picture, folder or video of ``replicates`` and the kinds of :data:`~evanesce.bundle.layout.AUXILIARY`.
    boards : sequence of SeenBoard
        Further boards that must be the scene's card, as a calibration lists them.
    square_mm : float, optional
        Side of the square card of the calibration [mm].
    title : str
    files : Mapping of str to Path
        Copied beside, by name; nothing reads them.
    provenance : Mapping, optional
        Goes to ``provenance.json``.
    tick : callable
        ``tick(done, total)`` after each step: the press, each kind of pictures, the check of everything.

    Returns
    -------
    Bundle
        As written.

    Raises
    ------
    InputError
        If something cannot be read or does not fit the scene, or the board is not the scene's card.
    WorkError
        If it cannot be written.
    """
    shots = [
        Shot(
            index=int(recording.index[k]), time_s=float(recording.time_s[k]), force_N=float(recording.force_N[k]),
            voltage_V=scene.leds.voltage_V if voltage_V is None else voltage_V,
        )
        for k in chosen(recording, frames)
    ]  # fmt: skip
    _refuse(other_card(boards, scene.card) or other_square(square_mm, scene.card), None)
    with new_folder(folder) as part:
        copy_scene_files(scene, part)
        (part / "scene.toml").write_text(dump_scene(scene), encoding="utf-8")
        described: dict[str, Any] = {"schema_version": 1, "title": title or scene.title, "scene": "scene.toml"}
        video = _press(part, recording, shots)
        if video is not None:
            described["press"] = {"video": video}
        write_shots(part / PRESS_TABLE, shots)
        given = pictures or {}
        for done, (kind, source) in enumerate(given.items(), start=1):
            tick(done, len(given) + 2)
            _pictures(part, kind, source)
            if kind == "checkerboard":
                check_boards(sorted((part / kind).iterdir()), scene, to_plate, source)
        tick(len(given) + 1, len(given) + 2)
        (part / MEASUREMENT_FILE).write_text(tomli_w.dumps(described), encoding="utf-8")
        for name, path in (files or {}).items():
            shutil.copyfile(path, part / name)
        if provenance is not None:
            (part / "provenance.json").write_text(json.dumps(dict(provenance), indent=2) + "\n", encoding="utf-8")
        _checked(part, recording.path)
        tick(len(given) + 2, len(given) + 2)
    return read_bundle(folder, decode=False)


def check_boards(paths: Sequence[Path], scene: Scene, to_plate: ToPlate, source: Path | None = None) -> list[str]:
    """Refuse pictures whose board is not the scene's card.

    Parameters
    ----------
    paths : sequence of Path
    scene : Scene
    to_plate : callable
        Contact plane [mm] from pixels.
    source : Path, optional
        Named in the error instead of the picture's folder.

    Returns
    -------
    list of str
        Names of pictures in which no board was found.

    Raises
    ------
    InputError
        Naming both boards.
    """
    none = []
    for path in paths:
        board = seen_board(read_image(path).data, path.name, to_plate)
        if board is None:
            none.append(path.name)
        else:
            _refuse(other_card([board], scene.card), source or path.parent)
    return none


def _refuse(why: str | None, file: Path | None) -> None:
    if why is not None:
        key = "card.checkerboard_squares, card.checkerboard_side_mm, card.square_side_mm"
        raise InputError(why, file=file, key=key, allowed="in the scene the card that was photographed")


def _press(part: Path, recording: Recording, shots: Sequence[Shot]) -> str | None:
    """Copy the frames as they are: a video whole, of a folder those that are named; return the video's name."""
    stream = open_frames(recording.path)
    if not isinstance(stream, ImageStream):
        name = f"press{recording.path.suffix.lower()}"
        shutil.copyfile(recording.path, part / name)
        return name
    (part / PRESS_FOLDER).mkdir()
    for shot in shots:
        path = stream.paths[shot.index]
        shutil.copyfile(path, part / PRESS_FOLDER / f"{shot.index:04d}{path.suffix.lower()}")
    return None


def _pictures(part: Path, kind: str, source: Path) -> None:
    """Copy pictures of a kind as they are; of a video, frames as PNG."""
    if kind not in (REPLICATES_FOLDER, *AUXILIARY):
        raise KeyError(kind)
    stream = open_frames(source)
    (part / kind).mkdir()
    if isinstance(stream, ImageStream):
        for number, path in enumerate(stream.paths):
            shutil.copyfile(path, part / kind / f"{number:04d}{path.suffix.lower()}")
        return
    for number, frame in enumerate(islice(stream, MAX_PICTURES)):
        write_png(part / kind / f"{number:04d}.png", frame.data)


def _checked(part: Path, source: Path) -> None:
    """Read the bundle back while it still has its temporary name, which no message may show."""
    try:
        read_bundle(part)
    except InputError as error:
        file = error.file
        if file is not None and Path(file).is_relative_to(part):
            inside = Path(file).relative_to(part)
            film = inside.parts[0] != PRESS_TABLE and Path(inside.parts[0]).stem == PRESS_FOLDER
            file = source if film else inside
        raise InputError(error.what, file=file, key=error.key, allowed=error.allowed) from None
