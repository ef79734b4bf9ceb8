"""Expected power of the joint critic by cause and strength, on a small rig without any cause: `make power`.

Run: python benchmarks/critic_power.py [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from evanesce.bundle.protocol import default_protocol
from evanesce.bundle.read import read_bundle
from evanesce.bundle.write import write_bundle
from evanesce.inference.critic import nominal_judge
from evanesce.rig import load_scene

RIG = {
    "plate.size_mm": [104.0, 84.0],
    "plate.thickness_mm": 5.0,
    "finger.tip_radius_mm": 8.6,
    "camera.resolution_px": [208, 156],
    "camera.scale_px_per_mm": 6.8,
    "camera.pixel.pitch_um": 15.5,
    "camera.pixel.fill_factor": 0.05,
    "camera.exposure_ms": 1.9,
    "camera.lens.f_number": 4.0,
    "camera.lens.defocus_um": 90.0,
    "card.checkerboard_squares": [9, 7],
    "card.checkerboard_side_mm": 3.0,
    "press.forces_N": [5.0],
}
STRENGTHS = (5.0, 7.0, 10.0, 20.0)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    target = parser.parse_args().json
    scene = load_scene("thesis", RIG)
    protocol = replace(default_protocol(scene), replicates=8)
    with tempfile.TemporaryDirectory() as folder:
        bundle = Path(folder) / "bundle"
        write_bundle(bundle, scene, seed=5, nominal=scene, protocol=protocol)
        judge, base = nominal_judge(read_bundle(bundle), tell=print)
    found = judge.power(base, STRENGTHS, np.random.default_rng(1))
    print(f"{'cause':22s}" + "".join(f"{f'at {s:g}':>26s}" for s in STRENGTHS))
    print(" " * 22 + "  detected first covered  n" * len(STRENGTHS))
    for name in dict.fromkeys(p.id for p in found):
        own = [p for p in found if p.id == name]
        print(f"{name:22s}" + "".join(f"{p.detected:10.2f}{p.first:6.2f}{p.covered:7.2f}{p.size:5.1f}" for p in own))
    for s in STRENGTHS:
        own = [p for p in found if p.strength == s]
        detected, first = (np.mean([getattr(p, n) for p in own]) for n in ("detected", "first"))
        covered, size = (np.nanmean([getattr(p, n) for p in own]) for n in ("covered", "size"))
        print(f"mean at {s:g}: detected {detected:.2f}, first {first:.2f}, covered {covered:.2f}, set {size:.1f}")
    if target is not None:
        target.write_text(json.dumps([vars(p) for p in found], indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
