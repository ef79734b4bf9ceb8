"""Something that no cause of the library makes: a random field over the frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.inference.constants import STRENGTHS, UNKNOWN_WAVES
from evanesce.inference.data import DataVector
from evanesce.inference.single_effects import UNKNOWN
from evanesce.prediction.views import View

Array = NDArray[Any]

PROFILES = ("force_N", "voltage_V", "time_s")
"""Of a view, with which an unknown field may grow."""
KINDS = {
    "light": "a smooth field of the light",
    "level": "a smooth field beside the light",
    "edges": "a moved or blurred picture",
    "series": "a smooth function in a series",
}
"""Of unknown fields, in words."""
LIT = 0.05
"""Of the largest level, below which there is hardly any light."""


def waves(shape: tuple[int, int], count: int, *, constant: bool = False) -> Array:
    """Return products of cosines (n, rows, cols) with up to count - 1 half waves along the longer side.

    Their amplitudes fall as one over the number of half waves: a random sum of them has as much power in each octave.

    Parameters
    ----------
    shape : tuple of int
        (rows, cols).
    count : int
    constant : bool
        Whether what is even over the frame is one of them, as large as one half wave.
    """
    rows, cols = shape
    longer = max(rows, cols)
    found = []
    for i in range(count):
        for j in range(count):
            # As many half waves to a millimetre either way: a field that has no preferred direction.
            number = float(np.hypot(i * longer / rows, j * longer / cols))
            if (constant or number > 0) and number < count:
                down = np.cos(np.pi * i * (np.arange(rows) + 0.5) / rows)
                right = np.cos(np.pi * j * (np.arange(cols) + 0.5) / cols)
                found.append(np.outer(down, right) / max(number, 1.0))
    return np.array(found).reshape(-1, rows, cols)


def at_largest_strength(rows: Array) -> Array:
    """Return whitened rows (k, d) times one factor: squared norms add up to that of the largest strength."""
    size = float(np.sqrt(np.sum([float(row @ row) for row in rows])))
    return np.asarray(rows * (STRENGTHS[-1] / size if size > 0 else 0.0), np.float32)


def profiles(views: Sequence[View]) -> dict[str, Array]:
    """Return how a field may go from view to view of the contact: a number (views,) for each, 0 where none is seen.

    ``alike`` in all, or with the distance of force, voltage or time from its mean, in standard deviations; what is the
    same in all views is left out.

    Parameters
    ----------
    views : sequence of View
    """
    touching = np.array([view.kind in ("press", "replicate") for view in views])
    found = {"alike": touching.astype(float)}
    for name in PROFILES:
        value = np.array([float(getattr(view, name) or 0.0) for view in views])
        away = np.where(touching, value - value[touching].mean(), 0.0) if touching.any() else np.zeros(len(views))
        spread = float(np.sqrt(np.mean(away[touching] ** 2))) if touching.any() else 0.0
        if spread > 0:
            found[name.partition("_")[0]] = away / spread
    return found


def told_fields(blocks: Iterable[str]) -> str:
    """Return what blocks of something unknown are, in words.

    Parameters
    ----------
    blocks : iterable of str
        Names, as those of :func:`unknown_blocks`.
    """
    words = ["something that no cause of the library makes"]
    for block in blocks:
        _, kind, *profile = block.split()
        how = "".join(", alike in all views" if name == "alike" else f" that goes with {name}" for name in profile)
        words.append(KINDS[kind] + how)
    return "; ".join(words)


def unknown_blocks(data: DataVector, nominal: Array) -> dict[str, Array]:
    """Return whitened rows (k, bins) by block: fields that follow the light, and fields that do not.

    Either are alike in all views of the contact, or go with force, voltage or time, in half as many waves: those of
    the light over the part of the frame where there is light. So may displacement, scale and blur of the picture.

    Parameters
    ----------
    data : DataVector
    nominal : ndarray (views, rows, cols)
        Prediction [DN].
    """
    shape = nominal.shape[1:]
    # Light and level that are even in all views are nuisances.
    whole, few = waves(shape, UNKNOWN_WAVES), waves(shape, UNKNOWN_WAVES // 2, constant=True)
    lit = _where_lit(nominal, UNKNOWN_WAVES // 2)
    valid = data.valid[list(data.open)]
    found = {}
    for name, profile in profiles(data.views).items():
        own = (whole, whole) if name == "alike" else (lit, few)
        for kind, basis, cube in zip(("light", "level"), own, (nominal, np.ones_like(nominal)), strict=True):
            over = data.over_noise(cube * profile[:, None, None])
            rows = np.array([(wave * over)[valid].astype(np.float32) for wave in basis])
            found[f"{UNKNOWN} {kind} {name}"] = at_largest_strength(rows)
        if name != "alike":
            rows = np.array([data.over_noise(cube * profile[:, None, None])[valid] for cube in _moved(nominal)])
            found[f"{UNKNOWN} edges {name}"] = at_largest_strength(rows)
    return found


def _moved(nominal: Array) -> list[Array]:
    """Return what frames (views, rows, cols) change by if they are displaced along either axis, scaled, or blurred."""
    down, right = np.gradient(nominal, axis=(1, 2))
    rows, cols = nominal.shape[1:]
    y, x = (np.arange(rows) - (rows - 1) / 2)[:, None], np.arange(cols) - (cols - 1) / 2
    return [down, right, x * right + y * down, np.array([ndimage.laplace(one) for one in nominal])]


def _where_lit(nominal: Array, count: int) -> Array:
    """Return waves (n, rows, cols) over the rectangle outside of which there is hardly any light, 0 there."""
    light = np.abs(nominal).max(axis=0)
    bright = light > LIT * light.max()
    rows, cols = (np.flatnonzero(bright.any(axis=axis)) for axis in (1, 0))
    down, right = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
    basis = waves(light[down, right].shape, count, constant=True)
    found = np.zeros((len(basis), *light.shape))
    found[:, down, right] = basis
    return found
