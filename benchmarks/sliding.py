"""Time of a press and slide: 200 frames of contact states at 512 x 512.

First by the solver alone (wanted: 20 s on two cores), then a scene's: a shaft held at 30 deg, friction by speed,
silicone stiffer by its rate and temperature (wanted: 5 s), and the same with a spin, solved in the plane.

Run: ``python benchmarks/sliding.py [--frames 200] [--samples 512] [--json FILE]``.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from evanesce.contact.analytic.hertz import hertz_contact
from evanesce.contact.analytic.partial_slip import tangential_modulus
from evanesce.contact.sliding.area_loss import area_loss_for
from evanesce.contact.sliding.solver import march
from evanesce.contact.sliding.states import SlideStates, SlideView
from evanesce.contact.solve import contact_sequence
from evanesce.core import provenance
from evanesce.core.states import PlateGrid
from evanesce.materials.friction import interface_of
from evanesce.materials.tables import material
from evanesce.rig import load_scene


def measure(frames: int, samples: int) -> dict[str, float]:
    """March a press to 1 N in 30 % of the frames and a slide of 4 mm in the rest; return times and a check."""
    silicone = material("silskin_0")
    press = max(2, int(0.3 * frames))
    contacts = [hertz_contact(f, 7.5, float(silicone.reduced_modulus(f))) for f in np.linspace(0.05, 1.0, press)]
    contacts += [contacts[-1]] * (frames - press)
    drive = np.concatenate([np.zeros(press), np.linspace(0.0, 4.0, frames - press)])
    modulus = float(tangential_modulus(float(silicone.reduced_modulus(1.0)), silicone.poisson_ratio))
    area = np.pi * contacts[-1].contact_radius ** 2
    loss = area_loss_for(area, 0.9, 0.85)
    start = time.perf_counter()
    slide = march(
        contacts,
        np.arange(frames) / 30.0,
        drive,
        interface_of("silskin_0"),
        modulus,
        drive_stiffness=3.0,
        area_loss=loss,
    )
    marched = time.perf_counter() - start
    grid = PlateGrid((samples, samples), 16.0 / samples, (2.0, 0.0))
    worst = 0.0
    start, cpu = time.perf_counter(), time.process_time()
    for state in SlideStates(slide, grid, SlideView()):
        carried = float(state.pressure.sum()) * grid.pitch**2
        worst = max(worst, abs(carried / state.normal_force - 1.0))
    sampled = time.perf_counter() - start
    return {
        "frames": frames,
        "samples": samples,
        "march_s": marched,
        "states_s": sampled,
        "total_s": marched + sampled,
        "states_cpu_s": time.process_time() - cpu,
        "worst_relative_force_error": worst,
        "final_tangential_force_N": slide.frames[-1].tangential_force,
        "final_area_mm2": slide.frames[-1].area,
    }


TILTED = {
    "slide.contact_angle_deg": 30.0,
    "slide.speed_exponent": 0.1,
    "environment.temperature_C": 10.0,
    "slide.distance_mm": 4.0,
    "slide.speed_mm_per_s": 1.0,
    "slide.press_time_s": 2.0,
    "slide.preload_N": 0.2,
    "contact.bone": "none",
}


def scene_seconds(frames: int, samples: int, spin: float = 0.0) -> dict[str, float]:
    """Return the time of all frames of a tilted, rate-dependent slide of a scene, and a check."""
    rate = (frames - 0.5) / 6.0  # 2 s press, 4 s slide
    more = {"press.frame_rate_hz": rate, "grid.samples": samples, "grid.size_mm": 20.0, "press.max_frames": 2 * frames}
    more |= {"slide.spin_deg_per_s": spin} if spin else {}
    scene = load_scene("thesis_slide", TILTED | more)
    start, worst, count = time.perf_counter(), 0.0, 0
    for state in contact_sequence(scene):
        carried = float(np.asarray(state.pressure).sum()) * state.grid.pitch**2
        worst = max(worst, abs(carried / state.normal_force - 1.0))
        count += 1
    return {"frames": count, "seconds": time.perf_counter() - start, "worst_relative_force_error": worst}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--samples", type=int, default=512)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    result = measure(given.frames, given.samples)
    total, march_s = result["total_s"], result["march_s"]
    print(f"{given.frames} frames at {given.samples}^2: {total:.2f} s, {march_s:.2f} s of it the march;", end=" ")
    print(f"processor time of the states {result['states_cpu_s']:.2f} s")
    for title, spin in (("tilted, rate-dependent", 0.0), ("the same with a spin", 20.0)):
        found = scene_seconds(given.frames, given.samples, spin)
        result[title] = found["seconds"]
        print(f"{title}: {found['frames']:.0f} frames in {found['seconds']:.2f} s, normal force within"
              f" {found['worst_relative_force_error']:.1e}")  # fmt: skip
    if given.json:
        given.json.write_text(json.dumps({**result, "provenance": dict(provenance.record())}, indent=2) + "\n")


if __name__ == "__main__":
    main()
