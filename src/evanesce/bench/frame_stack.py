"""Stacks of flat and covered frames -> mean, temporal and spatial variance of each exposure (EMVA 1288)."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from evanesce.core.columns import Column, read_columns, read_rows
from evanesce.core.errors import InputError

Floats = NDArray[np.float64]

LIST_FILE = "stack.csv"
HEADINGS = ("file", "exposure_s", "optionally light", "temperature_C")
IMAGE_SUFFIXES = (".png", ".tif", ".tiff")
RAW_SUFFIXES = (".raw", ".bin")
MAX_PIXELS = 100_000_000
COLUMNS = (
    Column("exposure", ("exposure_time", "t"), "time"),
    Column("light", ("level", "relative_light"), "ratio", required=False),
    Column("temperature", ("temp",), "temperature", required=False),
)


@dataclass(frozen=True)
class StackRow:
    """Frames of one exposure, one kind of pixels.

    Attributes
    ----------
    name : str
        Of the pixels.
    exposure_s, light, temperature_C : float
        [s], [1] with 0 for covered frames, [degC] or NaN.
    mean_DN : float
        [DN].
    temporal_DN2 : float
        Variance from frame to frame, each frame's mean taken off, mean over the pixels [DN^2].
    spatial_DN2 : float
        Variance over the pixels of the mean frame less the temporal part, a surface of second degree (light,
        vignetting) taken off [DN^2]; may be below 0 by noise.
    correlation : tuple of float
        Of the temporal noise with the next pixel of the same kind along the row and along the column [1].
    frames, pixels : int
    clipped : float
        Share of samples at either end of the converter [1].
    """

    name: str
    exposure_s: float
    light: float
    temperature_C: float
    mean_DN: float
    temporal_DN2: float
    spatial_DN2: float
    correlation: tuple[float, float]
    frames: int
    pixels: int
    clipped: float


@dataclass(frozen=True)
class _Group:
    """Files of one exposure."""

    exposure_s: float
    light: float
    temperature_C: float
    files: tuple[Path, ...]


def reduce_stack(
    folder: Path, *, bits: int, mosaic: str | None = None, raw_size: tuple[int, int] | None = None,
    seen: Callable[[int, int], None] = lambda done, of: None,
) -> list[StackRow]:  # fmt: skip
    """Reduce a folder of frames that its ``stack.csv`` lists: ``file, exposure_s[, light][, temperature_C]``.

    Parameters
    ----------
    folder : Path
        Frames are PNG or TIFF of one plane, ``.npy`` (rows, cols), or ``.raw`` (16 bits, little endian, no header).
    bits : int
        Of the converter.
    mosaic : str, optional
        Four letters, such as BGGR: the figures are taken for each position of the 2 x 2 cell.
    raw_size : tuple of int, optional
        (cols, rows) of ``.raw`` frames.
    seen : callable
        Called with the number of frames that are read, and of all.

    Returns
    -------
    list of StackRow

    Raises
    ------
    InputError
        For a missing list or frame, a size that changes, levels above the converter's, a single frame of an exposure.
    """
    groups = _groups(folder)
    total = sum(len(group.files) for group in groups)
    rows: list[StackRow] = []
    shape: tuple[int, ...] | None = None
    done = 0
    for group in groups:
        stack = []
        for file in group.files:
            frame = read_frame(file, bits, raw_size)
            if shape is not None and frame.shape != shape:
                raise InputError(
                    f"{frame.shape[1]} x {frame.shape[0]} pixels", file=file, allowed=f"{shape[1]} x {shape[0]}"
                )
            shape = frame.shape
            stack.append(frame)
            done += 1
            seen(done, total)
        for name, part in _kinds(mosaic):
            rows.append(_reduced(name, group, [frame[part] for frame in stack], 2**bits - 1))
    return rows


def read_frame(path: Path, bits: int, raw_size: tuple[int, int] | None = None) -> NDArray[np.uint16]:
    """Read one plane of raw numbers [DN].

    Parameters
    ----------
    path : Path
    bits : int
    raw_size : tuple of int, optional
        (cols, rows) of a ``.raw`` file.

    Returns
    -------
    ndarray of uint16 (rows, cols)

    Raises
    ------
    InputError
        If it is missing, damaged, in colour, or holds levels above the converter's.
    """
    suffix = path.suffix.lower()
    if not path.is_file():
        raise InputError("no such file", file=path, allowed="a frame that stack.csv lists")
    if suffix in IMAGE_SUFFIXES:
        values = _image(path)
    elif suffix == ".npy":
        try:
            values = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise InputError(f"not a readable array: {error}", file=path) from None
    elif suffix in RAW_SUFFIXES:
        values = _raw(path, raw_size)
    else:
        raise InputError(f"a {suffix or 'nameless'} file", file=path, allowed=".png, .tif, .tiff, .npy, .raw")
    if values.ndim != 2 or values.dtype.kind not in "ui":
        raise InputError(
            f"shape {values.shape} of {values.dtype}", file=path, allowed="one plane of whole numbers, not colour"
        )
    if min(values.shape) < 8:
        raise InputError(f"{values.shape[1]} x {values.shape[0]} pixels", file=path, allowed="at least 8 x 8")
    if values.min() < 0 or values.max() > 2**bits - 1:
        raise InputError(
            f"levels from {values.min()} to {values.max()} DN", file=path, key="--bits",
            allowed=f"0 to {2**bits - 1} DN, not shifted to the upper bits",
        )  # fmt: skip
    return values.astype(np.uint16)


def _image(path: Path) -> NDArray[np.generic]:
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path) as image:
            if image.width * image.height > MAX_PIXELS:
                raise InputError(f"{image.width} x {image.height} pixels", file=path, allowed=f"at most {MAX_PIXELS}")
            return np.asarray(image)
    except InputError:
        raise
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"not a readable image: {error}", file=path) from None


def _raw(path: Path, size: tuple[int, int] | None) -> NDArray[np.generic]:
    if size is None:
        raise InputError("a raw file does not carry its size", file=path, key="--raw-size", allowed="COLSxROWS")
    wanted, there = 2 * size[0] * size[1], path.stat().st_size
    if there != wanted:
        raise InputError(f"{there} bytes", file=path, key="--raw-size", allowed=f"{wanted} for {size[0]} x {size[1]}")
    return np.fromfile(path, "<u2").reshape(size[1], size[0])


def _groups(folder: Path) -> list[_Group]:
    """Return the files of each exposure, in the order of the list."""
    path = folder / LIST_FILE
    if not path.is_file():
        raise InputError(f"has no {LIST_FILE}", file=folder, allowed=f"a list: {', '.join(HEADINGS)}")
    data, table = read_columns(path, COLUMNS), read_rows(path)
    column = next((i for i, h in enumerate(table[0]) if h.strip().lower() in ("file", "frame", "name")), None)
    if column is None:
        raise InputError(f"no column 'file' among {', '.join(table[0])}", file=path, allowed="a heading file")
    count = data["exposure"].size
    light, temperature = data.get("light", np.ones(count)), data.get("temperature", np.full(count, np.nan))
    for key, values in (("exposure", data["exposure"]), ("light", light)):
        if (bad := np.flatnonzero(values < 0.0)).size:
            raise InputError(f"row {bad[0] + 2}: {values[bad[0]]:g}", file=path, key=key, allowed="0 and above")
    files: dict[tuple[float, float, float], list[Path]] = {}
    listed: set[str] = set()
    for row, line in enumerate(table[1:]):
        if line[column] in listed:
            raise InputError(f"row {row + 2}: {line[column]} is listed twice", file=path, allowed="each frame once")
        listed.add(line[column])
        key_of = (float(data["exposure"][row]), float(light[row]), float(np.nan_to_num(temperature[row], nan=-1e3)))
        files.setdefault(key_of, []).append(folder / line[column])
    for (exposure, level, _), names in files.items():
        if len(names) < 2:
            raise InputError(
                f"one frame of exposure {exposure:g} s, light {level:g}", file=path,
                allowed="two at least of each: noise in time shows in their difference",
            )  # fmt: skip
    return [_Group(t, level, np.nan if at == -1e3 else at, tuple(names)) for (t, level, at), names in files.items()]


def _kinds(mosaic: str | None) -> Iterator[tuple[str, tuple[slice, slice]]]:
    """Yield the name and the pixels of each position of a mosaic's cell."""
    if mosaic is None:
        yield "all", (slice(None), slice(None))
        return
    greens = 0
    for i, letter in enumerate(mosaic):
        greens += letter == "G"
        yield (f"G{greens}" if letter == "G" else letter), (slice(i // 2, None, 2), slice(i % 2, None, 2))


def _reduced(name: str, group: _Group, frames: list[NDArray[np.uint16]], full: int) -> StackRow:
    rows = min(frame.shape[0] for frame in frames)
    stack = np.stack([frame[:rows].astype(np.float64) for frame in frames])
    count, pixels = len(frames), stack[0].size
    mean = float(stack.mean())
    clipped = float(np.mean((stack <= 0.0) | (stack >= full)))
    own = stack - stack.mean(axis=(1, 2), keepdims=True)  # flicker of the light is none of the sensor's noise
    average = own.mean(axis=0)
    noise = own - average
    temporal = float(np.sum(noise**2) / ((count - 1) * (pixels - 1)))
    power = float(np.mean(noise**2)) or 1.0
    correlation = (
        float(np.mean(noise[:, :, 1:] * noise[:, :, :-1]) / power),
        float(np.mean(noise[:, 1:] * noise[:, :-1]) / power),
    )
    spatial = float(np.sum((average - _surface(average)) ** 2) / max(pixels - 6, 1)) - temporal / count
    return StackRow(
        name, group.exposure_s, group.light, group.temperature_C, mean, temporal, spatial, correlation, count, pixels,
        clipped,
    )  # fmt: skip


def _surface(values: Floats) -> Floats:
    """Return the surface of second degree through a frame: what lamp and lens vary by."""
    y, x = np.linspace(-1.0, 1.0, values.shape[0]), np.linspace(-1.0, 1.0, values.shape[1])
    terms = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
    # Normal equations from separable sums: the design matrix of 12 million pixels would not fit into memory.
    left = np.array([[np.sum(x ** (a + c)) * np.sum(y ** (b + d)) for c, d in terms] for a, b in terms])
    right = np.array([(y**b) @ values @ (x**a) for a, b in terms])
    weight = np.linalg.solve(left, right)
    return np.asarray(sum(w * np.outer(y**b, x**a) for w, (a, b) in zip(weight, terms, strict=True)))
