"""Departures from the ideal rig, one file each, found in this folder's subfolders."""

from __future__ import annotations

import difflib
import functools
import importlib
import pkgutil
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from evanesce.core.errors import InputError
from evanesce.effects.inference_hints import OBSERVABLES, Bands, Blot, Candidate, Line, Marks, Observable
from evanesce.effects.protocol import ANY_SCENE, Active, Context, Effect, Stage, apply_stage
from evanesce.rig import Scene
from evanesce.rig.load import validate

__all__ = [
    "OBSERVABLES",
    "Active",
    "Bands",
    "Blot",
    "Candidate",
    "Context",
    "Effect",
    "Line",
    "Marks",
    "Observable",
    "Stage",
    "active_effects",
    "all_effects",
    "apply_stage",
]


KEEP_CHECKED = 64
"""Tables that need not be checked again: a fit predicts a thousand times with the same lists of thousands of grains."""
_CHECKED: OrderedDict[tuple[str, str], Any] = OrderedDict()


@functools.cache
def all_effects() -> Mapping[str, Effect]:
    """Return every effect of this folder's subfolders by its id, in the ids' alphabetical order.

    Returns
    -------
    mapping of str to Effect

    Raises
    ------
    TypeError
        If a file's effect does not bear the file's name.
    """
    found: dict[str, Effect] = {}
    for module in pkgutil.walk_packages(__path__, f"{__name__}."):
        effect = getattr(importlib.import_module(module.name), "EFFECT", None)
        if not isinstance(effect, Effect):
            continue
        if effect.id != module.name.rpartition(".")[2]:
            raise TypeError(f"{module.name} declares the effect '{effect.id}'")
        found[effect.id] = effect
    return MappingProxyType(dict(sorted(found.items())))


def active_effects(scene: Scene, file: Path | str = ANY_SCENE) -> tuple[Active, ...]:
    """Check a scene's ``[effects.<id>]`` tables and return its effects in the order in which they stand there.

    Parameters
    ----------
    scene : Scene
    file : Path or str
        Named in errors.

    Returns
    -------
    tuple of Active

    Raises
    ------
    InputError
        For an unknown effect (naming the nearest), an unknown key, or a value out of bounds.
    """
    known = all_effects()
    found = []
    for name, table in scene.effects.items():
        effect = known.get(name)
        if effect is None:
            close = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
            raise InputError(
                f"unknown effect; nearest: {close[0]}", file=file, key=f"effects.{name}", allowed=", ".join(known)
            )
        key = (name, repr(table))
        try:
            parameters = _CHECKED.get(key) or validate(effect.parameters, dict(table), file)
        except InputError as error:
            where = f"effects.{name}.{error.key}" if error.key else f"effects.{name}"
            raise InputError(error.what, file=file, key=where, allowed=error.allowed) from None
        _CHECKED[key] = parameters
        if len(_CHECKED) > KEEP_CHECKED:
            _CHECKED.popitem(last=False)
        found.append(Active(effect, parameters))
    return tuple(found)
