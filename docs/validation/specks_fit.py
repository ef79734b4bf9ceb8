"""Statistics of the bright specks on the rig's photograph: how many per area, how bright, how large.

Method. Levels are taken back through BT.709's curve (the camera's own is unknown). A 9 x 9 median is the picture
without specks; specks are local maxima of the difference inside black squares, two pixels off their borders, at least
six robust standard deviations (of the same pixels) high. A speck's light is the sum of the difference over 5 x 5
pixels, in units of the white squares' light around it times area: the area of white paper that would be as bright. The
scale is local, from the corner list. Lights are fitted by maximum likelihood with a log-normal and with a power law,
both cut off where all specks are still found; the one with the larger likelihood is the effect's. Extent is light over
peak, in pixels.

Run: python docs/validation/specks_fit.py PHOTO_FOLDER [--json FILE]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage, optimize, stats
from scipy.interpolate import griddata

LUMA = np.array([0.2125, 0.7154, 0.0721])
SIGMAS = 6.0


def linear(level: np.ndarray) -> np.ndarray:
    """Return linear light of 8-bit levels through the inverse of BT.709."""
    v = level / 255.0
    return np.where(v < 0.081, v / 4.5, ((v + 0.099) / 1.099) ** (1 / 0.45))


def area_per_pixel(folder: Path, shape: tuple[int, int]) -> np.ndarray:
    """Return mm^2 per pixel from the corner list (1 mm squares)."""
    rows = np.loadtxt(folder / "corners.csv", delimiter=",", skiprows=1)
    rows = rows[rows[:, 0] == 1]
    at = {(int(x), int(y)): np.array([u, v]) for _, x, y, u, v in rows}
    centres, areas = [], []
    for (x, y), p in at.items():
        if (x + 1, y) in at and (x, y + 1) in at and (x + 1, y + 1) in at:
            a, b = at[x + 1, y + 1] - p, at[x, y + 1] - at[x + 1, y]
            centres.append((p + at[x + 1, y + 1]) / 2)
            areas.append(2.0 / abs(a[0] * b[1] - a[1] * b[0]))
    v, u = np.mgrid[: shape[0], : shape[1]]
    found = griddata(np.array(centres), np.array(areas), (u, v), method="linear")
    return found  # NaN outside the board's corners: not counted


def fit(light: np.ndarray, cut: float) -> dict[str, float]:
    """Fit both laws to lights above ``cut``."""
    logs = np.log(light[light > cut])

    def log_normal(p: np.ndarray) -> float:
        mean, sd = p[0], np.exp(p[1])
        return -float(np.sum(stats.norm.logpdf(logs, mean, sd)) - logs.size * stats.norm.logsf(np.log(cut), mean, sd))

    best = optimize.minimize(log_normal, [logs.mean(), 0.0], method="Nelder-Mead", options={"maxiter": 4000})
    exponent = 1.0 / np.mean(logs - np.log(cut))
    power = logs.size * np.log(exponent) + exponent * logs.size * np.log(cut) - exponent * logs.sum()
    return {
        "count": logs.size,
        "log_mean": best.x[0],
        "log_sd": float(np.exp(best.x[1])),
        "log_likelihood": -best.fun,
        "power_exponent": exponent,
        "power_error": exponent / np.sqrt(logs.size),
        "power_log_likelihood": power,
    }


def analyse(folder: Path) -> dict[str, object]:
    """Return all figures."""
    image = cv2.imread(str(folder / "checkerboard_1mm.png"))[:, :, ::-1].astype(float)
    grey = image @ LUMA
    median = cv2.medianBlur(np.round(grey).astype(np.uint8), 9).astype(float)
    low, high = ndimage.minimum_filter(median, 41), ndimage.maximum_filter(median, 41)
    black = ndimage.binary_erosion(median < low + 0.25 * (high - low), iterations=2)
    mm2 = area_per_pixel(folder, grey.shape)
    black &= np.isfinite(mm2)
    excess = linear(grey) - linear(median)
    white = linear(high) - linear(low)
    noise = 1.4826 * np.median(np.abs(excess[black] - np.median(excess[black])))
    peak = black & (excess == ndimage.maximum_filter(excess, 3)) & (excess > SIGMAS * noise)
    total = ndimage.uniform_filter(excess, 5) * 25
    peak &= total > 0
    light, level = (total * mm2 / white)[peak], (excess / white)[peak]
    extent = total[peak] / excess[peak]
    v, u = np.nonzero(peak)
    radius = np.hypot(u - 511.5, v - 383.5)
    seen = float(mm2[black].sum()) / 100
    # Where all are still found: a weak speck spread over nine pixels must reach the threshold.
    cut = float(np.median(SIGMAS * noise / white[black] * mm2[black]) * np.median(extent))
    laws = fit(light, cut)
    cells = [
        np.sum((u // 128 == i) & (v // 128 == j))
        / max(black[j * 128 : j * 128 + 128, i * 128 : i * 128 + 128].sum(), 1)
        for i in range(8)
        for j in range(6)
    ]
    return {
        "specks": int(light.size),
        "searched_cm2": seen,
        "per_cm2": light.size / seen,
        "cut_mm2": cut,
        "per_cm2_above_cut": laws["count"] / seen,
        "per_cm2_of_the_whole_log_normal": laws["count"]
        / seen
        / stats.norm.sf((np.log(cut) - laws["log_mean"]) / laws["log_sd"]),
        **laws,
        "light_percentiles_mm2": np.percentile(light, [10, 50, 90, 99]).tolist(),
        "peak_over_white_percentiles": np.percentile(level, [10, 50, 90, 99]).tolist(),
        "extent_px_centre": float(np.median(extent[radius < 200])),
        "extent_px_outside": float(np.median(extent[radius > 400])),
        "mm_per_px": float(np.sqrt(np.nanmedian(mm2))),
        "density_spread": float(np.std(cells) / np.mean(cells)),
    }


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description="Statistics of the specks on the rig's photograph.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    found = analyse(arguments.folder)
    for name, value in found.items():
        values = value if isinstance(value, list) else [value]
        print(f"{name}: " + "  ".join(f"{v:.4g}" for v in values))
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
