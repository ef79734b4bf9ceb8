"""Data sets of a colour camera: frames in colour, labels as ever, in every format."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import evanesce.dataset as dataset
from evanesce.dataset.export import export
from evanesce.dataset.job import new_job
from evanesce.dataset.run import make
from support.datasets import tiny_config
from support.rigs import small_rig


def test_colour_frames_are_exported_as_they_are(tmp_path: Path) -> None:
    rig = small_rig()
    colour = {"camera.colour": {"response": [1.0, 0.2, 0.05]}}
    make(tmp_path / "d", new_job(rig.with_(colour), tiny_config(), frames=6, seed=3))
    h5py, pq = pytest.importorskip("h5py"), pytest.importorskip("pyarrow.parquet")
    export(tmp_path / "d", tmp_path / "h", "hdf5")
    with h5py.File(tmp_path / "h" / "dataset.h5") as file, dataset.open(tmp_path / "d") as data:
        assert data[3].frame.shape == (*data[3].state.shape, 3)
        np.testing.assert_array_equal(file["frame"][3], data[3].frame)
        np.testing.assert_array_equal(file["state"][3], data[3].state)
    export(tmp_path / "d", tmp_path / "l", "lerobot")
    info = json.loads((tmp_path / "l" / "meta" / "info.json").read_text())["features"]
    assert info["observation.images.tactile"]["shape"][2] == 3
    assert info["labels.surface_state"]["shape"][2] == 3
    stats = json.loads((tmp_path / "l" / "meta" / "stats.json").read_text())
    assert np.shape(stats["observation.images.tactile"]["mean"]) == (3, 1, 1)
    export(tmp_path / "d", tmp_path / "p", "parquet")
    assert pq.read_table(tmp_path / "p" / "frames.parquet").num_rows == 6
