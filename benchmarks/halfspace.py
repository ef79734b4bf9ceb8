"""Time and accuracy of the half-space solver (the target: 1024^2 under 20 s and 512^2 under 4 s on two cores).

Run: ``python benchmarks/halfspace.py [--samples 512 1024] [--json FILE]``.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from evanesce.contact.analytic.hertz import hertz_radius
from evanesce.contact.halfspace.resolved import contact_area
from evanesce.contact.halfspace.solver import press_height_map
from evanesce.contact.solve import contact_state
from evanesce.core import provenance
from evanesce.rig import load_scene


def hertz(samples: int) -> dict[str, float | str]:
    """Press a sphere whose contact spans 5/8 of the map, off-centre, and compare with Hertz."""
    radius, modulus, force = 7.5, 0.769, 5.0
    a = float(hertz_radius(force, radius, modulus))
    pitch = 3.2 * a / samples
    x = (np.arange(samples) - (samples - 1) / 2) * pitch
    heights = ((x[None, :] - 0.213) ** 2 + (x[:, None] + 0.371) ** 2) / (2 * radius)
    start = time.perf_counter()
    found = press_height_map(heights, pitch, modulus, force)
    seconds = time.perf_counter() - start
    peak = 1.5 * force / (np.pi * a**2)
    return {
        "case": "sphere",
        "samples": samples,
        "seconds": seconds,
        "iterations": found.iterations,
        "area_error": contact_area(found.pressure > 0, pitch) / (np.pi * a**2) - 1.0,
        "peak_pressure_error": float(found.pressure.max()) / peak - 1.0,
        "depth_error": found.depth / (a**2 / radius) - 1.0,
    }


def westergaard(samples: int) -> dict[str, float | str]:
    """Press a sinusoid to half its closure and compare the peak pressure and the width."""
    modulus, amplitude, wavelength, load = 0.47, 0.02, 0.9, 0.5
    pitch = wavelength / samples
    x = (np.arange(samples) + 0.37) * pitch
    heights = np.tile(amplitude * (1 - np.cos(2 * np.pi * x / wavelength)), (4, 1))
    star = np.pi * modulus * amplitude / wavelength
    start = time.perf_counter()
    found = press_height_map(heights, pitch, modulus, load * star * wavelength * 4 * pitch, periodic=True)
    seconds = time.perf_counter() - start
    width = 2 * wavelength / np.pi * np.arcsin(np.sqrt(load))
    return {
        "case": "sinusoid",
        "samples": samples,
        "seconds": seconds,
        "iterations": found.iterations,
        "width_error": np.count_nonzero(found.pressure[0] > 0) * pitch / width - 1.0,
        "peak_pressure_error": float(found.pressure.max()) / (2 * np.sqrt(load) * star) - 1.0,
    }


def ridged(samples: int, pattern: str) -> dict[str, float | str]:
    """Press the thesis's ridged finger at 5 N; the first ridged model's area beside it."""
    overrides = {"grid.samples": samples, "finger.ridges.pattern": pattern, "finger.ridges.orientation_deg": 20.0}
    scene = load_scene("thesis_ridged", overrides | {"contact.law": "halfspace"})
    simple = load_scene("thesis_ridged", overrides)
    contact_state(simple, 4.9)  # its tables are made once
    before = time.process_time()
    first = contact_state(simple, 5.0)
    first_seconds = time.process_time() - before
    start = time.perf_counter()
    state = contact_state(scene, 5.0)
    seconds = time.perf_counter() - start
    return {
        "case": f"ridged finger, {pattern}, 5 N",
        "samples": samples,
        "seconds": seconds,
        "iterations": int(state.parameters["iterations"]),
        "area_mm2": state.nominal_contact_area,
        "first_model_area_mm2": first.nominal_contact_area,
        "first_model_processor_seconds": first_seconds,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, nargs="+", default=[512, 1024])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    for samples in options.samples:
        for row in (hertz(samples), westergaard(samples), ridged(samples, "parallel"), ridged(samples, "loop")):
            rows.append(row)
            print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()))
    if options.json:
        options.json.write_text(json.dumps({"runs": rows, **provenance.record()}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
