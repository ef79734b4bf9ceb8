"""Design variables: numeric keys of the scene or of the measurement that a search varies, with their ranges."""

from __future__ import annotations

import difflib
import math
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from evanesce.core.errors import InputError
from evanesce.core.quantities import Quantity, quantity_of
from evanesce.design.question import Design
from evanesce.rig import Scene
from evanesce.rig.load import validate

TABLE = "variables"
"""Name of the question file's table of ranges."""

FORM = "plate.thickness_mm = { low = 3.0, high = 10.0 }, with a step or log = true"

MEASUREMENT: Mapping[str, Quantity] = {
    "measurement.threshold": Quantity("1", (0.004, 0.996), doc="grey level of the reference segmentation"),
    "measurement.min_blob_px": Quantity("px", (0, 1_000_000), doc="minimum blob size of the reference segmentation"),
}
FIXED = ("grid.", "render.", "card.", "press.", "slide.", "camera.resolution_px", "finger.position_mm")
"""Not of the rig: how it is computed, calibrated and loaded."""


@dataclass(frozen=True)
class DesignVariable:
    """A key of the scene or of the measurement, and the range within which a search varies it.

    Attributes
    ----------
    key : str
        Dotted; ``plate.size_mm[0]`` is one number of a pair.
    low, high : float
    unit : str
    step : float or None
        Distance of the values that are sampled; None: continuous.
    log : bool
        Whether values are sampled uniformly in their logarithm.
    whole : bool
        Whether only integers are allowed.
    """

    key: str
    low: float
    high: float
    unit: str
    step: float | None = None
    log: bool = False
    whole: bool = False

    def clip(self, value: float) -> float:
        """Return the nearest value of the range."""
        value = min(max(value, self.low), self.high)
        if self.step is not None:
            value = min(self.low + self.step * round((value - self.low) / self.step), self.high)
        return float(round(value)) if self.whole else value


def known_keys(scene: Scene) -> dict[str, tuple[Quantity, bool]]:
    """Return every numeric key of a scene that may vary: its quantity, and whether it is an integer."""
    found = {key: (quantity, key.endswith("_px")) for key, quantity in MEASUREMENT.items()}
    for key, quantity, value in _numbers(scene, ""):
        if key.startswith(FIXED):
            continue
        if isinstance(value, tuple):
            found |= {f"{key}[{i}]": (quantity, False) for i in range(len(value))}
        else:
            found[key] = (quantity, isinstance(value, int) and not isinstance(value, bool))
    return found


def _numbers(model: BaseModel, at: str) -> Iterator[tuple[str, Quantity, Any]]:
    for name, info in type(model).model_fields.items():
        value, quantity = getattr(model, name), quantity_of(info)
        if quantity is not None:
            if value is not None and not (isinstance(value, tuple) and not value):
                yield at + name, quantity, value
            elif value is None and float in _plain_types(info.annotation):
                yield at + name, quantity, 0.0
        elif isinstance(value, BaseModel):
            yield from _numbers(value, f"{at}{name}.")


def _plain_types(annotation: Any) -> tuple[Any, ...]:
    if isinstance(annotation, types.UnionType) or typing.get_origin(annotation) is typing.Union:
        return typing.get_args(annotation)
    return (annotation,)


def design_variables(ranges: Mapping[str, Mapping[str, Any]], scene: Scene) -> tuple[DesignVariable, ...]:
    """Check the ranges of a question and return its design variables.

    Parameters
    ----------
    ranges : mapping
        Dotted key -> ``low``, ``high`` and perhaps ``step`` or ``log``.
    scene : Scene
        Whose keys may vary.

    Raises
    ------
    InputError
        Naming the key and what is allowed: for an unknown key, a range that is empty or outside the key's limits, or no
        range at all.
    """
    if not ranges:
        raise InputError("nothing to vary", key=TABLE, allowed=FORM)
    known = known_keys(scene)
    found = []
    for key, span in ranges.items():
        if key not in known:
            close = difflib.get_close_matches(key, known, n=3, cutoff=0.0)
            raise InputError(
                "no such number in this scene", key=f"{TABLE}.{key}", allowed=f"nearest: {', '.join(close)}"
            )
        found.append(_variable(key, span, *known[key]))
    return tuple(found)


def _variable(key: str, span: Mapping[str, Any], quantity: Quantity, whole: bool) -> DesignVariable:
    name = f"{TABLE}.{key}"
    low, high, step, log = float(span["low"]), float(span["high"]), span.get("step"), bool(span.get("log", False))
    text = f"{low:g} to {high:g}"
    lower, upper = quantity.bounds
    if not (math.isfinite(low) and math.isfinite(high) and lower <= low and high <= upper):
        raise InputError(f"{text} leaves the limits", key=name, allowed=str(quantity))
    if not low < high:
        raise InputError(f"{text} is empty", key=name, allowed=f"low < high within {quantity}")
    if log and not low > 0:
        raise InputError(text, key=name, allowed="a range above 0 where its logarithm is meant")
    if log and step is not None:
        raise InputError("step and log", key=name, allowed="one of the two")
    if step is not None and not 0 < step <= high - low:
        raise InputError(f"step {step:g}", key=name, allowed=f"above 0 to {high - low:g}")
    if whole and any(v != round(v) for v in (low, high, step or 1.0)):
        raise InputError(text, key=name, allowed="whole numbers")
    return DesignVariable(key, low, high, quantity.unit, None if step is None else float(step), log, whole)


def design_at(base: Design, values: Mapping[str, float]) -> Design:
    """Return a design with keys set.

    Raises
    ------
    InputError
        If such a rig is infeasible, with the reason.
    """
    data = base.scene.as_dict()
    threshold, min_blob = base.threshold, base.min_blob_px
    changed = set()
    for key, value in values.items():
        if key == "measurement.threshold":
            threshold = float(value)
        elif key == "measurement.min_blob_px":
            min_blob = round(value)
        else:
            changed.add(_set(data, key, value))
    # Sources and assumptions of a changed figure no longer hold.
    for table in ("sources", "assumptions"):
        data[table] = {k: v for k, v in data.get(table, {}).items() if k not in changed}
    return Design(scene=validate(Scene, data, "design"), threshold=threshold, min_blob_px=min_blob)


def value_of(design: Design, key: str) -> float | None:
    """Return the value of a key in a design; None where its scene leaves it open."""
    if key == "measurement.threshold":
        return design.threshold
    if key == "measurement.min_blob_px":
        return float(design.min_blob_px)
    name, _, index = key.partition("[")
    value: Any = design.scene
    for part in name.split("."):
        value = value.get(part) if isinstance(value, dict) else getattr(value, part, None)
    if value is None:
        return None
    return float(value[int(index[:-1])] if index else value)


def _set(data: dict[str, Any], key: str, value: float) -> str:
    """Set a number in a scene's plain data; return the key's name without an index."""
    name, _, index = key.partition("[")
    *parents, last = name.split(".")
    table: Any = data
    for part in parents:
        table = table.setdefault(part, {})
    if index:
        numbers = list(table[last])
        numbers[int(index[:-1])] = float(value)
        table[last] = numbers
    else:
        whole = isinstance(table.get(last), int) and not isinstance(table.get(last), bool)
        table[last] = round(value) if whole else float(value)
    return name
