"""Features of frames from which a plain model tells how much of a contact sticks: patch, motion, optical flow."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Image = NDArray[np.float32]

LAGS = (1, 3, 6)
"""Frames back at 30 Hz."""
WIDTH_PX = 200
"""Wider frames are shrunk to it: time goes with their pixels."""


def frame_features(frames: Sequence[NDArray[np.uint8]], rate_hz: float = 30.0) -> Floats:
    """Return features of every frame of a trial from it and those of the last 0.2 s, shape (n, k).

    Parameters
    ----------
    frames : sequence of ndarray (rows, cols)
        Consecutive, 8 bits.
    rate_hz : float

    Returns
    -------
    ndarray (n, k)
        Radius, level and contrast of the patch, its way since contact [px]; and over each of three lags motion and
        growth of the patch, change of the picture and median optical flow in core and rim [px].
    """
    lags = [max(1, round(lag * rate_hz / 30.0)) for lag in LAGS]
    images = [cv2.GaussianBlur(_grey(f), (0, 0), 0.8) for f in frames]
    patches = [_patch(image) for image in images]
    rows = []
    first = None
    for i, (image, (mask, centre, radius)) in enumerate(zip(images, patches, strict=True)):
        row = [
            radius,
            float(image[mask].mean()) if mask.any() else 0.0,
            float(image[mask].std()) if mask.any() else 0.0,
        ]
        if first is None and i >= 3 and mask.any():
            first = centre
        row += [float(np.hypot(*(centre - first))) if first is not None else 0.0]
        core, rim = _zones(image.shape, centre, radius)
        for lag in lags:
            before = images[max(i - lag, 0)]
            _, old_centre, old_radius = patches[max(i - lag, 0)]
            row += [float(np.hypot(*(centre - old_centre))), radius - old_radius]
            change = np.abs(image - before)
            row += [float(change[zone].mean()) if zone.any() else 0.0 for zone in (core, rim)]
            row += _flow(before, image, core, rim)
        rows.append(row)
    return np.array(rows)


def _patch(image: Image) -> tuple[NDArray[np.bool_], Floats, float]:
    """Return mask, middle (x, y) and radius [px] of the largest bright patch, furrows closed."""
    level = 0.5 * float(np.quantile(image, 0.995))
    mask = image > max(level, 0.04)
    count, labels, stats, centres = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    if count < 2:
        return np.zeros_like(mask), np.array(image.shape[::-1]) / 2.0, 0.0
    joined = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    count, labels, stats, centres = cv2.connectedComponentsWithStats(joined)
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    return labels == largest, centres[largest], float(np.sqrt(stats[largest, cv2.CC_STAT_AREA] / np.pi))


def _zones(shape: tuple[int, ...], centre: Floats, radius: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return core and rim of a patch."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    r = np.hypot(x - centre[0], y - centre[1])
    return r < 0.5 * radius, (r >= 0.7 * radius) & (r < 0.95 * radius)


def _flow(before: Image, now: Image, core: NDArray[np.bool_], rim: NDArray[np.bool_]) -> list[float]:
    """Return how far the pattern moved in the core and at the rim [px]."""
    if not core.any() or not rim.any():
        return [0.0, 0.0]
    a, b = (np.clip(255 * image, 0, 255).astype(np.uint8) for image in (before, now))
    flow = cv2.calcOpticalFlowFarneback(a, b, None, 0.5, 2, 11, 3, 5, 1.1, 0)
    return [float(np.hypot(*np.median(flow[zone], axis=0))) for zone in (core, rim)]


def _grey(frame: NDArray[np.uint8]) -> Image:
    """Return a frame of one channel, 0 to 1, at most :data:`WIDTH_PX` wide."""
    grey = np.asarray(frame if frame.ndim == 2 else frame.mean(axis=2), np.float32) / np.float32(255.0)
    if grey.shape[1] <= WIDTH_PX:
        return grey
    rows = round(grey.shape[0] * WIDTH_PX / grey.shape[1])
    return np.asarray(cv2.resize(grey, (WIDTH_PX, rows), interpolation=cv2.INTER_AREA))
