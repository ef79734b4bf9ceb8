"""Boundary of narrow ridges and grooves: a sharp contact is drawn, blurred, and moved until it is the frame.

Half-way between the light on both sides is the boundary only where that light can be read beyond the reach of the blur.
Between ridges a few pixels wide it cannot: neighbouring edges overlap. There the blur is known instead, from the board.
A contact with a sharp edge, blurred, is proportional to the frame around each place, with the light of contact and
surroundings as the two coefficients of a straight line; where the frame is brighter than that line the boundary lies
farther out. The map of levels is raised by what is left over, its curve drawn and blurred again, until the area rests:
Van Cittert's iteration with the constraint that a pixel's contact is a share between 0 and 1.

References
----------
P. H. van Cittert, Zeitschrift fuer Physik 69, 298-308 (1931); P. A. Jansson (ed.), *Deconvolution of Images and
Spectra*, 2nd ed. (1997), chapter 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.measurement.refined.edge import Boundary, EdgeSettings, half_contours
from evanesce.measurement.refined.plate import shoelace
from evanesce.measurement.refined.replica import contact_share, edge_residual

Floats = NDArray[np.float64]

NARROW_SHARE = 0.05
"""Share of the boundary beside narrow parts from which it is found by synthesis."""

NEAR_PX = 12
"""Distance from the boundary within which the frame is compared [px]: beyond it only the contact's own light varies."""

WINDOW_PX = 12.0
"""Standard deviation of the window of the straight line [px]: some ridges wide, narrower than the light varies."""

BAND_PX = 2
"""Distance from the boundary within which it may move in one round [px]."""

MOST_MOVED = 0.3
"""Greatest change of a level in one round: noise and specks move it no farther."""

RESTS = 2e-4
"""Relative change of the area in one round from which it rests: a tenth of an area's standard uncertainty."""

ROUNDS = (4, 30)
"""Least and most rounds."""


@dataclass(frozen=True)
class Synthesis:
    """Boundary by synthesis.

    Attributes
    ----------
    boundary : Boundary
    rests : bool
        Whether the area came to rest: False where the blur hides the ridges.
    residual : float
        What the drawn contact leaves of the frame at its edge (:func:`.edge_residual`) [1].
    """

    boundary: Boundary
    rests: bool
    residual: float


def synthesised(light: Floats, boundary: Boundary, blur_px: float, settings: EdgeSettings) -> Synthesis:
    """Move a boundary until the blurred contact inside it is the frame.

    Parameters
    ----------
    light : ndarray (rows, cols)
        Linear; not saturated.
    boundary : Boundary
        Found in it, right to a pixel or two.
    blur_px : float
        Standard deviation of the camera's blur [px].
    settings : EdgeSettings
        By which it was found.

    Returns
    -------
    Synthesis
    """
    smooth = cv2.GaussianBlur(light, (0, 0), settings.smoothing_px)
    total = float(np.hypot(blur_px, settings.smoothing_px))
    inside = (boundary.level > 0.5).astype(np.uint8)
    reach = np.ones((3, 3), np.uint8)
    near = (cv2.dilate(inside, reach, iterations=NEAR_PX) > 0) & (cv2.erode(inside, reach, iterations=NEAR_PX) == 0)
    level, area, step, rests = boundary.level, _area(boundary.level), boundary.step, False
    blurred = left = np.zeros_like(level)
    for number in range(ROUNDS[1]):
        blurred = cv2.GaussianBlur(contact_share(level), (0, 0), total)
        outer, step = _line(smooth, blurred, near)
        left = (smooth - outer - step * blurred) / np.maximum(step, 1e-9)
        # the boundary moves, it does not jump: elsewhere noise would add up until a hole opens
        inside = (level > 0.5).astype(np.uint8)
        band = (cv2.dilate(inside, reach, iterations=BAND_PX) > 0) & (cv2.erode(inside, reach, iterations=BAND_PX) == 0)
        level = np.clip(np.where(band, level + np.clip(left, -MOST_MOVED, MOST_MOVED), level), -1.0, 2.0)
        before, area = area, _area(level)
        rests = abs(area - before) <= RESTS * before
        if rests and number + 1 >= ROUNDS[0]:
            break
    found = Boundary(contours=half_contours(level), level=np.asarray(level), step=step)
    return Synthesis(found, rests, edge_residual(blurred + left, blurred))


def _line(light: Floats, blurred: Floats, near: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Fit light = outer + step x blurred around each place; return both."""
    weight = near.astype(np.float64)

    def mean(values: Floats) -> Floats:
        return np.asarray(cv2.GaussianBlur(weight * values, (0, 0), WINDOW_PX))

    total = mean(np.ones_like(light)) + 1e-12
    b, y = mean(blurred) / total, mean(light) / total
    step = (mean(blurred * light) / total - b * y) / np.maximum(mean(blurred**2) / total - b**2, 1e-6)
    return np.asarray(y - step * b), np.asarray(step)


def _area(level: Floats) -> float:
    return abs(sum(shoelace(curve) for curve in half_contours(level)))
