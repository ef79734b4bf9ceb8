"""Areas, histogram and profile of a measured frame against its ground truth. Arrays and floats only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.measurement.reference.segment import LUMA, LUMA_SCALE, TRUNCATE, Segmentation

Image = NDArray[np.uint8]
Grey = NDArray[np.float32]
Mask = NDArray[np.bool_]

LEVELS = 128
"""Classes of the histogram."""


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Figures of one frame against its ground truth.

    Attributes
    ----------
    true_mm2 : float
        Exact nominal contact area [mm^2].
    area_mm2 : float
        Measured: pixels times area of a pixel [mm^2].
    agree_mm2, missed_mm2, false_mm2 : float
        Areas of true positives, false negatives and false positives [mm^2], counted in pixels: true positives and false
        negatives add up to ``true_mm2`` except at the rim.
    overlap : float
        Intersection over union of mask and truth [1].
    pixels, blobs, dropped_blobs : int
    brightest_DN : int
    saturated_percent : float
        Of the mask's pixels that are at 255 DN [%].
    mm2_per_px : float
        [mm^2].
    """

    true_mm2: float
    area_mm2: float
    agree_mm2: float
    missed_mm2: float
    false_mm2: float
    overlap: float
    pixels: int
    blobs: int
    dropped_blobs: int
    brightest_DN: int
    saturated_percent: float
    mm2_per_px: float

    @property
    def error_mm2(self) -> float:
        """Measured less true area [mm^2]."""
        return self.area_mm2 - self.true_mm2

    @property
    def error_percent(self) -> float:
        """Relative error of the area [%]; NaN without contact."""
        return 100.0 * self.error_mm2 / self.true_mm2 if self.true_mm2 > 0 else float("nan")


def figures_of(found: Segmentation, in_contact: Mask, view: Image, true_mm2: float, mm2_per_px: float) -> Figures:
    """Return the figures of one segmented view.

    Parameters
    ----------
    found : Segmentation
    in_contact : ndarray of bool (rows, cols)
        Pixels of which at least half is in contact.
    view : ndarray of uint8 (rows, cols)
        The segmented image [DN].
    true_mm2, mm2_per_px : float
        Exact contact area and area of a pixel [mm^2].
    """
    agree = int(np.count_nonzero(found.mask & in_contact))
    true = int(np.count_nonzero(in_contact))
    brightest = int(view.max())
    full = int(np.count_nonzero(view[found.mask] == 255)) if brightest == 255 else 0
    union = true + found.pixels - agree
    return Figures(
        true_mm2=true_mm2,
        area_mm2=found.pixels * mm2_per_px,
        agree_mm2=agree * mm2_per_px,
        missed_mm2=(true - agree) * mm2_per_px,
        false_mm2=(found.pixels - agree) * mm2_per_px,
        overlap=agree / union if union else 1.0,
        pixels=found.pixels,
        blobs=found.blobs,
        dropped_blobs=found.dropped_blobs,
        brightest_DN=brightest,
        saturated_percent=100.0 * full / found.pixels if found.pixels else 0.0,
        mm2_per_px=mm2_per_px,
    )


def single_grey(image: Image, blur: float) -> Grey:
    """Return grey levels 0 to 1 after the segmentation's blur, in single precision: for display, not for segmentation.

    Parameters
    ----------
    image : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        [DN].
    blur : float
        Standard deviation [px].
    """
    level = image.astype(np.float32)
    if image.ndim == 3:
        level = cv2.transform(level, np.array([LUMA], np.float32)) / np.float32(LUMA_SCALE / 255)
    reach = int(TRUNCATE * blur + 0.5)
    if reach:
        side = 2 * reach + 1
        level = cv2.GaussianBlur(level, (side, side), blur, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(level * np.float32(1 / 255), np.float32)


@dataclass(frozen=True)
class Histogram:
    """Histogram of grey levels after the segmentation's blur.

    Attributes
    ----------
    inside, outside : ndarray of int (LEVELS,)
        Pixels in true contact, and the others; without ground truth all are outside.
    """

    inside: NDArray[np.int64]
    outside: NDArray[np.int64]


def histogram_of(grey: Grey, in_contact: Mask | None = None) -> Histogram:
    """Count pixels in equal classes of grey level from 0 to 1; the last includes 1."""
    classes = np.minimum(grey * np.float32(LEVELS), np.float32(LEVELS - 1)).astype(np.uint8)

    def count(mask: Image | None) -> NDArray[np.int64]:
        return np.asarray(cv2.calcHist([classes], [0], mask, [LEVELS], [0, LEVELS]), np.int64).ravel()

    every = count(None)
    inside = np.zeros_like(every) if in_contact is None else count(in_contact.view(np.uint8))
    return Histogram(inside, every - inside)


@dataclass(frozen=True)
class Profile:
    """Grey level along a line of the view.

    Attributes
    ----------
    along : {"x", "y"}
    position_mm : ndarray (n,)
        Distance from the finger's tip [mm].
    grey, share : ndarray (n,)
        Level after the segmentation's blur, and true share in contact, 0 to 1.
    line_px : int
        Row (along x) or column (along y) of the view.
    """

    along: Literal["x", "y"]
    position_mm: NDArray[np.float64]
    grey: Grey
    share: Grey
    line_px: int


def profile_of(
    grey: Grey, truth: Grey, tip: tuple[float, float], mm_per_px: float, along: Literal["x", "y"], line_mm: float
) -> Profile:
    """Read a row or a column of the view.

    Parameters
    ----------
    grey, truth : ndarray (rows, cols)
        Level after blur and true share in contact, 0 to 1.
    tip : tuple of float
        (row, col) of the finger's tip.
    mm_per_px : float
        [mm].
    along : {"x", "y"}
        A row, or a column.
    line_mm : float
        Its distance from the tip [mm]; beyond the view's border its outermost line is read.
    """
    across, start = (0, tip[1]) if along == "x" else (1, tip[0])
    line = int(np.clip(round(tip[across] + line_mm / mm_per_px), 0, grey.shape[across] - 1))
    part = np.s_[line, :] if along == "x" else np.s_[:, line]
    position = (np.arange(grey.shape[1 - across], dtype=np.float64) - start) * mm_per_px
    return Profile(along, position, grey[part].copy(), truth[part].copy(), line)
