"""Pictures and table of docs/criticism/photograph.md: one run of the critic on the rig's photograph.

Run: python docs/validation/criticism_photograph.py PHOTO_FOLDER [--out docs/pictures]
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

from evanesce.criticism.photograph import criticise_photograph
from evanesce.criticism.photograph_light import read_photograph
from evanesce.criticism.photograph_page import loss_figure, residual_figure, views_words
from evanesce.criticism.photograph_views import photographed_views
from evanesce.measurement.calibration.points import read_points
from evanesce.measurement.io.images import read_image
from evanesce.rig import load_scene


def main() -> None:
    """Run the critic, draw and print."""
    parser = argparse.ArgumentParser(description="The critic on the rig's photograph.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/pictures"))
    given = parser.parse_args()
    begun, used = time.time(), time.process_time()
    picture = read_image(given.folder / "checkerboard_1mm.png")
    photograph = read_photograph(picture.data, load_scene("thesis"), "libcamera")
    found, bench = criticise_photograph(photograph, tick=lambda step: print(step, flush=True))
    answer = found.answer
    answer["views"] = photographed_views(photograph, read_points(given.folder / "corners.csv"), bench.pixel_noise_DN)
    print(json.dumps(answer, indent=1))
    print(views_words(answer["views"]))
    print(f"{time.process_time() - used:.0f} s of one core, {time.time() - begun:.0f} s, load {os.getloadavg()[0]:.1f}")
    residual_figure(found, bench).savefig(given.out / "criticism-photograph-residuals.png", dpi=80)
    if answer["dropped"]:
        loss_figure(answer).savefig(given.out / "criticism-photograph-losses.png", dpi=100)


if __name__ == "__main__":
    main()
