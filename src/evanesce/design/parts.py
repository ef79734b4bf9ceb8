"""Cost of a rig's parts by a table of prices."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict
from evanesce.design.question import Design
from evanesce.design.variables import known_keys, value_of
from evanesce.optics.led import led_positions
from evanesce.rig import Scene
from evanesce.rig.load import validate

MAX_BYTES = 1_000_000


class Part(Strict):
    """One line of the table.

    ``per`` says what the price multiplies: the rig, each LED, square centimetres of plate, centimetres of lit edge. A
    part with a ``key`` is bought only where that number of the scene lies from ``low`` to below ``high``.
    """

    name: str = Field(min_length=1, max_length=200)
    price: float = Field(ge=0.0, le=1e9)
    per: Literal["rig", "led", "plate_cm2", "edge_cm"] = "rig"
    key: str | None = None
    low: float | None = None
    high: float | None = None

    @model_validator(mode="after")
    def _range(self) -> Self:
        if (self.key is None) != (self.low is None and self.high is None):
            raise ValueError("'key' goes with 'low' or 'high', and these with 'key'")
        return self


class PartsTable(Strict):
    """A table of parts and its currency."""

    currency: str = Field("EUR", min_length=1, max_length=10)
    part: tuple[Part, ...] = Field(min_length=1, max_length=1000)


@dataclass(frozen=True)
class Bought:
    """One part of a rig: its count, unit and price."""

    name: str
    count: float
    unit: str
    price: float

    @property
    def cost(self) -> float:
        """Count times price."""
        return self.count * self.price


def read_parts(path: Path, scene: Scene) -> PartsTable:
    """Read a parts table (TOML: ``currency`` and ``[[part]]`` tables).

    Raises
    ------
    InputError
        If the file is absent, malformed, or names a key that is not in the scene.
    """
    if not path.is_file():
        raise InputError("no such file", file=path, key="parts", allowed="a TOML table of parts")
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_BYTES} bytes")
    try:
        data: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid TOML: {error}", file=path) from None
    table = validate(PartsTable, data, path)
    known = known_keys(scene)
    for part in table.part:
        if part.key is not None and part.key not in known:
            raise InputError(f"'{part.key}' is no number of this scene", file=path, key=part.name)
    return table


def parts_of(table: PartsTable, design: Design) -> list[Bought]:
    """Return the parts of a design."""
    counts = part_counts(design.scene)
    found = []
    for part in table.part:
        if part.key is not None:
            value = value_of(design, part.key)
            if value is None or (part.low is not None and value < part.low):
                continue
            if part.high is not None and value >= part.high:
                continue
        count, unit = counts[part.per]
        found.append(Bought(part.name, count, unit, part.price))
    return found


def part_counts(scene: Scene) -> Mapping[str, tuple[float, str]]:
    """Return the count of each measure of a rig, with its unit."""
    width, height = scene.plate.size_mm
    lit = sum(height if edge in ("left", "right") else width for edge in scene.leds.edges)
    leds = sum(positions.size for positions in led_positions(scene.plate, scene.leds).values())
    return {
        "rig": (1.0, ""), "led": (float(leds), "LEDs"), "plate_cm2": (width * height / 100.0, "cm²"),
        "edge_cm": (lit / 10.0, "cm"),
    }  # fmt: skip


def cost(table: PartsTable, design: Design) -> float:
    """Return the cost of a design's parts, in the table's currency."""
    return sum(part.cost for part in parts_of(table, design))
