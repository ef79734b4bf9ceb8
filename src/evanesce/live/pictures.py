"""Draw overlays of mask and ground truth, encode JPEG, and draw scale bars and lines as SVG."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import WorkError
from evanesce.measurement.reference.segment import Crop

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

AGREE, MISSED, FALSE = "#56b4e9", "#f0e442", "#d55e00"
"""Sky blue, yellow and vermilion of Okabe and Ito's palette, distinct for all colour visions and in lightness.

M. Okabe and K. Ito, Color Universal Design, 2008.
"""

STRENGTH = 0.6
"""Opacity of the colours over the frame."""

QUALITY = 90


def overlay(view: Image, mask: Mask, truth: Mask) -> Image:
    """Return a frame as RGB with true positive, missed and false contact in their colours.

    Parameters
    ----------
    view : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        [DN].
    mask, truth : ndarray of bool (rows, cols)
    """
    grey = view if view.ndim == 2 else cv2.cvtColor(view, cv2.COLOR_RGB2GRAY)
    classes = mask.view(np.uint8) + 2 * truth.view(np.uint8)
    return np.asarray(_palette()[classes.astype(np.uint16) * 256 + grey])


@lru_cache(maxsize=1)
def _palette() -> Image:
    """Return RGB by class * 256 + grey: neither, mask only, truth only, both."""
    grey = np.arange(256.0)[:, None] * np.ones(3)
    tables = [grey]
    for colour in (FALSE, MISSED, AGREE):
        rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], float)
        tables.append((1 - STRENGTH) * grey + STRENGTH * rgb)
    return np.rint(np.concatenate(tables)).astype(np.uint8)


def jpeg(image: Image) -> bytes:
    """Return an image as JPEG; chroma at full resolution, so that the mask's rim is not displaced.

    Parameters
    ----------
    image : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        Grey or RGB [DN].
    """
    options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
        options += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    done, data = cv2.imencode(".jpg", np.ascontiguousarray(image), options)
    if not done:
        raise WorkError("a picture could not be encoded")
    return bytes(data)


def shrunk(image: Image, cols: int) -> Image:
    """Return an image at most ``cols`` wide."""
    if image.shape[1] <= cols:
        return image
    size = (cols, max(1, round(image.shape[0] * cols / image.shape[1])))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def frame_svg(shape: tuple[int, ...], border: NDArray[np.float64], mm_per_px: float) -> str:
    """Return the SVG over the frame: border of the enlarged window, and a scale bar.

    Parameters
    ----------
    shape : tuple of int
        (rows, cols) of the frame.
    border : ndarray (n, 2)
        (x, y) of the window's border in the frame [px].
    mm_per_px : float
    """
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in border)
    return _svg(shape, f'<polygon points="{points}" class="window"/>' + _scale(shape, mm_per_px))


def window_svg(window: Crop, line_px: int, along: str, mm_per_px: float) -> str:
    """Return the SVG over the enlarged window: the profile's line, and a scale bar."""
    rows, cols = size_of(window)
    at = line_px - (window.r0 if along == "x" else window.c0) + 0.5
    ends = (0, at, cols, at) if along == "x" else (at, 0, at, rows)
    line = '<line x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}" class="line"/>'.format(*ends)
    return _svg((rows, cols), line + _scale((rows, cols), mm_per_px))


def size_of(window: Crop) -> tuple[int, int]:
    """Return (rows, cols) of a crop with both ends."""
    assert window.r1 is not None
    assert window.c1 is not None
    return window.r1 - window.r0, window.c1 - window.c0


def _scale(shape: tuple[int, ...], mm_per_px: float) -> str:
    """Return a scale bar of a round length, about a fifth of the picture."""
    rows, cols = shape[:2]
    rough = 0.2 * cols * mm_per_px
    length = max((s for s in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50) if s <= rough), default=0.1)
    px, x, y, size = length / mm_per_px, 0.03 * cols, 0.95 * rows, 0.042 * rows
    return (
        f'<path d="M{x:.1f} {y:.1f}h{px:.1f}" class="scale"/>'
        f'<text x="{x:.1f}" y="{y - 0.35 * size:.1f}" font-size="{size:.1f}" class="scale">{length:g} mm</text>'
    )


def _svg(shape: tuple[int, ...], content: str) -> str:
    rows, cols = shape[:2]
    return f'<svg viewBox="0 0 {cols} {rows}" preserveAspectRatio="none" aria-hidden="true">{content}</svg>'


def crop_of(window: Crop, image: NDArray[Any]) -> NDArray[Any]:
    """Return the part of an image that a window shows."""
    return window.apply(image)
