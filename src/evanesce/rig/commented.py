"""A scene as a file to edit: every key with unit, range, meaning and origin in a comment above it."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

import tomli_w
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from evanesce.core.quantities import UNIT_SUFFIXES, quantity_of
from evanesce.rig import height_map, spectrum_file
from evanesce.rig.explain import frame_effects
from evanesce.rig.leds import circuit_defaults
from evanesce.rig.load import _models, _pick
from evanesce.rig.scene import Scene

WIDTH = 118
LAST = ("effects", "sources", "assumptions")
LEFT_OUT = ("render",)
"""Tables that are written only where the scene changes them."""

INTRODUCTION = """\
Every key carries its unit. Above it: unit, allowed range, meaning, and where its figure comes from. A key behind "# "
has the value that holds without it; "key =" without a value is switched off. See `evanesce scene explain KEY`."""


def commented(scene: Scene, heading: str = "") -> str:
    """Return a scene as commented TOML that :func:`~evanesce.rig.load_scene` reads back equal.

    Height map and spectrum are named as :func:`~evanesce.rig.copy_scene_files` names their copies.

    Parameters
    ----------
    scene : Scene
    heading : str
        First lines of the file, without comment signs.

    Returns
    -------
    str
    """
    named = spectrum_file.relative(height_map.relative(scene))
    data = named.as_dict()
    origins = {**data["assumptions"], **data["sources"]}
    lines = [*_comment(heading), *([""] if heading else []), *_comment(INTRODUCTION)]
    tables: list[tuple[str, type[BaseModel], Mapping[str, Any]]] = [("", Scene, data)]
    while tables:
        at, model, values = tables.pop(0)
        inner = []
        own = list(_keys(at, model, values, origins, data))
        if at and own:
            lines += ["", f"[{at}]"]
        lines += own
        for name, value in values.items():
            where = f"{at}.{name}" if at else name
            if not isinstance(value, dict) or name in LAST or (where in LEFT_OUT and _is_default(model, name, value)):
                continue
            chosen = _pick(_models(model.model_fields[name].annotation), value)
            if chosen is None:  # a table by edge
                lines += ["", *tomli_w.dumps(_nested(where, value)).splitlines()] if value else []
            else:
                inner.append((where, chosen, value))
        tables = inner + tables
    for name in LAST:
        if data[name]:
            lines += ["", *tomli_w.dumps({name: data[name]}).splitlines()]
    return "\n".join(lines) + "\n"


def _keys(
    at: str, model: type[BaseModel], values: Mapping[str, Any], origins: Mapping[str, str], data: Mapping[str, Any]
) -> Iterator[str]:
    """Yield the lines of a table's own keys."""
    defaults = circuit_defaults(data["leds"]["spectrum"]) if at == "leds.circuit" else {}
    for name, info in model.model_fields.items():
        where = f"{at}.{name}" if at else name
        value = values.get(name)
        if isinstance(value, dict) or name in LAST or (value is None and _models(info.annotation)):
            continue
        origin = origins.get(where)
        default = defaults.get(name, info.get_default())
        silent = origin is None and not info.is_required() and _plain(default) == value
        yield from _comment(_about(info, origin, silent, frame_effects().get(where, "")))
        text = f"{name} =" if value is None else tomli_w.dumps({name: value}, multiline_strings=False).rstrip("\n")
        if isinstance(value, list):
            text = " ".join(text.split()).replace("[ ", "[", 1).replace(", ]", "]").replace(",]", "]")
        yield f"# {text}" if silent else text


def _about(info: FieldInfo, origin: str | None, silent: bool, in_frame: str) -> str:
    """Return unit, range, meaning (or what it does to the frame) and origin of a key."""
    quantity = quantity_of(info)
    parts = []
    if quantity is not None:
        unit = "no unit" if quantity.unit == "1" else UNIT_SUFFIXES.get(quantity.unit, quantity.unit)
        parts.append(f"{unit}, {quantity.bounds[0]:g} to {quantity.bounds[1]:g}")
    meaning = (quantity.doc if quantity is not None else info.description) or ""
    if origin is not None:
        meaning = meaning.removesuffix("not published").rstrip("; ")
    meaning = meaning or ("" if in_frame.startswith("Nothing") else in_frame.rstrip("."))
    if meaning:
        parts.append(meaning)
    text = ": ".join(parts)
    source = quantity.source if quantity is not None and silent else ""
    said = origin or source
    return f"{text}. {said[:1].upper()}{said[1:]}" if text and said else text or said


def _comment(text: str) -> list[str]:
    wrapped = [piece for line in text.splitlines() for piece in (textwrap.wrap(line, WIDTH) or [""])]
    return [f"# {line}".rstrip() for line in wrapped]


def _nested(where: str, value: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = dict(value)
    for part in reversed(where.split(".")):
        found = {part: found}
    return found


def _plain(value: Any) -> Any:
    return [_plain(v) for v in value] if isinstance(value, tuple) else value


def _is_default(model: type[BaseModel], name: str, value: Mapping[str, Any]) -> bool:
    default = model.model_fields[name].get_default(call_default_factory=True)
    return isinstance(default, BaseModel) and default.model_dump(mode="json", exclude_none=True) == value
