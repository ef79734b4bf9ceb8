"""Compare an exported dataset with its source, frame by frame, through the formats' own libraries."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

import evanesce.dataset as dataset
from evanesce.dataset.config import CHANNELS
from evanesce.dataset.encode import decode_png
from evanesce.dataset.export import export
from evanesce.dataset.export_lerobot import LABELS
from evanesce.dataset.numbers import SCALARS


def exported_equal(source: Path, target: Path, to: str) -> bool:
    """Export and return whether every frame comes back equal."""
    export(source, target, to)
    with dataset.open(source, check=True) as data:
        return {"hdf5": _hdf5, "parquet": _parquet, "coco": _coco, "lerobot": _lerobot}[to](data, target)


def _hdf5(data: dataset.Dataset, target: Path) -> bool:
    import h5py

    with h5py.File(target / "dataset.h5") as file:
        for i, sample in enumerate(data):
            same = np.array_equal(file["frame"][i], sample.frame) and np.array_equal(file["state"][i], sample.state)
            for name in CHANNELS:
                for box, group in ((sample.labels, "labels"), (sample.plate, "plate")):
                    stored = file[f"{group}/{name}"][i]
                    same &= np.array_equal(stored, box.whole(name).astype(stored.dtype), equal_nan=True)
            if not (same and json.loads(file["meta"][i]) == sample.meta):
                return False
        return len(file["frame"]) == len(data)


def _parquet(data: dataset.Dataset, target: Path) -> bool:
    import pyarrow.parquet as pq

    rows = pq.read_table(target / "frames.parquet").to_pylist()
    return len(rows) == len(data) and all(
        {name: row[name] for name in SCALARS} == sample.scalars
        and row["key"] == sample.key
        and all(row[f"finger.{name}"] == value for name, value in sample.meta["finger"].items())
        and all(
            json.loads(row[f"rig.{name}"]) == sample.meta["rig"][name] for name in ("changes", "effects", "left_out")
        )
        for row, sample in zip(rows, data, strict=True)
    )


def _coco(data: dataset.Dataset, target: Path) -> bool:
    from pycocotools import mask

    found = json.loads((target / "annotations.json").read_text())
    states: dict[int, np.ndarray] = {}
    for image, sample in zip(found["images"], data, strict=True):
        picture = cv2.imread(str(target / "images" / image["file_name"]), cv2.IMREAD_UNCHANGED)
        if not np.array_equal(picture, sample.frame):
            return False
        states[image["id"]] = np.zeros_like(sample.state)
    for a in found["annotations"]:
        where = mask.decode(mask.frPyObjects(a["segmentation"], *a["segmentation"]["size"])).astype(bool)
        states[a["image_id"]][where] = a["category_id"]
    return all(np.array_equal(states[s.row["frame"]], s.state) for s in data)


def _lerobot(data: dataset.Dataset, target: Path) -> bool:
    import pyarrow.parquet as pq

    files = sorted((target / "data").rglob("*.parquet"))
    rows = [row for path in files for row in pq.read_table(path).to_pylist()]
    names = ["train", "validation", "test"]  # the order of the episodes
    samples = sorted(data, key=lambda s: names.index(s.row["split"]))
    return len(rows) == len(data) and all(
        np.array_equal(decode_png(row["observation.images.tactile"]["bytes"])[..., 0], s.frame)
        and np.array_equal(decode_png(row["labels.surface_state"]["bytes"])[..., 0], s.state)
        and np.float32(row["observation.state"][0]) == np.float32(s.scalars["drive_mm"])
        and row["labels"] == [float(np.float32(s.scalars[name])) for name in LABELS]
        for row, s in zip(rows, samples, strict=True)
    )
