"""Contact area against time by the reference segmentation, and the area of a pixel from a square card."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.core.states import Estimate, Frame
from evanesce.measurement.calibration.rectify import Rectification, rectify
from evanesce.measurement.reference.segment import Chain, Segmentation, segment
from evanesce.measurement.warnings import FrameFigures, Warning

ANISOTROPY = 0.02
"""Relative difference of a square's sides above which one area per pixel no longer describes the image."""

SQUARE_FILL = 0.93
"""Smallest share that a square fills of its own bounding rectangle."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Measurement of one frame.

    Attributes
    ----------
    estimate : Estimate
    segmentation : Segmentation
    view : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        The rectified, cropped frame that was segmented [DN].
    """

    estimate: Estimate
    segmentation: Segmentation
    view: NDArray[np.uint8]

    @property
    def figures(self) -> FrameFigures:
        """Figures of this frame for the warnings."""
        mask = self.segmentation.mask
        saturated = border = 0
        if self.segmentation.pixels:
            full = (self.view if self.view.ndim == 2 else self.view.max(axis=2)) == 255
            saturated = int(np.count_nonzero(full & mask))
            inner = np.count_nonzero(mask[1:-1, 1:-1]) if min(mask.shape) > 2 else 0
            border = self.segmentation.pixels - int(inner)
        return FrameFigures(
            index=self.estimate.index,
            pixels=self.segmentation.pixels,
            saturated_pixels=saturated,
            border_pixels=border,
            dropped_blobs=self.segmentation.dropped_blobs,
            grey_range=self.segmentation.grey_range,
        )


def measure_frame(frame: Frame, chain: Chain, mm2_per_px: float, rectified: Rectification | None = None) -> Measured:
    """Measure one frame: rectify, segment, count pixels times area per pixel.

    Parameters
    ----------
    frame : Frame
    chain : Chain
        Its crop counts in the rectified view.
    mm2_per_px : float
        Area of a pixel [mm^2].
    rectified : Rectification, optional
        None leaves the frame as it is.

    Returns
    -------
    Measured

    Raises
    ------
    InputError
        If the crop or the calibration does not fit the frame.
    """
    image = frame.data if rectified is None else rectify(frame.data, rectified)
    found = segment(image, chain)
    estimate = Estimate(
        mask=found.mask, pixels=found.pixels, area=found.pixels * mm2_per_px, time=frame.time, index=frame.index
    )
    return Measured(estimate=estimate, segmentation=found, view=chain.crop.apply(image))


@dataclass(frozen=True)
class AreaRow:
    """One line of an area-time table.

    Attributes
    ----------
    index : int
    time_s : float
        NaN where the frame rate is unknown.
    pixels : int
    area_mm2 : float
    blobs : int
        Dilated blobs that survived.
    area_low_mm2, area_high_mm2 : float
        95 % interval; NaN where none was asked for.
    corrected_mm2 : float
        Area less the known deviations of the budget, to which the interval belongs; NaN where none was asked for.
    reference_mm2 : float
        Area that the reference segmentation counts beside the refined estimator; NaN without it.
    """

    index: int
    time_s: float
    pixels: int
    area_mm2: float
    blobs: int
    area_low_mm2: float = math.nan
    area_high_mm2: float = math.nan
    corrected_mm2: float = math.nan
    reference_mm2: float = math.nan

    @property
    def outside(self) -> bool:
        """Whether the area lies outside the interval, which belongs to the corrected area."""
        return not math.isnan(self.area_low_mm2) and not self.area_low_mm2 <= self.area_mm2 <= self.area_high_mm2

    @classmethod
    def of(cls, measured: Measured, interval: tuple[float, float] = (math.nan, math.nan)) -> AreaRow:
        """Return the line of one frame, with the 95 % interval of its area [mm^2] if that is known.

        Parameters
        ----------
        measured : Measured
        interval : tuple of float
            95 % interval of the area [mm^2]; NaN where unknown.

        Returns
        -------
        AreaRow
        """
        e = measured.estimate
        return cls(e.index, e.time, e.pixels, e.area, measured.segmentation.blobs, *interval)


CSV_HEADER = "index,time_s,pixels_px,area_mm2,blobs,area_low_mm2,area_high_mm2,corrected_mm2,reference_mm2"


def to_csv(rows: Sequence[AreaRow]) -> str:
    """Return the table as CSV.

    Parameters
    ----------
    rows : sequence of AreaRow

    Returns
    -------
    str
        A field is empty where its value is unknown; numbers read back to the last bit.
    """
    lines = [CSV_HEADER]
    for row in rows:
        time, low, high, corrected, beside = (
            "" if math.isnan(value) else repr(float(value))
            for value in (row.time_s, row.area_low_mm2, row.area_high_mm2, row.corrected_mm2, row.reference_mm2)
        )
        counted = f"{row.pixels},{float(row.area_mm2)!r},{row.blobs}"
        lines.append(f"{row.index},{time},{counted},{low},{high},{corrected},{beside}")
    return "\n".join(lines) + "\n"


def to_plain(rows: Sequence[AreaRow]) -> list[dict[str, Any]]:
    """Return the table as JSON-able rows.

    Parameters
    ----------
    rows : sequence of AreaRow

    Returns
    -------
    list of dict
        index, time_s, pixels, area_mm2, blobs, area_low_mm2, area_high_mm2, and where they are known corrected_mm2
        and reference_mm2.
    """
    return [
        {
            "index": r.index,
            "time_s": r.time_s,
            "pixels": r.pixels,
            "area_mm2": r.area_mm2,
            "blobs": r.blobs,
            "area_low_mm2": r.area_low_mm2,
            "area_high_mm2": r.area_high_mm2,
        }
        | {
            name: value
            for name, value in (("corrected_mm2", r.corrected_mm2), ("reference_mm2", r.reference_mm2))
            if not math.isnan(value)
        }
        for r in rows
    ]


def summary(rows: Sequence[AreaRow]) -> dict[str, Any]:
    """Return count, duration [s] and the smallest, mean and greatest area [mm^2] with the frame of the greatest.

    Parameters
    ----------
    rows : sequence of AreaRow

    Returns
    -------
    dict
        Units in the keys.

    Raises
    ------
    ValueError
        If there are no rows.
    """
    if not rows:
        raise ValueError("summary of no frames")
    areas = np.array([row.area_mm2 for row in rows])
    peak = int(areas.argmax())
    return {
        "frames": len(rows),
        "frames_with_contact": int(np.count_nonzero(areas)),
        "duration_s": rows[-1].time_s - rows[0].time_s,
        "area_min_mm2": float(areas.min()),
        "area_mean_mm2": float(areas.mean()),
        "area_max_mm2": float(areas[peak]),
        "area_max_index": rows[peak].index,
    }


@dataclass(frozen=True, kw_only=True)
class SquareScale:
    """Area of a pixel, from a square of known side.

    Attributes
    ----------
    mm2_per_px : float
        side^2 / pixels [mm^2].
    pixels : int
    sides_px : tuple of float
        Longer and shorter side of the smallest rectangle around the square [px].
    rotation_deg : float
        Of that rectangle, -45 to 45.
    threshold : float
        Grey level that was used, 0 to 1.
    warnings : tuple of Warning
    """

    mm2_per_px: float
    pixels: int
    sides_px: tuple[float, float]
    rotation_deg: float
    threshold: float
    warnings: tuple[Warning, ...]


def square_scale(
    image: NDArray[np.uint8],
    side_mm: float,
    chain: Chain | None = None,
    *,
    square: Literal["white", "black"] = "white",
) -> SquareScale:
    """Measure the area of a pixel on a square card by the reference segmentation.

    The thesis calls its card a black square in one place and a white one in another, so both are taken: a black square
    is segmented on the negative, at the same grey level.

    Parameters
    ----------
    image : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        Rectified photograph of the card [DN].
    side_mm : float
        Side of the square [mm].
    chain : Chain, optional
        Settings; by default the threshold is half-way between the means of dark and bright pixels (split
        by Otsu's method), where a symmetric blur leaves a straight edge in place.
    square : {"white", "black"}
        Which of the two is the square.

    Returns
    -------
    SquareScale

    Raises
    ------
    InputError
        If not exactly one blob is found, if it touches the border or if it is not a square.

    References
    ----------
    N. Otsu, A threshold selection method from gray-level histograms, IEEE Trans. SMC 9(1), 62-66, 1979.
    """
    if not 0 < side_mm < math.inf:
        raise InputError(f"{side_mm}", key="square side", allowed="above 0 mm")
    if chain is None:
        chain = Chain(threshold=halfway_threshold(image))
    found = _segmented_square(image, chain, square)
    longer, shorter, angle = _smallest_rectangle(found.mask)
    fill = found.pixels / (longer * shorter)
    if fill < SQUARE_FILL or shorter / longer < 0.8:
        raise InputError(
            f"the blob is no square: {longer:.1f} x {shorter:.1f} px, {100 * fill:.1f} % filled",
            key="square card",
            allowed=f"sides within 20 %, at least {100 * SQUARE_FILL:g} % filled",
        )
    warnings = []
    apart = longer / shorter - 1
    if apart > ANISOTROPY:
        text = (
            f"the square's sides are {longer:.1f} and {shorter:.1f} px, {100 * apart:.1f} % apart: "
            "pixels are not square or the card is tilted"
        )
        warnings.append(Warning("anisotropic_scale", text))
    return SquareScale(
        mm2_per_px=side_mm**2 / found.pixels,
        pixels=found.pixels,
        sides_px=(longer, shorter),
        rotation_deg=(angle + 45) % 90 - 45,
        threshold=chain.threshold,
        warnings=tuple(warnings),
    )


def _segmented_square(image: NDArray[np.uint8], chain: Chain, square: Literal["white", "black"]) -> Segmentation:
    """Segment a square card, a black one on the negative; refuse anything but one whole blob."""
    positive = image if square == "white" else 255 - image
    level = chain.threshold if square == "white" else 1 - chain.threshold
    found = segment(positive, replace(chain, threshold=level))
    if found.blobs != 1:
        raise InputError(
            f"{found.blobs} {square} blobs of at least {chain.min_blob} px at threshold {chain.threshold:.4g}",
            key="square card",
            allowed="exactly one: crop to the square, or set the threshold",
        )
    if found.pixels - np.count_nonzero(found.mask[1:-1, 1:-1]):
        raise InputError("the square touches the border of the crop", key="square card", allowed="a whole square")
    return found


def halfway_threshold(image: NDArray[np.uint8]) -> float:
    """Return the threshold half-way between the means of dark and bright pixels, split by Otsu's method.

    Parameters
    ----------
    image : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        [DN].

    Returns
    -------
    float
        Grey level, 0 to 1.

    Raises
    ------
    InputError
        If all pixels are equal.
    """
    level = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    split, _ = cv2.threshold(level, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    bright = level > split
    if bright.all() or not bright.any():
        raise InputError(f"the image is flat at grey level {level.flat[0]}", key="square card", allowed="two levels")
    return float(level[bright].mean() + level[~bright].mean()) / 510


def _smallest_rectangle(mask: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return longer and shorter side [px] and angle [deg] of the smallest rectangle around the mask's pixels."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    _, sides, angle = cv2.minAreaRect(np.concatenate(contours))
    # centres of pixels span one pixel less than the pixels do
    return float(max(sides)) + 1, float(min(sides)) + 1, float(angle)
