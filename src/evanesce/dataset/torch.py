"""PyTorch datasets. The only module of the package that imports PyTorch."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.core.extras import require
from evanesce.dataset.config import CHANNELS
from evanesce.dataset.numbers import SCALARS
from evanesce.dataset.read import Dataset, Sample
from evanesce.dataset.stream import Stream, shuffled, windows
from evanesce.dataset.worker import single_threaded

try:
    import torch
    from torch.utils.data import Dataset as TorchDataset
    from torch.utils.data import IterableDataset, default_collate, get_worker_info
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
        :data:`evanesce.dataset.numbers.SCALARS`; ``index`` int. Where they are stored, or asked for of a stream,
        ``labels`` float32 (channels, rows, cols), in the order of :data:`evanesce.dataset.config.CHANNELS` (the gap is
        NaN where nothing is near), and ``raw`` int32 (1, rows, cols) [DN].
    """
    stored: dict[str, Any] = {}
    if "labels.exr" in sample.members or (not sample.members and len(sample.labels.channels) > 1):
        box = sample.labels
        stored["labels"] = torch.from_numpy(np.stack([box.whole(name) for name in CHANNELS if name in box.channels]))
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


class ClipDataset(TorchDataset):
    """Clips of consecutive frames by index; a ``DataLoader`` with ``shuffle=True`` shuffles them.

    Parameters
    ----------
    folder : str or Path
    length : int
        Frames of a clip; all are of one trial.
    stride : int
        Frames from one clip's first to the next one's.
    step : int
        Frames from one of a clip to its next.
    split : str, optional
    transform : callable, optional
        Of each frame; tensors are stacked along a new first axis.
    check : bool
        Compare each member with its SHA-256 when it is read.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        length: int = 8,
        stride: int = 4,
        step: int = 1,
        split: str | None = None,
        transform: Transform = tensors,
        check: bool = False,
    ) -> None:
        self.dataset, self.transform = Dataset(Path(folder), split=split, check=check), transform
        self.clips = windows(self.dataset.trials().values(), length, stride, step)

    def __len__(self) -> int:
        return len(self.clips)

    def __getitem__(self, index: int) -> Any:
        return default_collate([self.transform(self.dataset[i]) for i in self.clips[index]])


class SimulatedStream(IterableDataset):
    """Frames as they are made, without disk; each worker of a ``DataLoader`` makes trials of its own.

    Parameters
    ----------
    stream : Stream
        From :func:`evanesce.dataset.stream`, of ``workers=0``: the loader has the processes.
    transform : callable
    shuffle : int
        Frames in memory of each worker, from among which the next is drawn; 0 keeps their order.
    seed : int
        Of the order.
    """

    def __init__(self, stream: Stream, *, transform: Transform = tensors, shuffle: int = 0, seed: int = 0) -> None:
        self.stream, self.transform, self.shuffle, self.seed = stream, transform, shuffle, seed

    def __iter__(self) -> Iterator[Any]:
        worker = get_worker_info()
        mine, seed = self.stream, self.seed
        if worker is not None:
            single_threaded()
            mine, seed = mine.part(worker.id, worker.num_workers), seed + worker.id
        samples: Iterable[Sample] = shuffled(mine, self.shuffle, seed) if self.shuffle > 1 else mine
        for sample in samples:
            yield self.transform(sample)
