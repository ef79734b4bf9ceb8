"""Labels that are not stored are computed again, and are those that are stored where they are asked for."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce import dataset
from evanesce.core.errors import InputError
from evanesce.core.states import SurfaceState
from evanesce.dataset.audit import audit
from evanesce.dataset.config import CHANNELS, DatasetConfig
from evanesce.dataset.run import make
from support.datasets import tiny_job


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("computed")
    asked = {"all": ("all",), "none": (), "some": ("pressure", "slip.x")}
    for name, channels in asked.items():
        make(folder / name, tiny_job(frames=12, labels={"frame": channels, "plate": channels, "precision": "float"}))
    return {name: folder / name for name in asked}


def test_what_is_not_stored_is_what_would_have_been(folders):
    with dataset.open(folders["all"]) as full, dataset.open(folders["none"]) as bare:
        assert set(full[0].members) - set(bare[0].members) == {"labels.exr", "plate.exr"}
        touched = 0
        for stored, computed in zip(full, bare, strict=True):
            for name in ("frame.png", "mask.png"):
                assert stored.bytes_of(name) == computed.bytes_of(name)
            for kind in ("labels", "plate"):
                one, other = getattr(stored, kind), getattr(computed, kind)
                for channel in CHANNELS:
                    np.testing.assert_array_equal(one.whole(channel), other.whole(channel))
            touched += int((computed.state >= SurfaceState.STICK).any())
        assert touched > 6


def test_some_channels_are_stored_and_all_can_be_had(folders):
    with dataset.open(folders["some"]) as some, dataset.open(folders["all"]) as full:
        assert set(some[5]._stored("labels.exr") or ()) == set()  # not all: computed
        np.testing.assert_array_equal(some[5].labels.whole("gap"), full[5].labels.whole("gap"))
        assert len(some[5].bytes_of("labels.exr")) < 0.5 * len(full[5].bytes_of("labels.exr"))


def test_an_audit_needs_no_stored_maps(folders):
    found = {name: audit(folders[name]) for name in ("all", "none")}
    for one, other in zip(found["all"], found["none"], strict=True):
        assert (one.name, one.verdict, one.wrong, one.of) == (other.name, other.verdict, other.wrong, other.of)
    assert all(row.verdict in ("good", "none") for row in found["none"] if row.identity)


def test_labels_of_other_versions_are_not_computed(folders, monkeypatch):
    from evanesce.core import provenance

    record = dict(provenance.record())
    monkeypatch.setattr(provenance, "record", lambda **_: {**record, "evanesce": "0.0.1"})
    with dataset.open(folders["none"]) as bare, pytest.raises(InputError, match="evanesce"):
        _ = bare[3].plate


def test_an_unknown_channel_is_refused():
    with pytest.raises(ValueError, match=r"labels\.frame names 'presure' .*pressure"):
        DatasetConfig.model_validate({"labels": {"frame": ("presure",)}})
