"""The codec that the data came through is found, and what it makes of the mean and the scatter of bins is drawn."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from scipy import stats

from evanesce.prediction.observe import pixel_scatter
from evanesce.prediction.recoded import Codec, Recoded, Shooting, codec_of, recoded
from evanesce.prediction.tone import expected_tone
from evanesce.prediction.views import View, binned
from evanesce.rig import load_scene


@pytest.fixture(scope="module")
def shooting() -> Shooting:
    """Of a dim rig: noise of some DN a pixel."""
    camera = load_scene("thesis").camera.model_copy(update={"analogue_gain": 16.0, "resolution_px": (208, 160)})
    return Shooting(camera, 1.0, 1)


@pytest.fixture(scope="module")
def level() -> np.ndarray:
    y, x = np.mgrid[0:160, 0:208]
    return np.where(np.hypot(y - 70, x - 121) < 37, 90.0, 0.0) + 4.0 + 0.03 * x


def shot(shooting: Shooting, codec: Codec, level: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return frames of one state after a codec."""
    noise = shooting.frames(level, np.random.default_rng(seed))
    film = (next(noise) for _ in range(count * codec.filmed))
    return np.array(list(codec.through(film)))


def test_frames_have_the_mean_and_the_scatter_that_were_asked_for(shooting: Shooting, level: np.ndarray) -> None:
    noise = shooting.frames(level, np.random.default_rng(3))
    frames = np.array([next(noise) for _ in range(300)])
    assert frames.dtype == np.uint8
    variance = expected_tone(shooting.camera).variance_at(level)
    away = (frames.mean(axis=0) - level) / np.sqrt(variance / 300)
    assert abs(away.mean()) < 5 / np.sqrt(away.size)
    assert np.mean(away**2) == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize(("codec", "scale"), [(Codec("jpeg", 88), 1.0), (Codec("h264", 24, 3), 1.0)])
def test_the_codec_is_the_one_that_was_used(shooting: Shooting, level: np.ndarray, codec: Codec, scale: float) -> None:
    before = [0.6 * level, 0.8 * level]
    noise = np.random.default_rng(8)

    def film() -> Iterator[np.ndarray]:
        for state in [*before, *[level] * 12]:
            frames = shooting.frames(state, noise)
            for _ in range(codec.filmed):
                yield next(frames)

    frames = np.array(list(codec.through(film())))[-12:]
    held = binned(frames)
    made = [lambda state=state: state for state in before]
    found, size = codec_of(shooting, level, made, held, pixel_scatter(list(frames), 1), np.random.default_rng(1))
    assert found.kind == codec.kind
    assert abs(found.quality - codec.quality) <= 2
    assert size == pytest.approx(scale, abs=0.1)


def test_jpeg_is_that_of_the_library(shooting: Shooting, level: np.ndarray) -> None:
    frame = next(shooting.frames(level, np.random.default_rng(4)))
    ok, data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 70])
    assert ok
    assert np.array_equal(next(Codec("jpeg", 70).through(iter([frame]))), cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))


def test_a_film_gives_back_the_last_frame_of_each_state() -> None:
    """Odd sides, too; levels that no codec could mistake, the first two of each state others than the last."""
    levels = (170, 90, 40, 60, 220, 120, 20, 150, 200)
    back = list(Codec("h264", 18, 3).through(np.full((35, 51), value, np.uint8) for value in levels))
    assert [b.shape for b in back] == [(35, 51)] * 3
    assert [round(float(b.mean()), -1) for b in back] == [40, 120, 200]


@pytest.fixture(scope="module")
def made(shooting: Shooting, level: np.ndarray) -> tuple[Recoded, np.ndarray]:
    """Of two views, and what 60 frames of the first really are, of a film of its own."""
    codec, views = Codec("jpeg", 75), (View(kind="press", force_N=1.0), View(kind="replicate", force_N=1.0, frames=3))
    expected = np.array([binned(level), binned(0.5 * level)])
    found = recoded(shooting, lambda k: (level, 0.5 * level)[k], views, codec, expected, np.random.default_rng(6))
    return found, binned(shot(shooting, codec, level, 60, seed=77)) - expected[0]


def test_bias_and_scatter_are_those_of_frames_that_were_not_drawn(made: tuple[Recoded, np.ndarray]) -> None:
    found, real = made
    variance = real.var(axis=0, ddof=1)
    assert np.median(found.variance[0] / variance) == pytest.approx(1.0, abs=0.1)
    # Mean of three frames of another state: a third of the scatter or less.
    assert np.median(found.variance[1]) < 0.5 * np.median(found.variance[0])
    left = real.mean(axis=0) - found.bias[0]
    error = np.sqrt(variance / 60 + variance / len(found.fields))
    assert np.mean((left / error) ** 2) < 1.5
    assert abs(np.mean(left)) < 4 * np.sqrt(np.mean(error**2) / left.size) + 0.02
    # It says something: without it the same frames are farther off.
    assert np.mean(real.mean(axis=0) ** 2) > 1.5 * np.mean(left**2)


def test_draws_scatter_as_the_fields_do_with_tails_for_their_number() -> None:
    """Oracle: a sum of so few fields over its own scatter has Student's law."""
    rng = np.random.default_rng(2)
    fields = rng.standard_normal((9, 1, 1, 1)).astype(np.float32)
    coded = Recoded(Codec("jpeg", 75), np.zeros((1, 1, 1)), fields - fields.mean(), fields[:0], np.ones((1, 1, 1)))
    sums = coded.drawn(200_000, rng) @ coded.fields[:, 0, 0, 0]
    size = coded.fields.std(ddof=1)
    # Variance of Student's t of 8 degrees of freedom.
    assert np.var(sums / size) == pytest.approx(8 / 6, rel=0.05)
    assert np.mean(np.abs(sums / size) > stats.t(8).isf(0.0005)) == pytest.approx(0.001, rel=0.25)


def test_a_mean_change_may_be_off_by_a_share_from_place_to_place_alike_in_all_frames(
    made: tuple[Recoded, np.ndarray],
) -> None:
    """What it is off by is smooth over a macroblock and the same share in each view; its sum has the stated size."""
    found, _ = made
    maps = found.uneven.astype(float)
    share = 0.25 * np.sqrt(np.mean(found.bias**2))
    assert np.sqrt((maps**2).sum(axis=0).mean()) == pytest.approx(share, rel=0.15)
    known = np.abs(found.bias).min(axis=0) > 0.02
    first, second = (maps[:, k][:, known] / found.bias[k][known] for k in (0, 1))
    np.testing.assert_allclose(first, second, rtol=1e-3)
    amplitudes = found.drawn(4000, np.random.default_rng(3))[:, len(found.fields) :]
    assert amplitudes.shape[1] == len(maps)
    assert amplitudes.std() == pytest.approx(1.0, abs=0.02)
    beside = (maps[:, 0] / found.bias[0])[:, :, [0, 1, 9]]
    near, far = (np.corrcoef(beside[:, :, 0].ravel(), beside[:, :, k].ravel())[0, 1] for k in (1, 2))
    assert near > 0.8
    assert abs(far) < 0.4
