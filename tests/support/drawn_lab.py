"""A lab's frames drawn with NumPy and OpenCV alone: a ridged elliptical contact of known area, blur, glow, dust, noise.

Nothing here comes from the package: the tone curve is ITU-R BT.709-6's, written out; areas are counted on 4 x 4 points
a pixel.
"""

from __future__ import annotations

import cv2
import numpy as np

FINER = 4


def bt709(light):
    """Return grey levels 0 to 1 of linear light."""
    light = np.clip(light, 0.0, 1.0)
    return np.where(light < 0.018, 4.5 * light, 1.099 * np.maximum(light, 0.018) ** 0.45 - 0.099)


def on_plate(shape, fine, focal_px, k1, clear, thickness, index):
    """Return where fine pixels look on a plate's far face [mm], (x, y): Brown's formula inverted, Snell's law.

    ``clear``, ``thickness``: from the pinhole to the plate, and of the plate [mm].
    """
    rows, cols = shape
    u, v = np.meshgrid(*((np.arange(n * fine) + 0.5) / fine - 0.5 for n in (cols, rows)))
    xd, yd = (u - (cols - 1) / 2) / focal_px, (v - (rows - 1) / 2) / focal_px
    x, y = xd, yd
    for _ in range(40):
        bend = 1 + k1 * (x**2 + y**2)
        x, y = xd / bend, yd / bend
    inside = np.sqrt((1 + x**2 + y**2) * index**2 - (x**2 + y**2))
    return x * (clear + thickness / inside), y * (clear + thickness / inside)


def contact(shape, middle, axes, angle=0.3, ridges=None):
    """Return the share of each pixel in contact; ``ridges``: period [px] and share of it that is ridge."""
    rows, cols = shape
    y, x = np.mgrid[: rows * FINER, : cols * FINER].astype(np.float32)
    x, y = (x + 0.5) / FINER - 0.5 - middle[0], (y + 0.5) / FINER - 0.5 - middle[1]
    u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    inside = (u / axes[0]) ** 2 + (v / axes[1]) ** 2 < 1
    if ridges is not None:
        period, part = ridges
        inside &= np.abs((u / period) % 1 - 0.5) < part / 2
    return inside.reshape(rows, FINER, cols, FINER).mean(axis=(1, 3))


def dust(shape, rng, count=30, level=0.3):
    """Return light of specks of 1 to 4 px radius, the same in every frame."""
    found = np.zeros(shape)
    for _ in range(count):
        at = int(rng.integers(0, shape[1])), int(rng.integers(0, shape[0]))
        cv2.circle(found, at, int(rng.integers(1, 5)), float(level * rng.uniform(0.3, 1.0)), -1)
    return found


def frame(share, rng, *, step=0.35, ground=0.01, glow=0.0, glow_px=25.0, blur=1.2, noise=0.004, specks=None, tint=None):
    """Return an 8-bit frame of a contact; ``tint``: a colour's three factors."""
    rows, cols = share.shape
    y, x = np.mgrid[:rows, :cols]
    light = step * share * (1 + 0.1 * (x / cols - 0.5) + 0.05 * (y / rows - 0.5)) + ground
    if glow:
        light = light + glow * step * cv2.GaussianBlur(share, (0, 0), glow_px)
    if specks is not None:
        light = light + specks
    light = cv2.GaussianBlur(light, (0, 0), blur)
    if tint is not None:
        light = light[..., None] * np.array(tint)
    light = light + rng.normal(0, noise, light.shape)
    return np.clip(np.rint(255 * bt709(light)), 0, 255).astype(np.uint8)
