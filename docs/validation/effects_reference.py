"""Fast renderer against path tracer on rigs with effects that both model: total light of the contact, coarse camera.

Run: python docs/validation/effects_reference.py (several minutes; fields of each rig are computed once and cached)
"""

from __future__ import annotations

import numpy as np

from evanesce.contact.solve import contact_state
from evanesce.effects import Context, all_effects
from evanesce.render.fast.transport import render_fast
from evanesce.render.reference.path import render
from evanesce.rig import load_scene

COARSE = {
    "camera.resolution_px": [160, 120],
    "camera.scale_px_per_mm": 12.0,
    "camera.lens.focal_length_mm": 2.5,
    "grid.samples": 512,
}
CASES: dict[str, dict[str, object]] = {
    "led_dead": {"loss": 1.0, "first": 1, "count": 3},
    "glass_absorption": {"absorption_per_mm": 0.002},
    "real_contact": {"rms_slope": 0.5},
    "edge_finish": {"share": 0.6, "polish": 1.0},
    "led_air_gap": {"share": 0.7},
}


def main() -> None:
    """Print fast over traced light, with and without each effect, one standard error of the tracer."""
    base = load_scene("thesis", COARSE)
    scenes = {"nothing": base}
    for name, values in CASES.items():
        effect = all_effects()[name]
        scenes[name] = effect.apply(base, effect.parameters(**values), Context(base, seed=1))
    for name, scene in scenes.items():
        state = contact_state(scene, 4.0)
        traced, fast = render(scene, state, samples_per_pixel=256, passes=4, seed=3), render_fast(scene, state)
        there = fast.radiance > 0.3 * fast.radiance.max()
        total = traced.radiance[there].sum()
        error = np.sqrt(traced.variance[there].sum()) / total
        print(f"{name}: {fast.radiance[there].sum() / total:.4f} +- {error:.4f}", flush=True)


if __name__ == "__main__":
    main()
