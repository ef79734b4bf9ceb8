"""The codec that the data came through is found, and what it makes of the mean and the scatter of bins is drawn."""

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from evanesce.core import threads
from evanesce.prediction import codec_search
from evanesce.prediction.codec_search import _likely, codec_of
from evanesce.prediction.codecs import ENCODERS, Codec, Likely
from evanesce.prediction.observe import pixel_scatter
from evanesce.prediction.recoded import Recoded, Shooting, recoded
from evanesce.prediction.tone import expected_tone
from evanesce.prediction.views import View, binned
from evanesce.rig import load_scene
from evanesce.sensor.codec import STEADY


@pytest.fixture(scope="module")
def shooting() -> Shooting:
    """Of a dim rig: noise of some DN a pixel."""
    scene = load_scene("thesis")
    camera = scene.camera.model_copy(update={"analogue_gain": 16.0, "resolution_px": (208, 160)})
    return Shooting(scene.model_copy(update={"camera": camera}), 1.0, 1)


@pytest.fixture(scope="module")
def level() -> np.ndarray:
    y, x = np.mgrid[0:160, 0:208]
    return np.where(np.hypot(y - 70, x - 121) < 37, 90.0, 0.0) + 4.0 + 0.03 * x


def shot(shooting: Shooting, codec: Codec, level: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return frames of one state after a codec."""
    noise = shooting.frames(shooting.signal(level), np.random.default_rng(seed))
    film = (next(noise) for _ in range(count * codec.filmed))
    return np.array(list(codec.through(film)))


def test_frames_have_the_mean_and_the_scatter_that_were_asked_for(shooting: Shooting, level: np.ndarray) -> None:
    noise = shooting.frames(shooting.signal(level), np.random.default_rng(3))
    frames = np.array([next(noise) for _ in range(300)])
    assert frames.dtype == np.uint8
    variance = expected_tone(shooting.camera).variance_at(level)
    away = (frames.mean(axis=0) - level) / np.sqrt(variance / 300)
    assert abs(away.mean()) < 5 / np.sqrt(away.size)
    assert np.mean(away**2) == pytest.approx(1.0, abs=0.06)


@pytest.fixture
def fewer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer codecs to search among, if asked for."""
    if request.param:
        monkeypatch.setattr(codec_search, "ENCODERS", ENCODERS[:1])
        monkeypatch.setattr(codec_search, "QUALITIES", {"h264": (22, 26), "jpeg": (80, 90)})


@pytest.mark.parametrize(
    ("fewer", "codec"),
    [
        (True, Codec("jpeg", 88)),
        (True, Codec("h264", 24, 3)),
        pytest.param(False, Codec("jpeg", 88), marks=pytest.mark.slow),  # half a minute each
        pytest.param(False, Codec("h264", 24, 3), marks=pytest.mark.slow),
    ],
    indirect=["fewer"],
)
@pytest.mark.usefixtures("fewer")
def test_the_codec_is_the_one_that_was_used(shooting: Shooting, level: np.ndarray, codec: Codec) -> None:
    before = [0.6 * level, 0.8 * level]
    noise = np.random.default_rng(8)

    def film() -> Iterator[np.ndarray]:
        for state in [*before, *[level] * 12]:
            frames = shooting.frames(shooting.signal(state), noise)
            for _ in range(codec.filmed):
                yield next(frames)

    frames = np.array(list(codec.through(film())))[-12:]
    held = binned(frames)
    made = [lambda state=state: state for state in before]
    likely = codec_of(shooting, level, made, held, pixel_scatter(list(frames), 1), np.random.default_rng(1))
    found, size = likely.codec, likely.scale
    assert found.kind == codec.kind
    assert abs(found.quality - codec.quality) <= 2
    # How much noise came in and how much was kept back take each other's place: 0.2 to one step of quality.
    assert size == pytest.approx(1.0, abs=0.2 * max(abs(found.quality - codec.quality), 1))


def test_draws_are_as_frequent_as_codecs_are_probable() -> None:
    likely = Likely(tuple(Codec("h264", q) for q in (26, 25, 28)), (1.0, 1.1, 0.9), (0.6, 0.3, 0.1))
    drawn = likely.drawn(20)
    assert [sum(codec.quality == q for codec, _ in drawn) for q in (26, 25, 28)] == [12, 6, 2]
    assert all(scale == {26: 1.0, 25: 1.1, 28: 0.9}[codec.quality] for codec, scale in drawn)
    assert Likely.alone(likely.codec, 1.2).drawn(3) == [(likely.codec, 1.2)] * 3


def test_a_jpeg_and_a_video_that_leave_the_same_noise_are_both_drawn() -> None:
    """A defocused contact behind H.264 once passed for a JPEG, by deviations of 3.8 and 4.3 in 15 traits."""
    video, file = Codec("h264", 16, 3), Codec("jpeg", 86)
    both = _likely({(video, 0.94): 3.8, (file, 0.94): 4.3, (file, 1.0): 9.0}, 15)
    assert both.codec == video
    assert both.makers == {STEADY, "jpeg"}
    shares = {kind: sum(c.kind == kind for c, _ in both.drawn(24)) for kind in ("h264", "jpeg")}
    assert shares["h264"] == pytest.approx(12, abs=2)
    far = _likely({(video, 0.94): 900.0, (file, 0.94): 4.3}, 15)
    assert far.makers == {"jpeg"}


@pytest.mark.slow  # a quarter of a minute each
@pytest.mark.parametrize("encoder", ENCODERS[1:])
def test_another_encoder_is_known_by_its_noise(shooting: Shooting, level: np.ndarray, encoder: str) -> None:
    """As x264 is by default, without quality by content, or as little as it searches: draws were once of one kind."""
    own = Codec("h264", 24, 3, encoder)
    noise = np.random.default_rng(8)

    def film() -> Iterator[np.ndarray]:
        for state in [0.6 * level, 0.8 * level, *[level] * 12]:
            frames = shooting.frames(shooting.signal(state), noise)
            for _ in range(own.filmed):
                yield next(frames)

    frames = np.array(list(own.through(film())))[-12:]
    states = [lambda: 0.6 * level, lambda: 0.8 * level]
    scatter = pixel_scatter(list(frames), 1)
    drawn = codec_of(shooting, level, states, binned(frames), scatter, np.random.default_rng(1)).drawn(24)
    alike = [codec.quality for codec, _ in drawn if codec.encoder == encoder]
    assert len(alike) >= 24 / len(ENCODERS)
    assert np.mean(alike) == pytest.approx(own.quality, abs=1.2)
    assert len(alike) < 24  # others of another quality leave as much noise, and make other errors of the levels


def test_jpeg_is_that_of_the_library(shooting: Shooting, level: np.ndarray) -> None:
    frame = next(shooting.frames(shooting.signal(level), np.random.default_rng(4)))
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
    found = recoded(
        shooting,
        lambda k: (level, 0.5 * level)[k],
        views,
        Likely.alone(codec, shooting.scale),
        np.random.default_rng(6),
    )
    return found, binned(shot(shooting, codec, level, 60, seed=77)) - expected[0]


def test_bias_and_scatter_are_those_of_frames_that_were_not_drawn(made: tuple[Recoded, np.ndarray]) -> None:
    found, real = made
    variance = real.var(axis=0, ddof=1)
    # Draws differ by what is not known of codec and camera, too.
    assert 0.9 < np.median(found.sd[0] ** 2 / variance) < 1.4
    # Mean of three frames of another state: a third of the scatter or less.
    assert np.median(found.sd[1] ** 2) < 0.5 * np.median(found.sd[0] ** 2)
    left = real.mean(axis=0) - found.bias[0]
    error = np.sqrt(variance / 60 + variance / len(found.fields))
    assert np.mean((left / error) ** 2) < 1.5
    assert abs(np.mean(left)) < 4 * np.sqrt(np.mean(error**2) / left.size) + 0.02
    # It says something: without it the same frames are farther off.
    assert np.mean(real.mean(axis=0) ** 2) > 1.5 * np.mean(left**2)


def test_what_outlives_a_codec_and_what_it_rounds(shooting: Shooting, level: np.ndarray) -> None:
    """Next to nothing is lost by a JPEG of highest quality, most by a strong one; rounding is what nothing dithers."""
    views = (View(kind="press", force_N=1.0),)
    fine, coarse = (
        recoded(
            shooting, lambda k: level, views, Likely.alone(Codec("jpeg", q), shooting.scale), np.random.default_rng(6)
        )
        for q in (98, 20)
    )
    assert fine.passed[0] == pytest.approx(1.0, abs=0.05)
    assert coarse.passed[0] < 0.6
    assert fine.rounding[0] < 0.1 * coarse.rounding[0] + 0.02
    assert coarse.rounding[0] < 255.0 / 219.0 / np.sqrt(12.0)


def test_draws_are_the_same_by_one_thread_or_two(
    shooting: Shooting, level: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: sums of single precision in the order in which draws end would differ from run to run."""
    views = [View(kind="press", force_N=force, frames=2) for force in (1.0, 2.0)]
    monkeypatch.setattr("evanesce.prediction.recoded.MOST_KEPT", 0.0)  # pictures are made anew, one at a time
    found = []
    for count in (1, 2):
        monkeypatch.setattr(threads, "THREADS", count)
        found.append(
            recoded(
                shooting,
                lambda k: (level, 0.5 * level)[k],
                views,
                Likely.alone(Codec("jpeg", 60), shooting.scale),
                np.random.default_rng(6),
            )
        )
    for name in ("bias", "fields", "passed"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))
    scatter = [one.pixels[1] for one in found if one.pixels is not None]
    np.testing.assert_array_equal(*scatter)


def test_noise_raises_what_is_cut_off_at_black(shooting: Shooting) -> None:
    """Levels belong to the noise of the prediction: frames of more noise are brighter in the dark, and only there."""
    dark, bright = np.full((64, 64), 2.0), np.full((64, 64), 90.0)
    noisier = replace(shooting, scale=1.3, modelled=1.0)
    mean = [float(noisier.mean(noisier.signal(level)).mean()) for level in (dark, bright)]
    assert mean[0] > 2.3
    assert mean[1] == pytest.approx(90.0, abs=0.3)
    frames = noisier.frames(noisier.signal(dark), np.random.default_rng(1))
    assert np.mean([next(frames) for _ in range(30)]) == pytest.approx(mean[0], abs=0.05)
