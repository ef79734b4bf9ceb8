"""Read image files as 8-bit grey or RGB; damaged files are refused, since a partly decoded image has an area too."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from evanesce.core.errors import InputError
from evanesce.measurement.warnings import Warning

IMAGE_SUFFIXES = frozenset({".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp"})
MAX_PIXELS = 200_000_000
MAX_FILE_BYTES = 2_000_000_000
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


class Unreadable(Exception):
    """An image cannot be decoded whole; the message says why."""


@dataclass(frozen=True)
class Loaded:
    """An image with notes on what was changed to make it 8-bit grey or RGB.

    Attributes
    ----------
    data : ndarray of uint8, (rows, cols) or (rows, cols, 3)
    notes : tuple of Warning
    raw : ndarray of uint16 (rows, cols), optional
        Of a raw mosaic [DN].
    """

    data: NDArray[np.uint8]
    notes: tuple[Warning, ...] = ()
    raw: NDArray[np.uint16] | None = None


def read_image(path: str | Path) -> Loaded:
    """Read a single image, such as a photograph of a calibration target.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Loaded

    Raises
    ------
    InputError
        If it is absent, damaged or of an unknown kind.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", file=path, allowed="a PNG, TIFF, JPEG or BMP image")
    try:
        return load_image(path)
    except Unreadable as error:
        raise InputError(str(error), file=path, allowed="a whole PNG, TIFF, JPEG or BMP image") from None


def load_image(path: Path) -> Loaded:
    """Decode one image file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Loaded

    Raises
    ------
    Unreadable
        If the file is not an image, is cut off, fails its checksums, or holds floats or several pages.
    """
    return _to_8_bit_rgb(load_pixels(path))


def load_pixels(path: Path) -> NDArray[np.generic]:
    """Decode one image file and leave its samples as they are.

    Parameters
    ----------
    path : Path

    Returns
    -------
    ndarray (rows, cols) or (rows, cols, channels)

    Raises
    ------
    Unreadable
        If the file is not an image, is cut off, fails its checksums, or holds several pages.
    """
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise Unreadable(f"more than {MAX_FILE_BYTES} bytes")
        content = path.read_bytes()
    except OSError as error:
        raise Unreadable(f"cannot be read: {error.strerror}") from None
    if content[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        _check_tiff(content)
        return _decode_tiff(path)
    if content.startswith(b"\xff\xd8"):
        _check_jpeg(content)
    if content.startswith(PNG_SIGNATURE):
        _check_png(content)
        return _decode_png(content)
    return _decode(content)


def _check_png(content: bytes) -> None:
    """Check every chunk: the decoder itself may return part of a file that is cut off or altered."""
    at = len(PNG_SIGNATURE)
    while at + 12 <= len(content):
        length = int.from_bytes(content[at : at + 4], "big")
        kind, end = content[at + 4 : at + 8], at + 12 + length
        if end > len(content):
            break
        if zlib.crc32(content[at + 4 : end - 4]) != int.from_bytes(content[end - 4 : end], "big"):
            raise Unreadable("the PNG's checksum is wrong, the file is damaged")
        if kind == b"IHDR":
            _check_size(*(int.from_bytes(content[at + k : at + k + 4], "big") for k in (12, 8)))
        if kind == b"IEND":
            return
        at = end
    raise Unreadable(f"the PNG is cut off after {len(content)} bytes")


def _check_jpeg(content: bytes) -> None:
    """Look for the end marker; some cameras pad or append a preview, so anywhere in the last 64 kB will do."""
    if b"\xff\xd9" not in content[-65536:]:
        raise Unreadable(f"the JPEG is cut off after {len(content)} bytes")


def _check_tiff(content: bytes) -> None:
    """See that the classic TIFF's first directory, which many writers put at the end, lies within the file."""
    order: Literal["little", "big"] = "little" if content[:2] == b"II" else "big"
    if content[2:4] in (b"*\0", b"\0*") and int.from_bytes(content[4:8], order) + 2 > len(content):
        raise Unreadable(f"the TIFF is cut off after {len(content)} bytes")


def _check_size(rows: int, cols: int) -> None:
    if rows * cols > MAX_PIXELS:
        raise Unreadable(f"{cols} x {rows} pixels are more than {MAX_PIXELS}")


def _decode_png(content: bytes) -> NDArray[np.generic]:
    """Decode by FFmpeg, which takes four fifths of OpenCV's time; what is not plain 8-bit grey or RGB by OpenCV."""
    try:
        decoder = av.CodecContext.create("png", "r")
        pictures = decoder.decode(av.Packet(content)) or decoder.decode(None)
    except (av.FFmpegError, ValueError):
        return _decode(content)
    if len(pictures) == 1 and pictures[0].format.name in ("gray", "rgb24") and not pictures[0].is_corrupt:
        return np.asarray(pictures[0].to_ndarray())
    return _decode(content)


def _decode(content: bytes) -> NDArray[np.generic]:
    try:
        raw = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    except cv2.error as error:
        raise Unreadable(f"cannot be decoded: {error.err}") from None
    if raw is None:
        raise Unreadable("is empty" if not content else "cannot be decoded as an image")
    if raw.ndim == 3:
        code = {3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGBA}.get(raw.shape[2])
        raw = cv2.cvtColor(raw, code) if code is not None else raw[..., 0]
    return np.asarray(raw)


def _decode_tiff(path: Path) -> NDArray[np.generic]:
    # Pillow, because it raises on a damaged strip, where OpenCV prints a line and returns what it has
    try:
        with PillowImage.open(path) as picture:
            _check_size(picture.height, picture.width)
            pages = getattr(picture, "n_frames", 1)
            if pages != 1:
                raise Unreadable(f"{pages} pages in one TIFF: export them as single files")
            if picture.mode in ("P", "1", "PA", "CMYK", "YCbCr", "LAB"):
                return np.asarray(picture.convert("L" if picture.mode == "1" else "RGB"))
            return np.asarray(picture)
    except (
        OSError,
        ValueError,
        SyntaxError,
        TypeError,
        KeyError,
        EOFError,
        PillowImage.DecompressionBombError,
    ) as error:
        raise Unreadable(f"the TIFF cannot be decoded: {error}") from None


def _to_8_bit_rgb(raw: NDArray[np.generic]) -> Loaded:
    """Drop alpha and scale 16 bits to 8 by full scale, with notes."""
    notes = []
    _check_size(*raw.shape[:2])
    if raw.ndim == 3 and raw.shape[2] in (2, 4):
        alpha = raw[..., -1]
        if np.any(alpha != alpha.flat[0]):
            share = float(np.mean(alpha != alpha.max()))
            notes.append(
                Warning("alpha_dropped", f"transparency is ignored ({100 * share:.1f} % of the pixels have it)")
            )
        raw = raw[..., 0] if raw.shape[2] == 2 else raw[..., :3]
    if raw.dtype == np.uint16:
        top = int(raw.max())
        low = "; samples of fewer bits stay dark on this scale" if top < 32768 else ""
        notes.append(Warning("bit_depth", f"16-bit samples (greatest {top}) scaled by 255/65535 to 8 bits{low}"))
        # whole numbers: round(v / 257) without a detour over floats
        raw = ((raw.astype(np.uint32) + 128) // 257).astype(np.uint8)
    if raw.dtype != np.uint8:
        raise Unreadable(f"samples of type {raw.dtype}, not 8 or 16 bits")
    return Loaded(np.ascontiguousarray(raw), tuple(notes))
