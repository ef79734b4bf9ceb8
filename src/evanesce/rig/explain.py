"""What a key of a scene is: unit, range, default, source, and what it does to the frame."""

from __future__ import annotations

import difflib
import functools
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from evanesce.core.errors import InputError
from evanesce.core.quantities import Quantity, quantity_of
from evanesce.rig.load import _mapping_value, _models
from evanesce.rig.scene import Scene

EDGE = "EDGE"
"""Stands for an edge in a key: ``leds.edge.EDGE.voltage_V``."""
EDGES = ("left", "right", "top", "bottom")
TEXTS = Path(__file__).with_name("frame_effect.toml")


@dataclass(frozen=True)
class Key:
    """A key of a scene.

    Attributes
    ----------
    name : str
        Dotted.
    quantity : Quantity or None
        Of a number.
    default : object
        None where there is none.
    required : bool
    meaning : str
    in_frame : str
        What it does to the frame.
    choices : tuple of str
        Words that it takes, of those that are words.
    """

    name: str
    quantity: Quantity | None
    default: Any
    required: bool
    meaning: str
    in_frame: str
    choices: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return JSON-able data."""
        q = self.quantity
        return {
            "key": self.name, "unit": None if q is None else q.unit, "range": None if q is None else list(q.bounds),
            "default": self.default, "required": self.required, "null": None if q is None else q.null,
            "choices": list(self.choices), "meaning": self.meaning, "source": "" if q is None else q.source,
            "in_frame": self.in_frame,
        }  # fmt: skip


@functools.cache
def scene_keys() -> dict[str, Key]:
    """Return every key of a scene by its dotted name; an edge is called :data:`EDGE`."""
    found: dict[str, Key] = {}
    for name, info in _walk(Scene, ""):
        if name in found:  # of several contact laws
            more = (*found[name].choices, *words_of(info.annotation))
            found[name] = replace(found[name], choices=tuple(dict.fromkeys(more)))
            continue
        quantity = quantity_of(info)
        meaning = (quantity.doc if quantity is not None else info.description) or ""
        default = None if info.is_required() else info.get_default(call_default_factory=True)
        found[name] = Key(
            name,
            quantity,
            default,
            info.is_required(),
            meaning,
            frame_effects().get(name, ""),
            words_of(info.annotation),
        )
    return found


def words_of(annotation: Any) -> tuple[str, ...]:
    """Return the words that an annotation admits, of a ``Literal`` anywhere in it."""
    if get_origin(annotation) is Literal:
        return tuple(word for word in get_args(annotation) if isinstance(word, str))
    return tuple(word for inner in get_args(annotation) for word in words_of(inner))


@functools.cache
def frame_effects() -> dict[str, str]:
    """Return what each key does to the frame, by dotted name."""
    return dict(_flat(tomllib.loads(TEXTS.read_text(encoding="utf-8")), ""))


def explained(name: str) -> tuple[Key, ...]:
    """Return a key, or all keys of a table.

    Parameters
    ----------
    name : str
        Dotted name of a key or table.

    Returns
    -------
    tuple of Key

    Raises
    ------
    InputError
        For an unknown name, with the nearest ones.
    """
    keys = scene_keys()
    parts = [
        EDGE if i == 2 and name.startswith("leds.edge.") and p in EDGES else p for i, p in enumerate(name.split("."))
    ]
    wanted = ".".join(parts)
    if wanted in keys:
        return (keys[wanted],)
    below = tuple(key for known, key in keys.items() if known.startswith(f"{wanted}."))
    if below:
        return below
    close = difflib.get_close_matches(wanted, keys, n=3, cutoff=0.5)
    last = wanted.rpartition(".")[2]
    same = [known for known in keys if last and known.rpartition(".")[2].startswith(last)]
    near = list(dict.fromkeys([*same, *close]))[:5]
    tables = sorted({known.partition(".")[0] for known in keys if "." in known})
    raise InputError(f"no key or table '{name}' in a scene", key="KEY", allowed=", ".join(near or tables))


def _walk(model: type[BaseModel], at: str) -> Iterator[tuple[str, FieldInfo]]:
    for name, info in model.model_fields.items():
        where = f"{at}.{name}" if at else name
        for inner in _models(info.annotation):
            yield from _walk(inner, where)
        for inner in _mapping_value(info.annotation):
            yield from _walk(inner, f"{where}.{EDGE}")
        if not _models(info.annotation) and not _mapping_value(info.annotation):
            yield where, info


def _flat(table: dict[str, Any], at: str) -> Iterator[tuple[str, str]]:
    for name, value in table.items():
        where = f"{at}.{name}" if at else name
        if isinstance(value, dict):
            yield from _flat(value, where)
        else:
            yield where, value
