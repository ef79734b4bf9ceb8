"""Level of the light from a raw mosaic, without demosaicing: in light of one spectrum every pixel measures the same.

Red, green and blue pixels collect fixed shares of the light, so that a place's level is the charge that its pixels
collected over what they would have collected of unit light. Of Poisson noise this ratio of sums is the estimate of
least variance. A colour of which a pixel nearby is full is left out there, whole: dropping single pixels would draw the
others' centre towards the dark side of an edge. The least sensitive colour stays, full pixels and all: where it is full
the level is at least the top. Nothing is cut at 0, and red being full hides nothing that green shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

KERNEL = np.array([1.0, 2.0, 1.0])
"""Of the sums, along either side: symmetric about the pixel for each colour of a mosaic."""

FULL_SHARE = 0.95
"""Of full scale, from which a pixel counts as full: noise clips single ones before."""

MOSAIC_PX = 0.1
"""Half-width of what the coarser sampling of each colour does to an edge [px]: that of demosaicing."""


@dataclass(frozen=True, kw_only=True)
class RawModel:
    """What a colour camera's raw pixels make of light of one spectrum.

    Attributes
    ----------
    mosaic : str
        First 2 x 2 pixels, row by row, such as RGGB.
    response : tuple of float
        Of red, green and blue pixels, in any common unit [1].
    black_DN, full_DN : float
        Raw value without light, and of a full pixel [DN].
    """

    mosaic: str
    response: tuple[float, float, float]
    black_DN: float
    full_DN: float

    @cached_property
    def top(self) -> float:
        """Highest level that a mosaic shows: that which fills the least sensitive pixels, of what fills response 1."""
        return FULL_SHARE / min(share for share in self.response if share > 0)

    def light(self, raw: NDArray[np.uint16], dark: Floats | float = 0.0) -> tuple[Floats, Mask]:
        """Return light relative to the highest level that a mosaic shows, and where it is at least that.

        Parameters
        ----------
        raw : ndarray of uint16 (rows, cols)
            [DN].
        dark : ndarray (rows, cols) or float
            Level of the light without contact, which is taken off.

        Returns
        -------
        light : ndarray (rows, cols)
            Up to 1.
        full : ndarray of bool (rows, cols)
        """
        level, full = self.level(raw)
        return (np.minimum(level, self.top) - dark) / self.top, full

    def level(self, raw: NDArray[np.uint16]) -> tuple[Floats, Mask]:
        """Return the light's level, 1 filling a pixel of response 1, and where every colour is full.

        Parameters
        ----------
        raw : ndarray of uint16 (rows, cols)
            [DN].

        Returns
        -------
        level : ndarray (rows, cols)
            At most the top.
        full : ndarray of bool (rows, cols)
            Where it is the top.
        """
        value = (np.asarray(raw, np.float64) - self.black_DN) / (self.full_DN - self.black_DN)
        collected, expected = np.zeros(raw.shape), np.zeros(raw.shape)
        least = min(share for share in self.response if share > 0)
        for colour, share in zip("RGB", self.response, strict=True):
            if share <= 0:
                continue
            own = np.zeros(raw.shape)
            for place, letter in enumerate(self.mosaic):
                if letter == colour:
                    own[place // 2 :: 2, place % 2 :: 2] = 1.0
            clipped = ((value >= FULL_SHARE) & (own > 0)).astype(np.uint8)
            usable = (cv2.dilate(clipped, np.ones((3, 3), np.uint8)) == 0) | (share == least)
            collected += np.where(usable, _sums(value * own), 0.0)
            expected += np.where(usable, share * _sums(own), 0.0)
        level = collected / np.maximum(expected, 1e-12)
        full = level >= self.top
        return np.minimum(level, self.top), full


def _sums(values: Floats) -> Floats:
    """Return sums over the kernel; the reflection at the border keeps the mosaic's order."""
    return np.asarray(cv2.sepFilter2D(values, -1, KERNEL, KERNEL, borderType=cv2.BORDER_REFLECT_101))
