"""Figures of docs/criticism/photograph.md, and pictures: one run of the critic on the rig's photograph.

Run: python docs/validation/criticism_photograph.py PHOTO_FOLDER [--out outputs]
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

from evanesce.inference.photograph.answer import answer
from evanesce.inference.photograph.critic import criticise_photograph, judged_views
from evanesce.inference.photograph.page import loss_figure, residual_figure, views_words
from evanesce.inference.photograph.picture import read_photograph
from evanesce.measurement.calibration.points import read_points
from evanesce.measurement.io.images import read_image
from evanesce.rig import load_scene


def main() -> None:
    """Run the critic, draw and print."""
    parser = argparse.ArgumentParser(description="The critic on the rig's photograph.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("outputs"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    begun, used = time.time(), time.process_time()
    picture = read_image(given.folder / "checkerboard_1mm.png")
    photograph = read_photograph(picture.data, load_scene("thesis"), "libcamera")
    found = criticise_photograph(photograph, tell=lambda step: print(step, flush=True))
    result = answer(found)
    result["views"] = judged_views(found.bench, read_points(given.folder / "corners.csv"))
    print(json.dumps(result, indent=1))
    print(views_words(result["views"]))
    print(f"{time.process_time() - used:.0f} s of one core, {time.time() - begun:.0f} s, load {os.getloadavg()[0]:.1f}")
    residual_figure(found).savefig(given.out / "criticism-photograph-residuals.png", dpi=80)
    if result["held_out"]["without"]:
        loss_figure(result).savefig(given.out / "criticism-photograph-losses.png", dpi=100)


if __name__ == "__main__":
    main()
