"""Features of frames from which a plain model tells how much of a contact sticks: patch, and motion of the skin in it.

None of them counts how far the finger has come: up to slip that grows with friction and with the shaft's compliance,
and a model that goes by it takes a longer way on a rougher plate for slip.
"""

from __future__ import annotations

import math
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
BLUR_PX = 0.8
"""Standard deviation of the Gaussian that frames are smoothed by."""
WINDOW_PX = 11
"""Side of the windows in which motion is found."""
BACKGROUND_QUANTILE, PATCH_QUANTILE = 0.2, 0.999
"""Of a frame's levels: the room's light and haze beside the contact, and the contact, however small it is."""
LEAST_CONTRAST = 0.04
"""Between the two, or there is no contact [full scale]."""
LEAST_OVERLAP = 0.25
"""Of two patches, of the larger; below, they are not one contact that moved, and nothing is said of its motion."""
LEAST_PX = 30
"""Of a patch, for quantiles of its motion."""
SPEED_QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)
CHANGE_QUANTILES = (0.1, 0.3, 0.5, 0.9)
MOVING_PX = (0.05, 0.1, 0.2, 0.4)
"""Motions beyond which a pixel counts as moved: the shares of such pixels say how much of the contact slips."""
_OF_MOTION = len(SPEED_QUANTILES) + len(CHANGE_QUANTILES) + len(MOVING_PX) + 2


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
        Radius [px], level, contrast and noise of the patch, the last two in its level; and over each of three lags
        motion and growth of the patch [px], change of the picture in core and rim, and of the patch's pixels quantiles
        of motion and of change over slope [px], shares that moved, and median motion in core and rim [px].
    """
    lags = [max(1, round(lag * rate_hz / 30.0)) for lag in LAGS]
    raw = [_grey(f) for f in frames]
    images = [cv2.GaussianBlur(f, (0, 0), BLUR_PX) for f in raw]
    patches = [_patch(image) for image in images]
    rows = []
    for i, (image, (mask, centre, radius)) in enumerate(zip(images, patches, strict=True)):
        level = float(image[mask].mean()) if mask.any() else 0.0
        scale = 1.0 / level if level > 0.0 else 1.0
        noise = scale * _noise(raw[i])
        row = [radius, level, scale * float(image[mask].std()) if mask.any() else 0.0, noise]
        core, rim = _zones(image.shape, centre, radius)
        for lag in lags:
            before = images[max(i - lag, 0)]
            old_mask, old_centre, old_radius = patches[max(i - lag, 0)]
            both = mask & old_mask
            larger = max(int(mask.sum()), int(old_mask.sum()), 1)
            if int(both.sum()) < LEAST_OVERLAP * larger:
                row += [0.0] * (4 + _OF_MOTION)
                continue
            row += [float(np.hypot(*(centre - old_centre))), radius - old_radius]
            change = np.abs(image - before)
            row += [float(change[zone].mean()) if zone.any() else 0.0 for zone in (core, rim)]
            row += _of_motion(scale * before, scale * image, noise, both, (core, rim))
        rows.append(row)
    return np.array(rows)


def _patch(image: Image) -> tuple[NDArray[np.bool_], Floats, float]:
    """Return mask, middle (x, y) and radius [px] of the largest bright patch, furrows closed."""
    dark, bright = (float(value) for value in np.quantile(image, (BACKGROUND_QUANTILE, PATCH_QUANTILE)))
    mask = image > dark + max(0.5 * (bright - dark), LEAST_CONTRAST)
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


def _of_motion(
    before: Image, now: Image, noise: float, mask: NDArray[np.bool_], zones: Sequence[NDArray[np.bool_]]
) -> list[float]:
    """Return how the pixels of a patch moved, its edge left out."""
    inner = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    if np.count_nonzero(inner) < LEAST_PX:
        return [0.0] * _OF_MOTION
    speed, change = _motion(before, now, noise)
    inside = speed[inner]
    medians = [float(np.median(speed[part])) if (part := zone & inner).any() else 0.0 for zone in zones]
    return [
        *np.quantile(inside, SPEED_QUANTILES), *np.quantile(change[inner], CHANGE_QUANTILES),
        *(float((inside > least).mean()) for least in MOVING_PX), *medians,
    ]  # fmt: skip


def _motion(before: Image, now: Image, noise: float) -> tuple[Image, Image]:
    """Return each pixel's motion by least squares over its window, and its window's change over slope [px].

    One linear step (Lucas and Kanade 1981): right below a pixel or two, and grows with motion beyond. Noise damps it
    where the picture is plain.
    """
    mean = np.asarray(0.5 * (before + now), np.float32)
    along_x, along_y = (cv2.Sobel(mean, cv2.CV_32F, *order, ksize=3, scale=0.125) for order in ((1, 0), (0, 1)))
    over_time = np.asarray(now - before, np.float32)

    def window(values: Image) -> Image:
        return np.asarray(cv2.boxFilter(values, -1, (WINDOW_PX, WINDOW_PX)), np.float32)

    damping = np.float32(noise**2 + 1e-5)
    xx, yy = (np.maximum(window(slope * slope), 0.0) + damping for slope in (along_x, along_y))
    xy, xt, yt = window(along_x * along_y), window(along_x * over_time), window(along_y * over_time)
    determinant = xx * yy - xy * xy
    speed = np.hypot((yy * xt - xy * yt) / determinant, (xx * yt - xy * xt) / determinant)
    change = np.sqrt(np.maximum(window(over_time * over_time), 0.0) / (xx + yy - damping))
    return np.asarray(speed, np.float32), np.asarray(change, np.float32)


def _noise(raw: Image) -> float:
    """Return the standard deviation of a frame's noise after the blur, by the median of its second differences."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    spread = float(np.median(np.abs(cv2.filter2D(raw, -1, kernel)))) / 0.6745 / 6.0
    return spread / (2.0 * math.sqrt(math.pi) * BLUR_PX)


def _grey(frame: NDArray[np.uint8]) -> Image:
    """Return a frame of one channel, 0 to 1, at most :data:`WIDTH_PX` wide."""
    grey = np.asarray(frame if frame.ndim == 2 else frame.mean(axis=2), np.float32) / np.float32(255.0)
    if grey.shape[1] <= WIDTH_PX:
        return grey
    rows = round(grey.shape[0] * WIDTH_PX / grey.shape[1])
    return np.asarray(cv2.resize(grey, (WIDTH_PX, rows), interpolation=cv2.INTER_AREA))
