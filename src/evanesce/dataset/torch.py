"""PyTorch datasets. The only module of the package that imports PyTorch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.core.extras import require
from evanesce.dataset.config import CHANNELS
from evanesce.dataset.read import Dataset, Sample
from evanesce.dataset.trial import SCALARS

try:
    import torch
    from torch.utils.data import Dataset as TorchDataset
    from torch.utils.data import IterableDataset, get_worker_info
except ModuleNotFoundError:
    require("torch", "a data set as tensors")
    raise

Transform = Callable[[Sample], Any]


def tensors(sample: Sample) -> dict[str, Any]:
    """Return a frame as tensors, on the fixed physical scale of the labels.

    Returns
    -------
    dict
        ``frame`` uint8 (1, rows, cols) [DN]; ``state`` int64 (rows, cols); ``scalars`` float32 in the order of
        :data:`evanesce.dataset.trial.SCALARS`; ``index`` int. Where they are stored, ``labels`` float32 (channels,
        rows, cols), all in the order of :data:`evanesce.dataset.config.CHANNELS` (the gap is NaN where nothing is
        near), and ``raw`` int32 (1, rows, cols) [DN].
    """
    stored: dict[str, Any] = {}
    if "labels.exr" in sample.members:
        stored["labels"] = torch.from_numpy(np.stack([sample.labels.whole(name) for name in CHANNELS]))
    if sample.raw is not None:
        stored["raw"] = torch.from_numpy(sample.raw.astype(np.int32)[None])
    return stored | {
        "frame": torch.from_numpy(np.ascontiguousarray(sample.frame)[None]),
        "state": torch.from_numpy(sample.state.astype(np.int64)),
        "scalars": torch.tensor([sample.scalars[name] for name in SCALARS], dtype=torch.float32),
        "index": int(sample.row["frame"]),
    }


class FrameDataset(TorchDataset):
    """Frames by index.

    Parameters
    ----------
    folder : str or Path
    split : str, optional
    transform : callable, optional
        ``transform(Sample) -> anything``; :func:`tensors` by default.
    check : bool
        Compare each member with its SHA-256 when it is read.
    """

    def __init__(
        self, folder: str | Path, *, split: str | None = None, transform: Transform = tensors, check: bool = False
    ) -> None:
        self.dataset, self.transform = Dataset(Path(folder), split=split, check=check), transform

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: int) -> Any:
        return self.transform(self.dataset[index])


class FrameStream(IterableDataset):
    """Iteration in the order of the shards; each worker of a DataLoader reads its own shards.

    Parameters as for :class:`FrameDataset`.
    """

    def __init__(
        self, folder: str | Path, *, split: str | None = None, transform: Transform = tensors, check: bool = False
    ) -> None:
        self.dataset, self.transform = Dataset(Path(folder), split=split, check=check), transform

    def __iter__(self) -> Iterator[Any]:
        worker = get_worker_info()
        first, step = (0, 1) if worker is None else (worker.id, worker.num_workers)
        shards = list(dict.fromkeys(row["shard"] for row in self.dataset.rows()))
        mine = set(shards[first::step])
        for i, row in enumerate(self.dataset.rows()):
            if row["shard"] in mine:
                yield self.transform(self.dataset[i])
