"""A moving contact as a camera sees it whose rows are exposed one after another, each for some time.

To first order in the time off the frame's middle: the contact's outline moves and grows as it does at that moment, and
the skin slips on at its velocity, so that ridges stay where they stick however fast the outline moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState

Floats = NDArray[np.float64]

MAX_MOMENTS = 8
"""Maximum number of moments of an exposure."""


@dataclass(frozen=True)
class Motion:
    """Motion of a contact's outline.

    Attributes
    ----------
    centre : tuple of float
        Middle (x, y) at the frame's time [mm].
    velocity : tuple of float
        Of the middle [mm/s].
    growth_per_s : float
        Of lengths about it [1/s].
    """

    centre: tuple[float, float]
    velocity: tuple[float, float]
    growth_per_s: float


def advanced(state: ContactState, motion: Motion, late_s: Floats | float) -> ContactState:
    """Return a smooth finger's contact with each cell at its own time.

    Parameters
    ----------
    state : ContactState
        At the frame's time.
    motion : Motion
    late_s : ndarray (rows, cols) or float
        Time of each cell after the frame's [s].

    Returns
    -------
    ContactState
        Every field moves with the outline; slip gains its velocity's share. Stated numbers stay those of the frame.
    """
    grid = state.grid
    late = np.broadcast_to(np.asarray(late_s, dtype=float), grid.shape)
    scale = 1.0 / np.clip(1.0 + motion.growth_per_s * late, 0.5, 2.0)
    (x0, y0), (vx, vy) = motion.centre, motion.velocity
    x = x0 + (grid.x[None, :] - x0 - vx * late) * scale
    y = y0 + (grid.y[:, None] - y0 - vy * late) * scale
    row, col = (index.astype(np.float32) for index in grid.index(x, y))

    def moved(values: Any, how: int = cv2.INTER_LINEAR) -> NDArray[Any]:
        array = np.asarray(values)
        if array.ndim == 3:
            return np.stack([moved(part, how) for part in array])
        return np.asarray(cv2.remap(array, col, row, how, borderMode=cv2.BORDER_REPLICATE))

    names = ("pressure", "gap", "contact_mask", "traction", "strength", "slip", "slip_velocity")
    found: dict[str, Any] = {name: moved(getattr(state, name)) for name in names if getattr(state, name) is not None}
    if state.state is not None:
        found["state"] = moved(state.state, cv2.INTER_NEAREST)
    if state.slip is not None and state.slip_velocity is not None:
        found["slip"] = found["slip"] + found["slip_velocity"] * late
    return replace(state, **found)


def smeared(
    middle: ContactState, state_at: Callable[[Floats], ContactState], late_s: Floats, exposure_s: float, way_mm: float,
    pixel_mm: float,
) -> ContactState:  # fmt: skip
    """Return the mean of a contact over the exposure of each row.

    Parameters
    ----------
    middle : ContactState
        At the middle of the exposure.
    state_at : callable
        ``state_at(late_s) -> ContactState``, of which the outline counts.
    late_s : ndarray (rows, cols)
        Middle of each cell's exposure after the frame's time [s].
    exposure_s : float
        [s].
    way_mm : float
        Longest way of outline or skin within the exposure [mm]; one moment for each pixel of it is taken.
    pixel_mm : float
        Side of a pixel on the plate [mm].

    Returns
    -------
    ContactState
        Coverage is the share of the exposure in contact, the gap the mean while there is one.
    """
    count = min(max(math.ceil(way_mm / pixel_mm), 1), MAX_MOMENTS)
    offsets = ((np.arange(count) + 0.5) / count - 0.5) * exposure_s
    if count == 1:
        return middle
    states = [middle if offset == 0.0 else state_at(late_s + offset) for offset in offsets]
    covers = np.stack([np.asarray(s.contact_mask, dtype=float) for s in states])
    gaps = np.stack([np.asarray(s.gap, dtype=float) for s in states])
    mask, bare = covers.mean(axis=0), (1.0 - covers).mean(axis=0)
    gap = np.divide((gaps * (1.0 - covers)).mean(axis=0), bare, out=np.zeros_like(mask), where=bare > 0)
    changes: dict[str, Any] = {"contact_mask": mask, "gap": gap}
    if states[0].real_contact_fraction is not None:
        real = np.stack([np.asarray(s.real_contact_fraction, dtype=float) for s in states])
        changes["real_contact_fraction"] = np.divide(
            (real * covers).mean(axis=0), mask, out=np.zeros_like(mask), where=mask > 0
        )
    return replace(middle, **changes)
