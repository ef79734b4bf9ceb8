"""Time of the reference segmentation: this project's against scikit-image's functions called one after the other.

Both run in one process on the same 2000 x 1500 frames, then on the same folder of PNG files: scikit-image's functions
in a loop over the files, as one writes it down; ours as `evanesce measure` reads a folder, decoding ahead on threads.
Pixel counts have to be equal, or the run fails. Beside the time on the wall stands the processor time of all threads,
which other programs on the machine disturb less; half of it is the least that two cores can take.

    python benchmarks/measure.py [--quick] [--folder FRAMES] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
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


def literal(image: NDArray[np.uint8], threshold: float, min_blob: int) -> int:
    """Return the chain's pixel count as one writes it down with scikit-image."""
    level = color.rgb2gray(image) if image.ndim == 3 else util.img_as_float(image)
    mask = filters.gaussian(level, sigma=1) > threshold
    dilated = morphology.binary_dilation(mask, morphology.disk(10))
    labels = measure.label(dilated)
    sizes = np.bincount(labels.ravel())
    kept = sizes >= min_blob
    kept[0] = False
    return int((mask & kept[labels]).sum())


def timed(work: Callable[[], Any], repeats: int) -> tuple[list[float], Any]:
    """Return the times [s] of each repeat and the last result."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return times, result


def folder_of(frames: list[NDArray[np.uint8]], count: int, folder: Path) -> list[Path]:
    """Write a folder of so many PNG files, the frames in turn; return their paths."""
    files = []
    for image in frames:
        good, content = cv2.imencode(".png", image if image.ndim == 2 else image[..., ::-1])
        assert good
        files.append(content.tobytes())
    paths = [folder / f"frame{k:04d}.png" for k in range(count)]
    for k, path in enumerate(paths):
        path.write_bytes(files[k % len(files)])
    return paths


def case(
    name: str, frames: list[NDArray[np.uint8]], threshold: float, repeats: int, folder_count: int
) -> dict[str, Any]:
    """Time both chains on decoded frames, the median over frames and repeats, and on a folder, the best of repeats."""
    chain = Chain(threshold=threshold)
    slow, fast, counts = [], [], []
    for image in frames:
        # in turn, so that whatever else the machine does falls on both
        t_slow, expected = timed(lambda image=image: literal(image, threshold, 2000), 1)
        t_fast, found = timed(lambda image=image: segment(image, chain).pixels, repeats)
        if found != expected:
            sys.exit(f"{name}: {found} pixels, scikit-image {expected}")
        slow, fast, counts = slow + t_slow, fast + t_fast, [*counts, found]
    with tempfile.TemporaryDirectory() as folder:
        paths = folder_of(frames, folder_count, Path(folder))
        start = time.process_time()
        t_slow_files, slow_counts = timed(lambda: [literal(io.imread(p), threshold, 2000) for p in paths], 1)
        slow_processor = time.process_time() - start

        def read_and_measure() -> list[int]:
            return [measure_frame(f, chain, SCALE).estimate.pixels for f in open_frames(folder, 30)]

        start = time.process_time()
        t_fast_files, fast_counts = timed(read_and_measure, repeats)
        fast_processor = (time.process_time() - start) / repeats
    expected_counts = [counts[k % len(counts)] for k in range(folder_count)]
    if not fast_counts == slow_counts == expected_counts:
        sys.exit(f"{name}: counts from files differ: {fast_counts}, {slow_counts}, {expected_counts}")
    milliseconds = {
        "literal_ms": 1e3 * statistics.median(slow),
        "ours_ms": 1e3 * statistics.median(fast),
        "literal_from_png_ms": 1e3 * t_slow_files[0] / folder_count,
        "ours_from_png_ms": 1e3 * min(t_fast_files) / folder_count,
        "literal_processor_ms": 1e3 * slow_processor / folder_count,
        "ours_processor_ms": 1e3 * fast_processor / folder_count,
    }
    return {
        "case": name,
        **{key: round(value, 2) for key, value in milliseconds.items()},
        "ratio": round(milliseconds["literal_ms"] / milliseconds["ours_ms"], 1),
        "ratio_from_png": round(milliseconds["literal_from_png_ms"] / milliseconds["ours_from_png_ms"], 1),
        "pixels": counts,
        "load": os.getloadavg()[0],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two frames a case instead of six")
    parser.add_argument("--folder", type=int, metavar="FRAMES", help="frames of the folder; 40, or 6 with --quick")
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    options = parser.parse_args()
    warnings.simplefilter("ignore", FutureWarning)  # scikit-image renames binary_dilation
    count, repeats = (2, 3) if options.quick else (6, 5)
    folder_count = options.folder or (6 if options.quick else 40)
    results = []
    columns = f"{'literal':>10}{'ours':>9}{'ratio':>7}"
    print(f"{'case':24}{columns}   folder of {folder_count:<3}{columns}")
    for name, ridged, colour, threshold in (
        ("smooth, grey", False, False, 0.15),
        ("ridged, grey", True, False, 0.15),
        ("ridged, colour", True, True, 0.15),
        ("all lit, colour", True, True, 0.0375),
    ):
        frames = [draw(k, ridged=ridged, colour=colour) for k in range(1, count + 1)]
        found = case(name, frames, threshold, repeats, folder_count)
        results.append(found)
        print(
            f"{name:24}{found['literal_ms']:>7.0f} ms{found['ours_ms']:>6.1f} ms{found['ratio']:>6.1f}x"
            f"             {found['literal_from_png_ms']:>6.0f} ms{found['ours_from_png_ms']:>6.1f} ms"
            f"{found['ratio_from_png']:>6.1f}x   processor {found['literal_processor_ms']:.0f},"
            f" {found['ours_processor_ms']:.1f} ms; load {found['load']:.1f}",
            flush=True,
        )
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
