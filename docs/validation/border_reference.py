"""What the border of a plate with real arrises shows of the LEDs, path traced, against the effect led_edge_reflections.

Run: python docs/validation/border_reference.py (1 min)

Light along the lit edge, over a contact's, by distance inwards from the edge; e-fold distance of its mean from 0.3 to
6 mm, above what the middle shows; the same at the opposite edge.
"""

from __future__ import annotations

import itertools

import numpy as np

from evanesce.optics.led import each_led_power
from evanesce.optics.projection import Projection
from evanesce.render.fast.defects import contact_radiance, plate_points
from evanesce.render.reference.border import render_border
from evanesce.rig import Scene, load_scene
from evanesce.rig.coarser import coarser_camera
from evanesce.rig.surroundings import Haze, surrounded

EDGE_MM = 15.0
CASES: dict[str, tuple[float, float, float]] = {
    "clear": (0.0, 0.0, 0.0),
    "bevel 0.5 mm, polished": (0.5, 0.0, 0.0),
    "bevel 0.5 mm, alpha 0.4": (0.5, 0.4, 0.0),
    "haze of 1 % on both faces": (0.0, 0.0, 0.01),
}


def rig(haze: float) -> Scene:
    """Return a plate whose left, lit edge and right edge lie within the frame."""
    scene = load_scene("thesis", {"plate.size_mm": [2 * EDGE_MM, 66.68], "leds.edges": ["left"]})
    scene = coarser_camera(scene, 10, key="factor")
    return surrounded(scene, haze=Haze(top_share=haze, bottom_share=haze, contrast=0.0)) if haze else scene


def main() -> None:
    """Print."""
    steps = np.array([0.3, 1.0, 2.0, 3.0, 4.0, 6.0])
    print("case: mean over a contact between", steps, "mm; e-fold [mm]; within 1 mm of the other edge; middle")
    for name, (bevel, roughness, haze) in CASES.items():
        scene = rig(haze)
        view = Projection.of(scene.camera, scene.plate).ideal_view()
        powers = each_led_power(scene.plate, scene.leds)
        light = render_border(
            scene, powers, view, bevel_mm=bevel, roughness=roughness, samples_per_pixel=256, passes=8, seed=1
        )
        x, y = plate_points(scene, light)
        unit = float(contact_radiance(scene, 0.0, 0.0))
        inwards, rows = x + EDGE_MM, np.abs(y) < 8.335  # one pitch: a whole number of LEDs
        middle = light.radiance[rows & (np.abs(x) < 3)].mean() / unit
        levels = []
        for low, high in itertools.pairwise(steps):
            where = rows & (inwards >= low) & (inwards < high)
            levels.append(light.radiance[where].mean() / unit)
        above = np.maximum(np.array(levels) - middle, 1e-9)
        mean, weight = 0.5 * (steps[1:] + steps[:-1]), above * np.diff(steps)
        efold = float((weight * (mean - steps[0])).sum() / weight.sum())
        far = light.radiance[rows & (x > EDGE_MM - 1.0) & (x < EDGE_MM)].mean() / unit
        print(f"{name}:", *(f"{level:.4f}" for level in levels), f"; {efold:.2f}; {far:.3f}; {middle:.4f}", flush=True)


if __name__ == "__main__":
    main()
