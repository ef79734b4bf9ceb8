"""`evanesce calibrate` as a lab would call it: files in, JSON and pictures out, one line for bad input."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from evanesce.cli import calibrate as command
from evanesce.measurement.calibration.model import load_calibration
from evanesce.measurement.calibration.points import COLUMNS, read_points
from support.boards import Warp, draw, warp

SHAPE = (300, 400)


@pytest.fixture(scope="module")
def app() -> typer.Typer:
    app = typer.Typer()
    command.register(app)
    app.command("other")(lambda: None)  # with a single command Typer would take its name as an argument
    return app


def run(app: typer.Typer, *args: Any) -> Any:
    return CliRunner().invoke(app, ["calibrate", *map(str, args)])


def save(path: Path, picture: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), picture)
    return path


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pictures of one still board (other noise), one of another size, one without a board, a white square."""
    folder = tmp_path_factory.mktemp("cards")
    rng = np.random.default_rng(12)
    mapping = warp(SHAPE, 24.0, 6.0, barrel=0.1)
    save(folder / "a.png", draw(SHAPE, mapping, rng))
    save(folder / "b.png", draw(SHAPE, mapping, rng))
    save(folder / "small.png", draw((200, 260), warp((200, 260), 24.0, 6.0), rng))
    save(folder / "empty.png", rng.integers(90, 110, SHAPE).astype(np.uint8))
    save(folder / "square.png", square(mapping, 6.0))
    return folder


def square(mapping: Warp, side: float) -> np.ndarray:
    """A white square of ``side`` board squares through the same warp."""
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(float)
    total = np.zeros(SHAPE)
    for dy in (-0.375, -0.125, 0.125, 0.375):
        for dx in (-0.375, -0.125, 0.125, 0.375):
            board = mapping.to_board(np.stack([x + dx, y + dy], axis=-1)) - [0.3, 0.2]
            total += (np.abs(board) < side / 2).all(axis=-1) / 16
    return np.clip(cv2.GaussianBlur(20 + 150 * total, (0, 0), 1.0), 0, 255).astype(np.uint8)


def test_pictures_several_after_one_option(app: typer.Typer, pictures: Path, tmp_path: Path) -> None:
    out = tmp_path / "c.json"
    files = [pictures / "a.png", pictures / "b.png", pictures / "small.png"]
    result = run(app, "--checkerboard", *files, "--square-mm", 2, "--json", out)
    assert result.exit_code == 0, result.output
    data = json.loads(out.read_text())
    codes = {w["code"] for w in data["warnings"]}
    assert {"identical_views", "views_too_alike", "changed_resolution"} <= codes
    assert {c["view"] for c in data["corners"]} == {1, 2}
    assert set(data["corners"][0]) == set(COLUMNS)
    assert data["grid_rms_px"] < 0.1  # corners of a drawn board are good to some hundredths of a pixel
    world = np.array([(c["world_x_mm"], c["world_y_mm"]) for c in data["corners"]])
    for axis in (0, 1):  # the origin lies on the first line of at least half the usual length
        lines, counts = np.unique(world[:, axis], return_counts=True)
        assert lines[np.argmax(counts >= 0.5 * np.median(counts))] == 0.0
    np.testing.assert_array_equal(np.mod(world, 2), 0)
    # 24 px over 2 mm at the middle, squashed by 0.97 in y; radius r in the picture stretches it by (1 + 0.1 r^2)^2
    assert data["scale_px_per_mm2"]["max"] == pytest.approx(144 / 0.97, rel=0.03)
    assert data["scale_px_per_mm2"]["min"] < data["scale_px_per_mm2"]["median"] < data["scale_px_per_mm2"]["max"]
    stored = load_calibration(out)
    assert stored.image_size == (400, 300)
    assert stored.mm2_per_px is None


def test_option_repeated_square_card_and_pictures(app: typer.Typer, pictures: Path, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "out"
    args = ["--checkerboard", pictures / "a.png", "--checkerboard", pictures / "b.png", "--square-mm", 2]
    result = run(app, *args, "--square", pictures / "square.png", "--side-mm", 12, "--out", folder)
    assert result.exit_code == 0, result.output
    names = {
        "calibration.html",
        "calibration.json",
        "corners.png",
        "residuals.png",
        "scale.png",
        "scale_undistorted.png",
    }
    assert {p.name for p in folder.iterdir()} == names
    stored = load_calibration(folder / "calibration.json")
    assert stored.square_side_mm == 12.0
    assert stored.mm2_per_px is not None
    # the card and the board agree on the scale of the undistorted picture: the card spans 6 squares around its middle;
    # a border of 4 x 140 px, each pixel undecided by up to 1/sqrt(12) and a threshold at half height, leaves 0.3 %
    scale = stored.details["scale_undistorted_px_per_mm2"]["median"]
    assert stored.mm2_per_px * scale == pytest.approx(1.0, abs=0.01)


def test_folder_and_points_agree(app: typer.Typer, pictures: Path, tmp_path: Path) -> None:
    """Corners found in a picture, written as CSV and read back by --points, give the same calibration."""
    first, again = tmp_path / "a.json", tmp_path / "b.json"
    lone = tmp_path / "folder"
    lone.mkdir()
    (lone / "a.png").write_bytes((pictures / "a.png").read_bytes())
    assert run(app, "--checkerboard", lone, "--square-mm", 2, "--json", first).exit_code == 0
    data = json.loads(first.read_text())
    rows = [",".join(repr(c[name]) for name in COLUMNS) for c in data["corners"]]
    (tmp_path / "p.csv").write_text(",".join(COLUMNS) + "\n" + "\n".join(rows) + "\n")
    result = run(app, "--points", tmp_path / "p.csv", "--image-size", "400x300", "--json", again)
    assert result.exit_code == 0, result.output
    other = json.loads(again.read_text())
    for key in ("camera_matrix", "distortion", "grid_rms_px", "scale_px_per_mm2", "standard_errors"):
        assert data[key] == other[key], key


@pytest.mark.parametrize(
    ("args", "what"),
    [
        ([], "neither is given"),
        (["{dir}/a.png"], "belongs to no option"),
        (["--checkerboard", "{dir}/a.png", "--points", "x.csv"], "both are given"),
        (["--checkerboard", "{dir}/none.png"], "no such file"),
        (["--checkerboard", "{dir}/a.png", "--square-mm", "0"], "--square-mm"),
        (["--checkerboard", "{dir}/a.png", "--square-mm", "nan"], "--square-mm"),
        (["--checkerboard", "{dir}/a.png", "--model", "cubic"], "radial2, radial3, full"),
        (["--checkerboard", "{dir}/a.png", "--square", "{dir}/small.png"], "changed resolution"),
        (["--points", "{dir}/none.csv", "--image-size", "10x10"], "no such file"),
        (["--points", "{dir}/none.csv"], "--image-size"),
        (["--points", "{dir}/none.csv", "--image-size", "1024"], "1024x768"),
        (["--points", "{dir}/none.csv", "--image-size", "0x5"], "1024x768"),
        (["--points", "{dir}/a.png", "--image-size", "10x10"], ".csv or .mat"),
        (["--checkerboard", "{dir}/a.png", "--json", "{dir}/no/such/c.json"], "does not exist"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(app: typer.Typer, pictures: Path, args: list[str], what: str) -> None:
    result = run(app, *(a.format(dir=pictures) for a in args))
    assert result.exit_code == 2, result.output
    lines = [line for line in result.stderr.splitlines() if line.startswith("error:")]
    assert len(lines) == 1
    assert what in lines[0]
    assert "Traceback" not in result.output


def test_no_board_is_work_that_failed_and_writes_nothing(app: typer.Typer, pictures: Path, tmp_path: Path) -> None:
    result = run(app, "--checkerboard", pictures / "empty.png", "--json", tmp_path / "c.json", "--out", tmp_path / "o")
    assert result.exit_code == 1
    assert "no checkerboard found" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_rigs_points(app: typer.Typer, rig_photo: Path, tmp_path: Path) -> None:
    out = tmp_path / "cal.json"
    result = run(app, "--points", rig_photo / "corners.csv", "--image-size", "1024x768", "--json", out)
    assert result.exit_code == 0, result.output
    data = json.loads(out.read_text())
    assert len(data["corners"]) == sum(map(len, read_points(rig_photo / "corners.csv")))
    assert "identical_views" in {w["code"] for w in data["warnings"]}
    assert data["grid_rms_px"] < 0.75
    assert load_calibration(out).image_size == (1024, 768)
