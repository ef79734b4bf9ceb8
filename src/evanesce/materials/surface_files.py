"""Surface scans from files: a profile or a height matrix as CSV, a height map as TIFF or OpenEXR."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from evanesce.errors import InputError
from evanesce.materials.columns import UNITS, Column, number, read_columns, read_rows
from evanesce.materials.profile import HeightMap

Floats = NDArray[np.float64]
MAX_SAMPLES = 100_000_000
LONGEST_MM = 1000.0

PROFILE_COLUMNS = (
    Column("x", ("position", "distance", "path"), "length"),
    Column("z", ("height", "depth"), "length"),
)


def is_matrix(path: Path) -> bool:
    """Tell whether a CSV file is a bare matrix of numbers (a height map) rather than columns with headings."""
    first = read_rows(path)[0]
    try:
        [float(cell) for cell in first if cell]
    except ValueError:
        return False
    return len(first) > 2


def read_profile(path: Path) -> tuple[Floats, Floats]:
    """Read a profile ``x_mm, z_um`` (any length units in the headings); return (x, z) [mm], x ascending.

    Raises
    ------
    InputError
        For missing columns or units, fewer than 32 points, x that does not ascend or spans more than a metre.
    """
    data = read_columns(path, PROFILE_COLUMNS)
    x, z = data["x"], data["z"]
    if len(x) < 32:
        raise InputError(f"{len(x)} points", file=path, allowed="at least 32")
    back = np.flatnonzero(np.diff(x) <= 0)
    if len(back):
        raise InputError(f"row {back[0] + 3}: x does not ascend", file=path, key="x")
    if np.ptp(x) > LONGEST_MM or np.ptp(z) > 0.5 * np.ptp(x):
        raise InputError(
            f"the profile spans {np.ptp(x):.4g} mm along and {np.ptp(z):.4g} mm in height; is the unit right?",
            file=path,
        )
    return x, z


def read_map(path: Path, pitch: float, height_unit: str) -> HeightMap:
    """Read a height map from TIFF, OpenEXR or a CSV matrix.

    Parameters
    ----------
    path : Path
    pitch : float
        Sample distance [mm], which such files do not carry reliably.
    height_unit : str
        Unit of the stored figures: nm, um, mm, m.

    Raises
    ------
    InputError
        For an unreadable file, colour, more than 10^8 samples, fewer than 32 on a side, or an implausible height.
    """
    if height_unit not in UNITS["length"]:
        raise InputError(f"{height_unit!r}", key="--z-unit", allowed=", ".join(UNITS["length"]))
    if not 1e-6 <= pitch <= 10.0:
        raise InputError(f"{pitch:g} mm", key="--pitch-um", allowed="0.001 to 10000 um")
    if not path.is_file():
        raise InputError("no such file", file=path, allowed="a CSV, TIFF or EXR file")
    suffix = path.suffix.lower()
    if suffix == ".csv":
        values = _matrix(path)
    elif suffix in (".tif", ".tiff"):
        values = _tiff(path)
    elif suffix == ".exr":
        values = _exr(path)
    else:
        raise InputError(f"a {suffix or 'nameless'} file", file=path, allowed=".csv, .tif, .tiff, .exr")
    if min(values.shape) < 32:
        raise InputError(f"{values.shape[1]} x {values.shape[0]} samples", file=path, allowed="at least 32 x 32")
    height = values * UNITS["length"][height_unit]
    if not np.isfinite(height).any():
        raise InputError("holds no finite height", file=path)
    span = float(np.nanmax(height) - np.nanmin(height))
    if span == 0.0 or span > 0.5 * pitch * max(height.shape):
        raise InputError(
            f"heights span {span:.4g} mm over {pitch * max(height.shape):.4g} mm; are unit and pitch right?", file=path
        )
    return HeightMap(height, pitch)


def _matrix(path: Path) -> Floats:
    rows = read_rows(path)
    width = len(rows[0])
    values = np.empty((len(rows), width))
    for i, row in enumerate(rows):
        if len(row) != width:
            raise InputError(f"row {i + 1} has {len(row)} columns", file=path, allowed=f"{width} columns")
        # Scanners write lost samples as nothing or as NaN.
        values[i] = [
            np.nan if cell.lower() in ("", "nan") else number(cell, path, i + 1, f"column {j + 1}")
            for j, cell in enumerate(row)
        ]
    return values


def _tiff(path: Path) -> Floats:
    try:
        with Image.open(path) as image:
            if image.width * image.height > MAX_SAMPLES:
                raise InputError(f"{image.width} x {image.height} samples", file=path, allowed=f"at most {MAX_SAMPLES}")
            values = np.asarray(image)
    except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"not a readable TIFF: {error}", file=path) from None
    if values.ndim != 2:
        raise InputError(f"{values.shape[-1]} channels", file=path, allowed="one channel of heights, not colour")
    return values.astype(float)


def _exr(path: Path) -> Floats:
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except Exception as error:  # the binding raises its own kinds
        raise InputError(f"not a readable OpenEXR file: {error}", file=path) from None
    name = next((n for n in ("height", "Z", "Y") if n in channels), None)
    if name is None and len(channels) != 1:
        raise InputError(f"channels {', '.join(sorted(channels))}", file=path, allowed="'height', 'Z', 'Y' or one only")
    values = channels[name] if name else next(iter(channels.values()))
    if values.ndim != 2 or values.size > MAX_SAMPLES:
        raise InputError(f"shape {values.shape}", file=path, allowed="one channel, at most 10^8 samples")
    return values.astype(float)
