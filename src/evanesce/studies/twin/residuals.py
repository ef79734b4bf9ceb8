"""Residuals of a twin against its photograph, on the blocks held out of every fit, sorted by cause."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.studies.twin.study import Twin

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ZONES_PX = (0.0, 300.0, 450.0, np.inf)
"""Distances from the middle of a frame of 1024 columns that bound the zones; scaled with the frame's width."""

EDGE_10_90 = 2.5631
"""Width of a Gaussian-blurred step from 10 to 90 % of its height, in standard deviations."""

DOT_600_DPI_UM = 25400.0 / 600.0

_SPECK_DN = 12.0
_REFLECTION_DN = 8.0
_SMOOTH_PX = 8.0


@dataclass(frozen=True)
class Zone:
    """One annulus around the middle of the frame, held-out blocks only.

    Attributes
    ----------
    inner_px, outer_px : float
    corners : int
    corner_rms_px : float
        Found minus predicted corners.
    edge_photo_px, edge_twin_px : float
        Median 10 to 90 % width of the edges at the corners.
    bright_photo, bright_twin, dark_photo, dark_twin : float
        Median levels beside the corners [DN].
    grey_rms : float
        Photograph minus twin [DN].
    """

    inner_px: float
    outer_px: float
    corners: int
    corner_rms_px: float
    edge_photo_px: float
    edge_twin_px: float
    bright_photo: float
    bright_twin: float
    dark_photo: float
    dark_twin: float
    grey_rms: float


@dataclass(frozen=True)
class Cause:
    """One kind of pixel, by what the twin lacks there.

    Attributes
    ----------
    name : str
    pixels : float
        Share of the held-out pixels.
    energy : float
        Share of the sum of squared differences.
    rms : float
        Of the difference among them [DN].
    """

    name: str
    pixels: float
    energy: float
    rms: float


@dataclass(frozen=True)
class TwinResiduals:
    """Figures of a twin.

    Attributes
    ----------
    corner_rms_px, corner_median_px : float
        Of the held-out corners.
    corner_rms_fitted_px : float
        Of the fitted ones.
    grey_rms, grey_median_abs, grey_rms_fitted : float
        Photograph minus noise-free twin: held-out blocks, the same as median of the absolute value, fitted blocks [DN].
    photo_deviation : float
        Standard deviation of the photograph's held-out pixels: what a twin of one even grey would miss by [DN].
    zones : list of Zone
    causes : list of Cause
        Specks, reflections, edges, even print; they add up to all.
    spacing_narrow_um, spacing_wide_um : float
        Mean width of the narrow and of the wide squares minus 1 mm [um].
    """

    corner_rms_px: float
    corner_median_px: float
    corner_rms_fitted_px: float
    grey_rms: float
    grey_median_abs: float
    grey_rms_fitted: float
    photo_deviation: float
    zones: list[Zone]
    causes: list[Cause]
    spacing_narrow_um: float
    spacing_wide_um: float


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def twin_residuals(twin: Twin) -> TwinResiduals:
    """Compare photograph and twin on the held-out blocks.

    Parameters
    ----------
    twin : Twin

    Returns
    -------
    TwinResiduals
    """
    difference = twin.photo - twin.mean
    miss = np.linalg.norm(twin.corner_miss, axis=1)
    unseen = twin.corners_held_out
    narrow, wide = spacing_levels(twin)
    return TwinResiduals(
        corner_rms_px=_rms(miss[unseen]),
        corner_median_px=float(np.median(miss[unseen])),
        corner_rms_fitted_px=_rms(miss[~unseen]),
        grey_rms=_rms(difference[twin.held_out]),
        grey_median_abs=float(np.median(np.abs(difference[twin.held_out]))),
        grey_rms_fitted=_rms(difference[twin.fitted]),
        photo_deviation=float(twin.photo[twin.held_out].std()),
        zones=_zones(twin, difference, miss),
        causes=causes(difference, twin.mean, twin.held_out),
        spacing_narrow_um=narrow,
        spacing_wide_um=wide,
    )


def spacings(twin: Twin) -> Array:
    """Return the width of every column and row of squares minus its nominal one [um], both axes together.

    Parameters
    ----------
    twin : Twin

    Returns
    -------
    ndarray (n,)
        [um].
    """
    return np.concatenate(twin.rig.board.lines.spacings_um)


def spacing_levels(twin: Twin) -> tuple[float, float]:
    """Return the means of the squares below and above nominal width [um].

    Parameters
    ----------
    twin : Twin

    Returns
    -------
    narrow, wide : float
        [um].
    """
    widths = spacings(twin)
    narrow, wide = widths[widths < 0], widths[widths >= 0]
    return (float(narrow.mean()) if narrow.size else np.nan), (float(wide.mean()) if wide.size else np.nan)


def radius(points: Array, shape: tuple[int, int]) -> Array:
    """Return the distance of points (n, 2) from the middle of the frame [px].

    Parameters
    ----------
    points : ndarray (n, 2)
        (x, y) [px].
    shape : tuple of int
        (rows, cols).

    Returns
    -------
    ndarray (n,)
        [px].
    """
    return np.asarray(np.hypot(points[:, 0] - (shape[1] - 1) / 2, points[:, 1] - (shape[0] - 1) / 2))


def edge_width(sigma: Array) -> Array:
    """Return the 10 to 90 % width [px] of blurs given across two edges (n, 2) [px].

    Parameters
    ----------
    sigma : ndarray (n, 2)
        Standard deviations [px].

    Returns
    -------
    ndarray (n,)
        [px].
    """
    return np.asarray(EDGE_10_90 * np.sqrt((sigma**2).mean(axis=1)))


def _zones(twin: Twin, difference: Array, miss: Array) -> list[Zone]:
    shape = twin.photo.shape
    rows, cols = np.indices(shape)
    pixel_radius = np.hypot(cols - (shape[1] - 1) / 2, rows - (shape[0] - 1) / 2)
    bounds = np.array(ZONES_PX) * shape[1] / 1024
    r = radius(twin.grid.fit.position, shape)
    found = []
    for low, high in pairwise(bounds):
        some = twin.corners_held_out & (r >= low) & (r < high)
        pixels = twin.held_out & (pixel_radius >= low) & (pixel_radius < high)
        if not some.any() or not pixels.any():
            continue
        real, own = twin.grid.fit, twin.own
        found.append(
            Zone(
                inner_px=float(low),
                outer_px=float(min(high, r.max())),
                corners=int(some.sum()),
                corner_rms_px=_rms(miss[some]),
                edge_photo_px=float(np.median(edge_width(real.sigma[some]))),
                edge_twin_px=float(np.median(edge_width(own.sigma[some]))),
                bright_photo=float(np.median((real.level + np.abs(real.contrast))[some])),
                bright_twin=float(np.median((own.level + np.abs(own.contrast))[some])),
                dark_photo=float(np.median((real.level - np.abs(real.contrast))[some])),
                dark_twin=float(np.median((own.level - np.abs(own.contrast))[some])),
                grey_rms=_rms(difference[pixels]),
            )
        )
    return found


def causes(difference: Array, mean: Array, held_out: Mask) -> list[Cause]:
    """Sort the held-out pixels by what the twin lacks there.

    A speck stands out of its surroundings by more than 12 DN and five deviations; a reflection is a patch whose mean
    over some ten pixels is off by more than 8 DN; an edge is where the twin itself changes by a third of its contrast
    within two pixels; the rest is even print.

    Parameters
    ----------
    difference : ndarray (rows, cols)
        Photograph minus twin [DN].
    mean : ndarray (rows, cols)
        Noise-free twin [DN].
    held_out : ndarray of bool (rows, cols)

    Returns
    -------
    list of Cause
    """
    local = ndimage.median_filter(difference, size=9, mode="nearest")
    high = difference - local
    reach = ndimage.maximum_filter(mean, size=5) - ndimage.minimum_filter(mean, size=5)
    contrast = float(np.percentile(mean[held_out], 90) - np.percentile(mean[held_out], 10))
    edge = reach > contrast / 3
    even = held_out & ~edge
    deviation = 1.4826 * float(np.median(np.abs(high[even]))) if even.any() else 0.0
    # beside an edge the difference is large and thin as well: there only what is brighter than either side is a speck
    bright = high > max(_SPECK_DN, 5 * deviation)
    speck = bright & ~edge
    speck |= bright & edge & ndimage.binary_dilation(speck, iterations=2)
    speck = ndimage.binary_dilation(speck, structure=np.ones((3, 3)))
    weight = ndimage.gaussian_filter((held_out & ~speck & ~edge).astype(np.float64), _SMOOTH_PX)
    total = ndimage.gaussian_filter(np.where(held_out & ~speck & ~edge, difference, 0.0), _SMOOTH_PX)
    smooth = np.divide(total, weight, out=np.zeros_like(total), where=weight > 0.02)
    reflection = np.abs(smooth) > _REFLECTION_DN

    kinds: list[tuple[str, Mask]] = []
    left = held_out.copy()
    for name, which in (("specks and scratches", speck), ("reflections, light", reflection), ("edges", edge)):
        kinds.append((name, left & which))
        left = left & ~which
    kinds.append(("even print, noise", left))
    squared = difference**2
    whole = max(float(squared[held_out].sum()), 1e-300)
    return [
        Cause(name, float(m.sum() / max(held_out.sum(), 1)), float(squared[m].sum() / whole), _rms(difference[m]))
        for name, m in kinds
    ]
