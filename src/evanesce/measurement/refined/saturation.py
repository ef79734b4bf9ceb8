"""Edge of a saturated contact, from the foot of the blurred step that is not saturated.

The foot of a blurred step, light against distance, has its own length for each height of the step. So the part of it
below full scale determines how high the step is and how far inside the half-way point lies.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares, minimize_scalar

from evanesce.measurement.refined.blur import Blur
from evanesce.measurement.refined.edge import Boundary, EdgeSettings, envelopes, half_contours
from evanesce.measurement.refined.subsurface import Scattering, spread

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACH_PX = 6.0
REACH_BLURS = 5.0
"""How far out the foot is read, in standard deviations of the blur, but at least ``REACH_PX``."""

FOOT_ALLOWS = 1.7
"""A blur is excluded whose residual is so many times the smallest: on ellipses 1.3 to 4 times above full scale, blurred
by 1.1 to 3 px, the true blur's is at most 1.4 times the smallest."""

CLEAR_PX = 0.25
"""Where reading the foot begins [px]. Nearer to the curve noise saturates some pixels at a distance and not others:
reading there made contacts 3 and 4 times above full scale 0.8 and 1.3 % too large."""

BIN_PX = 0.25
MIN_IN_BIN = 10
BESIDE_PX = 40.0
WIDEST_RIM_PX = 30.0


def contact_edge(light: Floats, boundary: Boundary, settings: EdgeSettings) -> tuple[Floats, Floats] | None:
    """Return the profile across an unsaturated contact's edge: positions from dark to bright [px], share of step [1].

    It holds the camera's blur and the film of air beside the contact, through which some light passes as well.

    Parameters
    ----------
    light : ndarray (rows, cols)
    boundary : Boundary
    settings : EdgeSettings
        By which it was found.

    Returns
    -------
    tuple of ndarray (n,), or None
        None where the edge is too short for a profile.
    """
    inner, outer = envelopes(light, boundary.level > 0.5, settings)
    place = -_outside(boundary.level)
    near = (np.abs(place) < REACH_PX) & (inner - outer > 0)
    edges = np.arange(-REACH_PX, REACH_PX + BIN_PX / 2, BIN_PX)
    number = np.digitize(place[near], edges)
    if np.bincount(number, minlength=len(edges) + 1)[1 : len(edges)].min() < MIN_IN_BIN:
        return None
    share = ((light - outer) / np.where(inner > outer, inner - outer, 1.0))[near]
    profile = np.asarray(ndimage.median(share, number, np.arange(1, len(edges))))
    return 0.5 * (edges[1:] + edges[:-1]), np.clip(np.maximum.accumulate(profile), 0.0, None)


def shift_of_edge(
    light: Floats, full: Mask, boundary: Boundary, level: float, blur: Blur, widths_px: Sequence[float]
) -> Floats:
    """Return the distance from a curve of fixed light to the half-way point of its step [px], positive inwards.

    One row per width: the distance, and the RMS residual of the foot [of full scale].

    Parameters
    ----------
    light : ndarray (rows, cols)
        Linear, of full scale.
    full : ndarray of bool (rows, cols)
        Saturated pixels.
    boundary : Boundary
        At the fixed level: its map is 0.5 there.
    level : float
        That level, of full scale.
    blur : Blur
        Of the camera; its width determines how far out the foot is read.
    widths_px : sequence of float
        Standard deviations tried for it [px].

    Returns
    -------
    ndarray (n, 2)
    """
    distance = _outside(boundary.level)
    reach = max(REACH_PX, REACH_BLURS * min(blur.px, 10.0))
    foot = (distance > CLEAR_PX) & (distance < reach) & ~full & (light < 1.1 * level)
    edges = np.arange(0.0, reach + BIN_PX / 2, BIN_PX)
    number = np.digitize(distance[foot], edges)
    count = np.bincount(number, minlength=len(edges))[1 : len(edges)]
    good = count > 0
    if good.sum() < 4:
        return np.zeros((len(widths_px), 2))
    middle = (0.5 * (edges[1:] + edges[:-1]))[good]
    profile = ndimage.mean(light[foot], number, np.arange(1, len(edges))[good])
    return np.array([_shift(middle, np.asarray(profile), level, blur, width) for width in widths_px])


def edge_uncertainty(tried: Floats) -> float:
    """Return how far the half-way point may lie from the first blur's [px], over the blurs that the foot allows.

    Parameters
    ----------
    tried : ndarray (n, 2)
        Of :func:`shift_of_edge`.

    Returns
    -------
    float
        [px].
    """
    shifts, residuals = tried.T
    allowed = residuals <= FOOT_ALLOWS * residuals.min()
    return float(np.abs(shifts[allowed] - shifts[0]).max())


def _shift(middle: Floats, profile: Floats, level: float, blur: Blur, width_px: float) -> tuple[float, float]:
    """Fit the foot of a blurred step of unknown height and position; return position [px] inwards, and residual."""

    def residual(x: Floats) -> Floats:
        # x0 height, x1 shift, x2 light far outside; its own level is not used: smoothing moved it
        return np.asarray(x[0] * blur.edge(middle + x[1], width_px) + x[2] - profile)

    start = [1.5, float(np.clip(width_px * (0.5 - level / 1.5), -1.0, 1.0)), 0.0]
    solved = least_squares(residual, start, bounds=([level, -4.0, -0.2], [50.0, 6.0, 0.2]))
    return float(solved.x[1]), float(np.sqrt(np.mean(solved.fun**2)))


def contact_within(light: Floats, full: Mask, scattering: Scattering, blur_px: float) -> Boundary:
    """Return the contact inside a saturated part that explains the scattered light around that part.

    The contact is taken as the saturated part less a rim of one width, evenly lit; width and strength are those that
    fit the light beside it best. The curve is the contact's own: to look for an edge in light that is half measured,
    half modelled would find the seam of the two as well.

    Parameters
    ----------
    light : ndarray (rows, cols)
    full : ndarray of bool (rows, cols)
        Saturated pixels.
    scattering : Scattering
    blur_px : float
        Standard deviation of the camera's blur [px].

    Returns
    -------
    Boundary
    """
    depth = _outside(np.where(full, 1.0, 0.0))
    beside = (depth > 0.5) & (depth < BESIDE_PX)

    def model(rim: float) -> tuple[float, Floats]:
        made = spread(np.clip(0.5 - depth - rim, 0.0, 1.0), scattering, blur_px)
        return float((made[beside] * light[beside]).sum() / max(float((made[beside] ** 2).sum()), 1e-12)), made

    def misfit(rim: float) -> float:
        strength, made = model(rim)
        return float(np.mean((strength * made[beside] - light[beside]) ** 2))

    widest = float(-depth.min())
    # the contact is brighter than half of its step, so that where the step is over twice full scale it is saturated
    found = minimize_scalar(misfit, bounds=(0.0, max(min(WIDEST_RIM_PX, 0.8 * widest), 1.0)), method="bounded",
                            options={"xatol": 0.05})  # fmt: skip
    rim = float(found.x)
    level = np.clip(0.5 - depth - rim, 0.0, 1.0)
    strength, _ = model(rim)
    return Boundary(contours=half_contours(level), level=level, step=np.full(light.shape, strength))


def filled_by(light: Floats, full: Mask, mask: Mask, scattering: Scattering, blur_px: float) -> Floats:
    """Return light whose saturated part is replaced by that of a contact, its strength fitted to the light beside it.

    Parameters
    ----------
    light : ndarray (rows, cols)
        Linear, of full scale.
    full : ndarray of bool (rows, cols)
        Saturated pixels.
    mask : ndarray of bool (rows, cols)
        Contact.
    scattering : Scattering
    blur_px : float
        Standard deviation of the camera's blur [px].

    Returns
    -------
    ndarray (rows, cols)
    """
    beside = (cv2.dilate(full.astype(np.uint8), np.ones((41, 41), np.uint8)) > 0) & ~full
    model = spread(mask.astype(float), scattering, blur_px)
    strength = float((model[beside] * light[beside]).sum() / max(float((model[beside] ** 2).sum()), 1e-12))
    return np.where(full, np.maximum(strength * model, light), light)


def lies_within(mask: Mask, full: Mask) -> bool:
    """Return whether most of a contact's boundary lies where the frame is saturated.

    Parameters
    ----------
    mask : ndarray of bool (rows, cols)
        Contact.
    full : ndarray of bool (rows, cols)
        Saturated pixels.

    Returns
    -------
    bool
    """
    shape = np.ones((3, 3), np.uint8)
    rim = mask & ~(cv2.erode(mask.astype(np.uint8), shape) > 0)
    return bool((rim & full).sum() > 0.5 * rim.sum())


def _outside(level: Floats) -> Floats:
    """Return the distance of each pixel outside a map's curve at one half [px], negative inside."""
    # distances to pixels would be whole; on a map enlarged fourfold they are known to an eighth of a pixel
    factor = 4
    large = cv2.resize(level, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
    inside = (large > 0.5).astype(np.uint8)
    out = cv2.distanceTransform(1 - inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    into = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    signed = np.where(inside > 0, 0.5 - into, out - 0.5) / factor
    rows, cols = level.shape
    at = factor * np.arange(max(rows, cols)) + (factor - 1) / 2
    x, y = np.meshgrid(at[:cols], at[:rows])
    return np.asarray(
        cv2.remap(signed.astype(np.float32), x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    )
