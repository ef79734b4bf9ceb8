"""The real contact frame read through a colour camera, and the same reading of frames that are not what it believes."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

from evanesce.sensor.colour import ImageProcessor, colour_of_level

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return the script with a coarse grid."""
    path = ROOT / "docs" / "validation" / "real_frame_colour.py"
    spec = importlib.util.spec_from_file_location("real_frame_colour", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "TEMPERATURES_K", (2500, 3250, 4559))
    monkeypatch.setattr(module, "GREEN", (0.06, 0.12, 0.15))
    monkeypatch.setattr(module, "BLUE", (0.02, 0.04, 0.05))
    monkeypatch.setattr(module, "LEVELS", np.geomspace(1e-3, 1e2, 600))
    return module


def test_red_light_explains_the_real_frame_and_white_light_does_not(script: ModuleType, contact_frame: Path) -> None:
    found = script.analyse(contact_frame)
    held = {name: model["rms_DN"]["held"] for name, model in found["models"].items()}
    assert held["red light, colour camera"] < 5.0
    assert held["white light, colour camera"] > 5 * held["red light, colour camera"]
    assert held["monochrome camera"] > 10 * held["red light, colour camera"]
    masks = script.regions(found["frame"])
    best, _, expected = found["best"]
    shown = expected[best["best"]].astype(float)
    for mask in masks.values():
        difference = np.median(shown[mask], axis=0) - np.median(found["frame"][mask], axis=0)
        assert np.abs(difference).max() < 15  # red of the ring, 242 for 255: half of its pixels are just not clipped
    # The line that 0.35 to 0.6 draws is far above what fills the red channel; 0.15 lies below the ring.
    assert found["thresholds"][0.35][1] > found["light"]["ring over contact"][2]
    assert found["thresholds"][0.15][0] < found["light"]["ring over contact"][0]


@pytest.mark.parametrize("kind", ["red", "white"])
def test_a_drawn_frame_is_explained_by_its_own_light(script: ModuleType, tmp_path: Path, kind: str) -> None:
    # Rings and a slope of known level, of an odd size, and noise of 2 DN.
    rows, cols = np.indices((37, 61))
    radius = np.hypot(rows - 15.0, cols - 33.0)
    level = np.where(radius < 8, 9.0, np.where(radius < 14, 0.4, 0.02 + 0.001 * cols))
    processor = ImageProcessor.imx477(3250.0)
    response = (1.0, 0.12, 0.04) if kind == "red" else tuple(1.0 / processor.gains)
    frame = colour_of_level(level, response, processor) + 2.0 * np.random.default_rng(5).standard_normal((37, 61, 3))
    frame8 = np.clip(frame, 0, 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "frame_thumbnail.png"), frame8[..., ::-1])
    if kind == "white":
        # No region of pure red can be found by colour.
        script.regions = lambda image: {"contact": image[..., 1] > 200, "ring": level == 0.4, "ground": level < 0.1}
    found = script.analyse(tmp_path)
    held = {name: model["rms_DN"]["held"] for name, model in found["models"].items()}
    if kind == "red":
        assert held["red light, colour camera"] == min(held.values())
        # Several settings draw the same colours: the true one is among them, and the range of light covers the truth.
        assert (3250, 0.12, 0.04) in found["possible"]
        masks = script.regions(found["frame"])
        true = np.median(level[masks["ground"]]) / 9.0
        _, low, high = found["light"]["ground over contact"]
        assert low <= 1.05 * true
        assert high >= 0.95 * true
    else:
        assert held["red light, colour camera"] > 3 * held["white light, colour camera"]
