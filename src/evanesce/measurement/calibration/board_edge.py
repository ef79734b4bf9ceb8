"""The camera's edge response, tails included, from the edges of a photographed board.

A Gaussian describes where most of the light goes. A lens near its diffraction limit also spreads some far out, so that
the foot of an edge is wider than its middle; of a saturated edge only the foot is visible.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from evanesce.measurement.calibration.corners import CornerGrid, grey

Floats = NDArray[np.float64]

REACH_PX, MIN_REACH_PX = 10.0, 5.0
MIN_REACH_BLURS = 3.5
"""Reach of the profile to both sides [px], and the smallest reach kept [px], [standard deviations]."""

STEP_PX = 0.25
END_PX = 2.0
"""Length at both ends of the profile whose mean counts as the dark and the bright level [px]."""

MIDDLE = (0.3, 0.7)
"""Part of an edge that is read, of its length: other edges cross at its ends."""

ROWS = 24
MIN_EDGES = 4


def edge_profile(image: NDArray[np.uint8], grid: CornerGrid) -> dict[str, float | list[float]] | None:
    """Return the median profile across the edges between neighbouring corners.

    Parameters
    ----------
    image : ndarray (rows, cols[, 3])
        [DN].
    grid : CornerGrid

    Returns
    -------
    dict or None
        ``first_px``, ``step_px``: the positions, from dark to bright. ``levels_DN``: the grey level at each.
        None where squares are too small or edges too few.
    """
    starts, ends = _edges(grid)
    if len(starts) < MIN_EDGES:
        return None
    lengths = np.linalg.norm(ends - starts, axis=1)
    reach = min(REACH_PX, 0.8 * MIDDLE[0] * float(np.median(lengths)))
    if reach < max(MIN_REACH_PX, MIN_REACH_BLURS * float(np.median(grid.fit.sigma))):
        return None
    count = int(reach / STEP_PX)
    positions: Floats = STEP_PX * np.arange(-count, count + 1, dtype=np.float64)
    spline = spline_filter(grey(image), order=3)
    shape = np.array(spline.shape[::-1])
    found = []
    for start, end in zip(starts, ends, strict=True):
        if (np.minimum(start, end) > reach + 2).all() and (np.maximum(start, end) < shape - reach - 3).all():
            profile = _profile(spline, start, end, positions)
            if profile is not None:
                found.append(profile)
    if len(found) < MIN_EDGES:
        return None
    levels = np.array(found)
    count = round(END_PX / STEP_PX)
    dark, bright = levels[:, :count].mean(axis=1), levels[:, -count:].mean(axis=1)
    share = np.median((levels - dark[:, None]) / (bright - dark)[:, None], axis=0)
    level = np.median(dark) + share * np.median(bright - dark)
    return {"first_px": float(positions[0]), "step_px": STEP_PX, "levels_DN": [round(float(v), 3) for v in level]}


def _edges(grid: CornerGrid) -> tuple[Floats, Floats]:
    """Return both ends of every edge between neighbouring corners, (n, 2) each [px]."""
    at = {(int(i), int(j)): k for k, (i, j) in enumerate(grid.index)}
    pairs = [(k, at[other]) for (i, j), k in at.items() for other in ((i + 1, j), (i, j + 1)) if other in at]
    first, second = np.array(pairs, np.int64).reshape(-1, 2).T
    return grid.fit.position[first], grid.fit.position[second]


def _profile(spline: Floats, start: Floats, end: Floats, positions: Floats) -> Floats | None:
    """Return the mean level across one edge, its bow removed; None where there is no step."""
    along = (end - start) / np.linalg.norm(end - start)
    across = np.array([-along[1], along[0]])
    rows: Floats = np.linspace(*MIDDLE, ROWS, dtype=np.float64)
    middle = start + rows[:, None] * (end - start)

    def sampled(bow: Floats) -> Floats:
        offsets = positions[None, :] + bow[:, None]
        points = middle[:, None, :] + offsets[..., None] * across
        return np.asarray(map_coordinates(spline, [points[..., 1], points[..., 0]], order=3, prefilter=False))

    levels = sampled(np.zeros(ROWS))
    count = round(END_PX / STEP_PX)
    low, high = float(levels[:, :count].mean()), float(levels[:, -count:].mean())
    if abs(high - low) < 8.0:
        return None
    if high < low:
        across = -across
        levels = levels[:, ::-1]
    inside = np.abs(positions) < MIN_REACH_PX
    # the integral under a step determines its position without a search for the crossing, and with less noise
    share = np.clip((levels - min(low, high)) / abs(high - low), 0.0, 1.0)[:, inside]
    crossing = STEP_PX * (0.5 * inside.sum() - share.sum(axis=1))
    bow: Floats = np.asarray(np.polyval(np.polyfit(rows, crossing, 2), rows), np.float64)
    if np.abs(bow).max() > MIN_REACH_PX / 2:
        return None
    return np.asarray(sampled(bow).mean(axis=0))
