"""Light at the border of the rig's photograph: how strong against the white squares, how far in, how unlike its sides.

Method. Levels go back through BT.709's curve. Along each side the lower envelope (a 41-pixel minimum of the 9 x 9
median, so that black squares count) is averaged over the middle four fifths of the side; a constant plus an
exponential in the distance from the border is fitted over 250 pixels. The brightest veil is the highest excess of the
smoothed light over the median of its column, and its size that of the region above half of it.

Run: python docs/validation/edge_reflections_fit.py PHOTO_FOLDER
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage, optimize

LUMA = np.array([0.2125, 0.7154, 0.0721])
MM_PER_PX = 0.0373


def linear(level: np.ndarray) -> np.ndarray:
    """Return linear light of 8-bit levels through the inverse of BT.709."""
    v = level / 255.0
    return np.where(v < 0.081, v / 4.5, ((v + 0.099) / 1.099) ** (1 / 0.45))


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description="Light at the border of the rig's photograph.")
    parser.add_argument("folder", type=Path)
    image = cv2.imread(str(parser.parse_args().folder / "checkerboard_1mm.png"))[:, :, ::-1].astype(float)
    light = linear(cv2.medianBlur(np.round(image @ LUMA).astype(np.uint8), 9))
    floor = ndimage.minimum_filter(light, 41)
    white = float(np.median(ndimage.maximum_filter(light, 41)[284:484, 412:612]))
    sides = {"left": floor, "right": floor[:, ::-1], "top": floor.T, "bottom": floor[::-1].T}
    for name, side in sides.items():
        rows = side.shape[0]
        mean = side[rows // 10 : -rows // 10, :250].mean(axis=0) / white
        x = np.arange(mean.size) + 0.5
        (base, rise, decay), _ = optimize.curve_fit(
            lambda t, a, b, c: a + b * np.exp(-t / c), x, mean, p0=(0.05, 0.1, 40.0), bounds=([0, 0, 5], [1, 2, 150])
        )
        print(f"{name}: base {base:.3f}, rise {rise:.3f} of the white level, decay {decay * MM_PER_PX:.2f} mm")
    base = np.median(floor)
    seen = ndimage.gaussian_filter(light, 12)
    left = seen[200:600, :120] - np.median(seen[200:600, :120], axis=0)
    v, u = np.unravel_index(np.argmax(left), left.shape)
    region, _ = ndimage.label(left > left[v, u] / 2)
    here = region == region[v, u]
    height, width = np.ptp(np.nonzero(here)[0]) + 1, np.ptp(np.nonzero(here)[1]) + 1
    print(f"floor in the frame's middle: {base / white:.3f} of the white level")
    print(
        f"brightest veil: {left[v, u] / white:.3f} of the white level at column {u}, row {v + 200},"
        f" {width * MM_PER_PX:.1f} x {height * MM_PER_PX:.1f} mm above half"
    )


if __name__ == "__main__":
    main()
