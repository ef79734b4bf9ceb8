"""Values that are computed once and kept, in the process: the oldest of each kind are dropped."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

LIMITS = {
    "unit sums": 4, "unit": 4, "rig": 8, "tables": 16, "subsurface": 16, "inside reflectance": 4, "inside at knots": 4,
    "entering": 4, "spread": 8, "fields": 32, "maps": 4, "rays": 4, "flank": 32, "contact radiance": 8,
    "plate unit light": 4, "plate points": 4, "contact radiance seen": 4, "flank surroundings": 96,
    "flank exchange": 48, "surroundings": 2, "spill": 4, "escape": 4, "edge exchange": 4, "led radiances": 64,
}  # fmt: skip
"""How many of each kind; a camera's maps of 2000 x 1500 pixels take 80 MB.

Of the flank's, one for each tenth of a millimetre of approach: twenty forces reach over two millimetres.
"""

_KEPT: dict[str, OrderedDict[str, Any]] = {kind: OrderedDict() for kind in LIMITS}


def kept(kind: str, key: str, make: Callable[[], T]) -> T:
    """Return a kept value, made if needed.

    Parameters
    ----------
    kind : str
        One of :data:`LIMITS`.
    key : str
        All that the value depends on.
    make : callable
    """
    group = _KEPT[kind]
    if key not in group:
        group[key] = _read_only(make())
        while len(group) > LIMITS[kind]:
            group.popitem(last=False)
    group.move_to_end(key)
    found: T = group[key]
    return found


def _read_only(value: Any) -> Any:
    """Return a value whose arrays nobody may change: all who ask for it get the same ones."""
    for array in value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else (value,):
        if isinstance(array, np.ndarray):
            array.setflags(write=False)
    return value


def forget() -> None:
    """Drop everything, for tests and benchmarks."""
    for group in _KEPT.values():
        group.clear()
