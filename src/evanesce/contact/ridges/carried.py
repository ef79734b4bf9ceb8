"""What ridges carry of a smooth contact: its pressure and strength, shared within a pitch, and its traction."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState, SurfaceState

Array = NDArray[np.float64]

CORRECTIONS = 6
"""Rounds in which cells that have come to their strength are left as they are."""


def on_ridges(smooth: ContactState, local: Array, touched: NDArray[np.bool_], ridge_pitch: float) -> dict[str, Any]:
    """Return pressure and strength (or traction, without it) of a smooth contact, as the ridges carry them."""
    asked = ("pressure", "traction" if smooth.strength is None else "strength")
    names = [name for name in asked if getattr(smooth, name) is not None]
    fields = [np.asarray(getattr(smooth, name), dtype=float).reshape(-1, *smooth.grid.shape) for name in names]
    layers = np.concatenate(fields)
    carried = np.zeros_like(layers)
    if local.any():
        window = 2 * math.ceil(0.5 * ridge_pitch / smooth.grid.pitch) + 1
        rows, cols = (np.flatnonzero(touched.any(axis=axis)) for axis in (1, 0))
        box = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        carried[:, *box] = _shared(layers[:, *box] * touched[box], local[box], window)
    parts = np.split(carried, np.cumsum([len(field) for field in fields])[:-1])
    return {name: part.reshape(getattr(smooth, name).shape) for name, part in zip(names, parts, strict=True)}


def ridge_traction(smooth: ContactState, strength: Array) -> Array:
    """Return the traction (2, rows, cols) [MPa] of a smooth contact's shares of strength, with its force and torque.

    What is lacking goes by strength to cells that stick, up to their strength. Where they cannot carry it, what is
    lacking of the force goes to cells that slip, and the torque is that of ridges at their strength.
    """
    everywhere, whole = np.asarray(smooth.strength, dtype=float), np.zeros((2, *strength.shape))
    rows, cols = (np.flatnonzero(everywhere.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return whole
    box = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    x, y = (a - float(a.mean()) for a in np.meshgrid(smooth.grid.x[box[1]], smooth.grid.y[box[0]]))
    before, old, strength = np.asarray(smooth.traction, dtype=float)[:, *box], everywhere[box], strength[box]
    share = np.divide(before, old, out=np.zeros_like(before), where=old > 0)
    found = share * strength

    def sums(traction: Array) -> Array:
        return np.array([traction[0].sum(), traction[1].sum(), (x * traction[1] - y * traction[0]).sum()])

    wanted, touching = sums(before), strength > 0
    sticks = touching if smooth.state is None else touching & (np.asarray(smooth.state)[box] == SurfaceState.STICK)
    free = sticks
    for _ in range(CORRECTIONS):
        if not free.any():
            break
        weight = np.where(free, strength, 0.0)
        found = _carried(found, [weight, weight, weight], wanted, sums, (x, y))
        size = np.hypot(*found)
        over = free & (size > strength)
        if not over.any():
            break
        found[:, over] *= (strength / np.where(size > 0, size, 1.0))[over]
        free = free & ~over
    slips = np.where(touching & ~sticks, strength, 0.0)
    if slips.any():  # of the force what is lacking still, some per cent of it
        found = _carried(found, [slips, slips], wanted, sums, (x, y))
    whole[:, *box] = found
    return whole


def _carried(
    found: Array, weights: Sequence[Array], wanted: Array, sums: Callable[[Array], Array], place: tuple[Array, Array]
) -> Array:
    """Return a traction to which weighted shifts in x and y, and a turn where asked for, add what sums lack."""
    x, y = place
    one, none = np.ones_like(x), np.zeros_like(x)
    patterns = (np.stack([one, none]), np.stack([none, one]), np.stack([-y, x]))
    shapes = [weight * pattern for weight, pattern in zip(weights, patterns, strict=False)]
    matrix = np.array([sums(shape)[: len(shapes)] for shape in shapes]).T
    amounts = np.linalg.lstsq(matrix, (wanted - sums(found))[: len(shapes)], rcond=1e-9)[0]
    return np.asarray(found + np.tensordot(amounts, np.array(shapes), 1))


def _shared(layers: Array, weight: Array, window: int) -> Array:
    """Give what each cell carries to the cells about it in proportion to their weight; sums are kept.

    Parameters
    ----------
    layers : ndarray (n, rows, cols)
    weight : ndarray (rows, cols)
        Not negative, somewhere above 0.
    window : int
        Odd: side of the square [cells] over which a cell shares.

    Returns
    -------
    ndarray (n, rows, cols)
        Zero where the weight is. A combination of cells with weights that are not negative: what is nowhere larger in
        one layer than in another is not afterwards.
    """
    found, left = np.zeros_like(layers), layers
    while left.any():
        # A cell without any weight in reach, at the rim beside the outermost ridge, looks further.
        about = _blurred(weight, window)
        reach = about > 1e-9 * float(about.max())
        for layer, rest in zip(found, left, strict=True):
            layer += weight * _blurred(np.divide(rest, about, out=np.zeros_like(rest), where=reach), window)
        left, window = np.where(reach, 0.0, left), 3 * window
    return found


def _blurred(values: Array, window: int) -> Array:
    """Return the mean over a square of values that are 0 beyond their borders: symmetric in its two points."""
    border = window
    padded = cv2.copyMakeBorder(values, border, border, border, border, cv2.BORDER_CONSTANT, value=0.0)
    return np.asarray(cv2.blur(padded, (window, window))[border:-border, border:-border])
