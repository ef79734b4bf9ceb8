"""``evanesce measure --raw``: folders of raw mosaics drawn with NumPy, none by the project's own sensor."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
import typer
from PIL import Image
from scipy.ndimage import gaussian_filter
from typer.testing import CliRunner

from evanesce.cli import measure as command
from evanesce.cli import render
from evanesce.measurement.calibration.model import Calibration, save_calibration
from evanesce.rig import dump_scene, load_scene

SHAPE = (300, 380)
PX_PER_MM = 60.0
RADIUS_PX = 88.3
MM2 = np.pi * (RADIUS_PX / PX_PER_MM) ** 2
RESPONSE = {"R": 1.0, "G": 0.15, "B": 0.05}
BLACK, FULL = 256, 4095


def disc(level: float, order: str, seed: int) -> np.ndarray:
    """Return the mosaic of a disc of light: pixels sub-sampled, blurred, shot noise of 4000 e-, 12 bits."""
    rows, cols = SHAPE
    at = (np.arange(8) + 0.5) / 8 - 0.5
    y = (np.arange(rows)[:, None] + at).ravel()[:, None] - 147.2
    x = (np.arange(cols)[:, None] + at).ravel()[None, :] - 191.7
    share = (np.hypot(x, y) < RADIUS_PX).reshape(rows, 8, cols, 8).mean(axis=(1, 3))
    light = level * (0.008 + 0.992 * gaussian_filter(share, 1.1))
    letters = np.tile(np.array(list(order)).reshape(2, 2), (rows // 2, cols // 2))
    shares = np.vectorize(RESPONSE.get)(letters)
    charge = np.random.default_rng(seed).poisson(light * shares * 4000) / 4000
    return np.rint(BLACK + (FULL - BLACK) * np.minimum(charge, 1.0)).astype(np.uint16)


@pytest.fixture
def scene(tmp_path):
    """Return a scene file whose camera is the one drawn here."""
    own = {"camera.colour.response": list(RESPONSE.values()), "camera.pixel.black_level_DN": BLACK}
    target = tmp_path / "camera.toml"
    target.write_text(dump_scene(load_scene("thesis_ridged_red", own)))
    return target


@pytest.fixture
def calibration(tmp_path):
    rows, cols = SHAPE
    target = tmp_path / "cal.json"
    matrix = np.array([[900.0, 0, cols / 2], [0, 900.0, rows / 2], [0, 0, 1]])
    save_calibration(
        target,
        Calibration(image_size=(cols, rows), camera_matrix=matrix, distortion=np.zeros(5), mm2_per_px=PX_PER_MM**-2),
    )
    return target


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "frames"
    made.mkdir()
    return made


@pytest.fixture
def run(folder, calibration, scene):
    app = typer.Typer()
    command.register(app)
    render.register(app)

    def measure(*more: object):
        base = ("measure", folder, "--calibration", calibration, "--camera-model", scene, "--raw", "--fps", 10)
        return CliRunner().invoke(app, [*map(str, base), *map(str, more)])

    measure.app = app
    return measure


@pytest.mark.parametrize("kind", ["png", "tif", "big-endian tif"])
def test_area_of_a_drawn_disc(folder, tmp_path, run, kind):
    """Below red's clipping, where developed colours are blind, and far above: half a per cent, within the interval."""
    for k, level in enumerate((0.7, 1.5, 8.0)):
        raw = disc(level, "RGGB", k)
        if kind == "png":
            cv2.imwrite(str(folder / f"{k}.png"), raw)
        elif kind == "tif":
            Image.fromarray(raw).save(folder / f"{k}.tif", compression="tiff_lzw")
        else:
            Image.frombytes("I;16B", raw.shape[::-1], raw.astype(">u2").tobytes()).save(folder / f"{k}.tif")
    done = run("--json", tmp_path / "o.json")
    assert done.exit_code == 0, done.output
    data = json.loads((tmp_path / "o.json").read_text())
    assert [frame["time_s"] for frame in data["frames"]] == [0.0, 0.1, 0.2]
    for frame in data["frames"]:
        assert frame["area_mm2"] == pytest.approx(MM2, rel=5e-3)
        assert frame["area_low_mm2"] < MM2 < frame["area_high_mm2"]
    assert "codec" not in json.dumps(data["budget"])


def test_order_of_the_mosaic(folder, tmp_path, run):
    """Another order than the scene's is read when it is stated, and misread when it is not."""
    cv2.imwrite(str(folder / "0.png"), disc(8.0, "GBRG", 1))
    assert run("--mosaic", "GBRG", "--json", tmp_path / "o.json").exit_code == 0
    right = json.loads((tmp_path / "o.json").read_text())["frames"][0]["area_mm2"]
    assert right == pytest.approx(MM2, rel=5e-3)
    run("--json", tmp_path / "p.json")
    assert abs(json.loads((tmp_path / "p.json").read_text())["frames"][0]["area_mm2"] / MM2 - 1) > 0.01


def refused(done, *words: str) -> None:
    assert done.exit_code == 2, done.output
    assert done.stderr.count("\n") == 1
    for word in words:
        assert word in done.stderr


@pytest.mark.parametrize(
    ("name", "image", "words"),
    [
        ("a.png", disc(1.0, "RGGB", 1).astype(np.uint8), ("1 plane(s) of uint8", "uint16")),
        ("a.png", np.repeat(disc(1.0, "RGGB", 1)[..., None], 3, axis=2), ("3 plane(s) of uint16", "1 plane")),
        ("a.png", disc(1.0, "RGGB", 1)[:-2], ("380 x 298 pixels", "380 x 300")),
        ("a.png", disc(1.0, "RGGB", 1) << 4, (f"{FULL}", "camera.pixel.bits", "DN")),
        ("a.tif", np.repeat(disc(1.0, "RGGB", 1)[..., None], 3, axis=2), ("a.tif",)),
        ("a.tif", disc(1.0, "RGGB", 1).astype(np.float32), ("1 plane(s) of float32", "uint16")),
    ],
    ids=["8 bits", "three channels", "size", "levels", "three channels, TIFF", "floats"],
)
def test_refused_frames(folder, run, name, image, words):
    """Also behind a good one: the file is named."""
    cv2.imwrite(str(folder / "0.png"), disc(1.0, "RGGB", 1))
    cv2.imwrite(str(folder / name), image)
    refused(run(), str(folder / name), "--raw", *words)


def test_refused_options(folder, run, tmp_path, calibration):
    cv2.imwrite(str(folder / "0.png"), disc(1.0, "RGGB", 1))
    refused(run("--mosaic", "RGBG"), "--mosaic", "RGGB, GRBG, GBRG, BGGR")
    refused(run("--camera-model", "thesis"), "thesis: camera.colour", "monochrome")
    refused(run("--camera-model", "levels.csv"), "--camera-model", "scene")
    refused(run("--dark", folder), "--dark", "none with --raw")
    refused(run("--threshold", "auto"), "--threshold")
    refused(run("--estimator", "reference"), "--camera-model", "refined")
    bare = ["measure", str(folder), "--calibration", str(calibration)]
    refused(CliRunner().invoke(run.app, [*bare, "--raw"]), "--camera-model", "is missing")
    refused(CliRunner().invoke(run.app, [*bare, "--mosaic", "RGGB"]), "--mosaic", "with --raw")
    film = tmp_path / "film.mp4"
    film.write_bytes(b"none")
    refused(CliRunner().invoke(run.app, ["measure", str(film), *bare[2:], "--camera-model", "thesis_ridged_red",
                                         "--raw"]), "film.mp4", "--raw", "16 bits")  # fmt: skip
