"""Something that no cause of the library makes: a random field over the frame, and what it looks like where found."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.constants import UNKNOWN_WAVES
from evanesce.inference.data import DataVector

Array = NDArray[Any]


def waves(shape: tuple[int, int], count: int) -> Array:
    """Return products of cosines (n, rows, cols) with up to count - 1 half waves along the longer side, no constant.

    Parameters
    ----------
    shape : tuple of int
        (rows, cols).
    count : int
    """
    rows, cols = shape
    longer = max(rows, cols)
    found = []
    for i in range(count):
        for j in range(count):
            # As many half waves to a millimetre either way: a field that has no preferred direction.
            if 0 < np.hypot(i * longer / rows, j * longer / cols) < count:
                down = np.cos(np.pi * i * (np.arange(rows) + 0.5) / rows)
                right = np.cos(np.pi * j * (np.arange(cols) + 0.5) / cols)
                found.append(np.outer(down, right))
    return np.array(found).reshape(-1, rows, cols)


def unknown_rows(data: DataVector, nominal: Array) -> Array:
    """Return whitened rows (k, bins): fields that follow the light, and fields that do not, in all open views alike.

    Parameters
    ----------
    data : DataVector
    nominal : ndarray (views, rows, cols)
        Prediction [DN].
    """
    basis = waves(nominal.shape[1:], UNKNOWN_WAVES)
    opened = list(data.open)
    touching = np.array([data.views[k].kind in ("press", "replicate") for k in opened])[:, None, None]
    valid = data.valid[opened]
    weight = 1.0 / data.sd[opened]
    found = []
    for wave in basis:
        found.append((nominal[opened] * wave * touching * weight)[valid])
        found.append((wave * touching * weight)[valid])
    return np.array(found, np.float32)
