"""What a search may vary: a key of the scene, or of the measurement, with its range."""

from __future__ import annotations

import difflib
import math
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from evanesce.core.errors import InputError
from evanesce.core.quantities import Quantity, quantity_of
from evanesce.design.question import Design
from evanesce.rig import Scene
from evanesce.rig.load import validate

FORM = "KEY=LOW:HIGH, KEY=LOW:HIGH:STEP or KEY=LOW:HIGH:log, e.g. plate.thickness_mm=3:10"

MEASUREMENT: Mapping[str, Quantity] = {
    "measurement.threshold": Quantity("1", (0.004, 0.996), doc="grey level of the reference segmentation"),
    "measurement.min_blob_px": Quantity("px", (0, 1_000_000), doc="least blob of the reference segmentation"),
}
FIXED = ("grid.", "render.", "card.", "press.", "slide.", "camera.resolution_px", "finger.position_mm")
"""Not of the rig: how it is computed, what it is calibrated and loaded with."""


@dataclass(frozen=True)
class Vary:
    """One key with its range.

    Attributes
    ----------
    key : str
        Dotted; ``plate.size_mm[0]`` is one number of a pair.
    low, high : float
    unit : str
    step : float or None
        Distance of the values that are tried; none: all.
    log : bool
        Whether values are tried evenly in their logarithm.
    whole : bool
        Whether only whole numbers are allowed.
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
    """Return every numeric key that may be varied in a scene: its quantity and whether it is a whole number."""
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


def parse(texts: Sequence[str], scene: Scene) -> tuple[Vary, ...]:
    """Read ``--vary`` options.

    Raises
    ------
    InputError
        Naming the key and what is allowed: for another form, an unknown key, a range that is empty or outside the
        key's limits, a key named twice, or none at all.
    """
    if not texts:
        raise InputError("nothing to vary", key="--vary", allowed=FORM)
    known = known_keys(scene)
    found: dict[str, Vary] = {}
    for text in texts:
        key, sign, span = (part.strip() for part in text.partition("="))
        if not sign or not key:
            raise InputError(f"{text!r}", key="--vary", allowed=FORM)
        if key not in known:
            close = difflib.get_close_matches(key, known, n=3, cutoff=0.0)
            raise InputError(
                "no such number in this scene", key=f"--vary {key}", allowed=f"nearest: {', '.join(close)}"
            )
        if key in found:
            raise InputError("named twice", key=f"--vary {key}", allowed="each key once")
        found[key] = _range(key, span, *known[key])
    return tuple(found.values())


def _range(key: str, span: str, quantity: Quantity, whole: bool) -> Vary:
    name = f"--vary {key}"
    parts = span.split(":")
    if len(parts) not in (2, 3):
        raise InputError(f"{span!r}", key=name, allowed=f"{FORM}; {quantity}")
    try:
        low, high = float(parts[0]), float(parts[1])
        log = len(parts) == 3 and parts[2] == "log"
        step = float(parts[2]) if len(parts) == 3 and not log else None
    except ValueError:
        raise InputError(f"{span!r}", key=name, allowed=f"{FORM}; {quantity}") from None
    least, most = quantity.bounds
    if not (math.isfinite(low) and math.isfinite(high) and least <= low and high <= most):
        raise InputError(f"{span!r} leaves the limits", key=name, allowed=str(quantity))
    if not low < high:
        raise InputError(f"{span!r} is empty", key=name, allowed=f"low < high within {quantity}")
    if log and not low > 0:
        raise InputError(f"{span!r}", key=name, allowed="a range above 0 where its logarithm is meant")
    if step is not None and not 0 < step <= high - low:
        raise InputError(f"step {step:g}", key=name, allowed=f"above 0 to {high - low:g}")
    if whole and any(v != round(v) for v in (low, high, step or 1.0)):
        raise InputError(f"{span!r}", key=name, allowed="whole numbers")
    return Vary(key, low, high, quantity.unit, step, log, whole)


def design_at(base: Design, values: Mapping[str, float]) -> Design:
    """Return a design with keys set.

    Raises
    ------
    InputError
        If there can be no such rig: the reason in the scene's own words.
    """
    data = base.scene.as_dict()
    threshold, min_blob = base.threshold, base.min_blob_px
    touched = set()
    for key, value in values.items():
        if key == "measurement.threshold":
            threshold = float(value)
        elif key == "measurement.min_blob_px":
            min_blob = round(value)
        else:
            touched.add(_set(data, key, value))
    # What is said of a figure that a search has changed is no longer true.
    for table in ("sources", "assumptions"):
        data[table] = {k: v for k, v in data.get(table, {}).items() if k not in touched}
    return Design(scene=validate(Scene, data, "design"), threshold=threshold, min_blob_px=min_blob)


def value_of(design: Design, key: str) -> float | None:
    """Return what a design has under a key; None where its scene leaves it open."""
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
