"""A video or a folder of images as a stream of frames with time stamps, one frame in memory at a time."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import av
import av.logging
import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError, WorkError
from evanesce.core.states import Frame
from evanesce.measurement.io.images import IMAGE_SUFFIXES, MAX_PIXELS, Loaded, Unreadable, load_image
from evanesce.measurement.io.mosaics import MosaicFormat
from evanesce.measurement.io.times import read_times
from evanesce.measurement.warnings import RATE_TOLERANCE, Warning, frame_rate_warning

UNTIMED_FORMATS = frozenset({"h264", "hevc", "m4v", "mpegvideo", "mjpeg", "av1", "obu"})
"""Bare streams of pictures: they hold no time stamps, and the 25 Hz that FFmpeg reports for them is its own guess."""

READ_AHEAD = 3
"""Images decoded in advance while another is measured."""


@dataclass(frozen=True)
class _Item:
    """One picture as it comes, or the reason why it does not."""

    index: int
    name: str
    data: NDArray[np.uint8] | None = None
    time: float | None = None
    reason: str = ""
    notes: tuple[Warning, ...] = ()
    raw: NDArray[np.uint16] | None = None


class FrameStream(ABC):
    """Frames in the order of time; iterate once.

    Readable pictures are yielded; the others are left out and raised by :meth:`finish`. A picture of another size than
    the first is left out with a warning, because neither crop nor scale hold for it.

    Attributes
    ----------
    path : Path
    count : int or None
        Number of pictures the file states; None where it states none.
    stated_rate : float or None
        Frame rate the file states [Hz].
    given_rate : float or None
        Frame rate the user gives [Hz].
    shape : tuple of int or None
        (rows, cols) of the first frame, known once it has been read.
    frames : int
        Frames handed out so far.
    """

    def __init__(self, path: Path, given_rate: float | None) -> None:
        self.path, self.given_rate = path, given_rate
        self.count: int | None = None
        self.stated_rate: float | None = None
        self.shape: tuple[int, int] | None = None
        self.frames = 0
        self._bad: list[_Item] = []  # the first only; _bad_count counts
        self._bad_count = 0
        self._resized: list[str] = []
        self._resized_count = 0
        self._notes: dict[str, tuple[Warning, str, int]] = {}
        self._first_time: float | None = None
        self._last_time: float | None = None
        self._gaps: list[float] = []  # the widest gap and where it begins, once there is one
        self._gap_count = 0

    def __iter__(self) -> Iterator[Frame]:
        for item in self._items():
            if item.data is None:
                self._bad = self._bad or [item]
                self._bad_count += 1
                continue
            for note in item.notes:
                first, name, count = self._notes.get(note.code, (note, item.name, 0))
                self._notes[note.code] = (first, name, count + 1)
            rows, cols = item.data.shape[:2]
            if self.shape is None:
                self.shape = (rows, cols)
            if (rows, cols) != self.shape:
                self._resized = self._resized or [f"{item.name} is {cols} x {rows}"]
                self._resized_count += 1
                continue
            self.frames += 1
            yield Frame(data=item.data, raw=item.raw, time=self._time(item), index=item.index)

    @abstractmethod
    def _items(self) -> Iterator[_Item]:
        """Yield every picture of the source once, in order, readable or not."""

    @property
    def complete(self) -> bool:
        """Whether every picture so far could be read."""
        return not self._bad

    @property
    def _own_time(self) -> bool:
        """Whether the file's time stamps are used: they exist and the user does not contradict them."""
        if self.stated_rate is None or self.given_rate is None:
            return self.stated_rate is not None
        return abs(self.stated_rate / self.given_rate - 1) <= RATE_TOLERANCE

    def _time(self, item: _Item) -> float:
        if item.time is None or not self._own_time:
            return item.index / self.given_rate if self.given_rate else math.nan
        if self._first_time is None:
            self._first_time = item.time
        if self._last_time is not None and self.stated_rate is not None:
            gap = item.time - self._last_time
            if gap > 1.5 / self.stated_rate or gap <= 0:
                self._gap_count += 1
                if not self._gaps or abs(gap) > abs(self._gaps[0]):
                    self._gaps = [gap, self._last_time - self._first_time]
        self._last_time = item.time
        return item.time - self._first_time

    @property
    def warnings(self) -> list[Warning]:
        """Warnings about the frames read so far."""
        found = []
        rate = frame_rate_warning(self.stated_rate, self.given_rate, self.path.name)
        if rate is not None:
            found.append(rate)
        if self._gap_count and self.stated_rate:
            found.append(
                Warning(
                    "irregular_time_stamps",
                    f"{self._gap_count} step(s) between time stamps are not one frame "
                    f"of {1000 / self.stated_rate:.1f} ms; "
                    f"the widest is {1000 * self._gaps[0]:.1f} ms at {self._gaps[1]:.3f} s",
                )
            )
        if self._resized and self.shape:
            found.append(
                Warning(
                    "changed_resolution",
                    f"{self._resized[0]}, the first frame {self.shape[1]} x {self.shape[0]} pixels: "
                    f"{self._resized_count} frame(s) of another size left out",
                )
            )
        found += [
            Warning(note.code, f"{note.text} (in {count} frame(s), first {name})")
            for note, name, count in self._notes.values()
        ]
        return found

    def finish(self) -> None:
        """Raise what went wrong while reading, after the results so far have been stored.

        Raises
        ------
        InputError
            If there was not a single readable frame.
        WorkError
            If some pictures could not be read; names the first.
        """
        if not self.frames:
            why = f": {self._bad[0].name}: {self._bad[0].reason}" if self._bad else ""
            raise InputError(
                f"no readable frame{why}", file=self.path, allowed="a video, an image or a folder of images"
            )
        if self._bad:
            raise WorkError(
                f"{self.path}: {self._bad[0].name}: {self._bad[0].reason}; "
                f"{self._bad_count} unreadable, {self.frames} frame(s) measured"
            )


def natural_key(name: str) -> tuple[tuple[int, int | str], ...]:
    """Return a sort key under which ``frame_9`` comes before ``frame_10``.

    Parameters
    ----------
    name : str

    Returns
    -------
    tuple
    """
    parts = re.split(r"([0-9]+)", name.lower())
    return tuple((0, int(part)) if k % 2 else (1, part) for k, part in enumerate(parts))


class ImageStream(FrameStream):
    """Image files in natural order; times come from the folder's ``times.csv`` or from the frame rate given."""

    def __init__(self, path: Path, given_rate: float | None, load: Callable[[Path], Loaded] = load_image) -> None:
        super().__init__(path, given_rate)
        self._load = load
        if path.is_dir():
            found = [p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file()]
            # a leading dot marks the hidden companions that some systems leave beside each file
            self.paths = sorted(
                (p for p in found if not p.name.startswith(".")), key=lambda p: (natural_key(p.name), p.name)
            )
        else:
            self.paths = [path]
        if not self.paths:
            raise InputError(
                "the folder holds no images", file=path, allowed="files named " + " ".join(sorted(IMAGE_SUFFIXES))
            )
        self.count = len(self.paths)
        self.times = read_times(path, [p.name for p in self.paths]) if path.is_dir() else None
        if self.times and len(self.times) > 1:
            self.stated_rate = (len(self.times) - 1) / (self.times[-1] - self.times[0])
            self._first_time = self.times[0]  # also where the first image cannot be read

    def _items(self) -> Iterator[_Item]:
        with ThreadPoolExecutor(max_workers=2) as pool:
            waiting: deque[tuple[int, Path, Future[Loaded]]] = deque()
            jobs = enumerate(self.paths)
            try:
                while True:
                    for index, path in islice(jobs, READ_AHEAD - len(waiting)):
                        waiting.append((index, path, pool.submit(self._load, path)))
                    if not waiting:
                        return
                    index, path, future = waiting.popleft()
                    try:
                        loaded = future.result()
                        time = self.times[index] if self.times else None
                        yield _Item(index, path.name, data=loaded.data, time=time, notes=loaded.notes, raw=loaded.raw)
                    except Unreadable as error:
                        yield _Item(index, path.name, reason=str(error))
            finally:
                for _, _, future in waiting:
                    future.cancel()


class VideoStream(FrameStream):
    """Frames of a video file with its own time stamps."""

    def __init__(self, path: Path, given_rate: float | None) -> None:
        super().__init__(path, given_rate)
        with self._open() as container:
            stream = _video_of(container, path)
            timed = container.format.name not in UNTIMED_FORMATS and stream.average_rate
            self.stated_rate = float(stream.average_rate) if timed else None
            self._packets_stated = int(stream.frames)
            self._duration = _duration(container, stream)
        if self._packets_stated > 0:
            self.count = self._packets_stated
        elif self._duration and self.stated_rate:
            self.count = round(self._duration * self.stated_rate)

    def _open(self) -> Any:
        try:
            # an absolute path and one protocol: neither a name nor a playlist may lead FFmpeg elsewhere
            return av.open(str(self.path.resolve()), options={"protocol_whitelist": "file"})
        except (av.FFmpegError, OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(
                f"cannot be opened as a video: {reason}",
                file=self.path,
                allowed="a whole video file or a folder of images",
            ) from None

    def _items(self) -> Iterator[_Item]:
        with self._open() as container:
            stream = _video_of(container, self.path)
            # by default the decoder conceals what it cannot read; a concealed picture has an area too
            stream.codec_context.options = {"err_detect": "crccheck+explode"}
            index = packets = 0
            last: float | None = None
            lost = False
            demuxed = container.demux(stream)
            while True:
                try:
                    packet = next(demuxed, None)  # once it has raised, the generator is at its end
                    if packet is None:
                        break
                    packets += packet.size > 0
                    with _decoder_complaints() as complaints:
                        pictures = packet.decode()
                except (av.FFmpegError, ValueError) as error:
                    reason = getattr(error, "strerror", None) or str(error)
                    yield _Item(index, f"frame {index}", reason=f"cannot be decoded: {reason}")
                    index, lost = index + 1, True
                    continue
                for picture in pictures:
                    # after a loss the decoder's references are wrong until the next key frame
                    lost = bool(complaints) or picture.is_corrupt or (lost and not picture.key_frame)
                    if lost:
                        reason = complaints[0][2].strip() if complaints else "depends on data that cannot be decoded"
                        yield _Item(index, f"frame {index}", reason=reason)
                    else:
                        last = picture.time if picture.time is not None else last
                        yield _picture_item(index, picture)
                    index += 1
            yield from self._cut_off(index, packets, last)

    def _cut_off(self, index: int, packets: int, last: float | None) -> Iterator[_Item]:
        """Yield a bad item where the file ends before what its header promises."""
        if self._packets_stated > packets:
            reason = f"the file is cut off: {packets} of {self._packets_stated} stated frames are there"
            yield _Item(index, f"frame {index}", reason=reason)
        elif self._packets_stated <= 0 and self._duration and self.stated_rate and last is not None:
            # the duration includes the last frame's own; one and a half frames of slack for rounding
            missing = self._duration - last - 1 / self.stated_rate
            if missing > 1.5 / self.stated_rate:
                reason = f"the file is cut off at {last:.3f} s of {self._duration:.3f} s"
                yield _Item(index, f"frame {index}", reason=reason)


@contextmanager
def _decoder_complaints() -> Iterator[list[Any]]:
    """Collect FFmpeg's error messages: some decoders (FFV1 on a wrong checksum) log it and go on.

    The log is captured while a packet is decoded and at no other time, since PyAV warns of deadlocks elsewhere.
    """
    level, skip = av.logging.get_level(), av.logging.get_skip_repeated()
    av.logging.set_level(av.logging.ERROR)
    av.logging.set_skip_repeated(False)
    try:
        with av.logging.Capture(local=False) as complaints:
            yield complaints
    finally:
        av.logging.set_level(level)
        av.logging.set_skip_repeated(skip)


def _video_of(container: Any, path: Path) -> Any:
    # FFmpeg reads any text file as a video of a terminal
    if not container.streams.video or container.format.name == "tty":
        raise InputError("holds no video", file=path, allowed="a video file or a folder of images")
    stream = container.streams.video[0]
    if stream.width * stream.height > MAX_PIXELS:
        raise InputError(f"{stream.width} x {stream.height} pixels", file=path, allowed=f"at most {MAX_PIXELS} pixels")
    return stream


def _duration(container: Any, stream: Any) -> float | None:
    """Return the video's stated length [s], None where only that of the whole file is known and it holds more."""
    if stream.duration:
        return float(stream.duration * stream.time_base)
    tag = re.fullmatch(r"(\d+):(\d+):(\d+(?:\.\d+)?)", stream.metadata.get("DURATION", ""))  # Matroska's
    if tag:
        return 3600 * float(tag[1]) + 60 * float(tag[2]) + float(tag[3])
    if container.duration and len(container.streams) == 1:
        return float(container.duration) / float(av.time_base)
    return None


def _picture_item(index: int, picture: Any) -> _Item:
    bits = max(part.bits for part in picture.format.components)
    notes: tuple[Warning, ...] = ()
    if bits > 8:
        notes = (Warning("bit_depth", f"{bits}-bit samples reduced to 8 bits"),)
    grey = picture.format.name.startswith("gray")
    data = picture.to_ndarray(format="gray" if grey else "rgb24")
    return _Item(index, f"frame {index}", data=np.ascontiguousarray(data), time=picture.time, notes=notes)


def open_frames(path: str | Path, frame_rate: float | None = None, mosaic: MosaicFormat | None = None) -> FrameStream:
    """Open a video, an image or a folder of images.

    Parameters
    ----------
    path : str or Path
    frame_rate : float, optional
        Of the user [Hz]. Where the file states none, times are index / frame_rate; where both exist and differ by more
        than 1 %, this one is used with a warning; where they agree, the file's time stamps are used.
    mosaic : MosaicFormat, optional
        Of images that are raw mosaics; a frame's ``raw`` holds them.

    Returns
    -------
    FrameStream
        Iterate it, then call its ``finish``.

    Raises
    ------
    InputError
        If there is nothing readable at the path.
    """
    path = Path(path)
    if frame_rate is not None and not 0 < frame_rate <= 1e6:
        raise InputError(f"{frame_rate}", key="--fps", allowed="above 0 Hz, at most 1e6 Hz")
    if not path.exists():
        raise InputError("no such file or folder", file=path, allowed="a video, an image or a folder of images")
    if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES:
        return ImageStream(path, frame_rate, load_image if mosaic is None else mosaic.load)
    if mosaic is not None:
        raise InputError("is no folder of images", file=path, key="raw", allowed="a folder of PNG or TIFF of 16 bits")
    return VideoStream(path, frame_rate)
