"""Compare a measurement with the truth: area error, overlap of the masks, displacement of the boundary."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from skimage.measure import find_contours

from evanesce.evaluation.labels import FrameLabels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PERCENTILES = (5, 50, 95)


@dataclass(frozen=True, kw_only=True)
class Displacement:
    """Displacement of the measured boundary from the true one; positive outside it. NaN where there is none.

    Attributes
    ----------
    mean, rms : float
    percentile_5, percentile_50, percentile_95 : float
    points : int
        Boundary points of the estimate.
    """

    mean: float
    rms: float
    percentile_5: float
    percentile_50: float
    percentile_95: float
    points: int

    @classmethod
    def of(cls, values: Array) -> Displacement:
        """Summarise signed displacements.

        Parameters
        ----------
        values : ndarray (n,)
            Signed displacements.

        Returns
        -------
        Displacement
        """
        if values.size == 0:
            nan = float("nan")
            return cls(mean=nan, rms=nan, percentile_5=nan, percentile_50=nan, percentile_95=nan, points=0)
        low, middle, high = np.percentile(values, PERCENTILES)
        return cls(
            mean=float(values.mean()),
            rms=float(np.sqrt((values**2).mean())),
            percentile_5=float(low),
            percentile_50=float(middle),
            percentile_95=float(high),
            points=values.size,
        )


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Estimate against truth for one frame.

    Attributes
    ----------
    area_mm2, true_area_mm2 : float
        [mm^2].
    error_mm2, error_percent : float
        Estimate minus truth; percent of the truth, NaN where the truth is zero.
    iou : float
        Intersection over union of the masks; 1 where both are empty.
    displacement_px, displacement_mm : Displacement
        In pixels of the view and, by the local scale, on the plate.
    """

    area_mm2: float
    true_area_mm2: float
    error_mm2: float
    error_percent: float
    iou: float
    displacement_px: Displacement
    displacement_mm: Displacement

    def as_dict(self) -> dict[str, Any]:
        """Return plain data.

        Returns
        -------
        dict
            Units in the keys.
        """
        return asdict(self)


def compare(mask: Mask, area_mm2: float, labels: FrameLabels) -> Comparison:
    """Compare an estimate with the truth of its frame.

    Parameters
    ----------
    mask : ndarray of bool (rows, cols)
        Segmented contact, in the view of ``labels``.
    area_mm2 : float
        The measurement's own area [mm^2].
    labels : FrameLabels

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError
        If mask and labels are of different views.
    """
    if mask.shape != labels.mask.shape:
        raise ValueError(f"the mask has shape {mask.shape}, the labels {labels.mask.shape}")
    error = area_mm2 - labels.area
    pixels, scale = boundary_displacement(mask, labels.mask, labels.pixel_area)
    return Comparison(
        area_mm2=area_mm2,
        true_area_mm2=labels.area,
        error_mm2=error,
        error_percent=100.0 * error / labels.area if labels.area > 0 else float("nan"),
        iou=overlap(mask, labels.mask >= 0.5),
        displacement_px=Displacement.of(pixels),
        displacement_mm=Displacement.of(pixels * scale),
    )


def overlap(estimate: Mask, truth: Mask) -> float:
    """Return the intersection over union of two masks.

    Parameters
    ----------
    estimate, truth : ndarray of bool (rows, cols)

    Returns
    -------
    float
        1 where both masks are empty.
    """
    union = int((estimate | truth).sum())
    return int((estimate & truth).sum()) / union if union else 1.0


def boundary_displacement(mask: Mask, coverage: NDArray[Any], pixel_area: Array) -> tuple[Array, Array]:
    """Return the signed distance of each boundary point of a mask from the true boundary.

    Parameters
    ----------
    mask : ndarray of bool (rows, cols)
        Estimate; its boundary runs midway between pixels in and out.
    coverage : ndarray (rows, cols)
        True share of contact; its boundary is the contour at one half.
    pixel_area : ndarray (rows, cols)
        [mm^2].

    Returns
    -------
    displacement : ndarray (n,)
        [px], positive outside the true contact; empty where either has no boundary.
    scale : ndarray (n,)
        Local size of a pixel [mm].

    Notes
    -----
    Every estimate point counts, so a spurious blob shows in the upper percentiles; a part of the contact that was
    missed altogether shows in the overlap only. Points on the view's own border are left out: the crop made them.
    """
    found = mask | (coverage > 0)
    if not found.any():
        return np.empty(0), np.empty(0)
    rows, cols = np.flatnonzero(found.any(axis=1)), np.flatnonzero(found.any(axis=0))
    window = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    corner = np.array([rows[0], cols[0]])
    shares = np.pad(np.asarray(coverage[window], float), 1)
    points = _contours(np.pad(mask[window].astype(float), 1))
    truth = _contours(shares)
    if not points or not truth:
        return np.empty(0), np.empty(0)
    estimate = np.concatenate([contour[:-1] for contour in points])
    at = estimate - 1 + corner  # in the view's own pixels
    last = np.array(mask.shape) - 1
    estimate = estimate[np.all((at >= 0) & (at <= last), axis=1)]
    distance = _distance_to(truth, estimate)
    outside = map_coordinates(shares, estimate.T, order=1) < 0.5
    at = np.rint(estimate - 1 + corner).astype(int)
    return np.where(outside, distance, -distance), np.sqrt(pixel_area[at[:, 0], at[:, 1]])


def _contours(padded: Array) -> list[Array]:
    """Return closed contours at one half, as (row, col); the padding closes those that meet the border."""
    return [contour for contour in find_contours(padded, 0.5) if len(contour) > 2]


def _distance_to(contours: list[Array], points: Array) -> Array:
    """Return the distance of points from polygons: the nearest vertex, then the two edges that meet there."""
    vertices = np.concatenate([contour[:-1] for contour in contours])
    before = np.concatenate([np.roll(contour[:-1], 1, axis=0) for contour in contours])
    after = np.concatenate([np.roll(contour[:-1], -1, axis=0) for contour in contours])
    _, nearest = cKDTree(vertices).query(points)
    edges = (_from_edge(points, vertices[nearest], other[nearest]) for other in (before, after))
    return np.minimum(*edges)


def _from_edge(points: Array, a: Array, b: Array) -> Array:
    along = b - a
    length2 = np.maximum((along**2).sum(axis=1), 1e-30)
    part = np.clip(((points - a) * along).sum(axis=1) / length2, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - a - part[:, None] * along, axis=1))
