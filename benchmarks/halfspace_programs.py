"""Solve one half-space problem by another program: tamaas, ContactMechanics or ASPHER, whichever is asked for.

A process of its own, started by ``benchmarks/halfspace_others.py`` and by the tests: tamaas is AGPL-3, so nothing of
this project is imported here, and arrays come and go in files. Run: ``python benchmarks/halfspace_programs.py tamaas
problem.npz answer.npz``; the problem has heights (rows, cols) [mm], pitch [mm], modulus [MPa], force [N], periodic and
tolerance, the answer pressure (rows, cols) [MPa] and seconds of processor time of the solution alone.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

Problem = dict[str, Any]


def solve_tamaas(problem: Problem) -> Callable[[float], np.ndarray]:
    """Polonsky and Keer's algorithm after Rey et al.; free boundaries by its operator ``dcfft``."""
    import tamaas

    tamaas.set_log_level(tamaas.LogLevel.error)
    heights, pitch = problem["heights"], float(problem["pitch"])
    shape, sides = list(heights.shape), [n * pitch for n in heights.shape]

    def solve(tolerance: float) -> np.ndarray:
        model = tamaas.ModelFactory.createModel(tamaas.model_type.basic_2d, sides, shape)
        model.E, model.nu = float(problem["modulus"]), 0.0
        solver = tamaas.PolonskyKeerRey(model, -heights, tolerance)
        if not problem["periodic"]:
            tamaas.ModelFactory.registerNonPeriodic(model, "dcfft")
            solver.setIntegralOperator("dcfft")
        solver.max_iter = 5000
        solver.solve(float(problem["force"]) / (sides[0] * sides[1]))
        return np.array(model.traction)

    return solve


def solve_contact_mechanics(problem: Problem) -> Callable[[float], np.ndarray]:
    """Polonsky and Keer's algorithm; forces by cell. Its tolerances are lengths and forces: scaled by the problem."""
    from ContactMechanics import FreeFFTElasticHalfSpace, PeriodicFFTElasticHalfSpace, make_system
    from SurfaceTopography import Topography

    heights, pitch, force = problem["heights"], float(problem["pitch"]), float(problem["force"])
    sides = tuple(n * pitch for n in heights.shape)
    kind = PeriodicFFTElasticHalfSpace if problem["periodic"] else FreeFFTElasticHalfSpace

    def solve(tolerance: float) -> np.ndarray:
        substrate = kind(heights.shape, float(problem["modulus"]), sides)
        surface = Topography(-heights, sides, periodic=bool(problem["periodic"]))
        found = make_system(substrate=substrate, surface=surface).minimize_proxy(
            external_force=force,
            pentol=tolerance * heights.std(),
            forcetol=tolerance * force,
            thermotol=tolerance,
            maxiter=5000,
        )
        return np.array(found.jac)[: heights.shape[0], : heights.shape[1]] / pitch**2

    return solve


def solve_aspher(problem: Problem) -> Callable[[float], np.ndarray]:
    """Preconditioned conjugate gradients on nested grids; square maps of 64 2^k cells only."""
    import aspher

    heights, side = problem["heights"], float(problem["pitch"]) * problem["heights"].shape[0]

    def solve(tolerance: float) -> np.ndarray:
        found = aspher.solve_nested(
            grid_size=heights.shape[0],
            gap=np.ascontiguousarray(heights).ravel(),
            p_nominal=float(problem["force"]) / side**2,
            domain_size=side,
            E_star=float(problem["modulus"]),
            tol=tolerance,
            backend="periodic" if problem["periodic"] else "fft",
        )
        return np.array(found.pressure).reshape(heights.shape)

    return solve


PROGRAMS = {"tamaas": solve_tamaas, "ContactMechanics": solve_contact_mechanics, "aspher": solve_aspher}


def main() -> None:
    program, source, target = sys.argv[1:]
    with np.load(source) as stored:
        problem = {name: stored[name] for name in stored.files}
    solve = PROGRAMS[program](problem)
    start = time.process_time()
    pressure = solve(float(problem["tolerance"]))
    np.savez(target, pressure=pressure, seconds=time.process_time() - start)


if __name__ == "__main__":
    main()
