"""Time of the corner search beside OpenCV's sector finder (`findChessboardCornersSB`), on the same drawn boards.

Ten pictures a case, drawn here with NumPy: pinhole, k1 = -0.18, tilted boards, blur of 1 px, noise, JPEG. Both run on a
single thread, in turn, so that whatever else the machine does falls on both; the best of the repeats counts, the median
over the pictures is printed, in processor time. OpenCV's finder has to be told how many corners there are; ours finds
out. Found within 0.5 px of the true place counts as found; the RMS is that of these corners.

    python benchmarks/calibrate.py [--quick] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from evanesce.core.provenance import package_versions
from evanesce.measurement.calibration.corners import find_corners

SIDE = 2.0
CASES = (
    ("640 x 480, 17 x 13 squares", (640, 480), (17, 13)),
    ("1280 x 960, 17 x 13 squares", (1280, 960), (17, 13)),
    ("1280 x 960, 42 x 31 squares", (1280, 960), (42, 31)),
    ("2000 x 1500, 17 x 13 squares", (2000, 1500), (17, 13)),
)


def draw(
    rng: np.random.Generator, size: tuple[int, int], squares: tuple[int, int]
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return a picture of a tilted board with white paper around it, and the true places of its corners."""
    (cols, rows), (nx, ny), k1, ways = size, squares, -0.18, 5
    focal = 0.86 * cols
    rotation = cv2.Rodrigues(rng.uniform(-0.25, 0.25, 3))[0]
    far = nx * SIDE * focal / cols * rng.uniform(1.35, 1.55)
    shift = np.array([*rng.uniform(-0.05, 0.05, 2) * far, far])
    plane = np.column_stack([rotation[:, 0], rotation[:, 1], shift])
    v, u = np.indices((rows, cols))
    xd, yd = (u - (cols - 1) / 2) / focal, (v - (rows - 1) / 2) / focal
    x, y = xd.copy(), yd.copy()
    for _ in range(10):
        radial = 1 + k1 * (x * x + y * y)
        x, y = xd / radial, yd / radial
    seen = np.tensordot(np.linalg.inv(plane), np.stack([x, y, np.ones_like(x)]), 1)
    i, j = (seen[0] / seen[2] / SIDE + nx / 2, seen[1] / seen[2] / SIDE + ny / 2)
    (i_v, i_u), (j_v, j_u) = np.gradient(i), np.gradient(j)
    light, fine = np.zeros((rows, cols)), (np.arange(ways) + 0.5) / ways - 0.5
    for a in range(ways):
        for b in range(ways):
            du, dv = fine[a] + fine[b] / ways, fine[b] + fine[a] / ways
            p, q = i + i_u * du + i_v * dv, j + j_u * du + j_v * dv
            dark = (p > 0) & (p < nx) & (q > 0) & (q < ny) & ((np.floor(p) + np.floor(q)) % 2 == 0)
            light += np.where(dark, 30.0, 200.0) / ways**2
    noisy = cv2.GaussianBlur(light, (0, 0), 1.0) + rng.normal(0, 2, light.shape)
    _, packed = cv2.imencode(".jpg", np.clip(noisy, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 90])
    m, n = np.meshgrid(np.arange(1, nx), np.arange(1, ny))
    flat = SIDE * np.stack([m.ravel() - nx / 2, n.ravel() - ny / 2, np.full(m.size, 1 / SIDE)])
    at = plane @ flat
    x, y = at[0] / at[2], at[1] / at[2]
    radial = 1 + k1 * (x * x + y * y)
    true = np.stack([focal * x * radial + (cols - 1) / 2, focal * y * radial + (rows - 1) / 2], axis=-1)
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), np.uint8), true


def sectors(picture: NDArray[np.uint8], squares: tuple[int, int]) -> NDArray[np.float64]:
    """Return OpenCV's corners, none where it finds no board."""
    found, corners = cv2.findChessboardCornersSB(picture, (squares[0] - 1, squares[1] - 1))
    return corners.reshape(-1, 2).astype(np.float64) if found else np.empty((0, 2))


def timed(work: Callable[[], NDArray[np.float64]]) -> tuple[float, NDArray[np.float64]]:
    """Return processor time [s] and result."""
    begun = time.process_time()
    found = work()
    return time.process_time() - begun, found


def case(name: str, size: tuple[int, int], squares: tuple[int, int], pictures: int, repeats: int) -> dict[str, Any]:
    """Return the times [s], their ratio, and how well either finds the corners."""
    rng = np.random.default_rng([7, size[0], squares[0]])
    best: dict[str, list[float]] = {"ours": [], "opencv": []}
    within: dict[str, int] = dict.fromkeys(best, 0)
    squared = dict.fromkeys(best, 0.0)
    total = 0
    for _ in range(pictures):
        picture, true = draw(rng, size, squares)
        total += len(true)
        works: dict[str, Callable[[], NDArray[np.float64]]] = {
            "ours": lambda picture=picture: find_corners(picture).fit.position,
            "opencv": lambda picture=picture: sectors(picture, squares),
        }
        times: dict[str, list[float]] = {"ours": [], "opencv": []}
        for _ in range(repeats):
            for kind, work in works.items():
                spent, found = timed(work)
                times[kind].append(spent)
                if len(times[kind]) == 1 and len(found):
                    off = KDTree(found).query(true)[0]
                    within[kind] += int((off < 0.5).sum())
                    squared[kind] += float((off[off < 0.5] ** 2).sum())
        for kind, spent_all in times.items():
            best[kind].append(min(spent_all))
    ratios = [a / b for a, b in zip(best["ours"], best["opencv"], strict=True)]
    return {
        "case": name, "corners": total,
        **{f"{kind}_s": round(statistics.median(values), 3) for kind, values in best.items()},
        "ratio": round(statistics.median(ratios), 2),
        **{f"{kind}_found": within[kind] for kind in best},
        **{f"{kind}_rms_px": round(float(np.sqrt(squared[kind] / max(within[kind], 1))), 3) for kind in best},
        "load": os.getloadavg()[0],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="three pictures a case instead of ten")
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    pictures, repeats = (3, 2) if options.quick else (10, 4)
    find_corners(draw(np.random.default_rng(0), (640, 480), (17, 13))[0])  # imports and caches
    results = []
    print("s a picture of processor time; corners found within 0.5 px, and their RMS")
    print(
        f"{'':30}{'ours':>8}{'OpenCV':>8}{'ratio':>7}{'corners':>9}{'ours':>8}{'RMS px':>8}{'OpenCV':>8}{'RMS px':>8}"
    )
    for name, size, squares in CASES:
        found = case(name, size, squares, pictures, repeats)
        results.append(found)
        print(
            f"{name:30}{found['ours_s']:>8.3f}{found['opencv_s']:>8.3f}{found['ratio']:>7.2f}{found['corners']:>9}"
            f"{found['ours_found']:>8}{found['ours_rms_px']:>8.3f}{found['opencv_found']:>8}{found['opencv_rms_px']:>8.3f}",
            flush=True,
        )
    if options.json:
        record = {
            "cores": os.cpu_count(),
            "machine": platform.machine(),
            "packages": package_versions(("numpy", "scipy", "opencv-contrib-python-headless")),
            "cases": results,
        }
        options.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
