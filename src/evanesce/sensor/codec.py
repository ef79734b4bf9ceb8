"""Frames as files: PNG with a list of time stamps, and video with the frames' own time stamps. Whole files or none."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError, WorkError
from evanesce.core.states import Frame
from evanesce.sensor.pi_encoder import KEY_FRAMES, PI_CODECS, PiQuality, bit_rate, encoder_options

VideoCodec = Literal["h264", "ffv1", "h264-pi4", "h264-pi5"]
TIMES_FILE = "times.csv"

# Container of a suffix and the finest step of time that it stores; Matroska's writer counts milliseconds.
_CONTAINERS: dict[str, tuple[str, Fraction]] = {
    ".mp4": ("mp4", Fraction(1, 90_000)),
    ".mov": ("mov", Fraction(1, 90_000)),
    ".mkv": ("matroska", Fraction(1, 1000)),
}
_H264 = ("h264", *PI_CODECS)
_SUFFIXES: dict[str, tuple[str, ...]] = {"ffv1": (".mkv",)} | dict.fromkeys(_H264, (".mp4", ".mov", ".mkv"))
ENCODER_THREADS = 4
"""Of x264, whose pictures depend on their number: as many on every machine."""
STEADY = "mbtree=0"
"""Parameters of x264: its macroblock tree, which no encoder of a Pi has either, makes some videos of the same frames
differ."""
_ENCODERS = {"ffv1": "ffv1"} | dict.fromkeys(_H264, "libx264")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path beside ``path`` to write to; it replaces ``path`` only if no error occurred.

    Parameters
    ----------
    path : Path

    Raises
    ------
    WorkError
        If the system refuses a write (disk full, no permission).
    """
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield part
        with part.open("rb+") as stream:
            os.fsync(stream.fileno())
        os.replace(part, path)
    except OSError as error:
        raise WorkError(f"{path}: cannot write: {error.strerror or error}") from None
    finally:
        part.unlink(missing_ok=True)


def write_png(path: Path, image: NDArray[Any]) -> None:
    """Write an 8- or 16-bit image as PNG.

    Parameters
    ----------
    path : Path
    image : ndarray of uint8 or uint16, (rows, cols) grey or (rows, cols, 3) RGB
        [DN].

    Raises
    ------
    WorkError
        If it cannot be encoded or written.
    """
    if image.dtype not in (np.uint8, np.uint16):
        raise TypeError(f"a PNG holds uint8 or uint16, not {image.dtype}")
    ok, encoded = cv2.imencode(".png", image if image.ndim == 2 else image[..., ::-1])
    if not ok:
        raise WorkError(f"{path}: OpenCV could not encode an image of shape {image.shape}")
    # Encoded in memory and written by Python: cv2.imwrite reports neither why it failed nor a full disk.
    with replacing(path) as part:
        part.write_bytes(encoded.tobytes())


def write_frames(folder: Path, frames: Iterable[Frame], *, raw: bool = False) -> list[Path]:
    """Write frames as numbered PNG files, and their times as ``times.csv`` (file, index, time_s).

    Parameters
    ----------
    folder : Path
        Made if missing.
    frames : iterable of Frame
    raw : bool
        True writes the raw numbers as 16-bit PNG instead of the 8-bit frame.

    Returns
    -------
    list of Path
        The image files.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WorkError(f"{folder}: cannot make the folder: {error.strerror}") from None
    written: list[Path] = []
    table = io.StringIO()
    rows = csv.writer(table, lineterminator="\n")
    rows.writerow(["file", "index", "time_s"])
    for frame in frames:
        path = folder / f"{'raw' if raw else 'frame'}_{frame.index:06d}.png"
        if raw and frame.raw is None:
            raise ValueError(f"frame {frame.index} carries no raw numbers")
        write_png(path, frame.raw if raw and frame.raw is not None else frame.data)
        rows.writerow([path.name, frame.index, repr(float(frame.time))])
        written.append(path)
    with replacing(folder / TIMES_FILE) as part:
        part.write_text(table.getvalue(), encoding="utf-8")
    return written


class VideoWriter:
    """Write frames to a video, each at its own time; the file appears when the block ends without an error.

    H.264 in 4:2:0 without B-frames, as a small camera's encoder makes it; FFV1 without any loss, in RGB.

    Parameters
    ----------
    path : Path
        ``.mp4``, ``.mov`` or ``.mkv`` for H.264, ``.mkv`` for FFV1. Times are kept to 1/90000 s, in
        Matroska to 1 ms.
    codec : {"h264", "ffv1", "h264-pi4", "h264-pi5"}
        ``h264`` keeps the quality constant; ``h264-pi4`` and ``h264-pi5`` the bit rate of a Raspberry Pi's encoder
        (:mod:`evanesce.sensor.pi_encoder`).
    frame_rate_hz : float
        Nominal rate written to the header [Hz]; the time stamps are the frames' own.
    quality : int
        Constant rate factor of ``h264``, 0 (best) to 51.
    pi_quality : {"very low", "low", "medium", "high", "very high"}
        Of the Pi's encoders.
    x264 : str
        Parameters of ``h264``'s encoder, ``name=value`` with colons between them.

    Raises
    ------
    InputError
        If suffix, size or times do not suit the codec or container.
    WorkError
        If writing fails, or the finished file does not hold every frame.
    """

    def __init__(
        self, path: Path, *, codec: VideoCodec = "h264", frame_rate_hz: float = 30.0, quality: int = 18,
        pi_quality: PiQuality = "medium", x264: str = STEADY,
    ):  # fmt: skip
        if path.suffix not in _SUFFIXES[codec]:
            raise InputError(
                f"{path.suffix or 'no suffix'} does not hold {codec}", file=path, allowed=", ".join(_SUFFIXES[codec])
            )
        self.path, self.codec = path, codec
        self.frame_rate_hz, self.quality, self.pi_quality, self.x264 = frame_rate_hz, quality, pi_quality, x264
        self._ticks: list[int] = []
        self._size: tuple[int, int] | None = None
        self._stream: Any = None
        self._container: Any = None

    def __enter__(self) -> Self:
        self._replacing = replacing(self.path)
        self._part = self._replacing.__enter__()
        self._format, self._tick = _CONTAINERS[self.path.suffix]
        try:
            self._container = av.open(str(self._part), "w", format=self._format)
        except OSError as error:
            self._replacing.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def add(self, frame: Frame) -> None:
        """Append a frame at ``frame.time``; grey is written as equal R, G and B."""
        image = frame.data if frame.data.ndim == 3 else np.repeat(frame.data[..., None], 3, axis=2)
        if self._size is None:
            self._start(image.shape[0], image.shape[1])
        if image.shape[:2] != self._size:
            raise InputError(f"frame {frame.index} has shape {image.shape[:2]}, the first {self._size}", file=self.path)
        tick = round(Fraction(frame.time) / self._tick)
        if tick < 0 or (self._ticks and tick <= self._ticks[-1]):
            before = f", the one before at {float(self._ticks[-1] * self._tick):g} s" if self._ticks else ""
            raise InputError(
                f"frame {frame.index} at {frame.time:g} s{before}",
                file=self.path,
                key="time",
                allowed=f"times from 0 that rise by at least {float(self._tick):g} s",
            )
        picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
        picture.pts, picture.time_base = tick, self._tick
        self._ticks.append(tick)
        self._container.mux(self._stream.encode(picture))

    def _start(self, rows: int, cols: int) -> None:
        if self.codec in _H264 and (rows % 2 or cols % 2):
            raise InputError(
                f"{cols} x {rows} pixels", file=self.path, key="frame size", allowed="even sides for H.264"
            )
        rate = Fraction(self.frame_rate_hz).limit_denominator(1001)
        stream = self._container.add_stream(_ENCODERS[self.codec], rate=rate)
        stream.height, stream.width = rows, cols
        stream.pix_fmt = "yuv420p" if self.codec in _H264 else "bgr0"
        stream.time_base = stream.codec_context.time_base = self._tick
        if self.codec == "h264":
            stream.options = {
                "crf": str(self.quality), "bf": "0", "threads": str(ENCODER_THREADS), "x264-params": self.x264,
            }  # fmt: skip
        elif self.codec in PI_CODECS:
            bits = bit_rate(self.codec, (rows, cols), self.frame_rate_hz, self.pi_quality)
            stream.codec_context.bit_rate, stream.codec_context.gop_size = bits, KEY_FRAMES[self.codec]
            stream.options = encoder_options(self.codec, bits)
        self._stream, self._size = stream, (rows, cols)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                if self._stream is None:
                    raise InputError("no frame was given", file=self.path)
                self._container.mux(self._stream.encode(None))
            self._container.close()
            if kind is None:
                self._verify()
        except BaseException as failure:
            self._replacing.__exit__(type(failure), failure, failure.__traceback__)
            raise
        self._replacing.__exit__(kind, error, trace)

    def _verify(self) -> None:
        """Read the finished file's time stamps back: a disk that filled up leaves fewer."""
        try:
            with av.open(str(self._part)) as container:
                stream = container.streams.video[0]
                times = sorted(p.pts * stream.time_base for p in container.demux(stream) if p.pts is not None)
        except (OSError, ValueError, IndexError) as error:
            raise WorkError(f"{self.path}: the finished video cannot be read back: {error}") from None
        wanted = [tick * self._tick for tick in self._ticks]
        if times != wanted:
            raise WorkError(f"{self.path}: {len(times)} of {len(wanted)} frames came back with their times")


def write_video(
    path: Path,
    frames: Iterable[Frame],
    *,
    codec: VideoCodec = "h264",
    frame_rate_hz: float = 30.0,
    quality: int = 18,
    pi_quality: PiQuality = "medium",
) -> None:
    """Write all frames as one video; see :class:`VideoWriter`.

    Parameters
    ----------
    path : Path
    frames : iterable of Frame
    codec, frame_rate_hz, quality, pi_quality
        As for :class:`VideoWriter`.
    """
    with VideoWriter(path, codec=codec, frame_rate_hz=frame_rate_hz, quality=quality, pi_quality=pi_quality) as video:
        for frame in frames:
            video.add(frame)
