"""Export to HDF5: one file, one chunk per frame; labels over the whole frame, in physical units."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np

from evanesce.dataset.config import CHANNELS
from evanesce.dataset.export import Advance
from evanesce.dataset.numbers import SCALARS
from evanesce.dataset.read import Dataset

FILE = "dataset.h5"


def write(dataset: Dataset, folder: Path, advance: Advance) -> None:
    """Write ``dataset.h5``: ``frame``, ``raw``, ``state``, ``labels/*``, ``plate/*``, ``scalars/*``, ``meta``."""
    first, count = dataset[0], len(dataset)
    precision = np.float16 if dataset.job.config.labels.precision == "half" else np.float32
    with h5py.File(folder / FILE, "w", track_order=True) as file:
        file.attrs["description"] = json.dumps(dataset.job.describe()["config"])
        file.attrs["config_sha256"] = dataset.job.digest

        def images(name: str, shape: tuple[int, ...], dtype: type, unit: str) -> h5py.Dataset:
            fill = np.nan if name.endswith("/gap") else 0
            found = file.create_dataset(
                name, (count, *shape), dtype, chunks=(1, *shape), compression="gzip", compression_opts=1, shuffle=True,
                fillvalue=fill,
            )  # fmt: skip
            found.attrs["unit"] = unit
            return found

        shape, plate = first.state.shape, first.plate.shape
        frames = images("frame", first.frame.shape, np.uint8, "DN")
        states = images("state", shape, np.uint8, CHANNELS["state"])
        raws = None if first.raw is None else images("raw", shape, np.uint16, "DN")
        seen = {name: images(f"labels/{name}", shape, precision, unit) for name, unit in CHANNELS.items()}
        flat = {name: images(f"plate/{name}", plate, precision, unit) for name, unit in CHANNELS.items()}
        numbers = {}
        for name, unit in SCALARS.items():
            numbers[name] = file.create_dataset(f"scalars/{name}", (count,), np.float64)
            numbers[name].attrs["unit"] = unit
        texts = file.create_dataset("meta", (count,), h5py.string_dtype())
        for i, sample in enumerate(dataset):
            frames[i], states[i] = sample.frame, sample.state
            if raws is not None:
                raws[i] = sample.raw
            for box, into in ((sample.labels, seen), (sample.plate, flat)):
                high, wide = box.channels["gap"].shape
                for name, target in into.items():
                    if high and wide:
                        target[i, box.row : box.row + high, box.col : box.col + wide] = box.channels[name]
            for name, target in numbers.items():
                target[i] = sample.scalars[name]
            texts[i] = json.dumps(sample.meta, sort_keys=True)
            advance(1)
