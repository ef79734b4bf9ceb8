"""Whether a codec has been at work on frames of one state: what no camera's noise does.

Smoothing in the camera, and a tone curve or a black level of another shape, make the scatter smaller than its level in
the dark lets expect, as codecs do. But noise is drawn anew in each frame, and knows nothing of blocks of eight pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

BLOCK_PX = 8
TILES = 16
"""Along each side of the frame: their scatter says how well the whole is known, however noise is correlated."""
LEAST_TILES = 8
"""With any noise, from which a standard error is known."""
SURE = 3.0
"""Standard errors from which a trace is believed, where levels speak for a codec as well."""
LEAST_FRAMES = 3
LIT_SHARE = 0.5
"""Of the brightest level, from which on a pixel is lit."""
STILL_DN2 = 1.0 / 12.0
"""Variance of rounding: noise below it shows no traces of anything [DN^2]."""


@dataclass(frozen=True)
class Traces:
    """What noise shows that a camera's own does not.

    Attributes
    ----------
    correlation : float
        Correlation of a frame's noise with that of the next one; 0 without a codec.
    correlation_error : float
        Its standard error.
    borders : float
        Mean square step of the noise over borders of blocks, over that within them, less 1; 0 without a codec.
    borders_error : float
    """

    correlation: float
    correlation_error: float
    borders: float
    borders_error: float

    @property
    def found(self) -> bool:
        """Whether a codec was at work."""
        return self.correlation > SURE * self.correlation_error or self.borders > SURE * self.borders_error


def codec_traces(frames: Sequence[Array]) -> Traces | None:
    """Return the traces of a codec in frames of one state; None where too few or too quiet ones could not show any.

    Parameters
    ----------
    frames : sequence of ndarray (rows, cols)
        Single real frames [DN].
    """
    if len(frames) < LEAST_FRAMES:
        return None
    stack = np.asarray(frames, np.float32)
    mean = stack.mean(axis=0)
    left = stack - mean
    left *= (left**2).mean(axis=0) >= STILL_DN2  # where light is saturated or cut off, there is no noise
    mean = np.where(left.any(axis=0), mean, 0.0)
    power = float((mean**2).sum())
    if power > 0:  # each frame's own light is no noise of its pixels
        left -= (np.tensordot(left, mean, 2) / power)[:, None, None] * mean
    count, square = len(frames), (left**2).sum(axis=0)
    if float(square.mean()) / (count - 1) < STILL_DN2:
        return None
    # What is taken off with the mean makes neighbours in time unlike by 1 / (n - 1).
    alike = (left[1:] * left[:-1]).sum(axis=0) / (count - 1) + square / (count * (count - 1))
    # Videos keep more of the noise's past where there is light, which few pixels may have.
    lit = mean > LIT_SHARE * mean.max()
    found = [_ratio(alike * part, square * part / count) for part in (1.0, lit)]
    correlation = max((one for one in found if one is not None), key=lambda one: one[0] / one[1], default=None)
    borders = _ratio(*_steps(left))
    return None if correlation is None or borders is None else Traces(*correlation, *borders)


def _steps(left: Array) -> tuple[Array, Array]:
    """Return squared steps over borders of blocks less as many of those within, and the latter (tiles, tiles)."""
    over, within = np.zeros((TILES, TILES)), np.zeros((TILES, TILES))
    for axis in (1, 2):
        step = (np.diff(left, axis=axis) ** 2).sum(axis=0)
        border = np.arange(step.shape[axis - 1]) % BLOCK_PX == BLOCK_PX - 1
        shape = (-1, 1) if axis == 1 else (1, -1)
        at = np.broadcast_to(border.reshape(shape), step.shape)
        over += _tiles(np.where(at, step, 0.0)) / border.mean()
        within += _tiles(np.where(at, 0.0, step)) / (1.0 - border.mean())
    return over - within, within


def _tiles(image: Array) -> Array:
    """Return sums (tiles, tiles) over parts of an image."""
    if image.shape == (TILES, TILES):
        return image
    rows, cols = (np.linspace(0, n, TILES + 1).astype(int)[:-1] for n in image.shape)
    return np.add.reduceat(np.add.reduceat(image, rows, axis=0), cols, axis=1)


def _ratio(part: Array, whole: Array) -> tuple[float, float] | None:
    """Return the ratio of two sums and its standard error, by the jackknife over tiles; None where few have noise."""
    part, whole = _tiles(part), _tiles(whole)
    there = whole > 0
    count = int(there.sum())
    if count < LEAST_TILES:  # saturated light has no noise
        return None
    ratio = float(part.sum() / whole.sum())
    without = (part.sum() - part[there]) / (whole.sum() - whole[there])
    return ratio, max(float(np.sqrt((count - 1) / count * ((without - without.mean()) ** 2).sum())), 1e-9)
