"""Frames in memory: those of the data set on disk, the same from any number of processes; clips and shuffling."""

from __future__ import annotations

import itertools
import os

import numpy as np
import pytest

from evanesce import dataset
from evanesce.core.errors import InputError
from evanesce.dataset.run import make
from evanesce.dataset.stream import shuffled, stacked, stream, windows
from support.datasets import tiny_config, tiny_job
from support.rigs import small_rig


def small(**options):
    return stream(tiny_config(), scene=small_rig(), seed=11, **options)


def test_a_stream_is_the_data_set_on_disk(tmp_path):
    make(tmp_path / "d", tiny_job(frames=24, seed=11))
    with dataset.open(tmp_path / "d") as stored:
        made = list(small(trials=4))
        assert len(made) == len(stored) == 24
        for one, other in zip(made, stored, strict=True):
            assert one.key == other.key
            assert one.meta == other.meta
            np.testing.assert_array_equal(one.frame, other.frame)
            np.testing.assert_array_equal(one.state, other.state)
            pressure = other.labels.whole("pressure")  # half precision on disk
            np.testing.assert_allclose(one.labels.whole("pressure"), pressure, rtol=1e-3, atol=1e-6)
    assert {path.name for path in tmp_path.iterdir()} == {"d"}


@pytest.mark.slow
def test_processes_make_the_same_frames_in_the_same_order():
    alone = [(s.key, s.frame.tobytes(), s.scalars["Fz_N"]) for s in small(trials=3)]
    others = small(trials=3, workers=2)
    assert [(s.key, s.frame.tobytes(), s.scalars["Fz_N"]) for s in others] == alone
    assert len({frame for _, frame, _ in alone}) == 18


def test_an_endless_stream_can_be_left_and_begun_again():
    endless = small()
    first = [s.key for s in itertools.islice(endless, 30)]
    assert first == [f"{n:09d}" for n in range(30)]
    assert [s.key for s in itertools.islice(endless, 3)] == first[:3]


def test_parts_share_the_trials():
    whole = list(small(trials=5).numbers())
    parts = [list(small(trials=5).part(i, 2).numbers()) for i in (0, 1)]
    assert sorted(parts[0] + parts[1]) == whole == [0, 1, 2, 3, 4]
    split = list(itertools.islice(small(split="test").numbers(), 4))
    assert all(s.meta["split"] == "test" for s in small(split="test", trials=1))
    assert set(split).isdisjoint(itertools.islice(small(split="train").numbers(), 20))


def test_shuffling_keeps_every_sample_once_and_depends_on_the_seed():
    samples = list(range(200))
    one, again, other = (list(shuffled(samples, 50, seed)) for seed in (3, 3, 4))
    assert one == again != other
    assert sorted(one) == samples
    assert np.abs(np.subtract(one, samples)).mean() > 10
    assert list(shuffled(samples, 1, 3)) == samples


def test_clips_stay_within_a_trial():
    clips = windows([[0, 1, 2, 3, 4, 5], [6, 7, 8], [9]], length=3, stride=2)
    assert clips == [(0, 1, 2), (2, 3, 4), (6, 7, 8)]
    assert windows([[0, 1, 2, 3, 4, 5]], length=2, stride=1, step=4) == [(0, 4), (1, 5)]
    with pytest.raises(InputError, match="1 or more"):
        windows([[0]], length=0, stride=1)


def test_a_clip_is_stacked():
    clip = next(small(trials=1).clips())
    arrays = stacked(clip)
    assert arrays["frame"].shape == arrays["state"].shape == (6, 48, 64)
    np.testing.assert_allclose(np.diff(arrays["time_s"]), 1 / 8)


@pytest.mark.parametrize("wrong", [{"split": "tests"}, {"workers": -1}, {"trials": 0}, {"size": "big"}])
def test_what_cannot_be_streamed_is_refused(wrong):
    with pytest.raises(InputError):
        small(**wrong)


def test_torch_reads_streams_and_clips(tmp_path):
    torch = pytest.importorskip("torch")
    from torch.utils.data import DataLoader

    from evanesce.dataset.torch import ClipDataset, SimulatedStream

    made = SimulatedStream(small(trials=4), shuffle=8, seed=2)
    batches = list(DataLoader(made, batch_size=4))
    assert sum(len(batch["frame"]) for batch in batches) == 24
    assert batches[0]["frame"].shape == (4, 1, 48, 64)
    assert batches[0]["frame"].dtype == torch.uint8
    keys = [int(i) for batch in batches for i in batch["index"]]
    assert sorted(keys) == list(range(24)) != keys
    make(tmp_path / "d", tiny_job(frames=24, seed=11))
    clips = ClipDataset(tmp_path / "d", length=3, stride=3)
    generator = torch.Generator().manual_seed(4)
    shown = [int(c["index"][0, 0]) for c in DataLoader(clips, batch_size=1, shuffle=True, generator=generator)]
    assert sorted(shown) == [0, 3, 6, 9, 12, 15, 18, 21] != shown
    assert clips[2]["frame"].shape == (3, 1, 48, 64)
    if (os.cpu_count() or 1) > 1:
        shared = DataLoader(SimulatedStream(small(trials=4)), batch_size=None, num_workers=2)
        assert sorted(int(item["index"]) for item in shared) == list(range(24))
