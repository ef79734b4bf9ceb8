"""Traces of codecs in noise: frames of real codecs against noise that a camera smooths, bends and lets flicker."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import ndimage

from challenge.codec import by_jpeg, by_video
from evanesce.prediction.codec_traces import SURE, codec_traces

SHAPE = (152, 200)


def drawn(
    count: int, *, seed: int, smooth_px: float = 0.0, flicker: float = 0.0, gamma: float = 1.0
) -> list[np.ndarray]:
    """A disc of light on a dark ground, with noise that grows with the light."""
    rng = np.random.default_rng(seed)
    y, x = np.indices(SHAPE)
    mean = np.where(np.hypot(y - 76, x - 100) < 40, 150.0, 12.0)
    found = []
    for _ in range(count):
        noise = rng.standard_normal(SHAPE)
        if smooth_px:
            noise = ndimage.gaussian_filter(noise, smooth_px, mode="wrap")
            noise /= noise.std()
        light = mean * (1.0 + flicker * rng.standard_normal()) + noise * np.sqrt(4.0 + 0.2 * mean)
        found.append(np.floor(255.0 * np.clip(light / 255.0, 0.0, 1.0) ** gamma + 0.5).astype(np.uint8))
    return found


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    "camera", [{}, {"smooth_px": 0.7}, {"flicker": 0.01}, {"gamma": 0.45, "smooth_px": 0.55}, {"gamma": 1.6}]
)
def test_a_camera_leaves_no_trace(seed: int, camera: dict[str, float]) -> None:
    found = codec_traces(drawn(12, seed=seed, **camera))
    assert found is not None
    assert found.correlation < 3.5 * found.correlation_error
    assert found.borders < 3.5 * found.borders_error


@pytest.mark.parametrize(
    ("codec", "trace"),
    [
        (lambda film: by_video(film, 18), "correlation"),
        (lambda film: by_video(film, 22), "correlation"),
        (lambda film: [by_jpeg(frame, 92) for frame in film], "borders"),
        (lambda film: [by_jpeg(frame, 75) for frame in film], "borders"),
    ],
)
def test_codecs_do(codec: Callable[[list[np.ndarray]], list[np.ndarray]], trace: str) -> None:
    film = codec(drawn(12, seed=3))
    found = codec_traces(film)
    assert found is not None
    assert found.found
    assert getattr(found, trace) > SURE * getattr(found, f"{trace}_error")


def test_correlation_is_that_of_a_mixture() -> None:
    """Frames that hand on half of their noise are correlated by a half, what is taken off with the mean put right."""
    rng = np.random.default_rng(5)
    noise = [rng.standard_normal(SHAPE)]
    for _ in range(39):
        noise.append(0.5 * noise[-1] + np.sqrt(0.75) * rng.standard_normal(SHAPE))
    found = codec_traces([100.0 + 5.0 * one for one in noise])
    assert found is not None
    assert found.correlation == pytest.approx(0.5, abs=0.05)


def test_what_could_show_none_tells_nothing() -> None:
    assert codec_traces(drawn(2, seed=1)) is None
    assert codec_traces(by_video(drawn(12, seed=3), 26)) is None


def test_light_at_the_end_of_the_scale_has_no_noise_and_shows_no_trace() -> None:
    lit = np.hypot(*(np.indices(SHAPE) - np.array([76, 100])[:, None, None])) < 40
    found = codec_traces([np.where(lit, 255, frame) for frame in drawn(12, seed=2)])
    assert found is not None
    assert not found.found
    alone = np.zeros(SHAPE)
    alone[:8, :8] = 50.0
    rng = np.random.default_rng(1)
    assert codec_traces([alone * (1.0 + rng.standard_normal(SHAPE)) for _ in range(6)]) is None
    assert codec_traces([np.full(SHAPE, 7, np.uint8)] * 8) is None
