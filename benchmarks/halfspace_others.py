"""Half-space solver beside tamaas, ContactMechanics and ASPHER: processor time at equal accuracy, on one thread.

Each program solves the same maps at ever lower tolerances of its own; what counts is the first solution whose gap
error, measured alike for all of them, is below the asked one. Gap error: root mean square over the cells that touch or
overlap of the gap that the pressure leaves there, over the heights' standard deviation. Programs that are not installed
are left out; each runs in a process of its own (``halfspace_programs.py``).

Run: ``python benchmarks/halfspace_others.py [--samples 512 1024] [--forces 0.2 1] [--error 1e-5] [--json FILE]``.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

if __name__ == "__main__":
    # before scipy counts the processors: its transforms take as many threads as there are
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np

from evanesce.contact.halfspace.operators import free_operator, periodic_operator
from evanesce.contact.halfspace.solver import press_height_map
from evanesce.contact.ridges.heightmap import RidgeRow
from evanesce.core import provenance
from evanesce.core.rng import generator

MODULUS = 0.47  # MPa
PROGRAMS = ("tamaas", "ContactMechanics", "aspher")
LADDER = 10.0 ** -np.arange(3.0, 9.0, 0.5)


@dataclasses.dataclass(frozen=True)
class Problem:
    """Heights [mm] sampled every ``pitch`` [mm], pressed with a force [N]; ``periodic``: the map repeats."""

    heights: np.ndarray
    pitch: float
    force: float
    periodic: bool


Solve = Callable[[Problem, float], tuple[np.ndarray, float]]


def maps(samples: int, forces: Sequence[float]) -> dict[str, Problem]:
    """Return named problems: heights [mm], pitch [mm], force [N] and whether the map repeats."""
    side = 9.0
    pitch = side / samples
    x = (np.arange(samples) - (samples - 1) / 2) * pitch
    x, y = x[None, :] - 0.213, x[:, None] + 0.371
    sphere, ellipsoid = (x**2 + y**2) / 12.6, x**2 / 22.0 + y**2 / 8.0
    ridges = RidgeRow("parallel", 0.83, 0.37, 0.06, np.deg2rad(27.0)).heights(x, y)
    q = np.hypot(np.fft.fftfreq(samples, pitch)[:, None], np.fft.fftfreq(samples, pitch)[None, :])
    band = (q >= 4 / side) & (q <= 32 / side)
    noise = np.fft.fft2(generator(5, "rough").standard_normal((samples, samples)))
    rough = np.fft.ifft2(noise * np.where(band, np.where(q > 0, q, 1.0) ** -1.8, 0.0)).real
    rough *= 0.01 / rough.std()
    shapes = {
        "sphere": sphere,
        "ellipsoid": ellipsoid,
        "ridged pad": sphere + ridges,
        "rough pad": sphere + rough,
        "rough, periodic": rough,
    }
    return {
        f"{name}, {force:g} N": Problem(heights, pitch, force, name.endswith("periodic"))
        for name, heights in shapes.items()
        for force in forces
    }


def gap_error(problem: Problem, pressure: np.ndarray) -> float:
    """Return the error in the gap, relative to the standard deviation of the heights."""
    build = periodic_operator if problem.periodic else free_operator
    gap = problem.heights + build(problem.heights.shape, problem.pitch, MODULUS)(pressure)
    touching = pressure > 0
    gap -= gap[touching].mean()
    return float(np.sqrt(np.mean(gap[touching | (gap < 0)] ** 2)) / problem.heights.std())


def solve_own(problem: Problem, tolerance: float) -> tuple[np.ndarray, float]:
    """Return pressure [MPa] and processor time [s]."""
    start = time.process_time()
    found = press_height_map(
        problem.heights, problem.pitch, MODULUS, problem.force, periodic=problem.periodic, tolerance=tolerance
    )
    return found.pressure, time.process_time() - start


def solve_other(program: str, problem: Problem, tolerance: float) -> tuple[np.ndarray, float]:
    """Return pressure [MPa] and processor time [s] of another program, run in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "problem.npz", Path(folder) / "answer.npz"
        np.savez(source, modulus=MODULUS, tolerance=tolerance, **dataclasses.asdict(problem))
        script = Path(__file__).with_name("halfspace_programs.py")
        subprocess.run([sys.executable, script, program, source, target], check=True, stdout=subprocess.DEVNULL)
        with np.load(target) as stored:
            return stored["pressure"], float(stored["seconds"])


def first_enough(problem: Problem, solve: Solve, error: float) -> tuple[np.ndarray, dict[str, float]]:
    """Lower the tolerance until the gap error is small enough; return that pressure, its time and its errors."""
    for tolerance in LADDER:
        pressure, seconds = solve(problem, float(tolerance))
        found = gap_error(problem, pressure)
        if found <= error:
            return pressure, {"seconds": seconds, "gap_error": found, "tolerance": float(tolerance)}
    return pressure, {"seconds": float("nan"), "gap_error": found, "tolerance": float("nan")}


def compare(name: str, problem: Problem, programs: list[str], error: float) -> dict:
    """Return the row of one problem: each program's time over the project's own, its area and pressure beside it."""
    own, figures = first_enough(problem, solve_own, error)
    best = {"evanesce": figures}
    for program in programs:
        pressure, found = first_enough(problem, partial(solve_other, program), error)
        found["ratio"] = found["seconds"] / figures["seconds"]
        found["area_difference"] = np.count_nonzero(pressure) / np.count_nonzero(own) - 1.0
        found["pressure_rms_over_peak"] = float(np.sqrt(np.mean((pressure - own) ** 2)) / own.max())
        best[program] = found
    return {"case": name, "samples": problem.heights.shape[0], "programs": best}


def figures_line(found: dict[str, float]) -> str:
    """Return a line of figures."""
    line = f"{found['seconds']:8.3f} s, gap error {found['gap_error']:.1e}"
    if "ratio" in found:
        line += (
            f", {found['ratio']:6.2f} times; area {100 * found['area_difference']:+.3f} %, pressure (rms over peak) "
            f"{100 * found['pressure_rms_over_peak']:.4f} %"
        )
    return line


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, nargs="+", default=[512, 1024])
    parser.add_argument("--forces", type=float, nargs="+", default=[0.2, 1.0])
    parser.add_argument("--error", type=float, default=1e-5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    programs = [p for p in PROGRAMS if importlib.util.find_spec(p)]
    rows = []
    for samples in options.samples:
        for name, problem in maps(samples, options.forces).items():
            rows.append(compare(name, problem, programs, options.error))
            for program, found in rows[-1]["programs"].items():
                print(f"{name:24s} {samples:5d} {program:17s} {figures_line(found)}", flush=True)
    if options.json:
        options.json.write_text(json.dumps({"runs": rows, **provenance.record()}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
