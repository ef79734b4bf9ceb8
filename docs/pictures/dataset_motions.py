"""Draw trials of a data set with motions, prints, liquid and markers: ``python docs/pictures/dataset_motions.py``."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from dataset_sheet import FRAMES, tile

from evanesce.dataset.config import KINDS
from evanesce.dataset.stream import stream

HERE = Path(__file__).resolve().parent
PLAIN = {"randomisation": {"probability": 0.0}, "finger": {"ridged_share": 1.0, "count": 1}}
PRINT = {
    "pattern": {"constant": "print_loop"},
    "ridge_pitch_um": {"constant": 460.0},
    "ridge_height_um": {"constant": 100.0},
}
ROWS = (
    ("spin", {"finger": {"pattern": {"constant": "parallel"}}}),
    ("slide", {"motion": {"stick_slip": 1.0, "torsion": 1.0}, "finger": {"pattern": {"constant": "concentric"}}}),
    ("slide", {"motion": {"turn": 1.0}, "finger": PRINT}),
    ("slide", {"liquid": {"share": 1.0, "volume_uL": {"constant": 0.1}}, "finger": {"pattern": {"constant": "whorl"}}}),
    ("slide", {"motion": {"torsion": 1.0}, "markers": {"pitch_mm": 0.9}, "finger": {"ridged_share": 0.0}}),
)
"""Kind and what each row's trial has."""


def main() -> None:
    """Take one trial of each row, and frames from first contact to the end."""
    lines = []
    for kind, sections in ROWS:
        config = {**PLAIN, "kinds": {**dict.fromkeys(KINDS, 0.0), kind: 1.0}, **sections}
        config["finger"] = {**PLAIN["finger"], **sections["finger"]}
        samples = list(stream(config, size="320x240", seed=7, trials=1))
        chosen = np.linspace(8, len(samples) - 1, FRAMES).astype(int)
        lines.append(np.concatenate([tile(samples[i]) for i in chosen], axis=1))
    sheet = np.concatenate(lines, axis=0)
    cv2.imwrite(str(HERE / "dataset-motions.webp"), sheet[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, 80])


if __name__ == "__main__":
    main()
