"""A sampled contact stretched or shortened in its plane, its force and its area kept to what they should be."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from evanesce.core.states import ContactState, FloatMap

Array = NDArray[np.float64]


def reshaped_state(
    state: ContactState, along: float, across: float, direction: float, pivot: tuple[float, float]
) -> ContactState:
    """Stretch a contact about a point: every point moves to pivot + R diag(along, across) R^T (point - pivot).

    Parameters
    ----------
    state : ContactState
        Of a smooth finger: ridges would be stretched with their contact.
    along, across : float
        Factors along and across ``direction`` [1], positive.
    direction : float
        [rad], from x towards y.
    pivot : tuple of float
        Plate point (x, y) that stays [mm].

    Returns
    -------
    ContactState
        Its area is ``along * across`` times as large, its forces are the same, stresses the less. Fields are
        interpolated linearly; at the grid's border they go on as they end.
    """
    grid, change = state.grid, along * across
    x, y = grid.x[None, :] - pivot[0], grid.y[:, None] - pivot[1]
    cos, sin = math.cos(direction), math.sin(direction)
    u, v = (x * cos + y * sin) / along, (y * cos - x * sin) / across
    rows, cols = (
        index.astype(np.float32) for index in grid.index(pivot[0] + u * cos - v * sin, pivot[1] + u * sin + v * cos)
    )

    def moved(field: FloatMap) -> Array:
        # In single precision OpenCV interpolates exactly; in double, by steps of a thirty-second of a cell.
        flat = np.asarray(field, dtype=np.float32).reshape(-1, *grid.shape)
        found = [cv2.remap(part, cols, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for part in flat]
        return np.stack(found).reshape(field.shape).astype(float)

    def optional(field: FloatMap | None, factor: float = 1.0) -> Array | None:
        return None if field is None else moved(field) / factor

    labels = None
    if state.state is not None:
        labels = cv2.remap(state.state, cols, rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    pressure = moved(state.pressure) / change
    carried = float(pressure.sum()) * grid.pitch**2
    before = float(np.asarray(state.pressure, dtype=float).sum()) * grid.pitch**2
    if carried > 0 and before > 0:
        pressure *= before / carried
    area = change * state.nominal_contact_area
    mask = moved(state.contact_mask)
    return replace(
        state,
        pressure=pressure,
        gap=moved(state.gap),
        contact_mask=mask_with_sum(mask, mask, area / grid.pitch**2),
        nominal_contact_area=area,
        traction=optional(state.traction, change),
        strength=optional(state.strength, change),
        slip=optional(state.slip),
        slip_velocity=optional(state.slip_velocity),
        state=labels,
        wetted=optional(state.wetted),
        real_contact_fraction=optional(state.real_contact_fraction),
    )


def contact_centre(state: ContactState) -> tuple[float, float]:
    """Return the centroid (x, y) of nominal contact [mm]; of the smallest gap where nothing touches.

    Parameters
    ----------
    state : ContactState

    Returns
    -------
    tuple of float
        [mm].
    """
    mask, grid = np.asarray(state.contact_mask, dtype=float), state.grid
    total = float(mask.sum())
    if total == 0.0:
        row, col = np.unravel_index(int(np.argmin(state.gap)), grid.shape)
        return float(grid.x[col]), float(grid.y[row])
    return float(mask.sum(axis=0) @ grid.x) / total, float(mask.sum(axis=1) @ grid.y) / total


def mask_with_sum(mask: Array, before: Array, wanted: float) -> Array:
    """Return a mask within 0 to 1 whose sum is ``wanted`` [cells]: its border's cells take one common offset.

    Two masks place a border within its cells by different rules, so that their difference on top of a third spills
    over 0 and 1; what is cut off there would be missing in the area.

    Parameters
    ----------
    mask : ndarray (rows, cols)
        Share of each cell in contact, which may leave 0 to 1.
    before : ndarray (rows, cols)
        The mask before its change.
    wanted : float
        [cells].

    Returns
    -------
    ndarray (rows, cols)
    """
    border = ((mask != before) | ((mask > 0) & (mask < 1))) & ((mask > 0) | (before > 0))
    place, whole = mask[border], float(np.count_nonzero(mask[~border] >= 1.0))
    clipped = np.clip(mask, 0.0, 1.0)
    if place.size == 0 or not 0.0 < wanted - whole < place.size:
        return clipped
    reach = 1.0 + float(np.abs(place).max())
    offset = brentq(lambda shift: np.clip(place + shift, 0.0, 1.0).sum() - (wanted - whole), -reach, reach)
    clipped[border] = np.clip(place + offset, 0.0, 1.0)
    return clipped
