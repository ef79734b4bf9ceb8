"""``evanesce measure`` on a video that ends too early: writes what is readable, names the first bad frame, exits 1."""

from __future__ import annotations

import json
import re

import numpy as np
from typer.testing import CliRunner

from evanesce.cli.app import app
from support.videos import cut, write_video


def patch(k: int) -> np.ndarray:
    """Return a bright rectangle that grows by two columns a frame."""
    image = np.full((120, 160), 9, np.uint8)
    image[31:90, 40 : 80 + 2 * k] = 200
    return image


def test_a_cut_video_gives_its_readable_frames_and_fails(tmp_path) -> None:
    path, out = tmp_path / "press.mkv", tmp_path / "out"
    write_video(path, [patch(k) for k in range(24)])
    cut(path, 0.55)
    done = CliRunner().invoke(
        app, ["measure", str(path), "--mm2-per-px", "0.01", "--no-undistort", "--threshold", "0.3", "--out", str(out)]
    )
    assert done.exit_code == 1, done.output
    named = re.search(r"error: .*frame (\d+): ", done.stderr)
    assert named is not None
    data = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert data["complete"] is False
    frames = data["frames"]
    assert 8 <= len(frames) < 24
    assert [f["index"] for f in frames] == list(range(int(named[1])))
    # lossless: a pixel's width of blur moves a straight edge by less than one pixel
    for f in frames:
        assert abs(f["pixels"] - 59 * (40 + 2 * f["index"])) <= 2 * 59 + 2 * 120
    assert len((out / "area.csv").read_text(encoding="utf-8").splitlines()) == len(frames) + 1


def test_a_missing_file_is_named_before_any_option(tmp_path) -> None:
    path = tmp_path / "nowhere.mp4"
    done = CliRunner().invoke(app, ["measure", str(path)])
    assert done.exit_code == 2
    assert done.stderr.splitlines() == [
        f"error: {path}: no such file or folder (allowed: a video, an image or a folder of images)"
    ]
