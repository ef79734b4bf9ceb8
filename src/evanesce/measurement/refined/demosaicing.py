"""Where demosaicing moves an edge whose light passes the end of a channel's range.

Between its own pixels a channel is the mean of its neighbours. Where some of them are full the mean is less than the
channel would be at the mean light, since clipping bends downwards: the level is read too low there. Where this happens
near half the contact's light the boundary moves inwards, by up to 0.25 px of red or blue and 0.18 px of green. How far
follows from the camera model alone: an edge is drawn through a mosaic, demosaiced, and read.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from evanesce.measurement.refined.colour import CameraModel

Floats = NDArray[np.float64]

REACH_PX, STEP_PX = 8.0, 0.1
"""Distances from the edge that are drawn, and their step [px]."""

TURNS = (0.0, math.pi / 8, math.pi / 4)
"""Directions of the edge against the rows; the others are their mirror images [rad]."""

EXACT = ((0, 0),)
ACROSS, ALONG = ((0, 1), (0, -1)), ((1, 0), (-1, 0))
CROSS = (*ACROSS, *ALONG)
CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
SITES = (
    (EXACT, CROSS, CORNERS),
    (ACROSS, EXACT, ALONG),
    (ALONG, EXACT, ACROSS),
    (CORNERS, CROSS, EXACT),
)
"""Pixels (row, column) of which red, green and blue are the mean at each of a mosaic's four places, bilinearly."""


def demosaicing_shift(camera: CameraModel, contact: float, ground: float, blur_px: float) -> float:
    """Return how far outside a straight edge the half-way point of the level lies that its demosaiced colours show.

    Parameters
    ----------
    camera : CameraModel
    contact, ground : float
        Levels on the two sides of the edge, as read, in the unit of the camera's.
    blur_px : float
        Standard deviation of the lens's blur [px].

    Returns
    -------
    float
        [px]; 0 where nothing is brighter on one side, or the mosaic's values are not known.
    """
    if not contact > ground or camera.balanced is None or camera.matrix is None:
        return 0.0
    distance = np.arange(-REACH_PX, REACH_PX + STEP_PX, STEP_PX)
    linear = np.empty((len(TURNS), len(SITES), len(distance), 3))
    for place in np.ndindex(linear.shape[:2]):
        turn, site = TURNS[place[0]], SITES[place[1]]
        for channel, pixels in enumerate(site):
            offsets = np.array([row * math.sin(turn) + column * math.cos(turn) for row, column in pixels])
            light = ground + (contact - ground) * ndtr(-(distance[:, None] + offsets) / blur_px)
            linear[*place, :, channel] = np.interp(light, camera.levels, camera.balanced[:, channel]).mean(axis=1)
    colours = np.rint(np.interp(np.clip(linear @ camera.matrix.T, 0.0, 1.0), camera.tone, np.arange(256.0))).astype(
        np.uint8
    )
    level = camera.read(colours.reshape(1, -1, 3))[0].reshape(linear.shape[:3]).mean(axis=(0, 1))
    half = 0.5 * (level[0] + level[-1])
    # the area under the profile's passage of one half: steps of 8 bits make single crossings
    inside = np.clip((level - half) / (0.2 * (level[0] - level[-1])), -0.5, 0.5) + 0.5
    return float(inside.sum() * STEP_PX - REACH_PX - 0.5 * STEP_PX)
