"""Specks beside the contact: left out of it, and out of the light beside it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.measurement.refined.plate import PlateMap

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SPECK_RIM_PX = 5
"""Reach of the blur around a speck that is left out [px]."""


def without_specks(
    mask: Mask, plate: PlateMap, min_area_mm2: float, reach_px: int, origin: tuple[int, int]
) -> tuple[Mask, int]:
    """Drop islands below a minimum area.

    Islands whose dilations touch count together: the end of a ridge beside a contact is no speck.

    Parameters
    ----------
    mask : ndarray of bool (rows, cols)
    plate : PlateMap
    min_area_mm2 : float
        [mm^2].
    reach_px : int
        Radius of the dilating disk [px].
    origin : tuple of int
        Row and column of the mask in the frame as taken.

    Returns
    -------
    kept : ndarray of bool (rows, cols)
    dropped : int
        Number of islands that were dropped.
    """
    apart = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    labels, count = ndimage.label(apart <= reach_px, np.ones((3, 3)))
    if not count:
        return mask, 0
    labels = np.where(mask, labels, 0)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    middles = np.array(ndimage.center_of_mass(mask, labels, np.arange(1, count + 1)))[:, ::-1] + origin[::-1]
    keep = sizes * plate.pixel_area(middles) >= min_area_mm2
    return np.asarray(np.concatenate([[False], keep])[labels]), int((~keep).sum())


def filled(light: Floats, specks: Mask) -> Floats:
    """Return light whose specks, each with the reach of its blur, hold what is around them.

    Parameters
    ----------
    light : ndarray (rows, cols)
    specks : ndarray of bool (rows, cols)

    Returns
    -------
    ndarray (rows, cols)
    """
    size = 2 * SPECK_RIM_PX + 1
    bad = cv2.dilate(specks.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    weight = cv2.GaussianBlur((~bad).astype(np.float64), (0, 0), 2.0 * SPECK_RIM_PX)
    around = cv2.GaussianBlur(np.where(bad, 0.0, light), (0, 0), 2.0 * SPECK_RIM_PX) / np.maximum(weight, 1e-6)
    return np.where(bad & (weight > 1e-3), around, light)
