"""Frames through a lossy codec: found from the noise, its changes predicted, each view as rough as its own bins."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import development_rigs as rigs
import numpy as np
import pytest

from evanesce.bundle.read import read_bundle
from evanesce.inference.codec import filmed, with_roughness
from evanesce.inference.data import data_vector
from evanesce.inference.gate import gate_of
from evanesce.inference.model import AnchoredModel
from evanesce.prediction.observe import observe

NOISY = {"camera.analogue_gain": 8.0, "camera.exposure_ms": 0.56}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: Any) -> Path:
    """The tiny rig with nothing hidden and a noisy camera."""
    base = rigs.RIGS["tiny"]
    with pytest.MonkeyPatch.context() as patch:
        protocol = {**base.protocol, "replicates": 12}
        plain = rigs.DevelopmentRig({**base.nominal, **NOISY}, {}, protocol=protocol)
        patch.setattr(rigs, "RIGS", {"plain": plain})
        target: Path = tmp_path_factory.mktemp("codec") / "plain"
        rigs.write_rig("plain", target)
    return target


def model_of(folder: Path) -> tuple[AnchoredModel, dict[str, float]]:
    observation = observe(read_bundle(folder))
    model = AnchoredModel(observation, data_vector(observation))
    return model, dict(gate_of(observation, model.coarse).start)


def test_no_codec_no_change(folder: Path) -> None:
    model, point = model_of(folder)
    assert filmed(model, point) is None
    assert model.further_rows().shape[0] == 0


def test_a_view_is_as_rough_as_its_own_bins(folder: Path) -> None:
    """White noise leaves weights alone, 1.5 times as much widens them by that, and smooth misfit does not."""
    data = model_of(folder)[0].data
    rng = np.random.default_rng(4)
    white = rng.standard_normal(int(data.valid[list(data.open)].sum()))
    cube = np.zeros_like(data.cube[list(data.open)]) + 6.0 * np.cos(np.linspace(0, np.pi, data.cube.shape[2]))
    smooth = cube[data.valid[list(data.open)]]
    for residual, wider in ((0.7 * white, 1.0), (1.5 * white, 1.5), (1.5 * white + smooth, 1.5)):
        ratio = (with_roughness(data, residual).sd / data.sd)[list(data.open)]
        assert ratio.mean() == pytest.approx(wider, rel=0.03)


@pytest.mark.slow  # 20 s: some forty codecs are tried
def test_jpeg_is_found_and_what_it_changes_on_average_is_predicted(folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "coded"
    for path in folder.rglob("*"):
        if path.is_file():
            there = target / path.relative_to(folder)
            there.parent.mkdir(parents=True, exist_ok=True)
            there.write_bytes(path.read_bytes())
    for path in target.rglob("*.png"):
        _, data = cv2.imencode(".jpg", cv2.imread(str(path), cv2.IMREAD_UNCHANGED), [cv2.IMWRITE_JPEG_QUALITY, 75])
        cv2.imwrite(str(path), cv2.imdecode(data, cv2.IMREAD_UNCHANGED))
    model, point = model_of(target)
    found = filmed(model, point)
    assert found is not None
    assert found.codec.kind == "jpeg"
    assert abs(found.codec.quality - 75) <= 6
    # Against the frames before they were coded, which only this test has.
    changed = model.data.cube - model_of(folder)[0].data.cube
    dark = [k for k, view in enumerate(model.data.views) if view.kind in ("led_off", "lens_cap")]
    assert found.bias[dark].mean() == pytest.approx(changed[dark].mean(), abs=0.1)
