"""Encode and decode the members of a shard: PNG and EXR bytes that depend on the frame only."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import OpenEXR
from numpy.typing import NDArray

from evanesce.core.errors import WorkError
from evanesce.dataset.config import CHANNELS
from evanesce.dataset.labels import LabelBox, empty_box

PREFIX = "evanesce:"


def png(image: NDArray[Any]) -> bytes:
    """Return an 8- or 16-bit grey or RGB image of a camera as PNG.

    Noise has no runs that repeat: Huffman's code of the filtered rows alone is the smallest and the fastest.

    Raises
    ------
    WorkError
        If it cannot be encoded.
    """
    return _encoded(image, [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY])


def mask_png(image: NDArray[Any]) -> bytes:
    """Return a map of a few values as PNG, rows as they are: their runs repeat.

    Raises
    ------
    WorkError
        If it cannot be encoded.
    """
    options = [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]
    return _encoded(image, [*options, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE])


def _encoded(image: NDArray[Any], options: list[int]) -> bytes:
    ordered = image if image.ndim == 2 else image[..., ::-1]
    ok, data = cv2.imencode(".png", ordered, options)
    if not ok:
        raise WorkError(f"OpenCV could not encode an image of shape {image.shape}")
    return bytes(data.tobytes())


def decode_png(data: bytes) -> NDArray[Any]:
    """Return the image of :func:`png`.

    Raises
    ------
    ValueError
        If it cannot be decoded.
    """
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if image is None:
        raise ValueError("not a readable PNG")
    return image if image.ndim == 2 else image[..., ::-1]


def exr(box: LabelBox, precision: str, header: Mapping[str, Any]) -> bytes:
    """Return labels as a multichannel EXR, ZIP, with the box as data window and the frame as display window.

    Parameters
    ----------
    box : LabelBox
    precision : {"half", "float"}
    header : mapping
        JSON-able entries; each becomes a string attribute of the header. Units are always included.
    """
    rows, cols = box.shape
    dtype = np.float16 if precision == "half" else np.float32
    first = next(iter(box.channels.values()))
    # EXR has no empty window: one pixel of zeros represents it.
    high, wide = first.shape if first.size else (1, 1)
    attributes = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dataWindow": _window(box.row, box.col, high, wide),
        "displayWindow": _window(0, 0, rows, cols),
        PREFIX + "units": json.dumps({name: CHANNELS[name] for name in box.channels}, sort_keys=True),
        PREFIX + "empty": "0" if first.size else "1",
    }
    attributes |= {PREFIX + name: json.dumps(value, sort_keys=True, allow_nan=False) for name, value in header.items()}
    channels = {}
    for name, found in box.channels.items():
        values = found if first.size else np.zeros((1, 1), np.float32)
        channels[name] = np.ascontiguousarray(values, dtype)
    with _memory() as handle:
        try:
            OpenEXR.File(attributes, channels).write(f"/proc/self/fd/{handle.number}")
        except RuntimeError as error:
            raise WorkError(f"cannot encode labels: {error}") from None
        return handle.read()


def decode_exr(data: bytes) -> tuple[LabelBox, dict[str, Any]]:
    """Return labels and header entries of :func:`exr`.

    Raises
    ------
    ValueError
        If it cannot be decoded.
    """
    try:
        with _memory(data) as handle, OpenEXR.File(f"/proc/self/fd/{handle.number}", separate_channels=True) as file:
            header = dict(file.header())
            channels = {name: np.array(channel.pixels, np.float32) for name, channel in file.channels().items()}
        low = header["dataWindow"][0]
        entries = {
            name[len(PREFIX) :]: json.loads(value)
            for name, value in header.items()
            if name.startswith(PREFIX) and isinstance(value, str)
        }
        end = header["displayWindow"][1]
        shape = int(end[1]) + 1, int(end[0]) + 1
        box = LabelBox(int(low[1]), int(low[0]), shape, {n: channels[n] for n in CHANNELS if n in channels})
    except (OSError, RuntimeError, KeyError, TypeError, IndexError, ValueError) as error:
        raise ValueError(f"not a readable label file: {error}") from None
    if entries.get("empty") == 1:
        box = empty_box(shape, tuple(box.channels))
    return box, entries


def decoded(name: str, data: bytes) -> Any:
    """Decode a member as a handler of ``WebDataset(urls).decode(decoded)``.

    Parameters
    ----------
    name : str
        Extension of the member, with or without a dot before it.
    data : bytes

    Returns
    -------
    ndarray, LabelBox, dict or None
        Frames as 8 bits [DN], raw frames as 16 bits [DN], the mask as surface states, labels in their units, the
        numbers; None for other members, which a later handler may know.

    Raises
    ------
    ValueError
        If it cannot be decoded.
    """
    extension = name.lstrip(".")
    if extension in ("frame.png", "raw.png", "mask.png"):
        return decode_png(data)
    if extension in ("labels.exr", "plate.exr"):
        return decode_exr(data)[0]
    return json.loads(data) if extension == "json" else None


def _window(row: int, col: int, high: int, wide: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    return np.array([col, row], np.int32), np.array([col + wide - 1, row + high - 1], np.int32)


class _memory:
    """A file in memory: OpenEXR reads and writes paths only."""

    def __init__(self, data: bytes | None = None) -> None:
        self._data = data

    def __enter__(self) -> _memory:
        self.number = os.memfd_create("evanesce-labels")
        if self._data is not None:
            with os.fdopen(os.dup(self.number), "wb") as stream:
                stream.write(self._data)
        return self

    def read(self) -> bytes:
        """Return the whole file."""
        return os.pread(self.number, os.fstat(self.number).st_size, 0)

    def __exit__(self, *_: object) -> None:
        os.close(self.number)
