"""Gradients against search, for the continuous optical figures of a rig: LED powers, LED positions, absorption.

What is made even is the guided light over the middle of the plate, which is smooth in all of them. The rig is the
thesis's with LEDs on two edges only (`--edges`): with four it is even from the start. Three ways:

* Dr.Jit's reverse mode (LLVM) through the closed form of the direct light (columns of mirror images), with L-BFGS;
* L-BFGS with finite differences of the same function;
* Optuna's TPE, as `evanesce design` searches, with as many evaluations as are given.

The gradient is checked by finite differences, and Mitsuba's forward mode through the path tracer's loop against a
difference of the same paths. Scattering is not among them: the fast renderer has it as a kernel's width, the path
tracer of a plate does not know it. The area error itself has no useful gradient: it counts pixels above a level.

    python benchmarks/design_gradient.py --json outputs/design_gradient.json
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, minimize

from evanesce.optics.led import led_positions
from evanesce.render.variant import select
from evanesce.rig import Scene, load_scene

Array = NDArray[np.float64]

FIELD_MM = (24.0, 18.0)
"""Part of the plate that is made even: most of the camera's view."""

NODES = (13, 10)
IMAGES = 32
ABSORPTION = (1e-5, 2e-3)
SHIFT_MM = 3.0


class Evenness:
    """Relative spread of the direct guided light over the field, by power and position of each LED and by absorption.

    Arguments of the functions: powers [1], shifts along the edges [mm], absorption [1/mm].
    """

    def __init__(self, scene: Scene) -> None:
        import drjit as dr
        from drjit.auto.ad import Float64 as Float
        from drjit.auto.ad import UInt32

        self.dr, self.float = dr, Float
        plate, positions = scene.plate, led_positions(scene.plate, scene.leds)
        t, n = plate.thickness_mm, plate.refractive_index
        x, y = np.meshgrid(*(np.linspace(-s / 2, s / 2, k) for s, k in zip(FIELD_MM, NODES, strict=True)))
        points = np.stack([x.ravel(), y.ravel()], axis=-1)
        normal, beside, along = [], [], []
        for edge, centres in positions.items():
            on_x, side = edge in ("left", "right"), -1.0 if edge in ("left", "top") else 1.0
            wall = side * plate.size_mm[0 if on_x else 1] / 2
            for centre in centres:
                normal.append(np.abs(points[:, 0 if on_x else 1] - wall))
                beside.append(points[:, 1 if on_x else 0])
                along.append(centre)
        # (points, leds, images), flattened.
        place = np.arange(IMAGES) + 0.5
        self.count, self.points = len(along), len(points)
        full = (len(points), self.count, IMAGES)
        self.normal, self.beside, self.place = (
            Float(np.broadcast_to(a, full).ravel())
            for a in (np.array(normal).T[:, :, None], np.array(beside).T[:, :, None], place[None, None, :])
        )
        self.drop = self.place * t
        self.start = np.array(along)
        led = np.broadcast_to(np.arange(self.count)[None, :, None], full).ravel()
        point = np.broadcast_to(np.arange(len(points))[:, None, None], full).ravel()
        self.led, self.point = UInt32(led.astype(np.uint32)), UInt32(point.astype(np.uint32))
        self.steepest = np.sqrt(n * n - 1.0) / t

    def _light(self, powers: Any, shifts: Any, absorption: Any) -> Any:
        """Return the light at each point; what is steeper than the critical angle leaks and is left out.

        An LED as high as the plate has images without gaps: the last one that is guided counts in part.
        """
        dr, f = self.dr, self.float
        along = dr.gather(f, f(self.start) + shifts, self.led)
        run2 = self.normal**2 + (self.beside - along) ** 2
        length2 = run2 + self.drop**2
        length = dr.sqrt(length2)
        images = dr.sqrt(run2) * self.steepest - (self.place - 0.5)
        # By selection: LLVM 19 has no code for double minima and maxima on some processors, and aborts.
        guided = dr.select(images > 0.0, dr.select(images < 1.0, images, 1.0), 0.0)
        value = guided * dr.exp(-absorption * length) * (self.drop / length) * (self.normal / length) / length2
        light = dr.zeros(f, self.points)
        dr.scatter_reduce(dr.ReduceOp.Add, light, value * dr.gather(f, powers, self.led), self.point)
        return light

    def loss(self, powers: Any, shifts: Any, absorption: Any) -> Any:
        """Return the variance over the field, of the mean squared."""
        dr = self.dr
        light = self._light(powers, shifts, absorption)
        mean = dr.mean(light)
        return dr.mean((light / mean - 1.0) ** 2)

    def value(self, v: Array) -> float:
        """Return the loss of a flat vector."""
        f, k = self.float, self.count
        parts = f(v[:k]), f(v[k : 2 * k]), f(float(v[-1]))
        return float(self.loss(*parts)[0])

    def value_and_gradient(self, v: Array) -> tuple[float, Array]:
        """Return the loss and its gradient by reverse mode."""
        dr, f, k = self.dr, self.float, self.count
        parts = [f(v[:k]), f(v[k : 2 * k]), f(float(v[-1]))]
        dr.enable_grad(*parts)
        loss = self.loss(*parts)
        dr.backward(loss)
        return float(dr.detach(loss)[0]), np.concatenate([np.asarray(dr.grad(p), float).ravel() for p in parts])

    def matrix(self, shifts: Array, absorption: float) -> Array:
        """Return light at the points per power of each LED."""
        f = self.float
        columns = [np.asarray(self._light(f(row), f(shifts), f(absorption))) for row in np.eye(self.count)]
        return np.array(columns, float).T


def search(function: Callable[[Array], float], low: Array, high: Array, start: Array, trials: int, seed: int) -> float:
    """Return the smallest value that TPE finds; it starts at ``start``."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed))
    study.enqueue_trial({f"x{k}": float(v) for k, v in enumerate(start)})

    def objective(trial: Any) -> float:
        return function(
            np.array([trial.suggest_float(f"x{k}", a, b) for k, (a, b) in enumerate(zip(low, high, strict=True))])
        )

    study.optimize(objective, n_trials=trials)
    return float(study.best_value)


def mitsuba_forward(scene: Scene, samples: int, seed: int) -> dict[str, float]:
    """Return the derivative of the mean light by absorption: forward mode, and a difference of the same paths."""
    import drjit as dr
    import mitsuba as mi

    from evanesce.contact.solve import contact_state
    from evanesce.optics.projection import Projection
    from evanesce.render.reference.led_groups import in_units, lit_powers
    from evanesce.render.reference.path import integrator_for
    from evanesce.render.reference.scene import camera_dict, plate_scene

    info = select("llvm")
    state = contact_state(scene, 2.0)
    powers, _ = in_units(lit_powers(scene, "all"))
    model = plate_scene(scene, state, powers, True)
    projection = Projection.of(scene.camera, scene.plate)
    sensor = camera_dict(projection, projection.ideal_view())
    loaded = mi.load_dict({**model.shapes, "sensor": sensor}, parallel=False)

    def mean(absorption: Any) -> Any:
        integrator = integrator_for(scene, info, model, powers)
        integrator.absorption = absorption
        integrator.guide = replace(integrator.guide, absorption=absorption)
        with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, False):
            image = integrator.render(loaded, seed=seed, spp=samples)
        return dr.mean(image.array)

    value = scene.plate.absorption_coefficient_per_mm
    started = time.perf_counter()
    attached = mi.Float(value)
    dr.enable_grad(attached)
    result = mean(attached)
    dr.forward(attached)
    forward = float(dr.grad(result)[0])
    middle = time.perf_counter()
    step = 0.05 * value
    up, down = (float(mean(mi.Float(value + s))[0]) for s in (step, -step))
    ended = time.perf_counter()
    return {"forward": forward, "difference": (up - down) / (2 * step), "mean": float(dr.detach(result)[0]),
            "forward_s": middle - started, "two_renderings_s": ended - middle}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--edges", default="left,top", help="Lit edges, separated by commas.")
    parser.add_argument("--samples", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--no-mitsuba", action="store_true")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    select("llvm")
    scene = load_scene("thesis", {"leds.edges": args.edges.split(",")})
    even = Evenness(scene)
    k = even.count
    start = np.concatenate([np.ones(k), np.zeros(k), [scene.plate.absorption_coefficient_per_mm]])
    low = np.concatenate([np.full(k, 0.2), np.full(k, -SHIFT_MM), [ABSORPTION[0]]])
    high = np.concatenate([np.full(k, 2.0), np.full(k, SHIFT_MM), [ABSORPTION[1]]])
    width = high - low
    rng = np.random.default_rng(args.seed)
    found: dict[str, Any] = {"leds": k, "parameters": len(start), "load": os.getloadavg(), "start": even.value(start)}

    # The gradient against central differences, at a point where nothing is equal, by several steps.
    at = low + width * rng.uniform(0.3, 0.7, len(start))
    gradient = even.value_and_gradient(at)[1] * width
    differences = np.array([
        (even.value(at + h * width * e) - even.value(at - h * width * e)) / (2 * h)
        for h in (0.01,) for e in np.eye(len(start))
    ])  # fmt: skip
    found["gradient_worst"] = float(np.abs(gradient - differences).max() / np.abs(gradient).max())

    def scaled(u: Array) -> tuple[float, Array]:
        value, slope = even.value_and_gradient(low + width * u)
        return value, slope * width

    bounds = [(0.0, 1.0)] * len(start)
    for name, function, options in (
        ("autodiff", scaled, {"jac": True}),
        ("differences", lambda u: even.value(low + width * u), {"options": {"eps": 1e-3, "maxfun": 3000}}),
    ):
        began = time.process_time()
        solved = minimize(function, (start - low) / width, method="L-BFGS-B", bounds=bounds, **options)
        found[name] = {"loss": float(solved.fun), "evaluations": int(solved.nfev), "cpu_s": time.process_time() - began}
    began = time.process_time()
    found["tpe"] = {
        "loss": search(even.value, low, high, start, args.trials, args.seed), "evaluations": args.trials,
        "cpu_s": time.process_time() - began,
    }  # fmt: skip
    # Powers alone: light is linear in them, and least squares needs neither.
    began = time.process_time()
    matrix = even.matrix(np.zeros(k), start[-1])
    matrix /= (matrix @ np.ones(k)).mean()
    powers = lsq_linear(matrix, np.ones(len(matrix)), (0.2, 2.0)).x
    light = matrix @ powers
    found["least_squares_powers"] = {"loss": float(((light / light.mean() - 1) ** 2).mean()),
                                     "cpu_s": time.process_time() - began}  # fmt: skip
    if not args.no_mitsuba:
        camera = {"resolution_px": [40, 30], "scale_px_per_mm": 2.0, "pixel": {"pitch_um": 49.0}}
        small = load_scene("thesis", {"camera": camera})
        found["mitsuba"] = mitsuba_forward(small, args.samples, args.seed)
    text = json.dumps(found, indent=1)
    print(text)
    if args.json:
        args.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
