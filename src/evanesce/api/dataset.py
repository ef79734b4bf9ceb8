"""Make labelled samples in memory: the frames and labels that ``evanesce dataset make`` would write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, overload

from evanesce.core.errors import InputError
from evanesce.dataset.config import DatasetConfig, load_config
from evanesce.dataset.job import Job, new_job
from evanesce.dataset.layout import frame_key
from evanesce.dataset.produce import Producer
from evanesce.dataset.read import Sample
from evanesce.rig import Scene
from evanesce.rig.change import merged
from evanesce.rig.load import validate


class MemoryDataset(Sequence[Sample]):
    """The samples of a dataset, each made when it is asked for; nothing is written.

    Parameters
    ----------
    job : Job
        Scene, configuration, seed and count.

    Attributes
    ----------
    job : Job

    Notes
    -----
    A sample holds the bytes that stand in a shard and decodes them when they are asked for, so that it is equal to the
    one that is read from disk. Take the frames in order: only the current trial is cached, another one is solved anew.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self._producer = Producer(job)

    def __repr__(self) -> str:
        return f"MemoryDataset({self.job.trials} trials of {self.job.config.trial.frames} frames, seed {self.job.seed})"

    def __len__(self) -> int:
        return self.job.frames

    @overload
    def __getitem__(self, index: int) -> Sample: ...
    @overload
    def __getitem__(self, index: slice) -> list[Sample]: ...
    def __getitem__(self, index: int | slice) -> Sample | list[Sample]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        frame = range(len(self))[index]
        record = self._producer.record(frame)
        row = {"frame": frame, "trial": record.trial, "key": frame_key(frame), **record.row}
        return Sample(row, record.members, lambda data: data, lambda: self._producer.make(frame, exposed=False))

    def trials(self) -> dict[int, list[int]]:
        """Return the indices of each trial's frames, in order of time."""
        return {trial: list(self.job.frames_of(trial)) for trial in range(self.job.trials)}


def make_dataset(
    scene: Scene,
    *,
    trials: int,
    seed: int = 0,
    config: DatasetConfig | Mapping[str, Any] | str | Path | None = None,
    **changes: Any,
) -> MemoryDataset:
    """Make labelled samples of presses and slides, with stick and slip, in memory.

    Parameters
    ----------
    scene : Scene
        The rig; finger, friction, programme and the drawn keys change from trial to trial.
    trials : int
        Of ``trial.frames`` frames each.
    seed : int
        The same scene, configuration and seed give the same samples.
    config : DatasetConfig, mapping, str or Path, optional
        Declared distributions and options (docs/reference/dataset.md), or their TOML file; the defaults else.
    **changes
        Keys of the configuration to replace, with two underscores for each dot: ``trial__frames=20``,
        ``camera__scale=0.25``.

    Returns
    -------
    MemoryDataset
        A sequence of :class:`~evanesce.dataset.read.Sample`: ``frame`` uint8 (rows, cols) [DN], ``state`` uint8
        (rows, cols) with 0 none, 1 near, 2 stick, 3 slip, ``labels`` in the frame and ``plate`` on the contact plane
        (mask, pressure [MPa], gap [mm], traction [MPa], slip [mm], its velocity [mm/s]), ``scalars`` (forces, areas).

    Raises
    ------
    InputError
        If a key is unknown or out of range, or contacts would leave the sampled plane.

    Examples
    --------
    >>> import evanesce as ev
    >>> samples = ev.make_dataset(
    ...     ev.load("thesis"), trials=1, seed=7, trial__frames=20, camera__scale=0.1, randomisation__probability=0.0
    ... )
    >>> len(samples), samples[5].frame.shape
    (20, (150, 200))
    >>> sorted(samples[5].scalars)[:3]
    ['Fx_N', 'Fy_N', 'Fz_N']
    """
    if isinstance(trials, bool) or not isinstance(trials, int) or trials < 1:
        raise InputError(f"{trials}", key="trials", allowed="a whole number from 1")
    if isinstance(config, str | Path):
        config = load_config(Path(config))
    elif isinstance(config, Mapping):
        config = validate(DatasetConfig, dict(config), "make_dataset")
    settings = config or DatasetConfig()
    if changes:
        settings = validate(DatasetConfig, merged(settings.given(), changes, "make_dataset"), "make_dataset")
    return MemoryDataset(new_job(scene, settings, frames=trials * settings.trial.frames, seed=seed))
