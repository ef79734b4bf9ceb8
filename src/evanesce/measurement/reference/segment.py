"""The author's thresholding chain: grey, blur, threshold, and the removal of small blobs.

The reference is the chain as scikit-image computes it, in double precision (`rgb2gray`, `gaussian`, strict ``>``,
`binary_dilation` with `disk(10)`, `label` with 8 neighbours). This module returns the same mask to the pixel, and takes
about a twentieth of the time:

* Grey levels are sums of whole numbers (2125 R + 7154 G + 721 B), which single precision holds exactly; blurring them
  in single precision is then off by less than :func:`rounding_margin`. Only pixels closer to the threshold than that
  can differ from double precision; they are done again in double precision, and those that even this leaves open,
  such as a flat patch exactly at the threshold, with scikit-image's own functions on whole rows.
* Dilation and labels are confined to boxes around groups of bright pixels that cannot touch once dilated; a group whose
  box is smaller than the least blob needs neither.
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

from evanesce.core.errors import InputError

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

STRIP_PIXELS = 131_072
"""Pixels of a strip: half a megabyte in single precision."""

BLOCK = 8
"""Side of the blocks in which bright pixels are grouped [px]: a word of eight bytes."""

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
        Dilated blobs that survive, and those that are too small (specks close together may count as one).
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
    """Segment one frame by the reference segmentation.

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
    """Return where the blurred grey level exceeds the threshold (255, else 0) and the range of levels."""
    weights = _weights(blur)
    reach = len(weights) // 2
    scale = float(LUMA_SCALE) if view.ndim == 3 else 255.0
    margin = rounding_margin(len(weights))
    # the limits are single precision themselves, so each is moved outwards by its own rounding as well
    lower = float(np.nextafter(np.float32((threshold - margin) * scale), np.float32(-np.inf)))
    upper = float(np.nextafter(np.float32((threshold + margin) * scale), np.float32(np.inf)))
    bright = np.empty(view.shape[:2], dtype=np.uint8)
    extremes: list[float] = []
    undecided: list[Pixels] = []
    # in strips that stay in the processor's cache, each with the rows around it that its blur needs
    height = max(STRIP_PIXELS // view.shape[1], 4 * reach, 1)
    for start in range(0, view.shape[0], height):
        stop = min(start + height, view.shape[0])
        top, bottom = max(start - reach, 0), min(stop + reach, view.shape[0])
        level = _single_precision_grey(view[top:bottom])
        if reach:
            level = cv2.sepFilter2D(level, cv2.CV_32F, weights, weights, borderType=cv2.BORDER_REPLICATE)
        level = level[start - top : stop - top]
        extremes += cv2.minMaxLoc(level)[:2]
        np.multiply(level > upper, np.uint8(255), out=bright[start:stop])
        near = cv2.inRange(level, lower, upper)
        if cv2.countNonZero(near):
            at_rows, at_cols = np.nonzero(near)
            undecided.append((at_rows + start, at_cols))
    if undecided:
        pixels = np.concatenate([rows for rows, _ in undecided]), np.concatenate([cols for _, cols in undecided])
        if len(pixels[0]) <= MOST_WINDOWS:
            pixels = _decide_by_windows(view, threshold, weights, pixels, bright)
        _decide_by_rows(view, threshold, blur, pixels, bright)
    return bright, (min(extremes) / scale, max(extremes) / scale)


def _single_precision_grey(view: Image) -> NDArray[np.float32]:
    """Return weighted sums of R, G and B (whole numbers up to :data:`LUMA_SCALE`), or grey levels as they are."""
    single = view.astype(np.float32)
    return single if view.ndim == 2 else np.asarray(cv2.transform(single, np.array([LUMA], dtype=np.float32)))


def _decide_by_windows(
    view: Image, threshold: float, weights: NDArray[np.float64], pixels: Pixels, bright: Image
) -> Pixels:
    """Set pixels of ``bright`` in place in double precision; return those that even this leaves undecided."""
    rows, cols = pixels
    reach = len(weights) // 2
    steps = np.arange(-reach, reach + 1)
    around_rows = np.clip(rows[:, None] + steps, 0, view.shape[0] - 1)  # edges repeated
    around_cols = np.clip(cols[:, None] + steps, 0, view.shape[1] - 1)
    windows = view[around_rows[:, :, None], around_cols[:, None, :]].astype(np.float64)
    if windows.ndim == 4:
        windows = windows @ np.array(LUMA, dtype=np.float64) / 10_000
    level = np.einsum("kij,i,j->k", windows, weights, weights, optimize=True) / 255
    bright[rows, cols] = np.where(level > threshold, 255, 0)
    still = np.abs(level - threshold) <= DOUBLE_MARGIN
    return rows[still], cols[still]


def _decide_by_rows(view: Image, threshold: float, blur: float, pixels: Pixels, bright: Image) -> None:
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
        bright[rows[some], cols[some]] = np.where(exact[rows[some] - top, cols[some]] > threshold, 255, 0)


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
    blobs = pixels = 0
    groups, dropped = _groups(bright, chain.radius, chain.min_blob)
    for rows, cols, members in groups:
        box = cv2.bitwise_and(bright[rows, cols], members)  # 0 or 1
        grown = cv2.dilate(box, disk(chain.radius)) if chain.radius else box
        count, labels, stats, _ = cv2.connectedComponentsWithStats(grown, connectivity=8, ltype=cv2.CV_32S)
        large = stats[:, cv2.CC_STAT_AREA] >= chain.min_blob
        large[0] = False
        kept = int(np.count_nonzero(large))
        blobs += kept
        dropped += count - 1 - kept
        if kept < count - 1:
            grown = large.astype(np.uint8)[labels]
            box = cv2.bitwise_and(box, grown)
        # boxes may overlap, the blobs in them do not
        mask[rows, cols] |= box
        dilated[rows, cols] |= grown
        pixels += cv2.countNonZero(box)
    return Segmentation(
        mask=mask.view(np.bool_),
        dilated=dilated.view(np.bool_),
        pixels=pixels,
        blobs=blobs,
        dropped_blobs=dropped,
        grey_range=grey_range,
    )


def _groups(bright: Image, radius: int, min_blob: int) -> tuple[list[tuple[slice, slice, Image]], int]:
    """Split bright pixels into groups that cannot touch each other once dilated.

    Parameters
    ----------
    bright : ndarray of uint8 (rows, cols)
        0 or 255.
    radius, min_blob : int
        Of the chain [px].

    Returns
    -------
    groups : list of (slice, slice, ndarray of uint8)
        Box of each group with room for its dilation, and 1 where a pixel of the box may belong to it.
    dropped : int
        Number of groups left out, because even their box is smaller than ``min_blob``.

    Notes
    -----
    Pixels are gathered in blocks of 8 x 8, which a 64-bit word holds row by row. Disks touch, corner to corner
    included, only if their centres are at most 2 radius + 1 apart in each direction, that is (2 radius + 8) // 8
    blocks; blocks that far apart touch once each has grown by half of it.
    """
    rows, cols = bright.shape
    padded = np.zeros((-(-rows // BLOCK) * BLOCK, -(-cols // BLOCK) * BLOCK), dtype=np.uint8)
    padded[:rows, :cols] = bright
    words = padded.view(np.uint64)  # one word to eight pixels
    lit = (np.bitwise_or.reduce(words.reshape(-1, BLOCK, words.shape[1]), axis=1) != 0).astype(np.uint8)
    grow = (2 * radius + BLOCK) // BLOCK // 2
    grown = cv2.dilate(lit, np.ones((2 * grow + 1, 2 * grow + 1), np.uint8)) if grow else lit
    count, labels, _, _ = cv2.connectedComponentsWithStats(grown, connectivity=8, ltype=cv2.CV_32S)
    labels *= lit
    groups, dropped, room = [], 0, 0
    for label, found in enumerate(ndimage.find_objects(labels, count - 1), start=1):
        top, bottom = found[0].start * BLOCK, min(found[0].stop * BLOCK, rows)
        left, right = found[1].start * BLOCK, min(found[1].stop * BLOCK, cols)
        r = slice(max(top - radius, 0), min(bottom + radius, rows))
        c = slice(max(left - radius, 0), min(right + radius, cols))
        size = (r.stop - r.start) * (c.stop - c.start)
        if size < min_blob:
            dropped += 1
            continue
        members = np.zeros((r.stop - r.start, c.stop - c.start), dtype=np.uint8)
        inside = np.repeat(np.repeat(labels[found] == label, BLOCK, axis=0), BLOCK, axis=1)[
            : bottom - top, : right - left
        ]
        members[top - r.start : bottom - r.start, left - c.start : right - c.start] = inside
        groups.append((r, c, members))
        room += size
    if room > 2 * bright.size:  # entangled groups, each with a wide box: cheaper in one
        return [(slice(0, rows), slice(0, cols), np.ones_like(bright))], 0
    return groups, dropped
