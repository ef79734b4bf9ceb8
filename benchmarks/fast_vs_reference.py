"""The fast renderer against the path tracer: agreement, frames per second, equal-error speed-up.

The agreement is measured with pixels a few times as large (the light is the same, the noise of the reference less);
the speed at the camera's own 2000 x 1500.

    python benchmarks/fast_vs_reference.py [--quick] [--json FILE] [--samples N] [--coarser K] [--cases 0,3,4]
        [--part rates,agreement,cost]

Parts that are run apart gather in one FILE; what follows from all of them is added when they are there.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import resource
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.chain.fast import FastCamera
from evanesce.contact.solve import contact_state
from evanesce.core.provenance import package_versions
from evanesce.evaluation.agreement import Case, agreement, cases, coarser
from evanesce.optics.projection import Projection
from evanesce.render.fast.operators_llvm import llvm_works
from evanesce.render.fast.rig_fields import compute_rig_fields
from evanesce.render.fast.transport import render_fast
from evanesce.render.reference.path import render
from evanesce.render.reference.views import scaled_view
from evanesce.rig import load_scene


def measure_agreement(case: Case, samples: int, groups: int = 4) -> dict[str, Any]:
    """Compare one case with ``groups`` independent renderings of the reference."""
    start = time.perf_counter()
    passes = [
        render(case.scene, case.state, samples_per_pixel=samples // groups, passes=2, seed=1000 + k)
        for k in range(groups)
    ]
    seconds = time.perf_counter() - start
    found = agreement(case, passes, render_fast(case.scene, case.state))
    name, worst = found.worst
    print(
        f"{case.name:26s} level {100 * (found.level - 1):+.2f} % +- {100 * found.level_error:.2f}"
        f"   mean |d| {found.mean_abs_DN:.2f} DN (noise {found.noise_DN:.2f})   worst {worst:+.2f} DN in {name}"
        f" +- {found.regions[name][1]:.2f}   area {100 * found.area_bias:+.2f} % +- {100 * found.area_error:.2f}"
        f"   {seconds:.0f} s",
        flush=True,
    )
    return {"name": case.name, "reference_s": seconds, "worst_region": name, "worst_dn": worst} | dataclasses.asdict(
        found
    )


SURROUNDINGS = {
    "spill": {"share": 0.3},
    "haze": {"top_share": 0.004, "bottom_share": 0.002},
    "backdrop": {"reflectance": 0.3},
}
"""All causes of light beside the contact at once."""


def frame_rate(
    backend: str, count: int, scene_name: str = "thesis_ridged", changes: dict[str, Any] | None = None
) -> dict[str, float]:
    """Time frames of a pressing finger at the camera's resolution, each another state and other noise."""
    scene = load_scene(scene_name, changes)
    states = [contact_state(scene, 4.0 + 0.25 * k) for k in range(5)]
    camera = FastCamera(scene, backend)  # type: ignore[arg-type]
    for state in states:
        camera.frame(state, seed=1)
    times = []
    for k in range(count):
        start = time.perf_counter()
        camera.frame(states[k % 5], seed=1, index=k)
        times.append(time.perf_counter() - start)
    # Where the machine is shared, the quietest ten frames in a row tell more of the program than the median does.
    quiet = min(statistics.mean(times[k : k + 10]) for k in range(len(times) - 9))
    return {"best_ms": 1e3 * min(times), "quiet_ms": 1e3 * quiet, "median_ms": 1e3 * statistics.median(times)}


def reference_cost(samples: int = 32) -> dict[str, float]:
    """Return the plain path tracer's relative variance per path, and its time for one path per pixel of a frame."""
    scene = load_scene("thesis")
    state = contact_state(scene, 5.0)
    full = Projection.of(scene.camera, scene.plate).ideal_view()
    view = scaled_view(full, 0.25)
    found = {}
    for name, connect in (("plain", False), ("connected", True)):
        start = time.perf_counter()
        render(scene, state, view=view, samples_per_pixel=2, passes=2, focus=False, connect=connect, seed=3)
        ready = time.perf_counter()
        light = render(scene, state, view=view, samples_per_pixel=samples, passes=4, focus=False, connect=connect)
        seconds = time.perf_counter() - ready
        # The same compilation is in both; the first had next to nothing to trace.
        seconds = max(seconds - (ready - start), 0.2 * seconds)
        fast = render_fast(scene, state, view=view).radiance
        inner = fast > 0.9 * fast.max()
        relative = float(light.variance[inner].mean() * light.samples / light.radiance[inner].mean() ** 2)
        scale = full.shape[0] * full.shape[1] / (view.shape[0] * view.shape[1])
        found[f"{name}_variance"] = relative
        found[f"{name}_s_per_path"] = seconds / light.samples * scale
    return found


def measure_rates(quick: bool) -> dict[str, Any]:
    """Time precomputation and frames."""
    start, cpu = time.perf_counter(), time.process_time()
    compute_rig_fields(load_scene("thesis"))
    found: dict[str, Any] = {
        "precompute_s": time.perf_counter() - start,
        "precompute_cpu_s": time.process_time() - cpu,
        "rates": {name: frame_rate(name, 40 if quick else 150) for name in ("llvm", "numpy")},
        "colour_rates": {
            name: frame_rate(name, 40 if quick else 150, "thesis_ridged_red") for name in ("llvm", "numpy")
        },
        "lit_colour_rates": {
            name: frame_rate(name, 40 if quick else 150, "thesis_ridged_red", {"surroundings": SURROUNDINGS})
            for name in ("llvm", "numpy")
        },
        "peak_memory_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "load": os.getloadavg()[0],
    }
    lit, plain = found["lit_colour_rates"], found["colour_rates"]
    found["surroundings_over_none"] = {name: lit[name]["quiet_ms"] / plain[name]["quiet_ms"] for name in lit}
    print("colour frames with surroundings over those without:", found["surroundings_over_none"])
    for kind, rates in (("grey", found["rates"]), ("colour", plain), ("colour, surroundings", lit)):
        for name, rate in rates.items():
            print(kind, name, ", ".join(f"{key} {value:.1f}" for key, value in rate.items()), "a frame")
    return found


def measure_cases(numbers: list[int], factor: int, samples: int) -> dict[str, Any]:
    """Compare the cases of the given numbers, with pixels ``factor`` times as large."""
    chosen = cases(coarser(factor))
    return {"coarser": factor, "samples": samples, "cases": [measure_agreement(chosen[k], samples) for k in numbers]}


def conclusions(parts: dict[str, Any]) -> dict[str, Any]:
    """Return the figures that follow from all three parts."""
    rows, cost, rates = parts["cases"], parts["cost"], parts["rates"]
    # Error of the fast renderer: what is left in its levels, but never less than what could be seen of it.
    bias = max(float(np.sqrt(np.mean([(r["level"] - 1) ** 2 + r["level_error"] ** 2 for r in rows]))), 1e-3)
    paths = cost["plain_variance"] / bias**2
    frame_s = rates["llvm"]["quiet_ms"] * 1e-3
    reference_s = paths * cost["plain_s_per_path"]
    return {
        "mean_abs_dn": max(r["mean_abs_DN"] for r in rows),
        "worst_region_dn": max(abs(r["worst_dn"]) for r in rows),
        "area_bias_pct": 100 * max(abs(r["area_bias"]) for r in rows),
        "frames_per_s": 1 / frame_s,
        "frames_per_s_median": 1e3 / rates["llvm"]["median_ms"],
        "frames_per_s_numpy": 1e3 / rates["numpy"]["quiet_ms"],
        "frames_per_s_numpy_median": 1e3 / rates["numpy"]["median_ms"],
        "equal_error_speedup": reference_s / frame_s,
        "equal_error_speedup_1000_frames": reference_s / (frame_s + parts["precompute_s"] / 1000),
        "equal_error_speedup_connected": cost["connected_variance"] / bias**2 * cost["connected_s_per_path"] / frame_s,
        "relative_bias": bias,
        "paths_per_pixel_needed": paths,
        "paths_per_pixel_measured": 32,
    }


PARTS = ("rates", "agreement", "cost")


def main() -> int:
    """Run and print; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--samples", type=int, default=None, help="paths per pixel of the reference")
    parser.add_argument("--coarser", type=int, default=None, help="pixels this many times as large")
    parser.add_argument("--cases", default="", help="numbers of the cases, such as 0,3; all by default")
    parser.add_argument("--part", default=",".join(PARTS), help="what to measure; all by default")
    arguments = parser.parse_args()
    chosen = arguments.part.split(",")
    if not set(chosen) <= set(PARTS):
        parser.error(f"--part: of {', '.join(PARTS)}")
    os.environ.setdefault("EVANESCE_CACHE", tempfile.mkdtemp())
    if not llvm_works():
        print("the reference needs Dr.Jit's LLVM backend, which does not work here", file=sys.stderr)
        return 1

    # Parts of earlier runs stay; all of them are of a FILE's own program only if it is not kept over a change of it.
    path: Path | None = arguments.json
    parts: dict[str, Any] = {}
    if path is not None and path.exists() and len(chosen) < len(PARTS):
        parts = json.loads(path.read_text(encoding="utf-8"))
    if "rates" in chosen:
        parts |= measure_rates(arguments.quick)
    if "agreement" in chosen:
        numbers = [
            int(k) for k in (arguments.cases or ("0,3,4" if arguments.quick else "0,1,2,3,4,5,6,7,8")).split(",")
        ]
        factor = arguments.coarser or (8 if arguments.quick else 4)
        parts |= measure_cases(numbers, factor, arguments.samples or (512 if arguments.quick else 1024))
    if "cost" in chosen:
        parts |= {"cost": reference_cost()}
    if {"cases", "cost", "rates"} <= set(parts):
        parts = conclusions(parts) | {k: v for k, v in parts.items() if k not in conclusions(parts)}
    parts["versions"] = package_versions()
    print("\n".join(f"{k:32s} {v:.4g}" for k, v in parts.items() if isinstance(v, float | int)))
    if path is not None:
        part = path.with_suffix(".part")
        part.write_text(json.dumps(parts, indent=1) + "\n", encoding="utf-8")
        part.replace(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
