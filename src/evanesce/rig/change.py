"""Change keys of a scene by name; the result is checked as strictly as a scene that is read from a file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict
from evanesce.rig import height_map, spectrum_file
from evanesce.rig.beside import INSIDE
from evanesce.rig.leds import SPECTRA, circuit_defaults
from evanesce.rig.load import validate
from evanesce.rig.scene import Scene

SEPARATOR = "__"
"""Stands for the dot of a key where a Python name is needed: ``leds__voltage_V`` is ``leds.voltage_V``."""

HEIGHT_MAP = ("finger", "height_map")
SPECTRUM = ("leds", "spectrum")


def changed(scene: Scene, changes: Mapping[str, Any], *, file: str = "Scene.with_") -> Scene:
    """Return a scene with some keys replaced.

    Parameters
    ----------
    scene : Scene
    changes : mapping
        From keys, parts joined by a dot or by two underscores, to values; a table is given as a mapping and replaces
        the whole table, None removes an optional key.
    file : str
        Named in errors.

    Returns
    -------
    Scene
        Without the sentences under ``sources`` and ``assumptions`` that speak of a changed key.

    Raises
    ------
    InputError
        For an unknown key, naming the nearest, or a value of the wrong type or out of bounds.
    """
    paths = [_path(key) for key in changes]
    data = scene.as_dict()
    if SPECTRUM in paths:
        paths += [("leds", "circuit", name) for name in _forget_type(data["leds"])]
    data = merged(data, changes, file)
    for name in ("sources", "assumptions"):
        if (name,) not in paths:
            data[name] = {key: text for key, text in data[name].items() if not _affected(tuple(key.split(".")), paths)}
    found = validate(Scene, data, file)
    if _affected(SPECTRUM, paths):
        found = _with_spectrum_located(found, file)
    return _with_map_located(found, file) if _affected(HEIGHT_MAP, paths) else found


def merged(data: dict[str, Any], changes: Mapping[str, Any], file: str) -> dict[str, Any]:
    """Return nested tables with some keys replaced; unchecked, and the tables that are given are changed.

    Parameters
    ----------
    data : dict
    changes : mapping
        As for :func:`changed`.
    file : str
        Named in errors.
    """
    for key, value in changes.items():
        _set(data, _path(key), _plain(value), file)
    return data


def _path(key: str) -> tuple[str, ...]:
    return tuple(key.replace(SEPARATOR, ".").split("."))


def _set(data: dict[str, Any], path: tuple[str, ...], value: Any, file: str) -> None:
    *parents, last = path
    table = data
    for part in parents:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise InputError(f"{part} is not a table", file=file, key=".".join(path))
    if value is None:
        table.pop(last, None)
    else:
        table[last] = value


def _plain(value: Any) -> Any:
    """Return what a TOML file would hold: models as tables, arrays and tuples as lists, numpy's numbers as Python's."""
    if isinstance(value, Strict):
        return value.model_dump(mode="json", exclude_none=True)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def _affected(key: tuple[str, ...], paths: list[tuple[str, ...]]) -> bool:
    """Return whether one of the changed keys contains a key, equals it, or lies within it."""
    return any(key[: len(path)] == path or path[: len(key)] == key for path in paths)


def _forget_type(leds: dict[str, Any]) -> list[str]:
    """Take out of the strips' table, and name, what their LED type brought with it: another type brings its own."""
    figures = circuit_defaults(leds["spectrum"])
    forgotten = [name for name, value in leds["circuit"].items() if value == figures[name]]
    for name in forgotten:
        del leds["circuit"][name]
    leds.pop("spectrum_sha256", None)
    return forgotten


def _with_spectrum_located(scene: Scene, whose: str) -> Scene:
    """Return the scene with its spectrum file's digest; a relative name counts from the working folder."""
    leds = scene.leds
    if leds.spectrum in SPECTRA:
        return scene
    file = Path(leds.spectrum).absolute()
    named = scene.model_copy(update={"leds": leds.model_copy(update={"spectrum": file.name})})
    with _given(leds.spectrum, whose):
        return spectrum_file.located(named, file.parent / "scene")


def _with_map_located(scene: Scene, whose: str) -> Scene:
    """Return the scene with its height map's digest; a relative name counts from the working folder."""
    skin = scene.finger.height_map
    if skin is None:
        return scene
    file = Path(skin.file).absolute()
    named = skin.model_copy(update={"file": file.name})
    finger = scene.finger.model_copy(update={"height_map": named})
    with _given(skin.file, whose):
        return height_map.located(scene.model_copy(update={"finger": finger}), file.parent / "scene")


@contextmanager
def _given(name: str, whose: str) -> Iterator[None]:
    """Let errors about a file name it as it was given: no scene's file stands beside it."""
    try:
        yield
    except InputError as error:
        what = error.what.replace(repr(Path(name).name), repr(name))
        allowed = "an existing file" if error.allowed == INSIDE else error.allowed
        raise InputError(what, file=whose, key=error.key, allowed=allowed) from None
