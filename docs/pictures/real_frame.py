"""The real contact frame beside the simulated one, for the README and the first page of the documentation.

Left: the only public contact frame of the rig, a thumbnail of 53 x 42 pixels (A. E. Macaulay, drmacani/Waveguide, MIT
licence). Middle: its twin at the same resolution. Right: the twin's scene at the camera's own resolution.

Run: evanesce twin FRAME --contact --out TWIN; python docs/pictures/real_frame.py FRAME TWIN
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

from evanesce.chain.simulate import simulate
from evanesce.measurement.io.images import read_image
from evanesce.render.fast.transport import render_fast
from evanesce.rig import load_scene

HERE = Path(__file__).parent


def main() -> None:
    """Draw docs/pictures/real-frame.png."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frame", type=Path)
    parser.add_argument("twin", type=Path, help="folder that the command wrote")
    parser.add_argument("--out", type=Path, default=HERE / "real-frame.png")
    given = parser.parse_args()
    frame = read_image(given.frame).data
    scene = load_scene(given.twin / "twin_scene.toml")
    found = json.loads((given.twin / "twin.json").read_text(encoding="utf-8"))
    place = {one["name"]: one["value"] for one in found["figures"]}
    # The view of the frame: its width by the twin's scale, its middle where the finger is not.
    rows, cols = frame.shape[:2]
    width_mm = cols / place["scale"]
    view = {"camera.resolution_px": [1270, round(1270 * rows / cols)], "camera.scale_px_per_mm": 1270 / width_mm}
    middle = [(cols - 1) / 2 - found["place_px"]["x"], (rows - 1) / 2 - found["place_px"]["y"]]
    view["camera.centre_mm"] = [offset / place["scale"] for offset in middle]
    near = scene.with_(view)
    shot = simulate(near, near.press.forces_N[0], seed=1, render=render_fast).frame.data
    simulated = np.clip(np.rint(np.array(found["simulated"])), 0, 255).astype(np.uint8)
    figure, axes = plt.subplots(1, 3, figsize=(12.0, 3.5), layout="constrained")
    titles = ("real frame (thumbnail)", "simulated, same resolution", "simulated, camera's resolution")
    for axis, image, title in zip(axes, (frame, simulated, shot), titles, strict=True):
        axis.imshow(image, interpolation="nearest", extent=(0, width_mm, width_mm * rows / cols, 0))
        axis.set(title=title, xlabel="x [mm]", ylabel="y [mm]")
    figure.savefig(given.out, dpi=110)


if __name__ == "__main__":
    main()
