"""Corner lists of other programs: read to the pixel convention, or refused at the row that is wrong."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from evanesce.core.errors import InputError
from evanesce.measurement.calibration.points import COLUMNS, read_points

WORLD = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 1.0]])
IMAGE = np.array([[10.25, 20.5], [41.0, 19.5], [9.0, 51.0], [40.0, 50.25], [71.5, 49.0]])


def csv_text(rows: list[str]) -> str:
    return "\n".join([",".join(COLUMNS), *rows]) + "\n"


def good_rows(view: str = "a") -> list[str]:
    return [f"{view},{w[0]},{w[1]},{p[0]},{p[1]}" for w, p in zip(WORLD, IMAGE, strict=True)]


def test_csv_keeps_pixels_and_views(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("\ufeff" + csv_text(good_rows("7") + good_rows("3")), encoding="utf-8")
    views = read_points(path)
    assert [v.name for v in views] == ["7", "3"]
    np.testing.assert_array_equal(views[1].world, WORLD)
    np.testing.assert_array_equal(views[1].image, IMAGE)


@pytest.mark.parametrize(
    ("row", "what"),
    [
        ("a,5,5,nan,3", "line 7, image_x_px"),
        ("a,5,5,3,1e999", "line 7, image_y_px"),
        ("a,5,five,3,3", "line 7, world_y_mm"),
        ("a,5,5,3", "line 7"),
        ("a,0,0,99,99", "line 2"),
        ("a,9,9,41.0,19.5", "line 3"),
    ],
)
def test_csv_names_the_bad_line(tmp_path: Path, row: str, what: str) -> None:
    path = tmp_path / "p.csv"
    path.write_text(csv_text([*good_rows(), row]))
    with pytest.raises(InputError, match=what):
        read_points(path)


@pytest.mark.parametrize(
    "content",
    [
        "",
        ",".join(COLUMNS) + "\n",
        "a,b\n1,2\n",
        csv_text(good_rows()[:3]),
        csv_text([f"a,{i},{2 * i},{i},{i}" for i in range(5)]),
    ],
    ids=["empty", "header only", "other columns", "three corners", "one line"],
)
def test_csv_that_is_no_grid(tmp_path: Path, content: str) -> None:
    path = tmp_path / "p.csv"
    path.write_text(content)
    with pytest.raises(InputError):
        read_points(path)


def test_matlab_counts_from_one(tmp_path: Path) -> None:
    second = IMAGE + np.array([3.0, -2.0])
    second[4] = np.nan  # the detector lost a corner of the second view
    path = tmp_path / "p.mat"
    scipy.io.savemat(path, {"imagePoints": np.dstack([IMAGE, second]), "worldPoints": WORLD}, do_compression=True)
    first, other = read_points(path)
    np.testing.assert_array_equal(first.image, IMAGE - 1)
    np.testing.assert_array_equal(other.image, second[:4] - 1)
    np.testing.assert_array_equal(other.world, WORLD[:4])


def test_matlab_structure_and_single_view(tmp_path: Path) -> None:
    path = tmp_path / "p.mat"
    scipy.io.savemat(path, {"session": {"imagePoints": IMAGE, "worldPoints": WORLD}, "note": "text"})
    (view,) = read_points(path)
    np.testing.assert_array_equal(view.image, IMAGE - 1)


def half_lost() -> np.ndarray:
    image = IMAGE.copy()
    image[2, 1] = np.nan
    return image


@pytest.mark.parametrize(
    ("arrays", "what"),
    [
        ({"imagePoints": half_lost(), "worldPoints": WORLD}, r"imagePoints\(3,:,1\)"),
        ({"imagePoints": IMAGE[:4], "worldPoints": WORLD}, "imagePoints"),
        ({"imagePoints": IMAGE, "worldPoints": np.where(WORLD == 2, np.inf, WORLD)}, r"worldPoints\(5,:\)"),
        ({"imagePoints": IMAGE[[0, 1, 2, 3, 3]], "worldPoints": WORLD}, r"imagePoints\(5,:,1\).*imagePoints\(4,:,1\)"),
        ({"imagePoints": IMAGE + 1j, "worldPoints": WORLD}, "imagePoints"),
        ({"imagePoints": "text", "worldPoints": WORLD}, "imagePoints"),
        ({"imagePoints": IMAGE}, "worldPoints"),
    ],
    ids=["one coordinate lost", "lengths", "infinite", "twice", "complex", "text", "absent"],
)
def test_matlab_names_the_bad_index(tmp_path: Path, arrays: dict[str, np.ndarray], what: str) -> None:
    path = tmp_path / "p.mat"
    scipy.io.savemat(path, arrays)
    with pytest.raises(InputError, match=what):
        read_points(path)


def test_matlab_files_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "p.mat"
    good = tmp_path / "good.mat"
    scipy.io.savemat(good, {"imagePoints": IMAGE, "worldPoints": WORLD}, do_compression=True)
    whole = good.read_bytes()
    for content in (b"", b"text", whole[: len(whole) // 2], whole[:200] + b"\xff" * 40 + whole[240:]):
        path.write_bytes(content)
        with pytest.raises(InputError):
            read_points(path)
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n" + b"\0" * 100)
    with pytest.raises(InputError, match=r"7\.3"):
        read_points(path)


def test_a_compressed_giant_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    """A header that promises 8 x 10^9 numbers behind a few compressed bytes must not be allocated."""
    flags = struct.pack("<IIII", 6, 8, 6, 0)  # miUINT32, 8 bytes: class double
    dims = struct.pack("<IIii", 5, 8, 2_000_000_000, 4)
    name = struct.pack("<II", 1, 11) + b"imagePoints".ljust(16, b"\0")
    body = flags + dims + name
    packed = zlib.compress(struct.pack("<II", 14, len(body)) + body)
    path = tmp_path / "p.mat"
    path.write_bytes(
        b"MATLAB 5.0 MAT-file".ljust(124)
        + struct.pack("<HH", 0x0100, 0x4D49)
        + struct.pack("<II", 15, len(packed))
        + packed
    )
    with pytest.raises(InputError, match="at most"):
        read_points(path)


def test_unknown_ending_and_absent_file(tmp_path: Path) -> None:
    (tmp_path / "p.xls").write_bytes(b"x")
    for name in ("p.xls", "absent.csv"):
        with pytest.raises(InputError):
            read_points(tmp_path / name)


def test_the_rigs_own_corners(rig_photo: Path) -> None:
    views = read_points(rig_photo / "corners.csv")
    assert [len(v) for v in views] == [1139] * 12
    for view in views[1:]:
        np.testing.assert_array_equal(view.image, views[0].image)
