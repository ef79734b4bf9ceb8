"""Reference segmentation of the thesis: grey level, Gaussian blur, threshold, and removal of small blobs.

The reference is the chain as scikit-image computes it, in double precision (`rgb2gray`, `gaussian`, strict ``>``,
`binary_dilation` with `disk(10)`, `label` with 8 neighbours). This module returns the same mask to the pixel, at a
small part of the cost:

* Grey levels are sums of whole numbers (2125 R + 7154 G + 721 B), which single precision holds exactly; blurring them
  in single precision is then off by less than :func:`rounding_margin`. Only pixels closer to the threshold than that
  can differ from double precision; they are done again in double precision, and those that even this leaves open,
  such as a flat patch exactly at the threshold, with scikit-image's own functions on whole rows.
* Rows are blurred and compared in strips that stay in the processor's cache, in as many threads as OpenCV may use
  (``cv2.setNumThreads``).
* Dilation and selection by size work on one bit per pixel and on runs of pixels
  (:mod:`evanesce.measurement.reference.blobs`).
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.color import rgb2gray

from evanesce.core.errors import InputError
from evanesce.measurement.reference.blobs import large_blobs

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Pixels = tuple[NDArray[np.intp], NDArray[np.intp]]

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

STRIP_PIXELS = 524_288
"""Pixels of a strip: two megabytes in single precision."""

THREAD_PIXELS = 1_000_000
"""Pixels of a frame for each thread: for fewer a thread is not worth its start."""

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
    """Settings of the reference segmentation.

    Attributes
    ----------
    threshold : float
        Grey level, 0 to 1; brighter is contact (strict ``>``).
    min_blob : int
        Minimum size of a dilated blob that is kept [px].
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
    """Result of the reference segmentation on one frame.

    Attributes
    ----------
    mask : ndarray of bool (rows, cols)
        Contact in the cropped frame.
    dilated : ndarray of bool (rows, cols)
        The surviving dilated blobs, on which the thesis reads its "pressure".
    pixels : int
        Pixels of the mask.
    blobs, dropped_blobs : int
        Number of dilated blobs that survive, and of those that are too small.
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
    """Segment one frame by the reference segmentation of the thesis.

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
    blobs = large_blobs(bright, chain.radius, chain.min_blob)
    mask = bright & blobs.dilated if blobs.dropped else bright
    return Segmentation(
        mask=mask,
        dilated=blobs.dilated,
        pixels=int(np.count_nonzero(mask)),
        blobs=blobs.kept,
        dropped_blobs=blobs.dropped,
        grey_range=grey_range,
    )


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


def _brighter(view: Image, threshold: float, blur: float) -> tuple[Mask, tuple[float, float]]:
    """Return where the blurred grey level exceeds the threshold, and the range of blurred levels."""
    weights = _weights(blur)
    rows, cols = view.shape[:2]
    bright = np.empty((rows, cols), dtype=np.bool_)
    threads = max(min(cv2.getNumThreads(), rows * cols // THREAD_PIXELS, rows), 1)
    ends = [rows * k // threads for k in range(threads + 1)]

    def compare(part: int) -> tuple[float, float, NDArray[np.intp]]:
        return _compare_rows(view, threshold, weights, range(ends[part], ends[part + 1]), bright)

    with ThreadPoolExecutor(threads) as pool:  # starts a thread only for what is submitted
        others = [pool.submit(compare, part) for part in range(1, threads)]
        found = [compare(0), *(other.result() for other in others)]
    undecided = np.concatenate([at for _, _, at in found])
    if len(undecided):
        pixels = np.divmod(undecided, cols)
        if len(undecided) <= MOST_WINDOWS:
            pixels = _decide_by_windows(view, threshold, weights, pixels, bright)
        _decide_by_rows(view, threshold, blur, pixels, bright)
    return bright, (min(least for least, _, _ in found), max(greatest for _, greatest, _ in found))


def _compare_rows(
    view: Image, threshold: float, weights: NDArray[np.float64], rows: range, bright: Mask
) -> tuple[float, float, NDArray[np.intp]]:
    """Set rows of ``bright`` in place; return least and greatest level and the flat indices of undecided pixels."""
    scale = float(LUMA_SCALE) if view.ndim == 3 else 255.0
    margin = rounding_margin(len(weights))
    # the limits are single precision themselves, so each is moved outwards by its own rounding as well
    lower = np.nextafter(np.float32((threshold - margin) * scale), np.float32(-np.inf))
    upper = np.nextafter(np.float32((threshold + margin) * scale), np.float32(np.inf))
    extremes: list[float] = []
    undecided: list[NDArray[np.intp]] = []
    for start, level in _single_precision_levels(view, weights, rows):
        above = np.greater(level, upper, out=bright[start : start + len(level)])
        undecided.append(np.flatnonzero(np.not_equal(level >= lower, above)) + start * view.shape[1])
        extremes += (extreme / scale for extreme in cv2.minMaxLoc(level)[:2])
    return min(extremes), max(extremes), np.concatenate(undecided)


def _single_precision_levels(
    view: Image, weights: NDArray[np.float64], rows: range
) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Yield the blurred levels of some rows, strip by strip, each with its first row; the next overwrites the last.

    Levels are weighted sums of R, G and B (up to :data:`LUMA_SCALE`), or grey levels as they are (up to 255). A strip
    with the rows around it that its blur needs stays in the processor's cache, and so do its arrays, used again.
    """
    reach = len(weights) // 2
    height = max(STRIP_PIXELS // view.shape[1], 4 * reach, 1)
    most = min(height + 2 * reach, view.shape[0])
    colour = np.empty((most, *view.shape[1:]), dtype=np.float32) if view.ndim == 3 else None
    levels = np.empty((most, view.shape[1]), dtype=np.float32)
    blurred = np.empty_like(levels)
    for start in range(rows.start, rows.stop, height):
        stop = min(start + height, rows.stop)
        top, bottom = max(start - reach, 0), min(stop + reach, view.shape[0])
        n = bottom - top
        strip: NDArray[Any] = view[top:bottom]
        if colour is not None:
            np.copyto(colour[:n], strip)
            strip = cv2.transform(colour[:n], np.array([LUMA], dtype=np.float32), levels[:n])
        cv2.sepFilter2D(strip, cv2.CV_32F, weights, weights, blurred[:n], borderType=cv2.BORDER_REPLICATE)
        yield start, blurred[start - top : stop - top]


def _decide_by_windows(
    view: Image, threshold: float, weights: NDArray[np.float64], pixels: Pixels, bright: Mask
) -> Pixels:
    """Set pixels of ``bright`` in place in double precision; return those that even this leaves undecided."""
    rows, cols = pixels
    reach = len(weights) // 2
    steps = np.arange(-reach, reach + 1)
    around_rows = np.clip(rows[:, None] + steps, 0, view.shape[0] - 1)  # edges repeated
    around_cols = np.clip(cols[:, None] + steps, 0, view.shape[1] - 1)
    windows = view[around_rows[:, :, None], around_cols[:, None, :]].astype(np.float64)
    if windows.ndim == 4:
        windows = windows.reshape(-1, 3) @ np.array(LUMA, dtype=np.float64) / 10_000
    level = (windows.reshape(-1, len(weights)) @ weights).reshape(-1, len(weights)) @ weights / 255
    bright[rows, cols] = level > threshold
    still = np.abs(level - threshold) <= DOUBLE_MARGIN
    return rows[still], cols[still]


def _decide_by_rows(view: Image, threshold: float, blur: float, pixels: Pixels, bright: Mask) -> None:
    """Set pixels of ``bright`` in place to the last bit, by the reference's own functions on whole rows.

    Whole rows, because the matrix product behind `rgb2gray` may round differently at another place of a row; a block
    with the blur's reach of rows on either side (or the image's edge) blurs to the very bits of the whole image.
    """
    rows, cols = pixels  # in the order of rows
    reach = len(_weights(blur)) // 2
    for start, stop in _runs(np.unique(rows), gap=2 * reach + 1):
        top, bottom = max(start - reach, 0), min(stop + reach, view.shape[0])
        exact = blurred_grey(view[top:bottom], blur)
        some = slice(*np.searchsorted(rows, [start, stop]))
        bright[rows[some], cols[some]] = exact[rows[some] - top, cols[some]] > threshold


def _runs(indices: NDArray[np.intp], gap: int) -> list[tuple[int, int]]:
    """Return half-open ranges that cover sorted indices, joined where they are no further apart than ``gap``."""
    if not len(indices):
        return []
    breaks = np.flatnonzero(np.diff(indices) > gap)
    starts = indices[np.r_[0, breaks + 1]]
    stops = indices[np.r_[breaks, len(indices) - 1]] + 1
    return list(zip(starts.tolist(), stops.tolist(), strict=True))
