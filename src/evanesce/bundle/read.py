"""Read a bundle: tables at once, frames when they are asked for; an error names file, line and column."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from evanesce.bundle.bundle import Bundle
from evanesce.bundle.files import check_header, check_inside, inside, numbered, picture_files
from evanesce.bundle.layout import (
    AUXILIARY,
    HELD,
    MEASUREMENT_FILE,
    PRESS_FOLDER,
    PRESS_TABLE,
    REPLICATES_FOLDER,
    REPLICATES_TABLE,
    SERIES_FOLDER,
    Replicates,
    Series,
    Shot,
    same_condition,
    same_force,
)
from evanesce.bundle.tables import line_numbers, read_series, read_shots
from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict
from evanesce.core.resources import resource
from evanesce.rig import Scene, load_scene
from evanesce.rig.load import validate

Grey = NDArray[np.uint8]

MAX_TOML_BYTES = 1_000_000


class _Press(Strict):
    video: str | None = Field(None, max_length=255)


class _Replicates(Strict):
    press_index: int | None = Field(None, ge=0)


class _Measurement(Strict):
    """``measurement.toml``."""

    schema_version: int = Field(1, ge=1, le=1)
    title: str = Field("", max_length=200)
    scene: str = Field(min_length=1, max_length=255)
    press: _Press = Field(default_factory=lambda: _Press.model_validate({}))
    replicates: _Replicates = Field(default_factory=lambda: _Replicates.model_validate({}))
    series: dict[str, dict[str, float | int]] = Field(default_factory=dict)


def read_bundle(path: str | Path, *, decode: bool = True) -> Bundle:
    """Read and check a bundle.

    Parameters
    ----------
    path : str or Path
    decode : bool
        Whether to decode every frame once, so that damage is found here; else only sizes are checked.

    Returns
    -------
    Bundle

    Raises
    ------
    InputError
        With file, line and column of the first error.
    """
    root = Path(path)
    if not root.is_dir():
        raise InputError("no such folder", file=root, allowed="a measurement bundle, see docs/reference/bundle.md")
    described = _measurement(root)
    scene = _scene(root, described.scene)
    video = None if described.press.video is None else inside(root, described.press.video, "press.video")
    press, press_files = _read_press(root, scene, video)
    files = {kind: picture_files(root, kind) for kind in AUXILIARY}
    files[PRESS_FOLDER] = press_files
    replicates, files[REPLICATES_FOLDER] = _read_replicates(root, scene, described, press)
    bundle = Bundle(
        path=root,
        scene=scene,
        title=described.title,
        press=press,
        replicates=replicates,
        series=_read_series(root, described),
        _files=MappingProxyType(files),
        _video=video,
    )
    if not bundle.available:
        raise InputError("holds nothing measured", file=root, allowed="press frames, other shots or a scalar series")
    for paths in files.values():
        for file in paths:
            check_header(file, scene)
    if decode:
        for kind in (PRESS_FOLDER, REPLICATES_FOLDER, *AUXILIARY):
            bundle.frames(kind)
    return bundle


def _measurement(root: Path) -> _Measurement:
    path = inside(root, MEASUREMENT_FILE, None)
    if path.stat().st_size > MAX_TOML_BYTES:
        raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_TOML_BYTES} bytes")
    try:
        data: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid TOML: {error}", file=path) from None
    return validate(_Measurement, data, path)


def _scene(root: Path, name: str) -> Scene:
    """Return the nominal model of the rig: a file of the bundle, or a scene that ships, by its bare name."""
    if name.endswith(".toml"):
        return load_scene(inside(root, name, "scene"))
    if not name.replace("_", "").replace("-", "").isalnum():
        raise InputError(
            f"{name!r}", file=root / MEASUREMENT_FILE, key="scene",
            allowed="a TOML file inside the bundle, or the name of a shipped scene",
        )  # fmt: skip
    # Only ever a shipped scene: a file of that name in the working folder is not the bundle's.
    shipped = resource("scenes", f"{name}.toml")
    if not shipped.is_file():
        known = ", ".join(sorted(p.stem for p in resource("scenes").glob("*.toml")))
        raise InputError(
            f"no shipped scene {name!r}", file=root / MEASUREMENT_FILE, key="scene",
            allowed=f"a TOML file inside the bundle, or {known}",
        )  # fmt: skip
    return load_scene(shipped)


def _read_press(root: Path, scene: Scene, video: Path | None) -> tuple[tuple[Shot, ...], tuple[Path, ...]]:
    table = root / PRESS_TABLE
    folder = () if video is not None else picture_files(root, PRESS_FOLDER)
    if video is not None and (root / PRESS_FOLDER).exists():
        raise InputError(
            "there is a video and a folder press/", file=root / MEASUREMENT_FILE, key="press.video",
            allowed="one of both",
        )  # fmt: skip
    if not table.exists():
        if folder or video is not None:
            raise InputError("is missing, but there are press frames", file=table, allowed="a line for each frame")
        return (), ()
    inside(root, PRESS_TABLE, None)
    shots = read_shots(table, scene.leds.voltage_V)
    if video is not None:
        return shots, ()
    by_number = numbered(folder)
    for line, shot in zip(line_numbers(table), shots, strict=True):
        if shot.index not in by_number:
            raise InputError(
                f"frame {shot.index} is missing: no {PRESS_FOLDER}/{shot.index:04d}.png", file=table,
                key=f"line {line}, column index", allowed=f"{len(shots)} frames, one to each line",
            )  # fmt: skip
    extra = sorted(set(by_number) - {shot.index for shot in shots})
    if extra:
        raise InputError(
            f"has no line in {PRESS_TABLE}: {len(by_number)} frames, {len(shots)} lines", file=by_number[extra[0]],
            allowed="a line for each frame",
        )  # fmt: skip
    return shots, tuple(by_number[shot.index] for shot in shots)


def _read_replicates(
    root: Path, scene: Scene, described: _Measurement, press: tuple[Shot, ...]
) -> tuple[Replicates, tuple[Path, ...]]:
    files = picture_files(root, REPLICATES_FOLDER)
    table, index = root / REPLICATES_FOLDER / REPLICATES_TABLE, described.replicates.press_index
    key = "replicates.press_index"
    if not files:
        if index is not None:
            raise InputError("there are no replicates", file=root / MEASUREMENT_FILE, key=key)
        return Replicates(), ()
    if table.exists():
        if index is not None:
            raise InputError(f"{table.name} gives the state, too", file=root / MEASUREMENT_FILE, key=key)
        inside(root, f"{REPLICATES_FOLDER}/{REPLICATES_TABLE}", None)
        shots = read_shots(table, scene.leds.voltage_V)
        if len(shots) != len(files):
            raise InputError(
                f"{len(shots)} lines, but {len(files)} frames", file=table, allowed="a line for each frame"
            )
        _check_held(table, shots, press)
        return Replicates(shots, len(files)), files
    if index is None:
        return Replicates((), len(files)), files
    held = [shot for shot in press if shot.index == index]
    if not held:
        raise InputError(f"{index} is no frame of {PRESS_TABLE}", file=root / MEASUREMENT_FILE, key=key)
    return Replicates((held[0],) * len(files), len(files)), files


def _check_held(table: Path, shots: Sequence[Shot], press: Sequence[Shot]) -> None:
    """Refuse replicates that are not of one state, or that were taken while the finger was pressed otherwise."""
    first = shots[0]
    for line, shot in zip(line_numbers(table), shots, strict=True):
        if not same_condition(first, shot):
            same = {"force_N": same_force(first.force_N, shot.force_N), "session": first.session == shot.session}
            column = next((name for name, kept in same.items() if not kept), "voltage_V")
            was, now = (getattr(s, column) for s in (first, shot))
            raise InputError(
                f"{now:g} after {was:g}: no state that was held", file=table, key=f"line {line}, column {column}",
                allowed="replicates of one force, voltage and session",
            )  # fmt: skip
    for other in press:
        between = other.session == first.session and first.time_s <= other.time_s <= shots[-1].time_s
        if between and not same_condition(other, first):
            state = f"{other.force_N:g} N and {other.voltage_V:g} V at {other.time_s:g} s"
            raise InputError(
                f"frame {other.index} of {PRESS_TABLE} has {state}, between these", file=table, key="column time_s",
                allowed="one clock for all tables",
            )  # fmt: skip


def _read_series(root: Path, described: _Measurement) -> Mapping[str, Series]:
    folder = root / SERIES_FOLDER
    for name, table in described.series.items():
        where, key = root / MEASUREMENT_FILE, f"series.{name}"
        for entry, value in table.items():
            if entry not in HELD:
                raise InputError(f"unknown key {entry!r}", file=where, key=key, allowed=", ".join(HELD))
            if isinstance(value, bool) or not HELD[entry].lo <= value <= HELD[entry].hi:
                raise InputError(f"{value!r}", file=where, key=f"{key}.{entry}", allowed=str(HELD[entry]))
        if not (name.replace("_", "").replace("-", "").isalnum() and (folder / f"{name}.csv").exists()):
            raise InputError(f"no {SERIES_FOLDER}/{name}.csv", file=where, key=key)
    if not folder.exists():
        return MappingProxyType({})
    check_inside(root, folder)
    if not folder.is_dir():
        raise InputError("is a file", file=folder, allowed="a folder of CSV tables")
    found = {}
    for path in sorted(p for p in folder.iterdir() if not p.name.startswith(".")):
        if path.suffix.lower() != ".csv":
            raise InputError("is no CSV table", file=path, allowed="CSV tables only in this folder")
        inside(root, f"{SERIES_FOLDER}/{path.name}", None)
        if path.stem in found:
            raise InputError("is there twice", file=path, allowed=f"one table of the name {path.stem}")
        found[path.stem] = read_series(path, {k: float(v) for k, v in described.series.get(path.stem, {}).items()})
    return MappingProxyType(found)
