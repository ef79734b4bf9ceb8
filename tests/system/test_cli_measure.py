"""``evanesce measure`` as a user meets it: the contract of its JSON, its files, and how it ends on bad input."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import warnings

import av
import cv2
import numpy as np
import pytest
import typer
from skimage import color, filters, io, measure, morphology
from typer.testing import CliRunner

from evanesce.cli import measure as command
from evanesce.measurement.calibration.model import Calibration, save_calibration

SCALE = 0.0002935


def patch_frame(index, shape=(260, 340)):
    """A ridged, growing, off-centre patch with specks and noise, in colour."""
    rng = np.random.default_rng([11, index])
    rows, cols = shape
    y, x = np.mgrid[:rows, :cols]
    inside = np.hypot((x - 0.57 * cols) / 1.3, y - 0.44 * rows) < 12 + 11 * index
    level = 8 + 10 * y / rows + 140 * inside * (0.55 + 0.45 * np.sin(x / 2.7 + y / 9.1)) + rng.normal(0, 4, shape)
    level[rng.integers(0, rows, 25), rng.integers(0, cols, 25)] = 250
    return np.clip(np.rint(level[..., None] * [0.9, 1.05, 1.2]), 0, 255).astype(np.uint8)


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "frames"
    made.mkdir()
    for k in (0, 1, 2, 10):
        cv2.imwrite(str(made / f"f{k}.png"), patch_frame(min(k, 3))[..., ::-1])
    return made


@pytest.fixture
def run():
    app = typer.Typer()
    command.register(app)
    app.callback()(lambda: None)
    runner = CliRunner()
    return lambda *arguments: runner.invoke(app, ["measure", *map(str, arguments)])


def literal_pixels(path, crop, threshold=0.15, min_blob=2000):
    """The reference segmentation on a file, with scikit-image from the reading on."""
    r0, r1, c0, c1 = crop
    image = io.imread(path)[r0:r1, c0:c1]
    mask = filters.gaussian(color.rgb2gray(image), sigma=1) > threshold
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        labels = measure.label(morphology.binary_dilation(mask, morphology.disk(10)))
    keep = [r.label for r in measure.regionprops(labels) if r.area >= min_blob]
    return int((mask & np.isin(labels, keep)).sum())


PLAIN = ("--mm2-per-px", SCALE, "--threshold", 0.15, "--min-blob", 2000, "--no-undistort")


def test_contract(folder, tmp_path, run):
    target = tmp_path / "out.json"
    result = run(folder, *PLAIN, "--crop", "13:241,37:301", "--fps", 30, "--json", target)
    assert result.exit_code == 0, result.output
    data = json.loads(target.read_text())
    names = ["f0.png", "f1.png", "f2.png", "f10.png"]
    expected = [literal_pixels(folder / name, (13, 241, 37, 301)) for name in names]
    assert [f["pixels"] for f in data["frames"]] == expected
    assert expected[0] == 0 or expected[0] < expected[-1]
    for k, frame in enumerate(data["frames"]):
        assert frame["index"] == k
        assert frame["time_s"] == k / 30
        assert frame["area_mm2"] == expected[k] * SCALE
    assert data["complete"] is True
    assert data["settings"]["crop"] == "13:241,37:301"
    assert data["provenance"]["evanesce"]
    assert all(word in result.stdout for word in ("contact area", "time [s]", "area [mm²]"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["frames", "out.json"]  # no folder unless asked for


def test_real_process(folder, tmp_path):
    """The same through a process of its own, and the bare end of bad input."""
    base = [sys.executable, "-c", "from evanesce.cli import main; main()", "measure"]
    target = tmp_path / "out.json"
    arguments = [str(a) for a in (folder, *PLAIN, "--crop", "0:260,0:340", "--fps", "30", "--json", target)]
    good = subprocess.run([*base, *arguments], capture_output=True, text=True, check=False)
    assert good.returncode == 0, good.stderr
    data = json.loads(target.read_text())
    assert data["frames"][3]["pixels"] == literal_pixels(folder / "f10.png", (0, 260, 0, 340))
    bad = subprocess.run([*base, str(folder), "--mm2-per-px", "1"], capture_output=True, text=True, check=False)
    assert (bad.returncode, bad.stdout) == (2, "")
    assert bad.stderr.count("\n") == 1
    assert bad.stderr.startswith("error: --calibration: is needed to undistort")


def test_output_folder(folder, tmp_path, run):
    out = tmp_path / "deep" / "out"
    result = run(folder, *PLAIN, "--fps", 30, "--out", out)
    assert result.exit_code == 0, result.output
    assert sorted(p.name for p in out.iterdir()) == [
        "area.csv", "area.png", "histogram_000003.png", "intensity_000003.png", "overlay.mp4", "overlay_000003.png",
        "result.json", "threshold.png",
    ]  # fmt: skip
    data = json.loads((out / "result.json").read_text())
    with (out / "area.csv").open() as stream:
        table = list(csv.DictReader(stream))
    assert [float(line["area_mm2"]) for line in table] == [f["area_mm2"] for f in data["frames"]]
    with av.open(str(out / "overlay.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) == 4


def test_undistorted_with_the_calibrations_scale(folder, tmp_path, run):
    """A calibration gives view and scale; the patch's area in the view is that of the frame times the local scale."""
    save_calibration(
        tmp_path / "cal.json",
        Calibration(
            image_size=(340, 260),
            camera_matrix=np.array([[420.0, 0, 171.2], [0, 417.0, 128.7], [0, 0, 1]]),
            distortion=np.array([-0.4, 0.1, 0, 0, 0]),
            mm2_per_px=0.0011,
        ),
    )
    # the published segmentation alone: with a calibration the default leads with the refined estimator
    result = run(
        folder, "--calibration", tmp_path / "cal.json", "--estimator", "reference", "--fps", 30,
        "--json", tmp_path / "o.json",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    data = json.loads((tmp_path / "o.json").read_text())
    last = data["frames"][3]
    assert last["area_mm2"] == last["pixels"] * 0.0011
    assert data["view"]["shape_px"][0] > 260
    plain = literal_pixels(folder / "f10.png", (0, 260, 0, 340))
    assert 1.0 < last["pixels"] / plain < 1.25  # straightening a barrel image stretches all but its middle


def test_warnings_reach_json_and_screen(folder, tmp_path, run):
    result = run(folder, *PLAIN, "--crop", "0:100,190:340", "--json", tmp_path / "o.json")
    assert result.exit_code == 0, result.output
    codes = {w["code"] for w in json.loads((tmp_path / "o.json").read_text())["warnings"]}
    assert {"frame_rate_missing", "mask_touches_border"} <= codes
    assert json.loads((tmp_path / "o.json").read_text())["frames"][1]["time_s"] is None
    assert "warning: frame_rate_missing: frames states no frame rate and none was given: times are unknown\n" in (
        result.stderr
    )


def test_a_damaged_image_ends_with_1_after_the_rest_is_written(folder, tmp_path, run):
    content = (folder / "f2.png").read_bytes()
    (folder / "f2.png").write_bytes(content[: len(content) // 2])
    out = tmp_path / "out"
    result = run(folder, *PLAIN, "--fps", 10, "--out", out, "--json", tmp_path / "o.json")
    assert result.exit_code == 1
    assert "f2.png: the PNG is cut off" in result.stderr
    data = json.loads((tmp_path / "o.json").read_text())
    assert [f["index"] for f in data["frames"]] == [0, 1, 3]
    assert data["frames"][2]["time_s"] == 0.3
    assert data["complete"] is False
    assert (out / "area.csv").read_text().count("\n") == 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("--threshold", "nan"), "--threshold: nan"),
        (("--threshold", 1.5), "--threshold: 1.5"),
        (("--min-blob", -1), "--min-blob: -1"),
        (("--crop", "10:5,0:9"), "--crop: '10:5,0:9' is empty"),
        (("--crop", "0:261,0:340"), "260 rows and 340 columns"),
        (("--fps", 0), "--fps: 0"),
        (("--mm2-per-px", "nan"), "--mm2-per-px: nan"),
        (("--mm2-per-px", 0), "--mm2-per-px: 0"),
        (("--blur", -1), "--blur: -1"),
        (("--calibration", "absent.json"), "absent.json: no such file"),
        (("--undistort",), "--calibration: is needed"),
        (("--json", "absent/o.json"), "folder does not exist"),
    ],
)
def test_bad_input_ends_with_2_in_one_line_and_leaves_nothing(folder, tmp_path, run, change, message, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run(folder, *PLAIN, "--fps", 30, "--out", tmp_path / "out", "--json", tmp_path / "o.json", *change)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert message in result.stderr
    assert result.stderr.strip().count("\n") == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["frames"]


def test_no_scale_no_frames_no_file(folder, tmp_path, run):
    for arguments, message in (
        ((folder, "--no-undistort"), "no area per pixel"),
        ((tmp_path / "absent", *PLAIN), "no such file or folder"),
        ((tmp_path, *PLAIN), "holds no images"),
    ):
        result = run(*arguments, "--json", tmp_path / "o.json")
        assert (result.exit_code, result.stderr.strip().count("\n")) == (2, 0)
        assert message in result.stderr
    for name in folder.iterdir():
        name.write_bytes(b"junk")
    result = run(folder, *PLAIN, "--fps", 30, "--json", tmp_path / "o.json", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "no readable frame: f0.png" in result.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["frames"]


def test_calibration_of_another_size_is_bad_input(folder, tmp_path, run):
    save_calibration(
        tmp_path / "cal.json",
        Calibration(
            image_size=(640, 480),
            camera_matrix=np.diag([500.0, 500.0, 1.0]) + np.eye(3, k=2) * 300,
            distortion=np.zeros(5),
        ),
    )
    result = run(
        folder, "--calibration", tmp_path / "cal.json", "--mm2-per-px", 1, "--fps", 30, "--out", tmp_path / "out"
    )
    assert result.exit_code == 2
    assert "340 x 260 pixels, the calibration holds for 640 x 480" in result.stderr
    assert not (tmp_path / "out").exists()
