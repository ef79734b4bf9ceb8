"""Figures of the validation pages of scatterers on the plate: what they add to a frame of the thesis rig.

Run: python docs/validation/effects_plate.py
"""

from __future__ import annotations

import time

import numpy as np

from evanesce.chain.simulate import simulate
from evanesce.render.fast.transport import render_fast
from evanesce.rig import load_scene

CASES = {
    "nothing": {},
    "specks": {"specks": {"per_cm2": 418.0}},
    "scratch": {"scratch": {"relative_radiance": 0.5, "middle_mm": [-3.0, 4.0]}},
    "residue_film": {"residue_film": {"relative_radiance": 0.03}},
    "led_edge_reflections": {"led_edge_reflections": {"relative_radiance": 0.13}},
}


def render(scene, state, *, seed):  # type: ignore[no-untyped-def]
    """Render without the seed, which the fast renderer has no use for."""
    return render_fast(scene, state)


def main() -> None:
    """Print grey levels and falsely segmented area at three thresholds, finger away and pressed with 1 N, 9 V."""
    for name, effects in CASES.items():
        scene = load_scene("thesis", {"effects": effects})
        for force in (None, 1.0):
            started = time.perf_counter()
            frame = simulate(scene, force, seed=1, render=render).frame.data
            took = time.perf_counter() - started
            grey = frame / 255.0
            areas = np.array([(grey > t).sum() for t in (0.0375, 0.15, 0.35)]) / 58.37**2
            shown = "  ".join(f"{a:.2f}" for a in areas)
            pressed = "away" if force is None else f"{force:g} N"
            top = np.percentile(frame, [50, 99, 99.9])
            print(
                f"{name}, finger {pressed}: {shown} mm^2 above 0.0375, 0.15, 0.35; DN {top}; {took:.1f} s", flush=True
            )


if __name__ == "__main__":
    main()
