"""Frames through a lossy codec: found from the noise, its changes predicted, each view as rough as its own bins."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import development_rigs as rigs
import numpy as np
import pytest
from scipy import ndimage

from evanesce.bundle.read import read_bundle
from evanesce.inference.codec import Filmed, codec_behind, filmed
from evanesce.inference.data import SCALE_STEP, data_vector, stepped
from evanesce.inference.gate import gate_of
from evanesce.inference.model import AnchoredModel
from evanesce.prediction.codecs import Codec
from evanesce.prediction.observe import observe
from evanesce.prediction.recoded import Recoded

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
    assert codec_behind(model, point) is None
    assert model.data.correlation is None


@pytest.fixture(scope="module")
def drawn(folder: Path) -> tuple[AnchoredModel, Filmed, Any]:
    """Noise that hangs together, far above all other: squares of bins err together, half of that in all views alike."""
    model = model_of(folder)[0]
    rng = np.random.default_rng(4)
    views, rows, cols = model.data.cube.shape

    def noise(count: int) -> np.ndarray:
        common, own = rng.standard_normal((count, 1, rows, cols)), rng.standard_normal((count, views, rows, cols))
        smooth = ndimage.uniform_filter((common + own) / np.sqrt(2), (0, 0, 4, 4), mode="wrap") * 4.0
        return np.asarray(8.0 * smooth, np.float32)

    fields = noise(24)
    zero = np.zeros(model.data.cube.shape)
    return model, Filmed(Recoded(Codec("h264", 20), zero, fields - fields.mean(axis=0), np.ones(views)), 1.0), noise


def test_noise_that_hangs_together_over_places_and_views_is_made_white(
    drawn: tuple[AnchoredModel, Filmed, Any],
) -> None:
    """Fresh noise of the same law: unit variance, regions and what views share of no more power than white noise."""
    model, film, noise = drawn
    data = film.data(model.data, np.zeros(model.data.cube.shape))
    fresh = noise(40)
    before = np.array([one[list(data.open)] / data.sd[list(data.open)] for one in fresh])
    after = np.array([data.over_noise(one) for one in fresh])
    assert np.mean(after**2) == pytest.approx(1.0, abs=0.1)
    regions = [np.mean(cube[:, :, :16, :16].sum(axis=(2, 3)) ** 2) / 256 for cube in (before, after)]
    assert regions[0] > 5.0
    assert regions[1] == pytest.approx(1.0, abs=0.35)
    together = [np.mean(cube.sum(axis=1) ** 2) / cube.shape[1] for cube in (before, after)]
    assert together[0] > 3.0
    assert together[1] == pytest.approx(1.0, abs=0.25)


def test_views_that_scatter_more_than_the_draws_count_for_less(drawn: tuple[AnchoredModel, Filmed, Any]) -> None:
    """Three times the noise in what views share: found in the data themselves, and as white as before."""
    model, film, noise = drawn
    more = noise(1)[0] + 2.0 * noise(1)[0].mean(axis=0)
    calm = film.data(model.data, np.zeros(model.data.cube.shape))
    data = film.data(model.data, more)
    again = noise(1)[0] + 2.0 * noise(1)[0].mean(axis=0)
    together = [np.mean(one.over_noise(again).sum(axis=0) ** 2) / len(one.open) for one in (calm, data)]
    assert together[0] > 3.0
    assert together[1] < 1.5


def test_what_a_strong_cause_leaves_counts_as_noise_until_it_is_explained(
    drawn: tuple[AnchoredModel, Filmed, Any],
) -> None:
    """Rationale: about the nominal rig a strong cause made noise larger, and weaker causes beside it were lost."""
    model, film, _ = drawn
    strong = np.zeros(model.data.cube.shape)
    strong[:, 4:12, 4:12] = 200.0 * np.arange(len(strong))[:, None, None]
    sizes = [film.data(model.data, left).correlation.size for left in (strong, np.zeros_like(strong))]  # type: ignore[union-attr]
    assert sizes[0] > 1.05 * sizes[1]


def test_bundles_of_one_camera_share_the_scale_of_their_noise() -> None:
    assert stepped(1.003, SCALE_STEP) == stepped(0.997, SCALE_STEP) == 1.0
    assert stepped(0.8, SCALE_STEP) == pytest.approx(0.8, rel=0.5 * SCALE_STEP)


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
    behind = codec_behind(model, point)
    assert behind is not None
    assert behind.codec.kind == "jpeg"
    assert abs(behind.codec.quality - 75) <= 6
    found = filmed(model, point, behind).made
    # Against the frames before they were coded, which only this test has.
    changed = model.data.cube - model_of(folder)[0].data.cube
    dark = [k for k, view in enumerate(model.data.views) if view.kind in ("led_off", "lens_cap")]
    assert found.bias[dark].mean() == pytest.approx(changed[dark].mean(), abs=0.1)
