"""Picture of docs/criticism/index.md: what every cause may look like in the frames of a small rig.

Run: python docs/pictures/critic_shapes.py
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from evanesce.bundle.protocol import default_protocol
from evanesce.bundle.read import read_bundle
from evanesce.bundle.write import write_bundle
from evanesce.inference.critic import shapes_of
from evanesce.inference.shape_picture import shape_figure
from evanesce.rig import load_scene

HERE = Path(__file__).resolve().parent
RIG = {
    "plate.size_mm": [90.0, 70.0],
    "finger.tip_radius_mm": 8.0,
    "finger.position_mm": [0.6, 0.4],
    "camera.resolution_px": [160, 120],
    "camera.scale_px_per_mm": 8.0,
    "camera.exposure_ms": 4.5,
    "camera.pixel.pitch_um": 15.5,
    "camera.pixel.fill_factor": 0.05,
    "camera.lens.defocus_um": 60.0,
    "press.forces_N": [5.0],
}


def main() -> None:
    """Write the picture."""
    scene = load_scene("thesis", RIG)
    protocol = replace(default_protocol(scene), replicates=6, led_off=3, lens_cap=3, checkerboard=0, square=0)
    with tempfile.TemporaryDirectory() as folder:
        bundle = Path(folder) / "bundle"
        write_bundle(bundle, scene, seed=3, nominal=scene, protocol=protocol)
        forms, data = shapes_of(read_bundle(bundle), tell=print)
    shape_figure(forms, data).savefig(HERE / "critic-shapes.png", dpi=80)


if __name__ == "__main__":
    main()
