"""Dilation by a disk and selection of blobs by size, on images of one bit per pixel.

The results equal those of `binary_dilation` with `disk(radius)` and of `label` with 8 neighbours (scikit-image). A row
is kept as 64-bit words, the first column in the lowest bit of the first word, and ends in columns that stay 0 (the
guard), so that the words of all rows form one string of bits: an operation on the string acts on 64 pixels at once,
and what it moves beyond an edge stays within the guard.

Notes
-----
A disk is a stack of horizontal segments. A row dilated by a longer segment is the union of shifted copies of the row
dilated by a shorter one, so all the segments of a disk cost a few shifts each. Connected components are found on runs
(maximal horizontal segments of set pixels): two runs of neighbouring rows are connected where they overlap or touch
corner to corner [1]_, and the components of this graph are the blobs.

References
----------
.. [1] L. He, X. Ren, Q. Gao, X. Zhao, B. Yao, Y. Chao, The connected-component labeling problem: a review of
   state-of-the-art algorithms, Pattern Recognition 70, 25-43, 2017, doi:10.1016/j.patcog.2017.04.018.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import isqrt

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Mask = NDArray[np.bool_]
Words = NDArray[np.uint64]
Positions = NDArray[np.int64]

WORD = 64
"""Pixels of a word."""

MOST_RUNS = 150_000
"""Runs up to which they are labelled; beyond, pixels are (OpenCV), which takes the same time however many there are."""


@dataclass(frozen=True, kw_only=True)
class Blobs:
    """Blobs of a dilated mask.

    Attributes
    ----------
    dilated : ndarray of bool (rows, cols)
        The blobs that are large enough.
    kept, dropped : int
        Number of blobs that are large enough, and of those that are not.
    """

    dilated: Mask
    kept: int
    dropped: int


def large_blobs(mask: Mask, radius: int, min_size: int) -> Blobs:
    """Dilate a mask by a disk and keep the blobs of at least ``min_size`` pixels.

    Parameters
    ----------
    mask : ndarray of bool (rows, cols)
    radius : int
        Of the disk [px]; 0 leaves the mask as it is.
    min_size : int
        Minimum size of a blob after dilation [px].

    Returns
    -------
    Blobs
    """
    cols = mask.shape[1]
    packed = pack(mask, guard=max(radius, 1))
    if dilates_to_everything(packed, cols, radius):
        enough = mask.size >= min_size
        return Blobs(dilated=np.full(mask.shape, enough), kept=int(enough), dropped=int(not enough))
    grown = dilate(packed, cols, radius)
    starts, stops = runs(grown)
    if len(starts) > MOST_RUNS:
        return _large_blobs_by_pixel(unpack(grown, cols), min_size)
    count, labels = label_runs(starts, stops, stride=grown.shape[1] * WORD)
    large = np.bincount(labels, weights=stops - starts, minlength=count) >= min_size
    kept = int(np.count_nonzero(large))
    if kept < count:
        chosen = large[labels]
        grown = fill(starts[chosen], stops[chosen], grown.shape)
    return Blobs(dilated=unpack(grown, cols), kept=kept, dropped=count - kept)


def _large_blobs_by_pixel(dilated: Mask, min_size: int) -> Blobs:
    """Keep the blobs of at least ``min_size`` pixels, without a detour over runs."""
    count, labels, figures, _ = cv2.connectedComponentsWithStats(
        dilated.view(np.uint8), connectivity=8, ltype=cv2.CV_32S
    )
    large = figures[:, cv2.CC_STAT_AREA] >= min_size
    large[0] = False  # the background
    kept = int(np.count_nonzero(large))
    return Blobs(dilated=large[labels] if kept < count - 1 else dilated, kept=kept, dropped=count - 1 - kept)


def pack(mask: Mask, guard: int) -> Words:
    """Return a mask of shape (rows, cols) as words (rows, words), with at least ``guard`` columns of 0 at the end.

    The order of bytes is that of a little-endian processor, as all are that the dependencies are built for.
    """
    rows, cols = mask.shape
    octets = np.zeros((rows, -(-(cols + guard) // WORD) * 8), dtype=np.uint8)
    octets[:, : -(-cols // 8)] = np.packbits(mask, axis=1, bitorder="little")
    return octets.view(np.uint64)


def unpack(words: Words, cols: int) -> Mask:
    """Return the first ``cols`` columns of packed rows as a mask of shape (rows, cols)."""
    return np.unpackbits(words.view(np.uint8), axis=1, count=cols, bitorder="little").view(np.bool_)


def dilates_to_everything(words: Words, cols: int, radius: int) -> bool:
    """Return True only if dilation sets every pixel: if even the square within the disk does."""
    bits = _string(words, radius)
    half = isqrt(radius * radius // 2)
    for step in (1, words.shape[1] * WORD):  # to the next column, to the next row
        reach = 0
        while reach < half:
            by = min(2 * reach + 1, half - reach)
            bits = _joined_with_shifted(bits, by * step)
            reach += by
    square = bits[-words.size :].reshape(words.shape)
    last, left = divmod(cols, WORD)
    tail = np.uint64((1 << left) - 1)
    return bool((square[:, :last] == ~np.uint64(0)).all() and (square[:, last] & tail == tail).all())


@lru_cache(maxsize=8)
def disk_segments(radius: int) -> tuple[tuple[int, tuple[int, ...]], ...]:
    """Return the disk x^2 + y^2 <= radius^2 as pairs of a half-length and the rows y >= 0 that have it [px].

    The half-lengths increase from 0, where a row may be absent, such that a segment of one half-length is the union of
    the one before and its two shifted copies: the shift is at most the length 2 h + 1 of the segment before.
    """
    rows_of: dict[int, list[int]] = {}
    for y in range(radius, -1, -1):
        rows_of.setdefault(isqrt(radius * radius - y * y), []).append(y)
    half_lengths = [0]
    for wanted in sorted(rows_of):
        while wanted > 3 * half_lengths[-1] + 1:
            half_lengths.append(3 * half_lengths[-1] + 1)
        if wanted > half_lengths[-1]:
            half_lengths.append(wanted)
    return tuple((half, tuple(rows_of.get(half, ()))) for half in half_lengths)


def dilate(words: Words, cols: int, radius: int) -> Words:
    """Return packed rows after dilation by the disk of ``radius`` [px].

    Parameters
    ----------
    words : ndarray of uint64 (rows, words)
        With a guard of at least ``radius`` columns.
    cols, radius : int
    """
    segment = _string(words, radius)
    grown = np.zeros(words.size, dtype=np.uint64)
    length = 0
    for half, rows in disk_segments(radius):
        if half > length:
            segment = _joined_with_shifted(segment, half - length)
            length = half
        wide = segment[-words.size :]
        for y in rows:
            offset = y * words.shape[1]
            if offset < len(grown):
                grown[offset:] |= wide[: len(grown) - offset]
                if y:
                    grown[: len(grown) - offset] |= wide[offset:]
    dilated = grown.reshape(words.shape)
    last, bits = divmod(cols, WORD)
    dilated[:, last] &= np.uint64((1 << bits) - 1)  # empty the guard
    dilated[:, last + 1 :] = 0
    return dilated


def _string(words: Words, radius: int) -> Words:
    """Return the string of bits of packed rows, after a guard before the first row's first column as well."""
    return np.concatenate([np.zeros(-(-radius // WORD), dtype=np.uint64), words.ravel()])


def _joined_with_shifted(bits: Words, by: int) -> Words:
    """Return the union of a string of bits and its copies shifted up and down by so many bits."""
    skip, shift = divmod(by, WORD)
    n = len(bits) - skip
    if n <= 0:
        return bits
    joined = bits.copy()
    if not shift:
        joined[skip:] |= bits[:n]
        joined[:n] |= bits[skip:]
        return joined
    part = np.empty_like(bits)
    joined[skip:] |= np.left_shift(bits[:n], shift, out=part[:n])
    joined[:n] |= np.right_shift(bits[skip:], shift, out=part[:n])
    # what crosses from one word into the next
    joined[skip + 1 :] |= np.right_shift(bits[: n - 1], WORD - shift, out=part[: n - 1])
    joined[: n - 1] |= np.left_shift(bits[skip + 1 :], WORD - shift, out=part[: n - 1])
    return joined


def runs(words: Words) -> tuple[Positions, Positions]:
    """Return where runs of set pixels start and stop (half-open), as positions in the string of bits, in order."""
    bits = words.ravel()
    before = bits << np.uint64(1)
    before[1:] |= bits[:-1] >> np.uint64(WORD - 1)
    changes = bits ^ before  # a run has a first pixel and a first pixel after it, which the guard has room for
    at = np.flatnonzero(changes)
    found = np.flatnonzero(np.unpackbits(changes[at].view(np.uint8), bitorder="little").view(np.bool_))
    positions = at[found // WORD] * WORD + found % WORD
    return positions[::2], positions[1::2]


def fill(starts: Positions, stops: Positions, shape: tuple[int, int]) -> Words:
    """Return packed rows (rows, words) in which the given runs are set."""
    changes = np.zeros(shape[0] * shape[1], dtype=np.uint64)
    for ends in (starts, stops):
        np.bitwise_xor.at(changes, ends // WORD, np.uint64(1) << (ends % WORD).astype(np.uint64))
    # a pixel is set if the number of changes up to it is odd: within each word, then over the words before it
    for shift in (1, 2, 4, 8, 16, 32):
        changes ^= changes << np.uint64(shift)
    odd = np.bitwise_xor.accumulate(changes >> np.uint64(WORD - 1))
    changes[1:] ^= np.negative(odd[:-1])
    return changes.reshape(shape)


def label_runs(starts: Positions, stops: Positions, stride: int) -> tuple[int, NDArray[np.int32]]:
    """Label runs by connected component, 8 neighbours.

    Parameters
    ----------
    starts, stops : ndarray of int64 (runs,)
        Positions in the string of bits, half-open, in order.
    stride : int
        Distance from a pixel to the one below it; above the number of columns, so that the ends of rows are apart.

    Returns
    -------
    count : int
    labels : ndarray of int32 (runs,)
        0 to count - 1.
    """
    # the runs below that are connected to a run follow each other: from the first that ends at or after its start
    # to the last that starts at or before its end, each moved one row down
    first = np.searchsorted(stops, starts + stride, side="left")
    number = np.searchsorted(starts, stops + stride, side="right") - first
    above = np.repeat(np.arange(len(starts)), number)
    below = np.arange(len(above)) + np.repeat(first - (np.cumsum(number) - number), number)
    touching = coo_array((np.ones(len(above), np.int8), (above, below)), shape=(len(starts), len(starts)))
    return connected_components(touching, directed=False)
