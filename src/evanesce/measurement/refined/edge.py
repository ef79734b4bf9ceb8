"""The boundary of contact to a fraction of a pixel, by a threshold that follows the light on either side of it.

A symmetric blur leaves a step in place where it passes half-way between what lies on its two sides. So the threshold at
each place is the mean of two envelopes: the light inside the contact and the light outside it, each read beyond the
blur and carried to the boundary by a straight line in the distance from it. Scattered light in a
groove or around a contact belongs to the outer envelope and is not counted; uneven illumination belongs to both.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.measure import find_contours

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

CLEAR_SHARE = 0.01
"""Share of the pixels around a place that must lie beyond the blur's reach for an envelope there."""

FLATTEST = 0.02
"""Slope [1/px] below which an edge is no edge."""


@dataclass(frozen=True, kw_only=True)
class EdgeSettings:
    """Settings of the search for the boundary.

    Attributes
    ----------
    smoothing_px : float
        Standard deviation of a Gaussian against noise [px]; it leaves a straight edge in place.
    near_px, far_px : float
        Distances from the boundary between which the envelopes are read [px]; nearer, light is blurred across it.
    window_px : float
        Standard deviation of the window of an envelope along the boundary [px].
    rounds : int
        Number of times that threshold and boundary are found in turn.
    """

    smoothing_px: float = 0.7
    near_px: float = 4.0
    far_px: float = 16.0
    window_px: float = 7.0
    rounds: int = 4


@dataclass(frozen=True, kw_only=True)
class Boundary:
    """Boundary of contact in one frame.

    Attributes
    ----------
    contours : list of ndarray (n, 2)
        Closed curves, (x, y) [px]; holes run the other way round.
    level : ndarray (rows, cols)
        Light over its step: 0 at the outer, 1 at the inner envelope.
    step : ndarray (rows, cols)
        Inner less outer envelope, in units of light.
    """

    contours: list[Floats]
    level: Floats
    step: Floats


def envelopes(light: Floats, mask: Mask, settings: EdgeSettings) -> tuple[Floats, Floats]:
    """Extrapolate inner and outer light to the boundary of a mask.

    Parameters
    ----------
    light : ndarray (rows, cols)
    mask : ndarray of bool (rows, cols)
    settings : EdgeSettings

    Returns
    -------
    inner, outer : ndarray (rows, cols)
    """
    inner, outer = (_carried(light, _distance(side), settings) for side in (mask, ~mask))
    return inner, outer


def _distance(side: Mask) -> Floats:
    """Return the distance of a side's pixels from its border, which runs half a pixel before the first of them [px]."""
    found = cv2.distanceTransform(side.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(found, np.float64) - 0.5


def _carried(light: Floats, distance: Floats, settings: EdgeSettings) -> Floats:
    """Fit light = a + b distance by weights around each pixel and return a."""
    # A narrow ridge or groove has no pixel beyond the blur's reach; there the farthest ones count, with a small weight.
    weight = np.where(distance > 0, 1e-6 * np.clip(distance, 0, settings.near_px) ** 6, 0.0)
    weight = np.where((distance >= settings.near_px) & (distance <= settings.far_px), 1.0, weight)
    weight[distance > settings.far_px] = 0.0

    def around(values: Floats) -> Floats:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), settings.window_px, borderType=cv2.BORDER_REFLECT))

    total = around(weight) + 1e-12
    d1, d2 = around(weight * distance) / total, around(weight * distance**2) / total
    l1, ld = around(weight * light) / total, around(weight * light * distance) / total
    slope = (ld - d1 * l1) / (d2 - d1**2 + 1.0)  # one pixel squared holds the slope where distances hardly differ
    return np.asarray(l1 - slope * d1)


def coarse_mask(light: Floats, min_step: float, *, pixels: int = 1000) -> Mask | None:
    """Segment contact half-way between the background and the plateau of the light; None where there is no contact.

    Parameters
    ----------
    light : ndarray (rows, cols)
    min_step : float
        Light over the background below which there is no contact.
    pixels : int
        Contact covers at least so many pixels; what is brighter and smaller is a speck.

    Returns
    -------
    ndarray of bool (rows, cols), or None
    """
    smooth = cv2.GaussianBlur(light, (0, 0), 2.0)
    base = float(np.median(smooth))
    count = min(pixels, smooth.size)
    top = float(np.partition(smooth, smooth.size - count, axis=None)[smooth.size - count])
    if not top - base > min_step:
        return None
    # the brightest thousand pixels may be a crest in the light: the median of what is bright is the plateau
    plateau = float(np.median(smooth[smooth > 0.5 * (base + top)]))
    return np.asarray(smooth > 0.5 * (base + plateau))


def find_boundary(light: Floats, mask: Mask, settings: EdgeSettings | None = None) -> Boundary:
    """Find the boundary near that of a first mask.

    Parameters
    ----------
    light : ndarray (rows, cols)
        Linear; not saturated.
    mask : ndarray of bool (rows, cols)
        First guess, right to some pixels.
    settings : EdgeSettings, optional

    Returns
    -------
    Boundary
    """
    settings = settings or EdgeSettings()
    smooth = np.asarray(cv2.GaussianBlur(light, (0, 0), settings.smoothing_px))
    reach = np.ones((3, 3), np.uint8)
    for _ in range(settings.rounds):
        inner, outer = envelopes(smooth, mask, settings)
        step = inner - outer
        level = (smooth - outer) / np.maximum(step, 1e-9)
        # Beyond the envelopes' own reach nothing may appear: the boundary moves, it does not jump.
        near = cv2.dilate(mask.astype(np.uint8), reach, iterations=3) > 0
        deep = cv2.erode(mask.astype(np.uint8), reach, iterations=3) > 0
        level = np.where(deep, np.maximum(level, 1.0), np.where(near, level, np.minimum(level, 0.0)))
        mask = level > 0.5
    return Boundary(contours=half_contours(level), level=level, step=step)


def edge_spread(boundary: Boundary) -> float:
    """Return how much wider the edge is on average along its curves than at its median [px].

    A blur is the same all along; what widens the edge locally is a film of air that opens slowly beside the contact.
    An edge's width is one over the slope of its level.

    Parameters
    ----------
    boundary : Boundary

    Returns
    -------
    float
        [px].
    """
    width, length = _widths(boundary)
    if not len(width):
        return 0.0
    return float(((width - np.median(width)) * length).sum() / length.sum())


def edge_width(boundary: Boundary) -> float:
    """Return the median width of the edge along its curves: one over the slope of its level [px].

    Parameters
    ----------
    boundary : Boundary

    Returns
    -------
    float
        [px]; 0 without a curve.
    """
    width, _ = _widths(boundary)
    return float(np.median(width)) if len(width) else 0.0


def _widths(boundary: Boundary) -> tuple[Floats, Floats]:
    """Return width of the edge and length of each piece of its curves [px]."""
    slope = np.hypot(*np.gradient(boundary.level))
    widths, lengths = [np.zeros(0)], [np.zeros(0)]
    for curve in boundary.contours:
        middle = 0.5 * (curve[1:] + curve[:-1])
        found = ndimage.map_coordinates(slope, [middle[:, 1], middle[:, 0]], order=1)
        widths.append(1.0 / np.maximum(found, FLATTEST))
        lengths.append(np.linalg.norm(np.diff(curve, axis=0), axis=1))
    return np.concatenate(widths), np.concatenate(lengths)


def narrow_share(boundary: Boundary, settings: EdgeSettings) -> float:
    """Return the share of a boundary that has no pixel beyond the blur's reach on one of its sides.

    Parameters
    ----------
    boundary : Boundary
    settings : EdgeSettings
        By which it was found.

    Returns
    -------
    float
        0 to 1.
    """
    inside = boundary.level > 0.5
    seen, near = np.ones(inside.shape, np.bool_), np.zeros(inside.shape, np.bool_)
    for side in (inside, ~inside):
        distance = _distance(side)
        clear = ((distance >= settings.near_px) & (distance <= settings.far_px)).astype(np.float32)
        seen &= cv2.GaussianBlur(clear, (0, 0), settings.window_px) > CLEAR_SHARE
        near |= (distance > 0) & (distance < 1)
    return float((near & ~seen).sum() / max(int(near.sum()), 1))


def half_contours(level: Floats) -> list[Floats]:
    """Return the closed curves (x, y) where a map passes one half [px]; they close along the map's border.

    Parameters
    ----------
    level : ndarray (rows, cols)

    Returns
    -------
    list of ndarray (n, 2)
        (x, y) [px].
    """
    found = find_contours(np.pad(level, 1, constant_values=0.0), 0.5)
    return [(contour - 1)[:, ::-1] for contour in found if len(contour) > 3]
