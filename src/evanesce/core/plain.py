"""JSON-able copies of results."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def plain(value: Any) -> Any:
    """Return a copy of a value that JSON can hold.

    Parameters
    ----------
    value : object
        Numbers, text, paths, NumPy scalars and arrays, and mappings, lists and tuples of these.

    Returns
    -------
    object
        Arrays and tuples as lists, paths and keys as text, NaN and infinity as None.
    """
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
