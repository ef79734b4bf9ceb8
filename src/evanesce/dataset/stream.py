"""Frames and labels in memory, as they are made: no disk, the same for any number of processes."""

from __future__ import annotations

import itertools
import multiprocessing
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.core import rng
from evanesce.core.errors import InputError
from evanesce.dataset.config import DatasetConfig, load_config, with_size
from evanesce.dataset.design import trial_plan
from evanesce.dataset.job import Job, new_job
from evanesce.dataset.produce import Made, Producer
from evanesce.dataset.read import Sample
from evanesce.dataset.worker import single_threaded
from evanesce.rig import Scene, load_scene
from evanesce.rig.load import validate

AHEAD = 2
"""Trials that each process has in hand or in store."""


class Stream(Iterable[Sample]):
    """Frames in order of trials and time, each a :class:`~evanesce.dataset.read.Sample`; iterate as often as needed.

    Parameters
    ----------
    job : Job
    trials : int or None
        Count of trials of the split; None: endless.
    split : str or None
        Only ``train``, ``validation`` or ``test``.
    workers : int
        Processes; 0 makes frames in this one.
    first, step : int
        Of the trials of the split, begin with this one and take every so many: for loaders that share a stream.
    """

    def __init__(
        self, job: Job, *, trials: int | None, split: str | None = None, workers: int = 0, first: int = 0, step: int = 1
    ) -> None:
        self.job, self.trials, self.split, self.workers, self.first, self.step = (
            job,
            trials,
            split,
            workers,
            first,
            step,
        )

    def part(self, first: int, step: int) -> Stream:
        """Return every so many of the trials, made in this process."""
        return Stream(
            self.job, trials=self.trials, split=self.split, first=self.first + first * self.step, step=self.step * step
        )

    def numbers(self) -> Iterator[int]:
        """Return the numbers of the trials."""
        config, seed = self.job.config, self.job.seed
        every = (n for n in itertools.count() if self.split in (None, trial_plan(config, seed, n).split))
        return itertools.islice(every, self.first, self.trials, self.step)

    def clips(self) -> Iterator[list[Sample]]:
        """Return whole trials."""
        for made in self._made():
            yield [sample_of(one) for one in made]

    def __iter__(self) -> Iterator[Sample]:
        return itertools.chain.from_iterable(self.clips())

    def _made(self) -> Iterator[list[Made]]:
        if not self.workers:
            producer = Producer(self.job)
            for number in self.numbers():
                yield _trial(producer, number)
            return
        pool = ProcessPoolExecutor(
            self.workers, multiprocessing.get_context("spawn"), initializer=_begin, initargs=(self.job,)
        )
        waiting: deque[Future[list[Made]]] = deque()
        numbers = self.numbers()
        try:
            for number in itertools.islice(numbers, AHEAD * self.workers):
                waiting.append(pool.submit(_in_process, number))
            while waiting:
                done = waiting.popleft().result()
                waiting.extend(pool.submit(_in_process, number) for number in itertools.islice(numbers, 1))
                yield done
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def stream(
    config: DatasetConfig | Mapping[str, Any] | Path | str | None = None,
    *,
    scene: Scene | str = "thesis",
    size: str = "",
    seed: int = 0,
    trials: int | None = None,
    split: str | None = None,
    workers: int = 0,
) -> Stream:
    """Return frames and labels of a data set that is never written.

    Parameters
    ----------
    config : DatasetConfig, mapping or path of a TOML file, optional
        ``labels.frame`` names the channels beside the state that each frame carries.
    scene : Scene or str
    size : str
        Of the frames, e.g. ``320x240``; empty: as the configuration says.
    seed : int
        The same seed gives the same frames, with any number of workers.
    trials : int, optional
        Of the split; endless by default.
    split : str, optional
        ``train``, ``validation`` or ``test``; finger and rig of one are in no other.
    workers : int
        Processes; 0 makes frames in this one.

    Returns
    -------
    Stream

    Raises
    ------
    InputError
        For a configuration that cannot be made.

    Examples
    --------
    >>> from evanesce.dataset import stream
    >>> for sample in stream(size="96x72", seed=3, trials=1):  # doctest: +SKIP
    ...     train(sample.frame, sample.state, sample.scalars["stick_ratio"])
    """
    if split not in (None, "train", "validation", "test"):
        raise InputError(f"{split!r}", key="split", allowed="train, validation, test")
    if workers < 0:
        raise InputError(f"{workers}", key="workers", allowed="0 or more")
    if trials is not None and trials < 1:
        raise InputError(f"{trials}", key="trials", allowed="1 or more, or None")
    if isinstance(config, str | Path):
        config = load_config(Path(config))
    elif config is None or isinstance(config, Mapping):
        config = validate(DatasetConfig, dict(config or {}), "config")
    config = with_size(config, size)
    seen = load_scene(scene) if isinstance(scene, str) else scene
    return Stream(
        new_job(seen, config, frames=(trials or 1) * config.trial.frames, seed=seed),
        trials=trials,
        split=split,
        workers=workers,
    )


def shuffled(samples: Iterable[Any], buffer: int, seed: int) -> Iterator[Any]:
    """Return samples in random order, each from among the next ``buffer``; the same for the same seed.

    Parameters
    ----------
    samples : iterable
    buffer : int
        Samples in memory; 1 keeps the order.
    seed : int
    """
    generator, held = rng.generator(seed, "dataset", "shuffle"), []
    for sample in samples:
        held.append(sample)
        if len(held) >= buffer:
            chosen = int(generator.integers(len(held)))
            held[chosen], held[-1] = held[-1], held[chosen]
            yield held.pop()
    generator.shuffle(held)
    yield from held


def windows(trials: Iterable[list[int]], length: int, stride: int, step: int = 1) -> list[tuple[int, ...]]:
    """Return the clips of trials: ``length`` frames ``step`` apart, one clip every ``stride`` frames.

    Parameters
    ----------
    trials : iterable of list of int
        Indices of each trial's frames, in order of time.
    length, stride, step : int

    Raises
    ------
    InputError
        For a number below 1.
    """
    if min(length, stride, step) < 1:
        raise InputError(f"{length}, {stride}, {step}", key="length, stride, step", allowed="1 or more")
    reach = (length - 1) * step
    return [
        tuple(frames[first : first + reach + 1 : step])
        for frames in trials
        for first in range(0, len(frames) - reach, stride)
    ]


def sample_of(made: Made) -> Sample:
    """Return a frame in memory as a sample."""
    meta, picture = made.meta, made.picture
    assert picture is not None
    row = {"frame": made.frame, "key": meta["key"], "trial": made.trial, "split": meta["split"], "kind": meta["kind"]}
    sample = Sample(row, {}, lambda _: b"", lambda: made)
    sample.__dict__ |= {"frame": picture.data, "raw": picture.raw, "state": made.mask, "meta": meta}
    return sample


def _trial(producer: Producer, number: int) -> list[Made]:
    labels = producer.job.config.labels
    asked = [labels.channels(key) for key in ("frame", "plate")]
    return [producer.make(frame, *asked) for frame in producer.job.frames_of(number)]


_producer: Producer | None = None


def _begin(job: Job) -> None:
    global _producer
    single_threaded()
    _producer = Producer(job)


def _in_process(number: int) -> list[Made]:
    assert _producer is not None  # the pool's initializer made it
    return _trial(_producer, number)


def stacked(samples: Iterable[Sample]) -> dict[str, np.ndarray]:
    """Return frames of one clip as arrays: ``frame``, ``state`` (n, rows, cols), ``time_s``, ``stick_ratio`` (n,)."""
    every = list(samples)
    return {
        "frame": np.stack([s.frame for s in every]),
        "state": np.stack([s.state for s in every]),
        **{name: np.array([s.scalars[name] for s in every]) for name in ("time_s", "stick_ratio")},
    }
