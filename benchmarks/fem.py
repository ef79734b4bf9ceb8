"""Time of the finite elements, and the table of presses and of a slide.

Run: ``python benchmarks/fem.py [--element-mm 0.12] [--slide] [--json FILE]``. Nothing is taken from the cache.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

from evanesce.contact.fem.material import rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize
from evanesce.contact.fem.programme import SLIDE_MESH, press, slide
from evanesce.contact.fem.result import SolvedRun
from evanesce.core import provenance

FORCES = (0.5, 1.0, 2.0, 5.0)


def _figures(run: SolvedRun, seconds: float) -> dict[str, Any]:
    iterations = sum(step.state.iterations for step in run.history.steps)
    keep = ("normal_force_N", "depth_mm", "slide_mm", "area_mm2", "reduced_modulus_MPa", "tangential_force_N")
    rows = [{key: float(run.row(i)[key]) for key in keep} for i in run.reached()]
    return {
        "elements": len(run.mesh.cells),
        "steps": len(run),
        "iterations": iterations,
        "seconds": seconds,
        "seconds_per_iteration": seconds / iterations,
        "rows": rows,
    }


def timed_press(material: str, bone: float, element: float) -> dict[str, Any]:
    start = time.perf_counter()
    run = press(FingerShape(bone_radius=bone), rubber(material), forces=FORCES, size=MeshSize(contact=element))
    return {"material": material, "bone_radius_mm": bone, **_figures(run, time.perf_counter() - start)}


def timed_slide(element: float) -> dict[str, Any]:
    start = time.perf_counter()
    size = MeshSize(element, SLIDE_MESH.fine_extent, SLIDE_MESH.growth, SLIDE_MESH.coarsest)
    run = slide(FingerShape(), rubber("silskin_0"), force=1.0, distances=(2.0, 10.0), friction=0.67, size=size)
    return {"material": "silskin_0", "friction": 0.67, **_figures(run, time.perf_counter() - start)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--element-mm", type=float, default=0.12)
    parser.add_argument("--slide", action="store_true", help="also a slide of 10 mm in three dimensions")
    parser.add_argument("--slide-element-mm", type=float, default=1.1)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    results = []
    for material in ("silskin_0", "silskin_20"):
        for bone in (0.0, 3.75):
            results.append(timed_press(material, bone, options.element_mm))
            _show(results[-1])
    if options.slide:
        results.append(timed_slide(options.slide_element_mm))
        _show(results[-1])
    if options.json:
        record = {"results": results, "provenance": dict(provenance.record())}
        options.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def _show(result: dict[str, Any]) -> None:
    head = {key: value for key, value in result.items() if key != "rows"}
    print(
        "  ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}" for key, value in head.items())
    )
    for row in result["rows"]:
        print("   " + "  ".join(f"{key} {value:.4f}" for key, value in row.items()), flush=True)


if __name__ == "__main__":
    main()
