"""Time of the reference segmentation: this project's against scikit-image's functions called one after the other.

Both run in one process on the same 2000 x 1500 frames. Three times are taken:

* the function alone, on frames in memory, both in turn: the best of the repeats (what other programs on the machine
  disturb least), then the median over frames; on the wall, and in processor time of all threads;
* the whole process from a folder of PNG files to areas: scikit-image's functions in a loop over the files, as one
  writes it down; ours as `evanesce measure` reads a folder, decoding ahead on threads;
* the same from a folder of uncompressed files (BMP), where decompression does not bound it.

Masks have to be equal to the pixel, or the run fails. Half of the processor time is the least that two cores can take.

    python benchmarks/measure.py [--quick] [--folder FRAMES] [--only WORD] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage import color, filters, io, measure, morphology, util

from evanesce.core.provenance import package_versions
from evanesce.measurement.io.frames import open_frames
from evanesce.measurement.reference.area import measure_frame
from evanesce.measurement.reference.segment import Chain, segment

ROWS, COLS = 1500, 2000
SCALE = 0.0002935


def draw(index: int, *, ridged: bool, colour: bool) -> NDArray[np.uint8]:
    """Return a frame like the rig's: a patch that grows with the index, uneven light, noise and 300 specks."""
    rng = np.random.default_rng([2024, index, ridged, colour])
    y, x = np.mgrid[:ROWS, :COLS].astype(np.float32)
    inside = np.hypot((x - 943) / 1.08, y - 718) < 150 + 60 * index
    # 1 mm pitch at 58.37 px/mm
    pattern = 0.55 + 0.45 * np.sin(2 * np.pi * (x + 0.21 * y) / 58.37) if ridged else 1.0
    level = 9 + 9 * x / COLS + 120 * inside * pattern + rng.normal(0, 3.5, (ROWS, COLS))
    level[rng.integers(0, ROWS, 300), rng.integers(0, COLS, 300)] = 230
    if colour:
        level = level[..., None] * [0.93, 1.03, 1.12] + rng.normal(0, 1.5, (ROWS, COLS, 3))
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)


def draw_noise(kind: str, index: int, *, colour: bool) -> NDArray[np.uint8]:
    """Return a frame with something everywhere: noise in each pixel, or specks all over dark noise."""
    rng = np.random.default_rng([2025, index, len(kind), colour])
    size = (ROWS, COLS, 3) if colour else (ROWS, COLS)
    if kind == "uniform":
        level = rng.uniform(0, 256, size)
    elif kind == "grain":  # blobs of light and dark, 6 pixels wide
        grain = rng.normal(0, 60, (ROWS // 6, COLS // 6 + 1)).repeat(6, axis=0).repeat(6, axis=1)[:, :COLS]
        level = 40 + grain.reshape((ROWS, COLS, 1)[: len(size)]) + rng.normal(0, 3, size)
    else:
        share = {"specks, 1 %": 0.01, "specks, 0.1 %": 0.001}[kind]
        level = rng.normal(8, 2, size) + 240 * (rng.random((ROWS, COLS)) < share).reshape((ROWS, COLS, 1)[: len(size)])
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)


def literal(image: NDArray[np.uint8], threshold: float, min_blob: int) -> NDArray[np.bool_]:
    """Return the mask as one writes the chain down with scikit-image."""
    level = color.rgb2gray(image) if image.ndim == 3 else util.img_as_float(image)
    mask = filters.gaussian(level, sigma=1) > threshold
    dilated = morphology.binary_dilation(mask, morphology.disk(10))
    labels = measure.label(dilated)
    sizes = np.bincount(labels.ravel())
    kept = sizes >= min_blob
    kept[0] = False
    return mask & kept[labels]


def timed(work: Callable[[], Any], repeats: int) -> tuple[list[float], list[float], Any]:
    """Return the times on the wall and of the processor [s] of each repeat, and the last result."""
    wall, processor = [], []
    for _ in range(repeats):
        starts = time.perf_counter(), time.process_time()
        result = work()
        wall.append(time.perf_counter() - starts[0])
        processor.append(time.process_time() - starts[1])
    return wall, processor, result


def folder_of(frames: list[NDArray[np.uint8]], count: int, suffix: str, folder: Path) -> None:
    """Write a folder of so many files, the frames in turn."""
    files = []
    for image in frames:
        good, content = cv2.imencode(suffix, image if image.ndim == 2 else image[..., ::-1])
        assert good
        files.append(content.tobytes())
    for k in range(count):
        (folder / f"frame{k:04d}{suffix}").write_bytes(files[k % len(files)])


def times_of_functions(
    name: str, frames: list[NDArray[np.uint8]], threshold: float, repeats: int
) -> tuple[dict[str, float], list[int]]:
    """Return the times [ms] on decoded frames, the median of each frame's best, and the number of pixels in each."""
    chain = Chain(threshold=threshold)
    times: dict[str, list[float]] = {"literal": [], "ours": [], "literal_processor": [], "ours_processor": []}
    counts = []
    for image in frames:
        best = dict.fromkeys(times, math.inf)
        for _ in range(repeats):
            # in turn, so that whatever else the machine does falls on both
            slow, slow_processor, expected = timed(lambda image=image: literal(image, threshold, 2000), 1)
            fast, fast_processor, found = timed(lambda image=image: segment(image, chain), 4)
            for kind, values in zip(times, (slow, fast, slow_processor, fast_processor), strict=True):
                best[kind] = min(best[kind], *values)
        if not np.array_equal(found.mask, expected):
            sys.exit(f"{name}: {np.count_nonzero(found.mask != expected)} pixels differ from scikit-image's")
        counts.append(found.pixels)
        for kind, value in best.items():
            times[kind].append(value)
    return {f"{key}_ms": 1e3 * statistics.median(values) for key, values in times.items()}, counts


def times_from_files(
    name: str, frames: list[NDArray[np.uint8]], threshold: float, repeats: int, count: int, suffix: str
) -> dict[str, float]:
    """Return the times [ms] a frame of the whole process, from a folder of files to areas, the best of repeats."""
    chain = Chain(threshold=threshold)
    with tempfile.TemporaryDirectory() as folder:
        folder_of(frames, count, suffix, Path(folder))
        paths = sorted(Path(folder).iterdir())
        slow, slow_processor, expected = timed(
            lambda: [int(literal(io.imread(p), threshold, 2000).sum()) for p in paths], 1 if repeats < 3 else 2
        )
        fast, fast_processor, counts = timed(
            lambda: [measure_frame(f, chain, SCALE).estimate.pixels for f in open_frames(folder, 30)], 2 * repeats
        )
    if counts != expected:
        sys.exit(f"{name}: counts from files differ: {counts}, {expected}")
    kind = suffix[1:]
    return {
        f"literal_{kind}_ms": 1e3 * min(slow) / count,
        f"ours_{kind}_ms": 1e3 * min(fast) / count,
        f"literal_{kind}_processor_ms": 1e3 * min(slow_processor) / count,
        f"ours_{kind}_processor_ms": 1e3 * min(fast_processor) / count,
    }


def case(
    name: str, frames: list[NDArray[np.uint8]], threshold: float, repeats: int, folder_count: int
) -> dict[str, Any]:
    """Return all times of one kind of frame [ms] and how many times as fast ours is."""
    times, counts = times_of_functions(name, frames, threshold, repeats)
    for suffix in (".png", ".bmp"):
        times |= times_from_files(name, frames, threshold, repeats, folder_count, suffix)
    ratios = {
        key.replace("ours", "ratio").removesuffix("_ms"): times[key.replace("ours", "literal")] / value
        for key, value in times.items()
        if key.startswith("ours")
    }
    return {
        "case": name,
        "threshold": threshold,
        **{key: round(value, 2) for key, value in times.items()},
        **{key: round(value, 1) for key, value in ratios.items()},
        "share_lit": round(statistics.mean(counts) / (ROWS * COLS), 3),
        "load": os.getloadavg()[0],
    }


CASES: tuple[tuple[str, Callable[[int], NDArray[np.uint8]], float], ...] = (
    ("smooth contact, grey", lambda k: draw(k, ridged=False, colour=False), 0.15),
    ("ridged contact, grey", lambda k: draw(k, ridged=True, colour=False), 0.15),
    ("ridged contact, colour", lambda k: draw(k, ridged=True, colour=True), 0.15),
    ("all lit, grey", lambda k: draw(k, ridged=True, colour=False), 0.0375),
    ("all lit, colour", lambda k: draw(k, ridged=True, colour=True), 0.0375),
    ("uniform noise, grey", lambda k: draw_noise("uniform", k, colour=False), 0.45),
    ("uniform noise, colour", lambda k: draw_noise("uniform", k, colour=True), 0.45),
    ("grain, colour", lambda k: draw_noise("grain", k, colour=True), 0.15),
    ("specks 1 %, colour", lambda k: draw_noise("specks, 1 %", k, colour=True), 0.15),
    ("specks 0.1 %, colour", lambda k: draw_noise("specks, 0.1 %", k, colour=True), 0.15),
)
"""Name, picture of an index, threshold; from the fourth on frames that are lit all over."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two frames a case instead of six")
    parser.add_argument("--folder", type=int, metavar="FRAMES", help="frames of the folder; 20, or 6 with --quick")
    parser.add_argument("--only", default="", metavar="WORD", help="only cases with this in their name")
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    options = parser.parse_args()
    warnings.simplefilter("ignore", FutureWarning)  # scikit-image renames binary_dilation
    count, repeats = (2, 2) if options.quick else (6, 3)
    folder_count = options.folder or (6 if options.quick else 20)
    results = []
    print(f"ms a frame: literal, ours, ratio on the wall (of processor time); folders of {folder_count} frames")
    print(f"{'':24}{'lit':>5}{'function':^36}{'PNG files to areas':^36}{'BMP files to areas':^36}load")
    for name, picture, threshold in CASES:
        if options.only not in name:
            continue
        found = case(name, [picture(k) for k in range(1, count + 1)], threshold, repeats, folder_count)
        results.append(found)
        columns = ""
        for kind in ("", "_png", "_bmp"):
            slow, fast = found[f"literal{kind}_ms"], found[f"ours{kind}_ms"]
            ratios = f"{found[f'ratio{kind}']:.1f} ({found[f'ratio{kind}_processor']:.1f})"
            columns += f"{slow:>10.0f}{fast:>8.1f}{ratios:>14}    "
        print(f"{name:24}{100 * found['share_lit']:>4.0f}%{columns}{found['load']:.1f}", flush=True)
    if options.json:
        record = {
            "frame": [ROWS, COLS],
            "cores": os.cpu_count(),
            "machine": platform.machine(),
            "packages": package_versions(("numpy", "scipy", "scikit-image", "opencv-contrib-python-headless")),
            "cases": results,
        }
        options.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
