"""Export to LeRobot's layout, version 3.0: trials as episodes; frames and state masks as lossless images in Parquet.

What a robot would know (frame, position of its drive) are observations, what only the simulation knows (forces, areas,
stick ratio, state masks) are labels: a policy trained on ``observation.*`` sees no truth. Images have three channels.
Images are in the data file (``dtype: image``), not in a video, because H.264 is lossy.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from evanesce.core.errors import InputError
from evanesce.dataset import layout
from evanesce.dataset.encode import decode_png, png
from evanesce.dataset.export import Advance
from evanesce.dataset.numbers import SCALARS
from evanesce.dataset.read import Dataset, Sample

VERSION = "v3.0"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
FILE_BYTES = 100_000_000
CHUNK_FILES = 1000
SPLITS = ("train", "validation", "test")
STATE = ("drive_mm",)
"""Numbers that make up ``observation.state``; the action is that of the next frame."""
LABELS = tuple(name for name in SCALARS if name not in (*STATE, "time_s"))
"""Numbers that make up ``labels``."""
TACTILE, SURFACE = "observation.images.tactile", "labels.surface_state"

_IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
_SCHEMA = pa.schema(
    [
        (TACTILE, _IMAGE),
        (SURFACE, _IMAGE),
        ("observation.state", pa.list_(pa.float32(), len(STATE))),
        ("labels", pa.list_(pa.float32(), len(LABELS))),
        ("action", pa.list_(pa.float32(), 1)),
        ("timestamp", pa.float32()),
        ("frame_index", pa.int64()),
        ("episode_index", pa.int64()),
        ("index", pa.int64()),
        ("task_index", pa.int64()),
    ]
)


def write(dataset: Dataset, folder: Path, advance: Advance) -> None:
    """Write ``meta/``, ``data/`` in LeRobot's layout.

    Raises
    ------
    InputError
        If the frame rate is not an integer, as LeRobot requires.
    """
    rate = dataset.job.config.trial.frame_rate_hz
    if rate != round(rate):
        raise InputError(f"{rate:g} frames a second", file=dataset.folder, key="--to lerobot", allowed="whole numbers")
    tasks: dict[str, int] = {}
    episodes, stats = [], _Stats()
    writer = _Files(folder)
    done = 0
    for number, indices in enumerate(_by_split(dataset)):
        rows = []
        for position, i in enumerate(indices):
            sample = dataset[i]
            task = tasks.setdefault(sample.meta["kind"], len(tasks))
            rows.append(_row(sample, number, position, done + position, task))
            advance(1)
        for row, after in zip(rows, [*rows[1:], rows[-1]], strict=True):
            row["action"] = after["observation.state"]
            stats.add(row)
        chunk, file = writer.add(rows)
        kind = dataset[indices[0]].meta["kind"]
        episodes.append(
            {
                "episode_index": number, "tasks": [kind], "length": len(rows), "data/chunk_index": chunk,
                "data/file_index": file, "dataset_from_index": done, "dataset_to_index": done + len(rows),
                "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
                "split": dataset[indices[0]].row["split"], "trial": dataset[indices[0]].row["trial"],
            }
        )  # fmt: skip
        done += len(rows)
    writer.close()
    _meta(dataset, folder, tasks, episodes, stats, done)


def _by_split(dataset: Dataset) -> list[list[int]]:
    """Return the indices of each episode's frames, ordered by split: LeRobot's splits are ranges.

    An episode is a trial; it ends where a frame could not be made, since its time stamps have to be equidistant.
    """
    rows = dataset.rows()
    episodes: list[list[int]] = []
    for indices in dataset.trials().values():
        for position, i in enumerate(indices):
            if position == 0 or rows[i]["frame"] != rows[indices[position - 1]]["frame"] + 1:
                episodes.append([])
            episodes[-1].append(i)
    return sorted(episodes, key=lambda indices: SPLITS.index(rows[indices[0]]["split"]))


def _ranges(episodes: list[dict[str, Any]]) -> dict[str, str]:
    """Return the episodes of each split that is not empty, ``first:end``."""
    found = {}
    for split in SPLITS:
        numbers = [e["episode_index"] for e in episodes if e["split"] == split]
        if numbers:
            found[split] = f"{numbers[0]}:{numbers[-1] + 1}"
    return found


def _row(sample: Sample, episode: int, position: int, index: int, task: int) -> dict[str, Any]:
    fps = float(sample.scalars["time_s"])
    return {
        TACTILE: {"bytes": png(_three(sample.frame)), "path": f"{sample.key}.frame.png"},
        SURFACE: {"bytes": png(_three(sample.state)), "path": f"{sample.key}.mask.png"},
        "observation.state": [sample.scalars[name] for name in STATE],
        "labels": [sample.scalars[name] for name in LABELS],
        "timestamp": fps,
        "frame_index": position,
        "episode_index": episode,
        "index": index,
        "task_index": task,
    }


class _Files:
    """Parquet files of bounded size; no episode is divided."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._number, self._size = folder, -1, 0
        self._writer: Any = None

    def add(self, rows: list[dict[str, Any]]) -> tuple[int, int]:
        """Append an episode; return the chunk and file it went to."""
        size = sum(len(row[TACTILE]["bytes"]) for row in rows)
        if self._writer is None or self._size + size > FILE_BYTES:
            self.close()
            self._number, self._size = self._number + 1, 0
            path = self._folder / DATA.format(
                chunk_index=self._number // CHUNK_FILES, file_index=self._number % CHUNK_FILES
            )
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path, _SCHEMA)
        self._writer.write_table(pa.Table.from_pylist(rows, schema=_SCHEMA))
        self._size += size
        return self._number // CHUNK_FILES, self._number % CHUNK_FILES

    def close(self) -> None:
        """Finish the last file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


def _three(image: np.ndarray) -> np.ndarray:
    """Return an image with three channels, as LeRobot's policies take them."""
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image


class _Stats:
    """Running minimum, maximum, mean and deviation of each feature, as LeRobot keeps them."""

    def __init__(self) -> None:
        self._sums: dict[str, list[Any]] = {}

    def add(self, row: dict[str, Any]) -> None:
        """Include a frame."""
        for name in (
            "observation.state",
            "labels",
            "action",
            "timestamp",
            "frame_index",
            "episode_index",
            "index",
            "task_index",
        ):
            self._take(name, np.atleast_1d(np.asarray(row[name], np.float64)), 1)
        for name in (TACTILE, SURFACE):
            # LeRobot's images are in [0, 1] with a channel axis first.
            values = decode_png(row[name]["bytes"]).astype(np.float64).reshape(-1, 3) / 255.0
            self._merge(name, [values.min(0), values.max(0), values.sum(0), (values**2).sum(0), len(values)])

    def _take(self, name: str, value: np.ndarray, count: int) -> None:
        self._merge(name, [value, value, value, value**2, count])

    def _merge(self, name: str, new: list[Any]) -> None:
        old = self._sums.get(name)
        if old is None:
            self._sums[name] = new
            return
        low, high = np.minimum(old[0], new[0]), np.maximum(old[1], new[1])
        self._sums[name] = [low, high, old[2] + new[2], old[3] + new[3], old[4] + new[4]]

    def table(self, frames: int) -> dict[str, Any]:
        """Return the content of ``meta/stats.json``."""
        found = {}
        for name, (low, high, total, squares, count) in self._sums.items():
            mean = total / count
            deviation = np.sqrt(np.maximum(squares / count - mean**2, 0.0))
            values = {"min": low, "max": high, "mean": mean, "std": deviation}
            image = name in (TACTILE, SURFACE)
            shown = {k: [[[x]] for x in v.tolist()] if image else v.tolist() for k, v in values.items()}
            found[name] = shown | {"count": [frames]}
        return found


def _meta(
    dataset: Dataset, folder: Path, tasks: dict[str, int], episodes: list[dict[str, Any]], stats: _Stats, frames: int
) -> None:
    names = ["height", "width", "channels"]
    image = {"dtype": "image", "shape": [*dataset[0].frame.shape[:2], 3], "names": names}
    scalar = {"dtype": "int64", "shape": [1], "names": None}
    features = {
        TACTILE: image,
        SURFACE: image,
        "observation.state": {"dtype": "float32", "shape": [len(STATE)], "names": list(STATE)},
        "labels": {"dtype": "float32", "shape": [len(LABELS)], "names": list(LABELS)},
        "action": {"dtype": "float32", "shape": [1], "names": ["drive_mm"]},
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        "frame_index": scalar,
        "episode_index": scalar,
        "index": scalar,
        "task_index": scalar,
    }
    path = folder / EPISODES
    path.parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(episodes), path)
    # LeRobot reads tasks through pandas, with the task's text as index.
    texts = pd.DataFrame({"task_index": list(tasks.values())}, index=pd.Index(list(tasks), name="task"))
    texts.to_parquet(folder / "meta" / "tasks.parquet")
    layout.write_json(folder / "meta" / "stats.json", stats.table(frames))
    layout.write_json(
        folder / "meta" / "info.json",
        {
            "codebase_version": VERSION,
            "robot_type": "ftir_tactile_rig",
            "total_episodes": len(episodes),
            "total_frames": frames,
            "total_tasks": len(tasks),
            "chunks_size": CHUNK_FILES,
            "data_files_size_in_mb": FILE_BYTES // 1_000_000,
            "video_files_size_in_mb": 200,
            "fps": round(dataset.job.config.trial.frame_rate_hz),
            "splits": _ranges(episodes),
            "data_path": DATA,
            "video_path": None,
            "features": features,
        },
    )
