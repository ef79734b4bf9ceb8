"""Grey level of light in a colour camera, in closed form: no noise, no neighbours."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.measurement.reference.segment import LUMA, LUMA_SCALE
from evanesce.rig.colour import Mosaic
from evanesce.sensor.colour import ImageProcessor, channel_map

Array = NDArray[np.float64]

GREY = np.array(LUMA) / (LUMA_SCALE / 255)
"""Weights of the reference segmentation for red, green and blue [1]."""

TABLE_POINTS = 8192
HIGHEST_LEVEL = 1e4
"""Light beyond which every filter with a response of 0.0001 or more is at full scale."""

_KERNELS = {
    "sparse": np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4.0,  # red and blue: one pixel in four
    "quincunx": np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4.0,  # green: one in two
}


def bilinear(mosaic: Array, pattern: Mosaic) -> Array:
    """Return red, green and blue of a mosaic by bilinear interpolation, not clipped and not rounded.

    Parameters
    ----------
    mosaic : ndarray (rows, cols)
        [any unit].
    pattern : {"RGGB", "BGGR", "GRBG", "GBRG"}

    Returns
    -------
    ndarray (rows, cols, 3)
        In the unit of ``mosaic``; at the border the neighbours are mirrored.
    """
    rows, cols = mosaic.shape
    channels = channel_map((rows, cols), pattern)
    planes = [
        cv2.filter2D(
            np.where(channels == k, mosaic, 0.0), -1, _KERNELS["quincunx" if k == 1 else "sparse"],
            borderType=cv2.BORDER_REFLECT_101,
        )
        for k in range(3)
    ]  # fmt: skip
    return np.stack(planes, axis=-1)


class GreyTable:
    """Grey level, 0 to 1, by light level, 1 of which fills a raw pixel whose filter has response 1.

    Parameters
    ----------
    response : sequence of 3 float
        Share that a red, green and blue filter let through [1].
    processor : ImageProcessor
    well : float
        Raw value of a full well [1]; 1 or more where the converter is full first.
    """

    def __init__(self, response: Sequence[float], processor: ImageProcessor, well: float = 1.0) -> None:
        # evenly in the logarithm: colours change over five decades of light
        self.levels = np.concatenate([[0.0], np.geomspace(1e-5, HIGHEST_LEVEL, TABLE_POINTS - 1)])
        raw = np.minimum(self.levels[:, None] * np.asarray(response), min(well, 1.0))
        self.colours = processor.finished(np.minimum(raw * processor.gains, 1.0))
        self._grey = (self.colours @ GREY / 255.0).astype(np.float32)
        self._steps = (TABLE_POINTS - 2) / np.log(HIGHEST_LEVEL / 1e-5)

    def __call__(self, level: ArrayLike) -> NDArray[np.float32]:
        """Return the grey levels of light levels.

        Parameters
        ----------
        level : array_like (...)
            [1].

        Returns
        -------
        ndarray of float32 (...)
            The 8-bit grey of the nearest of :data:`TABLE_POINTS` light levels, 0.25 % apart.
        """
        light = np.asarray(level, np.float32)
        with np.errstate(divide="ignore"):
            place = np.log(light * np.float32(1e5)) * np.float32(self._steps) + np.float32(1.5)
        return np.asarray(self._grey[np.clip(place, 0, TABLE_POINTS - 1).astype(np.int32)])

    def first(self, channel: int, value: float) -> float:
        """Return the least light level at which a channel has a value; infinite where it never does.

        Parameters
        ----------
        channel : int
            0 red, 1 green, 2 blue.
        value : float
            [DN].

        Returns
        -------
        float
            [1].
        """
        there = self.colours[:, channel] >= value
        return float(self.levels[there.argmax()]) if there.any() else float("inf")

    def crosses(self, grey: float) -> float:
        """Return the least light level at which the grey level exceeds a threshold; infinite where it never does.

        Parameters
        ----------
        grey : float
            0 to 1 [1].

        Returns
        -------
        float
            [1].
        """
        above = self._grey > grey
        return float(self.levels[above.argmax()]) if above.any() else float("inf")
