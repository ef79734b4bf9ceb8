"""The quality of a JPEG, by another encoder's files; frames that came through none, or through a video, show none."""

from __future__ import annotations

import io
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from evanesce.prediction.jpeg_steps import _steps, jpeg_quality


def frames(sd: float, seed: int = 0, count: int = 3, level: float = 40.0) -> list[Any]:
    """A dim disc with noise, cut off at black beside it."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:300, :400]
    disc = level * ndimage.gaussian_filter((np.hypot(y - 140, x - 220) < 70).astype(float), 2.0)
    return [
        np.clip(np.round(disc - 1 + sd * rng.standard_normal(disc.shape)), 0, 255).astype(np.uint8)
        for _ in range(count)
    ]


def by_jpeg(frame: Any, quality: int, mode: str = "L") -> Any:
    file = io.BytesIO()
    Image.fromarray(frame).convert(mode).save(file, "JPEG", quality=quality)
    with Image.open(file) as picture:
        return np.asarray(picture.convert("L"))


def by_video(pictures: list[Any], rate_factor: int) -> list[Any]:
    file = io.BytesIO()
    with av.open(file, "w", format="matroska") as film:
        stream = film.add_stream("libx264", rate=30, options={"crf": str(rate_factor)})
        stream.width, stream.height, stream.pix_fmt = 400, 300, "yuv420p"
        for one in pictures:
            film.mux(stream.encode(av.VideoFrame.from_ndarray(one, format="gray")))
        film.mux(stream.encode(None))
    file.seek(0)
    with av.open(file) as film:
        return [p.to_ndarray(format="rgb24")[:, :, 1] for p in film.decode(video=0)]


@pytest.mark.parametrize("quality", [35, 60, 75, 86, 92, 95])
@pytest.mark.parametrize("sd", [1.5, 7.0])
def test_the_quality_is_that_of_the_file(quality: int, sd: float) -> None:
    """To one where little noise leaves few coefficients: the tables of neighbours differ in few steps."""
    found = jpeg_quality([by_jpeg(f, quality) for f in frames(sd)])
    assert found == pytest.approx(quality, abs=1 if sd < 2.0 else 0)


@pytest.mark.parametrize("quality", [70, 90])
def test_files_in_colour_keep_the_steps_of_their_brightness(quality: int) -> None:
    assert jpeg_quality([by_jpeg(f, quality, "RGB") for f in frames(5.0)]) == quality


@pytest.mark.parametrize("sd", [0.0, 0.5, 7.0])
@pytest.mark.parametrize("level", [12.0, 200.0])
def test_frames_that_came_through_no_jpeg_show_none(sd: float, level: float) -> None:
    plain = frames(sd, level=level)
    assert jpeg_quality(plain) is None
    for rate_factor in (12, 18, 26, 34):
        assert jpeg_quality(by_video(plain, rate_factor)) is None
    assert jpeg_quality([np.full((64, 64), 7, np.uint8)]) is None
    assert jpeg_quality([]) is None


def test_a_jpeg_that_was_resized_or_shifted_shows_none() -> None:
    came = [by_jpeg(f, 80) for f in frames(7.0)]
    assert jpeg_quality([c[3:, 2:] for c in came]) is None
    assert jpeg_quality([np.asarray(Image.fromarray(c).resize((360, 270))) for c in came]) is None


def test_steps_are_those_of_the_standard() -> None:
    """Table K.1 of ITU-T T.81 at quality 50, its first row and its corners."""
    np.testing.assert_array_equal(_steps(50)[0], [16, 11, 10, 16, 24, 40, 51, 61])
    assert (_steps(50)[7, 0], _steps(50)[7, 7], _steps(50)[1, 0], _steps(50)[0, 1]) == (72, 99, 12, 11)
