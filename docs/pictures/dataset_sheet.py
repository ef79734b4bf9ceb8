"""Draw slides of a data set, frames above surface states: ``python docs/pictures/dataset_sheet.py FOLDER``.

The folder is that of ``evanesce dataset make thesis --n 3200 --seed 7 --size 320x240``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

import evanesce as ev
from evanesce.core.states import SurfaceState
from evanesce.dataset.preview import COLOURS

HERE = Path(__file__).resolve().parent
SLIDES, FRAMES, WIDTH = 4, 8, 190


def main(folder: str) -> None:
    """Take the first slide of each pattern of ridges, and frames from first contact to the end."""
    data = ev.open_dataset(folder)
    firsts = {}
    for trial, rows in data.trials().items():
        meta = data[rows[0]].meta
        if meta["kind"] == "slide" and meta["finger"]["pattern"]:
            firsts.setdefault(meta["finger"]["pattern"], trial)
    lines = []
    for trial in sorted(firsts.values())[:SLIDES]:
        rows = data.trials()[trial]
        tiles = [tile(data[rows[int(i)]]) for i in np.linspace(8, len(rows) - 1, FRAMES)]
        lines.append(np.concatenate(tiles, axis=1))
    sheet = np.concatenate(lines, axis=0)
    cv2.imwrite(str(HERE / "dataset-slides.webp"), sheet[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, 80])


def tile(sample) -> np.ndarray:
    """Return a frame above the same with its states: green sticks, orange slips."""
    grey = np.repeat(sample.frame[..., None], 3, axis=2) if sample.frame.ndim == 2 else sample.frame
    tinted = grey.astype(np.float32)
    for state in (SurfaceState.STICK, SurfaceState.SLIP):
        where = sample.state == state
        tinted[where] = 0.4 * tinted[where] + 0.6 * np.array(COLOURS[state], np.float32)
    pair = np.concatenate([grey, tinted.astype(np.uint8)], axis=0)
    small = cv2.resize(pair, (WIDTH, round(WIDTH * pair.shape[0] / pair.shape[1])), interpolation=cv2.INTER_AREA)
    text = f"{sample.scalars['time_s']:.2f} s, stick {sample.scalars['stick_ratio']:.2f}"
    cv2.putText(small, text, (4, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.34, (255, 255, 255), 1, cv2.LINE_AA)
    return small


if __name__ == "__main__":
    main(sys.argv[1])
