"""Images of smooth light, sampled at some pixels or at the centres of blocks and interpolated to all."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.optics.projection import IdealView

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Maps = tuple[Image, Image]
"""Column and row on another image for each pixel, as ``cv2.remap`` takes them."""

BLOCK = 8
"""Side of the largest blocks of pixels over which what is smooth is sampled once; windows are whole blocks [px]."""


def view_rays(view: IdealView, step: int = 1) -> tuple[Array, Array]:
    """Return the directions (u, v, 1) of every ``step``-th pixel of a view.

    Parameters
    ----------
    view : IdealView
    step : int

    Returns
    -------
    u, v : ndarray (rows / step, cols / step), rounded up and one more where needed to pass the last pixel
        [1].
    """
    rows, cols = view.shape
    px, py = view.principal_point
    u, v = np.meshgrid(
        (np.arange(0, cols + step - 1, step) - px) / view.focal_px,
        (np.arange(0, rows + step - 1, step) - py) / view.focal_px,
    )
    return u, v


def enlarged(coarse: Image, step: int, shape: tuple[int, int]) -> Image:
    """Return an image sampled at pixels 0, step, 2 step, ... at all pixels of ``shape`` (rows, cols).

    Parameters
    ----------
    coarse : ndarray of float32
    step : int
        [px].
    shape : tuple of int
    """
    onto = np.array([[step, 0, 0], [0, step, 0]], np.float32)
    return np.asarray(cv2.warpAffine(coarse, onto, shape[::-1], flags=cv2.INTER_LINEAR), np.float32)


def block_means(image: Any, step: int) -> Image:
    """Return the means of blocks of ``step`` x ``step`` pixels, of a shape in whole blocks.

    Parameters
    ----------
    image : ndarray (rows, cols)
    step : int
        [px].

    Returns
    -------
    ndarray of float32 (rows / step, cols / step)
    """
    rows, cols = image.shape
    return np.asarray(
        cv2.resize(np.asarray(image, np.float32), (cols // step, rows // step), interpolation=cv2.INTER_AREA)
    )


def spread_blocks(means: Image, step: int) -> Image:
    """Return values at the centres of blocks at all pixels, linear between them, as they are beyond the outermost.

    Parameters
    ----------
    means : ndarray of float32 (rows, cols)
    step : int
        [px].

    Returns
    -------
    ndarray of float32 (rows * step, cols * step)
    """
    rows, cols = means.shape
    return np.asarray(cv2.resize(means, (cols * step, rows * step), interpolation=cv2.INTER_LINEAR))
