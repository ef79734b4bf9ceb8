"""The author's thresholding chain: grey, blur, threshold, and the removal of small blobs.

The reference is the chain as scikit-image computes it, in double precision (`rgb2gray`, `gaussian`, strict ``>``,
`binary_dilation` with `disk(10)`, `label` with 8 neighbours). This module returns the same mask to the pixel, and takes
about a twentieth of the time:

* Grey levels are sums of whole numbers (2125 R + 7154 G + 721 B), which single precision holds exactly; blurring them
  in single precision is then off by less than :func:`rounding_margin`. Only pixels closer to the threshold than that
  can differ from double precision; they are done again in double precision, and those that even this leaves open,
  such as a flat patch exactly at the threshold, with scikit-image's own functions on whole rows.
* Dilation and labels are confined to the box around what was segmented.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.color import rgb2gray

from evanesce.errors import InputError

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

LUMA = (2125, 7154, 721)
"""Weights of R, G and B times 10000 (ITU-R BT.709 for CRT phosphors, as scikit-image has them)."""

LUMA_SCALE = 10_000 * 255
"""Weighted sum of a white pixel."""

TRUNCATE = 4.0
"""Reach of the Gaussian in standard deviations (SciPy's and scikit-image's default)."""

SINGLE_ROUNDING = 2.0**-24
"""Unit roundoff of IEEE single precision."""

DOUBLE_MARGIN = 1e-13
"""What double precision leaves undecided: two sums of at most 401 terms, up to 1, of unit roundoff 1.1e-16."""

MOST_WINDOWS = 4000
"""Undecided pixels up to which their surroundings are gathered one by one; whole rows are cheaper for more."""


@dataclass(frozen=True)
class Crop:
    """Rows ``r0:r1`` and columns ``c0:c1`` of an image, half-open as in Python; None is the image's end."""

    r0: int = 0
    r1: int | None = None
    c0: int = 0
    c1: int | None = None

    @classmethod
    def parse(cls, text: str) -> Crop:
        """Read ``"r0:r1,c0:c1"``; an end may be left empty.

        Raises
        ------
        InputError
            If the text has another form, or a range is empty.
        """
        allowed = "r0:r1,c0:c1 with whole numbers, 0 <= start < end"
        try:
            (r0, r1), (c0, c1) = (part.split(":") for part in text.split(","))
            crop = cls(_bound(r0) or 0, _bound(r1), _bound(c0) or 0, _bound(c1))
        except ValueError:
            raise InputError(f"{text!r} is no crop", key="--crop", allowed=allowed) from None
        if any(end is not None and end <= start for start, end in ((crop.r0, crop.r1), (crop.c0, crop.c1))):
            raise InputError(f"{text!r} is empty", key="--crop", allowed=allowed)
        return crop

    def apply(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return the view of an image.

        Raises
        ------
        InputError
            If the crop reaches beyond the image.
        """
        rows, cols = image.shape[:2]
        r1, c1 = rows if self.r1 is None else self.r1, cols if self.c1 is None else self.c1
        if not (0 <= self.r0 < r1 <= rows and 0 <= self.c0 < c1 <= cols):
            raise InputError(
                f"{self} does not fit the image of {rows} rows and {cols} columns",
                key="--crop",
                allowed=f"rows within 0:{rows}, columns within 0:{cols}",
            )
        return image[self.r0 : r1, self.c0 : c1]

    def __str__(self) -> str:
        return f"{self.r0}:{'' if self.r1 is None else self.r1},{self.c0}:{'' if self.c1 is None else self.c1}"


def _bound(text: str) -> int | None:
    text = text.strip()
    if text and not text.isdecimal():
        raise ValueError(text)
    return int(text) if text else None


@dataclass(frozen=True, kw_only=True)
class Chain:
    """Settings of the chain.

    Attributes
    ----------
    threshold : float
        Grey level, 0 to 1; brighter is contact (strict ``>``).
    min_blob : int
        Least size of a dilated blob that is kept [px].
    blur : float
        Standard deviation of the Gaussian [px]; 0 for none.
    radius : int
        Radius of the dilating disk [px].
    crop : Crop
    """

    threshold: float
    min_blob: int = 2000
    blur: float = 1.0
    radius: int = 10
    crop: Crop = Crop()

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("threshold", self.threshold, 0.0, 1.0),
            ("min-blob", self.min_blob, 0, 10**9),
            ("blur", self.blur, 0.0, 50.0),
            ("radius", self.radius, 0, 200),
        ):
            if not low <= value <= high:  # NaN fails as well
                raise InputError(f"{value}", key=f"--{name}", allowed=f"{low:g} to {high:g}")


@dataclass(frozen=True, kw_only=True)
class Segmentation:
    """Result of the chain on one frame.

    Attributes
    ----------
    mask : ndarray of bool (rows, cols)
        Contact in the cropped frame.
    dilated : ndarray of bool (rows, cols)
        The surviving dilated blobs, on which the author reads his "pressure".
    pixels : int
        Pixels of the mask.
    blobs, dropped_blobs : int
        Dilated blobs that survive, and those that are too small.
    grey_range : tuple of float
        Least and greatest blurred grey level of the crop, 0 to 1, to single precision.
    """

    mask: Mask
    dilated: Mask
    pixels: int
    blobs: int
    dropped_blobs: int
    grey_range: tuple[float, float]


def segment(image: Image, chain: Chain) -> Segmentation:
    """Segment one frame by the author's chain.

    Parameters
    ----------
    image : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        Grey or RGB frame [DN].
    chain : Chain

    Returns
    -------
    Segmentation
        Masks have the shape of the crop.

    Raises
    ------
    InputError
        If the image is not 8-bit grey or RGB, or the crop does not fit it.

    References
    ----------
    A. E. Macaulay, The Development of a New Synthetic Finger for Robotics Applications, University of Sheffield, 2024.
    S. van der Walt et al., scikit-image: image processing in Python, PeerJ 2:e453, 2014, doi:10.7717/peerj.453.
    """
    _check(image)
    view = chain.crop.apply(image)
    bright, grey_range = _brighter(view, chain.threshold, chain.blur)
    return _keep_large(bright, grey_range, chain)


def _check(image: Image) -> None:
    if image.dtype != np.uint8 or image.size == 0 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise InputError(f"an image of {image.dtype} and shape {image.shape}", allowed="8-bit grey or RGB")


def grey(image: Image) -> NDArray[np.float64]:
    """Return grey levels 0 to 1 in double precision, as scikit-image gives them.

    Parameters
    ----------
    image : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        Grey or RGB [DN].
    """
    if image.ndim == 3:
        return np.asarray(rgb2gray(image), dtype=np.float64)
    # a product with the rounded reciprocal, as img_as_float has it; a quotient would differ in the last bit
    return np.multiply(image, 1.0 / 255.0, dtype=np.float64)


def blurred_grey(image: Image, blur: float) -> NDArray[np.float64]:
    """Return :func:`grey` after a Gaussian of standard deviation ``blur`` [px], edges repeated."""
    return np.asarray(ndimage.gaussian_filter(grey(image), blur, mode="nearest", truncate=TRUNCATE))


@lru_cache(maxsize=16)
def _weights(blur: float) -> NDArray[np.float64]:
    """Return the Gaussian's taps, of sum 1."""
    if blur < 1e-15:  # SciPy leaves an axis alone below this
        return np.ones(1)
    reach = int(TRUNCATE * blur + 0.5)
    taps: NDArray[np.float64] = np.exp(-0.5 * (np.arange(-reach, reach + 1) / blur) ** 2)
    return taps / taps.sum()


def rounding_margin(taps: int) -> float:
    """Return the greatest error of a separable blur in single precision on grey levels 0 to 1.

    Parameters
    ----------
    taps : int
        Length of the kernel in each direction.

    Notes
    -----
    The weighted sum of n numbers in any order, with rounded weights, is off by at most (n + 1) u / (1 - (n + 1) u)
    times the sum of magnitudes (Higham 2002, section 3.1). The sums here are averages of values up to 1, in two passes;
    one more roundoff each goes to storing, to scaling and to a kernel sum that is not exactly 1.

    References
    ----------
    N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., SIAM, 2002.
    """
    steps = 2 * (taps + 3) * SINGLE_ROUNDING
    return steps / (1 - steps) + DOUBLE_MARGIN


def _brighter(view: Image, threshold: float, blur: float) -> tuple[Image, tuple[float, float]]:
    """Return where the blurred grey level exceeds the threshold (0 or 1) and the range of levels."""
    if view.ndim == 3:
        level = cv2.transform(view.astype(np.float32), np.array([LUMA], dtype=np.float32))
        scale = float(LUMA_SCALE)
    else:
        level, scale = view.astype(np.float32), 255.0
    weights = _weights(blur)
    if len(weights) > 1:
        level = cv2.sepFilter2D(level, cv2.CV_32F, weights, weights, borderType=cv2.BORDER_REPLICATE)
    low, high, _, _ = cv2.minMaxLoc(level)
    margin = rounding_margin(len(weights))
    # the limits are single precision, so each is moved outwards by its own rounding as well
    outwards = 1 + 2 * SINGLE_ROUNDING
    upper = np.float32((threshold + margin) * scale * outwards)
    lower = np.float32((threshold - margin) * scale)
    lower = np.float32(lower / outwards if lower > 0 else lower * outwards)
    bright = cv2.threshold(level, float(upper), 1, cv2.THRESH_BINARY)[1].astype(np.uint8)
    if high > lower and low < upper:
        near = cv2.inRange(level, float(lower), float(upper))
        undecided = cv2.countNonZero(near)
        if 0 < undecided <= MOST_WINDOWS:
            near = _decide_by_windows(view, threshold, weights, near, bright)
            undecided = cv2.countNonZero(near)
        if undecided:
            _decide_by_rows(view, threshold, blur, near, bright, reach=len(weights) // 2)
    return bright, (low / scale, high / scale)


def _decide_by_windows(
    view: Image, threshold: float, weights: NDArray[np.float64], near: Image, bright: Image
) -> Image:
    """Set undecided pixels of ``bright`` in place in double precision; return those that even this leaves open."""
    rows, cols = np.nonzero(near)
    reach = len(weights) // 2
    steps = np.arange(-reach, reach + 1)
    around_rows = np.clip(rows[:, None] + steps, 0, view.shape[0] - 1)  # edges repeated
    around_cols = np.clip(cols[:, None] + steps, 0, view.shape[1] - 1)
    windows = view[around_rows[:, :, None], around_cols[:, None, :]].astype(np.float64)
    if windows.ndim == 4:
        windows = windows @ np.array(LUMA, dtype=np.float64) / 10_000
    level = np.einsum("kij,i,j->k", windows, weights, weights, optimize=True) / 255
    bright[rows, cols] = level > threshold
    still = np.abs(level - threshold) <= DOUBLE_MARGIN
    left = np.zeros_like(near)
    left[rows[still], cols[still]] = 1
    return left


def _decide_by_rows(view: Image, threshold: float, blur: float, near: Image, bright: Image, *, reach: int) -> None:
    """Set undecided pixels of ``bright`` in place to the last bit, by the reference's own functions on whole rows.

    Whole rows, because the matrix product behind `rgb2gray` may round differently at another place of a row; a block
    with ``reach`` more rows on either side (or the image's edge) blurs to the very bits of the whole image.
    """
    rows = view.shape[0]
    for start, stop in _runs(np.flatnonzero(near.any(axis=1)), gap=2 * reach + 1):
        top, bottom = max(start - reach, 0), min(stop + reach, rows)
        exact = blurred_grey(view[top:bottom], blur)[start - top : stop - top]
        undecided = near[start:stop] != 0
        bright[start:stop][undecided] = exact[undecided] > threshold


def _runs(indices: NDArray[np.intp], gap: int) -> list[tuple[int, int]]:
    """Return half-open ranges that cover sorted indices, joined where they are no further apart than ``gap``."""
    if not len(indices):
        return []
    breaks = np.flatnonzero(np.diff(indices) > gap)
    starts = indices[np.r_[0, breaks + 1]]
    stops = indices[np.r_[breaks, len(indices) - 1]] + 1
    return list(zip(starts.tolist(), stops.tolist(), strict=True))


@lru_cache(maxsize=8)
def disk(radius: int) -> Image:
    """Return the digital disk: 1 where x^2 + y^2 <= radius^2, shape (2 radius + 1, 2 radius + 1)."""
    y, x = np.ogrid[-radius : radius + 1, -radius : radius + 1]
    return (x * x + y * y <= radius * radius).astype(np.uint8)


def _keep_large(bright: Image, grey_range: tuple[float, float], chain: Chain) -> Segmentation:
    """Drop what belongs to no dilated blob of ``min_blob`` pixels."""
    mask = np.zeros(bright.shape, dtype=np.uint8)
    dilated = np.zeros(bright.shape, dtype=np.uint8)
    x, y, width, height = cv2.boundingRect(bright)
    blobs = dropped = pixels = 0
    if width:
        # the box holds every dilated blob whole, so labels and sizes are those of the full frame
        r = slice(max(y - chain.radius, 0), y + height + chain.radius)
        c = slice(max(x - chain.radius, 0), x + width + chain.radius)
        box = np.ascontiguousarray(bright[r, c])
        grown = cv2.dilate(box, disk(chain.radius)) if chain.radius else box
        count, labels, stats, _ = cv2.connectedComponentsWithStats(grown, connectivity=8, ltype=cv2.CV_32S)
        large = stats[:, cv2.CC_STAT_AREA] >= chain.min_blob
        large[0] = False
        blobs = int(large.sum())
        dropped = count - 1 - blobs
        if dropped:
            grown = large.astype(np.uint8)[labels]
            box = cv2.bitwise_and(box, grown)
        mask[r, c] = box
        dilated[r, c] = grown
        pixels = cv2.countNonZero(box)
    return Segmentation(
        mask=mask.view(np.bool_),
        dilated=dilated.view(np.bool_),
        pixels=pixels,
        blobs=blobs,
        dropped_blobs=dropped,
        grey_range=grey_range,
    )
