"""The steps of a JPEG that frames came through, read off their own coefficients.

A JPEG rounds the cosine coefficients of blocks of 8 x 8 pixels to multiples of steps that its quality sets (ITU-T T.81,
annex A.3), so that decoded frames have no others, but for the rounding of their pixels. A video predicts blocks from
others and deblocks them: its frames have coefficients of any size.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

Array = NDArray[Any]

SIDE = 8
QUALITIES = range(20, 99)
"""Above, the steps are no larger than what the rounding of pixels makes of a coefficient."""
ROUNDED_SD = 0.35
"""Of a coefficient of a frame whose pixels were rounded: sqrt(1/12), and something more for a conversion of colour."""
ASTRAY = 0.02
"""Share of coefficients that may be anywhere: of blocks that were cut off at black or white."""
FEWEST, MOST = 50, 20_000
"""Coefficients by which a quality is judged."""
EVIDENCE = 20.0
"""Nats by which multiples of a quality's steps must explain them better than any values do."""


def jpeg_quality(frames: Sequence[Array]) -> int | None:
    """Return the quality of the JPEG that frames came through; None where they show none.

    Parameters
    ----------
    frames : sequence of ndarray (rows, cols)
        Of uint8, as decoded: neither resized, nor cut but at multiples of 8 pixels.

    Notes
    -----
    Judged are coefficients that a quality would not have rounded to zero: those that it would have are near zero in
    every smooth frame.
    """
    blocks = np.concatenate([_whole_blocks(frame) for frame in frames] or [np.zeros((0, SIDE, SIDE))])
    if not len(blocks):
        return None
    found = fft.dctn(blocks - 128.0, axes=(1, 2), norm="ortho").reshape(len(blocks), -1)[:, 1:]
    evidence = {quality: _evidence(found, _steps(quality).ravel()[1:]) for quality in QUALITIES}
    best = max(evidence, key=lambda quality: evidence[quality])
    return best if evidence[best] > EVIDENCE else None


def _whole_blocks(frame: Array) -> Array:
    """Return the blocks (n, 8, 8) in which no pixel is cut off."""
    if frame.dtype != np.uint8 or frame.ndim != 2:
        return np.zeros((0, SIDE, SIDE))
    rows, cols = (n // SIDE for n in frame.shape)
    cut = frame[: rows * SIDE, : cols * SIDE].reshape(rows, SIDE, cols, SIDE).swapaxes(1, 2).reshape(-1, SIDE, SIDE)
    inside = (cut.min(axis=(1, 2)) > 0) & (cut.max(axis=(1, 2)) < 255)
    return cut[inside].astype(float)


def _evidence(coefficients: Array, steps: Array) -> float:
    """Return the log likelihood ratio of multiples of the steps over any values [nats]."""
    wide = np.broadcast_to(steps, coefficients.shape)
    multiple = np.round(coefficients / wide)
    judged = (multiple != 0) & (wide > 1)
    if judged.sum() < FEWEST:
        return 0.0
    step, away = wide[judged][:MOST], (coefficients - multiple * wide)[judged][:MOST]
    near = np.exp(-0.5 * (away / ROUNDED_SD) ** 2) / (ROUNDED_SD * np.sqrt(2.0 * np.pi))
    return float(np.log((1.0 - ASTRAY) * near * step + ASTRAY).sum())


@cache
def _steps(quality: int) -> Array:
    """Return the steps (8, 8) of a quality's luminance, as the encoder writes them into a file."""
    _, file = cv2.imencode(".jpg", np.zeros((SIDE, SIDE), np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    table = file.tobytes().partition(b"\xff\xdb")[2]
    # Two bytes of length, one of precision and number; then 64 steps along the zigzag.
    found, order = np.zeros(SIDE**2), sorted(np.ndindex(SIDE, SIDE), key=_along_zigzag)
    found[[row * SIDE + col for row, col in order]] = np.frombuffer(table[3 : 3 + SIDE**2], np.uint8)
    return found.reshape(SIDE, SIDE)


def _along_zigzag(place: tuple[int, ...]) -> tuple[int, int]:
    row, col = place
    return row + col, row if (row + col) % 2 else col
