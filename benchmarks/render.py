"""Path tracer: paths per second, and seconds per megapixel at equal error, for each variant family side by side.

A path is one camera sample. The error is the relative standard deviation of a pixel inside the contact, from the
variance that the passes measure; time to a given error follows because variance falls as one over the samples. All
pixels are inside the contact of the thesis rig's smooth finger at 2 N: the costly ones.

Two more ratios at equal error: LED groups by one set of paths against one rendering for each edge, and passes until an
error against the passes that the worst case would have had to be given in advance.

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
from evanesce.core.provenance import package_versions
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.reference.led_groups import LedGroups
from evanesce.render.reference.passes import relative_error
from evanesce.render.reference.path import render, render_groups
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


def grouped(variant: str, *, pixels: int, samples: int, repeats: int) -> dict[str, Any]:
    """Return what it takes to know the light of every edge to one error: all by the same paths, and edge by edge."""
    scene = load_scene("thesis")
    state = contact_state(scene, 2.0)
    powers = dict.fromkeys(LedGroups.of(scene).names, 1.0)
    options: dict[str, Any] = {
        "variant": variant, "powers": powers, "focus": False, "passes": 4, "view": contact_view(scene, pixels),
    }  # fmt: skip
    ways: dict[str, Any] = {
        "together": lambda spp, seed: render_groups(scene, state, samples_per_pixel=spp, seed=seed, **options),
        "apart": lambda spp, seed: {
            edge: render(
                scene, state, leds="all", samples_per_pixel=spp, seed=seed, **options | {"powers": {edge: 1.0}}
            )
            for edge in powers
        },
    }
    found: dict[str, Any] = {"groups": len(powers)}
    for name, way in ways.items():
        way(4, SEED)  # compiles
        costs, errors = [], []
        for k in range(repeats):
            # Of the processor, all threads: the ratio then holds on a machine that others use as well.
            start = time.process_time()
            lights = way(samples, SEED + k)
            costs.append(time.process_time() - start)
            errors.append([relative_error(light) for light in lights.values()])
        # The worst edge decides; its mean square over the repeats.
        worst = float(np.sqrt(np.max(np.mean(np.square(errors), axis=0))))
        found[name] = {
            "seconds": min(costs),
            "worst_relative_error": worst,
            "seconds_times_variance": min(costs) * worst**2,
        }
    found["equal_error_ratio"] = found["apart"]["seconds_times_variance"] / found["together"]["seconds_times_variance"]
    return found


def adaptive(variant: str, *, pixels: int, samples: int) -> dict[str, Any]:
    """Return the passes that one error takes at a light and at a heavy force, and what the worst of them would cost."""
    scene = load_scene("thesis_ridged")
    found: dict[str, Any] = {"target": TARGET, "passes": {}, "seconds": {}, "reached": {}}
    for force in (0.2, 1.0, 5.0):
        state = contact_state(scene, force)
        start = time.perf_counter()
        light = render(
            scene, state, variant=variant, samples_per_pixel=4 * samples, passes=4, until_error=TARGET, focus=False,
            seed=SEED, view=contact_view(scene, pixels),
        )  # fmt: skip
        key = f"{force:g} N"
        found["seconds"][key] = time.perf_counter() - start
        found["passes"][key] = light.samples // samples
        found["reached"][key] = relative_error(light)
    counts = list(found["passes"].values())
    found["ratio"] = max(counts) * len(counts) / sum(counts)
    return found


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


def variants(pixels: int, samples: int, repeats: int) -> list[dict[str, Any]]:
    """Measure every variant that works, print, return."""
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
    return results


def groups(pixels: int, samples: int, repeats: int) -> dict[str, Any]:
    """Measure LED groups, print, return."""
    found = grouped("auto", pixels=pixels, samples=samples, repeats=repeats)
    for name in ("together", "apart"):
        way = found[name]
        print(f"{found['groups']} edges {name}: {way['seconds']:.1f} s of processor, worst error", end=" ")
        print(f"{100 * way['worst_relative_error']:.1f} %")
    print(f"by the same paths at equal error: {found['equal_error_ratio']:.2f} times as fast")
    return found


def until_error(pixels: int, samples: int, repeats: int) -> dict[str, Any]:
    """Measure passes until an error, print, return."""
    found = adaptive("auto", pixels=pixels, samples=max(samples // 8, 2))
    passes = ", ".join(
        f"{key}: {count} ({100 * found['reached'][key]:.2f} %)" for key, count in found["passes"].items()
    )
    print(f"passes to {100 * TARGET:g} %: {passes}; as many for all as the worst takes: {found['ratio']:.2f} x")
    return found


def frame(pixels: int, samples: int, repeats: int) -> dict[str, Any]:
    """Measure a whole frame, print, return."""
    found = whole_frame("auto", max(samples // 8, 2))
    print(f"whole frame {found['pixels']}, {found['samples_per_pixel']} paths/px: {found['seconds']:.1f} s")
    return found


PARTS = {"variants": variants, "led_groups": groups, "until_error": until_error, "whole_frame": frame}


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a few seconds, for a check that it runs")
    parser.add_argument("--part", choices=PARTS, action="append", help="only this (repeatable)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results as JSON")
    options = parser.parse_args()
    size = (48, 64, 1) if options.quick else (128, 128, 3)
    results = {name: PARTS[name](*size) for name in options.part or PARTS}
    if options.json:
        record = {
            "cores": os.cpu_count(),
            "load": os.getloadavg()[0],
            "machine": platform.machine(),
            "packages": package_versions(("mitsuba", "drjit", "numpy")),
            "llvm": find("auto").backend_version,
            **results,
        }
        options.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
