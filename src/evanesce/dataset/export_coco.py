"""Export to COCO: frames as PNG, near, stick and slip as run-length masks, numbers as extra keys of each image."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import SurfaceState
from evanesce.dataset import layout
from evanesce.dataset.export import Advance
from evanesce.dataset.read import Dataset

FILE = "annotations.json"
CATEGORIES = {int(SurfaceState.NEAR): "near", int(SurfaceState.STICK): "stick", int(SurfaceState.SLIP): "slip"}


def run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """Return COCO's uncompressed run lengths in column-major order, zeros first."""
    flat = np.concatenate([[False], mask.ravel(order="F"), [False]])
    flat[-1] = not flat[-2]
    edges = np.flatnonzero(flat[1:] != flat[:-1])
    counts = np.diff(np.concatenate([[0], edges]))
    return [int(c) for c in counts]


def write(dataset: Dataset, folder: Path, advance: Advance) -> None:
    """Write ``images/*.png`` and ``annotations.json``."""
    (folder / "images").mkdir()
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for sample in dataset:
        name = f"{sample.key}.png"
        (folder / "images" / name).write_bytes(sample.bytes_of("frame.png"))
        state = sample.state
        rows, cols = state.shape
        images.append(
            {
                "id": sample.row["frame"], "file_name": name, "width": cols, "height": rows,
                "split": sample.row["split"], "trial": sample.row["trial"], **sample.scalars,
            }
        )  # fmt: skip
        for category in CATEGORIES:
            mask = state == category
            if not mask.any():
                continue
            at_rows, at_cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
            box = [int(at_cols[0]), int(at_rows[0]), int(np.ptp(at_cols)) + 1, int(np.ptp(at_rows)) + 1]
            annotations.append(
                {
                    "id": len(annotations) + 1, "image_id": sample.row["frame"], "category_id": category, "iscrowd": 1,
                    "segmentation": {"size": [rows, cols], "counts": run_lengths(mask)}, "area": int(mask.sum()),
                    "bbox": box,
                }
            )  # fmt: skip
        advance(1)
    whole = {
        "info": {"description": dataset.job.config.title or dataset.job.scene.title, "version": "1.0"},
        "images": images,
        "annotations": annotations,
        "categories": [{"id": i, "name": name, "supercategory": "contact"} for i, name in CATEGORIES.items()],
    }
    layout.write_json(folder / FILE, whole)
