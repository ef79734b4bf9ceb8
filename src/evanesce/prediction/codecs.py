"""Lossy codecs that frames may have come through, and how probable each is."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import Frame
from evanesce.sensor.codec import STEADY, VideoWriter

Array = NDArray[Any]
Kind = Literal["h264", "jpeg"]

ENCODERS = (
    STEADY,
    "mbtree=1:threads=1:lookahead-threads=1",
    f"{STEADY}:aq-mode=0",
    f"{STEADY}:ref=1:subme=2:trellis=0:weightp=0",
)
"""Of H.264, by parameters of x264: which one filmed is not known, and what it makes of weak contrasts depends on
whether it looks ahead, spares flat parts, and how hard it searches."""


@dataclass(frozen=True)
class Codec:
    """A lossy codec.

    Attributes
    ----------
    kind : {"h264", "jpeg"}
    quality : int
        Constant rate factor; JPEG's quality.
    filmed : int
        Frames of a video for each that is kept, the last of them.
    encoder : str
        Of a video: one of :data:`ENCODERS`.
    """

    kind: Kind
    quality: int
    filmed: int = 1
    encoder: str = STEADY

    @property
    def maker(self) -> str:
        """Encoder of a video, or ``jpeg``."""
        return self.encoder if self.kind == "h264" else self.kind

    def __str__(self) -> str:
        name = "H.264 of rate factor" if self.kind == "h264" else "JPEG of quality"
        return f"{name} {self.quality}"

    def worse(self, steps: int) -> Codec:
        """Return one of another quality, by so many steps of its scale."""
        low, high = (1, 51) if self.kind == "h264" else (1, 100)
        return replace(self, quality=int(np.clip(self.quality + steps, low, high)))

    def through(self, frames: Iterator[Array]) -> Iterator[Array]:
        """Yield frames (rows, cols), or (rows, cols, 3) in colour, of uint8 after the codec, the kept ones."""
        return _as_video(frames, self) if self.kind == "h264" else _as_jpeg(frames, self.quality)


def _as_jpeg(frames: Iterator[Array], quality: int) -> Iterator[Array]:
    for frame in frames:
        coloured = frame.ndim == 3
        shown = frame[..., ::-1] if coloured else frame
        _, data = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, quality])
        back = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR if coloured else cv2.IMREAD_GRAYSCALE))
        yield back[..., ::-1] if coloured else back


def _as_video(frames: Iterator[Array], codec: Codec) -> Iterator[Array]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        shape: tuple[int, ...] = (0, 0)
        with VideoWriter(path, codec="h264", quality=codec.quality, x264=codec.encoder) as film:
            for k, frame in enumerate(frames):
                shape = frame.shape
                even = np.pad(frame, [(0, n % 2) for n in shape[:2]] + [(0, 0)] * (frame.ndim - 2), mode="edge")
                film.add(Frame(data=even, time=k / 30.0, index=k))
        with av.open(str(path)) as container:
            for k, picture in enumerate(container.decode(video=0)):
                if k % codec.filmed == codec.filmed - 1:
                    back = picture.to_ndarray(format="rgb24")[: shape[0], : shape[1]]
                    yield back if len(shape) == 3 else back[..., 1]


@dataclass(frozen=True)
class Likely:
    """Codecs, with the noise before them, by which noise comes as it came in the replicates.

    Attributes
    ----------
    codecs : tuple of Codec
        The most alike one first.
    scales : tuple of float
        Real over modelled noise before the tone curve.
    probability : tuple of float
    """

    codecs: tuple[Codec, ...]
    scales: tuple[float, ...]
    probability: tuple[float, ...]

    @classmethod
    def alone(cls, codec: Codec, scale: float) -> Likely:
        """Return a codec and a noise that are known."""
        return cls((codec,), (scale,), (1.0,))

    @property
    def codec(self) -> Codec:
        """The most alike one."""
        return self.codecs[0]

    @property
    def makers(self) -> frozenset[str]:
        """Encoders among them, or ``jpeg``."""
        return frozenset(codec.maker for codec in self.codecs)

    @property
    def scale(self) -> float:
        """Noise before the most alike one."""
        return self.scales[0]

    def drawn(self, count: int) -> list[tuple[Codec, float]]:
        """Return so many of them with the noise before each, as often as they are probable."""
        places = np.searchsorted(np.cumsum(self.probability), (np.arange(count) + 0.5) / count)
        return [(self.codecs[k], self.scales[k]) for k in np.minimum(places, len(self.codecs) - 1)]
