"""Read a user's own frame from a file, a film or untrusted bytes, and measure it by the reference segmentation."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from evanesce.core.errors import InputError
from evanesce.live.figures import Histogram, histogram_of, single_grey
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.rectify import rectification, rectify
from evanesce.measurement.io.frames import FrameStream, open_frames
from evanesce.measurement.io.images import Unreadable, load_image
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.measurement.refined.light import tone_table
from evanesce.measurement.survey import look_through

Image = NDArray[np.uint8]

MAX_BYTES = 64_000_000
MAX_PIXELS = 40_000_000
ALLOWED = f"one PNG, TIFF, JPEG or BMP image of at most {MAX_BYTES // 10**6} MB and {MAX_PIXELS // 10**6} megapixels"
KEY = "own frame"
SURVEY_BLOB_PX, SURVEY_RADIUS_PX = 2000, 10
"""Of the reference segmentation; they decide which frames of a film show no finger, of which none is used here."""


@dataclass(frozen=True)
class OwnFrame:
    """A frame of the user's own rig.

    Attributes
    ----------
    name : str
        As shown; never a path.
    view : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        Undistorted where there is a calibration [DN].
    notes : tuple of str
        Conversions while reading.
    """

    name: str
    view: Image
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class OwnMeasured:
    """The segmentation of an own frame.

    Attributes
    ----------
    frame : OwnFrame
    mask : ndarray of bool (rows, cols)
    pixels, blobs : int
    mm2_per_px : float or None
        Area of a pixel [mm^2], where it is known.
    histogram : Histogram
    """

    frame: OwnFrame
    mask: NDArray[np.bool_]
    pixels: int
    blobs: int
    mm2_per_px: float | None
    histogram: Histogram

    @property
    def area_mm2(self) -> float | None:
        """Measured area [mm^2]; None where the area of a pixel is not known."""
        return None if self.mm2_per_px is None else self.pixels * self.mm2_per_px


@dataclass(frozen=True)
class OwnFilm:
    """A film of the user's own rig, or a folder of pictures; one frame of it is in memory at a time.

    Attributes
    ----------
    path : Path
    count : int
        Frames that can be read.
    largest : int
        Place of the frame with the largest contact.
    calibration : Calibration or None
        Whose lens distortion is corrected.
    """

    path: Path
    count: int
    largest: int
    calibration: Calibration | None = None

    def frame(self, number: int) -> OwnFrame:
        """Return a frame by its place among those that can be read, from 0.

        Raises
        ------
        InputError
            If there is no such frame, or it does not fit the calibration.
        """
        for place, frame in enumerate(open_frames(self.path)):
            if place == number:
                data, known = np.asarray(frame.data, np.uint8), self.calibration
                view = data if known is None else rectify(data, rectification(known))
                return OwnFrame(f"{plain_name(self.path.name)}, frame {number}", view)
        raise InputError(f"frame {number}", file=self.path, key="--frame", allowed=f"0 to {self.count - 1}")


def read_film(path: Path, calibration: Calibration | None, tick: Callable[[int, int | None], None]) -> OwnFilm:
    """Look through a video or a folder of pictures for the frame with the largest contact.

    Parameters
    ----------
    path : Path
    calibration : Calibration, optional
    tick : callable
        ``tick(done, total)`` after each frame; the total may be None.

    Returns
    -------
    OwnFilm

    Raises
    ------
    InputError
        If it is neither, or holds no readable frame.
    """
    try:
        stream: FrameStream = open_frames(path)
    except InputError as error:
        raise InputError(error.what, file=path, key="--frame", allowed=f"{ALLOWED}, a folder, or a video") from None
    total, seen = stream.count, 0

    def looked() -> None:
        nonlocal seen
        seen += 1
        tick(seen, total)

    details = {} if calibration is None else calibration.details
    found = look_through(
        lambda: open_frames(path), tone_table(details.get("tone_curve", "bt709")), count=total,
        radius=SURVEY_RADIUS_PX, min_blob=SURVEY_BLOB_PX, tick=looked,
    )  # fmt: skip
    if found is None:
        raise InputError("holds no readable frame", file=path, key="--frame", allowed="a whole video or pictures")
    places = (place for place, frame in enumerate(open_frames(path)) if frame.index == found.brightest.index)
    return OwnFilm(path, seen, next(places), calibration)


def is_film(path: Path) -> bool:
    """Return whether a path is a folder, or a file that is no picture."""
    if path.is_dir():
        return True
    try:
        with PillowImage.open(path):
            return False
    except (PillowImage.DecompressionBombError, PillowImage.DecompressionBombWarning):
        return False
    except (OSError, ValueError, SyntaxError, TypeError, KeyError, EOFError, OverflowError):
        return path.is_file() and path.stat().st_size > 0


def read_own(content: bytes, name: str, calibration: Calibration | None = None) -> OwnFrame:
    """Read an uploaded frame.

    Parameters
    ----------
    content : bytes
        Content of the file; its type is read from it, not from its name.
    name : str
        For the caption only.
    calibration : Calibration, optional
        Whose lens distortion is corrected.

    Raises
    ------
    InputError
        If it is too large, not an image, damaged, or of another size than the calibration.
    """
    if not 0 < len(content) <= MAX_BYTES:
        raise InputError(f"{len(content)} bytes", key=KEY, allowed=ALLOWED)
    _check_size(content)
    # The TIFF decoder needs a file: in a temporary folder, under a name that is not the user's.
    with tempfile.TemporaryDirectory(prefix="evanesce-") as folder:
        path = Path(folder) / "frame"
        path.write_bytes(content)
        try:
            loaded = load_image(path)
        except Unreadable as error:
            raise InputError(str(error), key=KEY, allowed=ALLOWED) from None
    data = loaded.data if calibration is None else rectify(loaded.data, rectification(calibration))
    return OwnFrame(plain_name(name), data, tuple(note.text for note in loaded.notes))


def read_own_file(path: Path, calibration: Calibration | None = None) -> OwnFrame:
    """Read a frame from a file that the command line names.

    Raises
    ------
    InputError
        As :func:`read_own`, or if the file cannot be read.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=ALLOWED)
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path, allowed=ALLOWED) from None
    try:
        return read_own(content, path.name, calibration)
    except InputError as error:
        raise InputError(error.what, file=path, key=error.key, allowed=error.allowed) from None


def plain_name(name: str) -> str:
    """Return a file's name for a caption: without folders and unprintable characters, at most 60 characters."""
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    return "".join(c for c in last if c.isprintable())[:60] or "frame"


def _check_size(content: bytes) -> None:
    """Refuse images whose header states more pixels than allowed."""
    try:
        with PillowImage.open(io.BytesIO(content)) as picture:
            cols, rows = picture.size
    except (PillowImage.DecompressionBombError, PillowImage.DecompressionBombWarning):
        raise InputError("far too many pixels", key=KEY, allowed=ALLOWED) from None
    except (OSError, ValueError, SyntaxError, TypeError, KeyError, EOFError, OverflowError):
        raise InputError("is not a readable image", key=KEY, allowed=ALLOWED) from None
    if rows * cols > MAX_PIXELS:
        raise InputError(f"{cols} x {rows} pixels", key=KEY, allowed=ALLOWED)


def measure_own(frame: OwnFrame, chain: Chain, mm2_per_px: float | None) -> OwnMeasured:
    """Segment an own frame by the reference segmentation, at its own resolution."""
    found = segment(frame.view, chain)
    histogram = histogram_of(single_grey(frame.view, chain.blur))
    return OwnMeasured(frame, found.mask, found.pixels, found.blobs, mm2_per_px, histogram)
