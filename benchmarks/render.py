"""Path tracer: paths per second, and seconds per megapixel at equal error, for each variant family side by side.

A path is one camera sample. The error is the relative standard deviation of a pixel inside the contact, from the
variance that the passes measure; time to a given error follows because variance falls as one over the samples. All
pixels are inside the contact of the thesis rig's smooth finger at 2 N: the costly ones.

    python benchmarks/render.py [--quick] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.contact.solve import contact_state
from evanesce.optics.projection import IdealView, Projection
from evanesce.provenance import package_versions
from evanesce.render.path import render
from evanesce.render.variant import attempts, find
from evanesce.rig import load_scene

TARGET = 0.05  # relative; about the shot noise of one 8-bit step at mid grey
SEED = 20240611


def contact_view(scene: Any, pixels: int) -> IdealView:
    """Return a square view of the camera's own scale, in the middle of the field."""
    projection = Projection.of(scene.camera, scene.plate)
    middle = (pixels - 1) / 2
    return IdealView((pixels, pixels), projection.focal_px, (middle, middle))


def case(variant: str, *, connect: bool, pixels: int, samples: int, repeats: int) -> dict[str, Any]:
    """Return speed and noise of one way to render."""
    scene = load_scene("thesis")
    state = contact_state(scene, 2.0)
    options: dict[str, Any] = {
        "variant": variant, "connect": connect, "focus": False, "passes": 4, "view": contact_view(scene, pixels),
    }  # fmt: skip
    render(scene, state, samples_per_pixel=4, seed=SEED, **options)  # compiles
    times, lights = [], []
    for k in range(repeats):
        start = time.perf_counter()
        lights.append(render(scene, state, samples_per_pixel=samples, seed=SEED + k, **options))
        times.append(time.perf_counter() - start)
    mean = np.mean([light.radiance.mean() for light in lights])
    variance = np.mean([light.variance.mean() for light in lights]) * samples / mean**2
    error = np.sqrt(np.mean([light.variance.sum() for light in lights]) / repeats) / pixels**2
    paths_per_s = pixels**2 * samples / min(times)
    return {
        "variant": find(variant).name,
        "connections": connect,
        "paths_per_s": paths_per_s,
        "relative_deviation_per_path": float(np.sqrt(variance)),
        "seconds_per_megapixel_at_5_percent": float(variance / TARGET**2 * 1e6 / paths_per_s),
        "radiance": float(mean),
        "radiance_error": float(error),
    }


def whole_frame(variant: str, samples: int) -> dict[str, Any]:
    """Return the time of a whole frame as `evanesce render` makes it: samples around the contact, few elsewhere."""
    scene = load_scene("thesis")
    state = contact_state(scene, 2.0)
    start = time.perf_counter()
    light = render(scene, state, variant=variant, samples_per_pixel=samples, passes=2, seed=SEED)
    return {
        "variant": find(variant).name,
        "pixels": list(light.radiance.shape),
        "samples_per_pixel": samples,
        "seconds": time.perf_counter() - start,
    }


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a few seconds, for a check that it runs")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results as JSON")
    options = parser.parse_args()
    pixels, samples, repeats = (48, 64, 1) if options.quick else (128, 128, 3)
    wanted = [("llvm", True), ("llvm", False), ("scalar", False)]
    if attempts("cuda")[-1].works:
        wanted.insert(0, ("cuda", True))
    results = []
    print(f"{'variant':16}{'connections':>12}{'paths/s':>12}{'deviation/path':>16}{'s/Mpx at 5 %':>14}   radiance")
    for variant, connect in wanted:
        tried = attempts(variant)
        if not (tried and tried[-1].works):
            print(f"{variant:16}does not work here")
            continue
        found = case(variant, connect=connect, pixels=pixels, samples=samples, repeats=repeats)
        results.append(found)
        print(
            f"{found['variant']:16}{'yes' if connect else 'no':>12}{found['paths_per_s']:>12.3g}"
            f"{found['relative_deviation_per_path']:>16.2f}{found['seconds_per_megapixel_at_5_percent']:>14.0f}"
            f"   {found['radiance']:.4g} +- {found['radiance_error']:.1g}"
        )
    frame = whole_frame("auto", 4 if options.quick else 16)
    print(f"whole frame {frame['pixels']}, {frame['samples_per_pixel']} paths/px: {frame['seconds']:.1f} s")
    if options.json:
        record = {
            "cores": os.cpu_count(),
            "machine": platform.machine(),
            "packages": package_versions(("mitsuba", "drjit", "numpy")),
            "llvm": find("auto").backend_version,
            "cases": results,
            "whole_frame": frame,
        }
        options.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
