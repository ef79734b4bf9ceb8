"""What the search for a boundary does to a contact of the same shape whose edge is sharp.

Blur rounds the corners of a contact, fills narrow grooves and thins narrow ridges, and it widens an edge where that
edge is bent: a contact of many ridge ends looks as if a film of air lay beside it. Both depend on the frame's own
contact, blur and noise. So the boundary that was found is drawn again with a sharp edge, the frame's own envelopes,
blur and noise, and searched for again: what the second search loses of the first area, the first lost of the contact,
to first order; and the width of an edge that is left after the drawn one's is the film's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core import rng
from evanesce.measurement.refined.edge import (
    Boundary,
    EdgeSettings,
    edge_spread,
    edge_width,
    envelopes,
    find_boundary,
)
from evanesce.measurement.refined.plate import shoelace

Floats = NDArray[np.float64]

FINER = 4
"""Points a pixel's side at which the share of a pixel in contact is read from the map of levels."""

SMALLEST_PX = 0.3
"""Standard deviation of the least blur that is drawn [px]: a pixel's own square has 0.29."""

EDGE_PX = 2
"""Distance from the boundary within which a drawn edge is compared with the frame's [px]."""

DEEP_PX = 4
"""Distance from the boundary beyond which a frame shows its noise [px]."""


@dataclass(frozen=True)
class Replica:
    """Second search, on the drawn contact.

    Attributes
    ----------
    gain : float
        Area found over the area drawn, less one [1].
    spread_px : float
        Of the drawn contact's edge (:func:`.edge_spread`) [px].
    blur_px : float
        Standard deviation of the blur with which a drawn contact's edges show what the frame's do [px].
    residual : float
        How much more a contact drawn with a sharp edge leaves of the frame than of the replica, in quadrature [1].
    """

    gain: float
    spread_px: float
    blur_px: float
    residual: float


def replica(light: Floats, boundary: Boundary, settings: EdgeSettings) -> Replica | None:
    """Draw the contact that was found with a sharp edge and search for its boundary.

    Parameters
    ----------
    light : ndarray (rows, cols)
        Linear; not saturated.
    boundary : Boundary
        Found in it.
    settings : EdgeSettings
        By which it was found.

    Returns
    -------
    Replica, or None
        None where nothing is left of the contact.
    """
    smooth = np.asarray(cv2.GaussianBlur(light, (0, 0), settings.smoothing_px))
    inside = boundary.level > 0.5
    if not inside.any():
        return None
    inner, outer = envelopes(smooth, inside, settings)
    share = contact_share(boundary.level)
    blur = _drawn_blur(share, (inner, outer), edge_blur(boundary, settings), settings)
    drawn = outer + cv2.GaussianBlur(share * (inner - outer), (0, 0), blur)
    noise = np.where(inside, *(_noise(light - smooth, side, settings.smoothing_px) for side in (inside, ~inside)))
    drawn = drawn + noise * rng.generator(0, "replica").standard_normal(light.shape)
    found = find_boundary(drawn, share > 0.5, settings)
    before, after = (abs(sum(shoelace(curve) for curve in b.contours)) for b in (boundary, found))
    if not (before > 0 and after > 0):
        return None
    wide = float(np.hypot(blur, settings.smoothing_px))
    seen, own = (
        edge_residual(b.level, np.asarray(cv2.GaussianBlur(contact_share(b.level), (0, 0), wide)))
        for b in (boundary, found)
    )
    left = float(np.sqrt(max(seen**2 - own**2, 0.0)))
    return Replica(gain=after / before - 1.0, spread_px=edge_spread(found), blur_px=blur, residual=left)


def _drawn_blur(share: Floats, sides: tuple[Floats, Floats], shown: float, settings: EdgeSettings) -> float:
    """Return the blur with which a drawn contact's edges show a blur [px].

    Where the blur reaches as far as the envelopes are read, or ridges leave them no room, the step is read too small
    and the edge too steep. A contact drawn with the blur that is shown shows by how much.
    """
    inner, outer = sides
    drawn = outer + cv2.GaussianBlur(share * (inner - outer), (0, 0), shown)
    again = edge_blur(find_boundary(drawn, share > 0.5, replace(settings, rounds=1)), settings)
    return float(np.sqrt(max(2.0 * shown**2 - again**2, SMALLEST_PX**2)))


def edge_residual(level: Floats, blurred: Floats) -> float:
    """Return what a blurred sharp contact leaves of a map of levels within two pixels of its curve at one half.

    Parameters
    ----------
    level : ndarray (rows, cols)
        Light over its step, 0 to 1.
    blurred : ndarray (rows, cols)
        Share of contact, blurred.

    Returns
    -------
    float
        RMS [1].
    """
    inside, reach = (blurred > 0.5).astype(np.uint8), np.ones((3, 3), np.uint8)
    band = (cv2.dilate(inside, reach, iterations=EDGE_PX) > 0) & (cv2.erode(inside, reach, iterations=EDGE_PX) == 0)
    if not band.any():
        return 0.0
    return float(np.sqrt(np.mean(np.clip(level - blurred, -1.0, 1.0)[band] ** 2)))


def edge_blur(boundary: Boundary, settings: EdgeSettings) -> float:
    """Return the blur that the edges of a boundary show at their median [px].

    Parameters
    ----------
    boundary : Boundary
    settings : EdgeSettings
        By which it was found.

    Returns
    -------
    float
        Standard deviation [px].
    """
    # at its middle a step that a Gaussian blurred rises by 1/(sqrt(2 pi) sigma) a pixel; the pixel's square, and the
    # difference over two pixels by which the slope is read, widen it by 1/12 and 1/3 px^2
    total = edge_width(boundary) / np.sqrt(2.0 * np.pi)
    return float(np.sqrt(max(total**2 - settings.smoothing_px**2 - 1.0 / 12.0 - 1.0 / 3.0, SMALLEST_PX**2)))


def contact_share(level: Floats) -> Floats:
    """Return the share of each pixel on the bright side of a map's curve at one half.

    Parameters
    ----------
    level : ndarray (rows, cols)

    Returns
    -------
    ndarray (rows, cols)
        0 to 1.
    """
    rows, cols = level.shape
    large = cv2.resize(level, None, fx=FINER, fy=FINER, interpolation=cv2.INTER_LINEAR) > 0.5
    return np.asarray(large.reshape(rows, FINER, cols, FINER).mean(axis=(1, 3)))


def _noise(left: Floats, side: NDArray[np.bool_], smoothing_px: float) -> float:
    """Return the standard deviation of white noise, from what a Gaussian takes off it away from the boundary."""
    deep = cv2.erode(side.astype(np.uint8), np.ones((2 * DEEP_PX + 1, 2 * DEEP_PX + 1), np.uint8)) > 0
    if deep.sum() < 100:
        return 0.0
    kernel = cv2.getGaussianKernel(33, smoothing_px)
    taken = float(np.sqrt(1.0 - 2.0 * kernel.max() ** 2 + (kernel**2).sum() ** 2))
    # the median of magnitudes: specks of dust are no noise
    return 1.4826 * float(np.median(np.abs(left[deep]))) / taken
