"""A stored calibration survives the round trip; a damaged one is refused with the key at fault."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evanesce.core.errors import InputError, WorkError
from evanesce.measurement.calibration.model import Calibration, load_calibration, save_calibration

GOOD: dict[str, Any] = {
    "image_size": [1024, 768],
    "camera_matrix": [[941.5, 0.0, 503.2], [0.0, 937.1, 391.0], [0.0, 0.0, 1.0]],
    "distortion": [-0.31, 0.11, 0.001, -0.002, 0.0],
    "mm2_per_px": 0.00117,
    "square_side_mm": 15.0,
}


def written(folder: Path, **changes: Any) -> Path:
    path = folder / "cal.json"
    data = {key: value for key, value in {**GOOD, **changes}.items() if value is not ...}
    path.write_text(json.dumps(data))
    return path


def test_round_trip(tmp_path: Path) -> None:
    saved = Calibration(
        image_size=(1024, 768),
        camera_matrix=np.array(GOOD["camera_matrix"]),
        distortion=np.array(GOOD["distortion"]),
        mm2_per_px=1.17e-3,
        details={"warnings": [{"code": "x", "text": "y"}], "map": np.array([[1.5, np.nan]])},
    )
    save_calibration(tmp_path / "c.json", saved)
    loaded = load_calibration(tmp_path / "c.json")
    assert loaded.image_size == saved.image_size
    np.testing.assert_array_equal(loaded.camera_matrix, saved.camera_matrix)
    np.testing.assert_array_equal(loaded.distortion, saved.distortion)
    assert (loaded.mm2_per_px, loaded.square_side_mm) == (1.17e-3, None)
    assert loaded.details == {"warnings": [{"code": "x", "text": "y"}], "map": [[1.5, None]]}
    assert [p.name for p in tmp_path.iterdir()] == ["c.json"]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("image_size", [1024]),
        ("image_size", [1024, 0]),
        ("image_size", [1024.5, 768]),
        ("image_size", [10**9, 768]),
        ("image_size", ...),
        ("camera_matrix", [[float("nan"), 0, 1], [0, 1, 1], [0, 0, 1]]),
        ("camera_matrix", [[-5.0, 0, 1], [0, 1, 1], [0, 0, 1]]),
        ("camera_matrix", [[5.0, 0, 1], [0, 1, 1], [0, 0, 2]]),
        ("camera_matrix", [[5.0, 0, 1], [0, 1, 1]]),
        ("camera_matrix", [[5.0, 0, 1, 0], [1, 1], [0, 0, 1]]),
        ("distortion", [0.1, 0.2]),
        ("distortion", [0.1, 0.2, 0, 0, "0"]),
        ("distortion", [0.1, 0.2, 0, 0, True]),
        ("distortion", [0.1, 0.2, 0, 0, 10**400]),
        ("distortion", None),
        ("mm2_per_px", 0),
        ("mm2_per_px", float("inf")),
        ("square_side_mm", "15"),
    ],
)
def test_a_bad_value_names_file_and_key(tmp_path: Path, key: str, value: Any) -> None:
    path = written(tmp_path, **{key: value})
    with pytest.raises(InputError, match=key) as caught:
        load_calibration(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"[1, 2]", b"{", b"\xff\xfe", b"[" * 100_000])
def test_what_is_not_a_calibration_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "cal.json"
    path.write_bytes(content)
    with pytest.raises(InputError):
        load_calibration(path)


def test_absent_file_and_unwritable_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_calibration(tmp_path / "none.json")
    calibration = load_calibration(written(tmp_path))
    with pytest.raises(WorkError, match="cannot write"):
        save_calibration(tmp_path / "absent" / "c.json", calibration)
