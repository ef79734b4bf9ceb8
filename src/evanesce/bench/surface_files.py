"""Surface scans from files: a profile or a height matrix as CSV, a height map as TIFF, OpenEXR or NPZ."""

from __future__ import annotations

import warnings
import zipfile
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from evanesce.bench.relief import HeightMap, RepeatedProfile, height_map_of_scan, repeated_profile
from evanesce.core.columns import UNITS, Column, number, read_columns, read_rows
from evanesce.core.errors import EvanesceError, InputError, WorkError

Floats = NDArray[np.float64]
MAX_SAMPLES = 100_000_000
LONGEST_MM = 1000.0
RELIEF_MM = (1e-4, 5.0)
"""Range that the relief of a finger's skin may span, as that of designed ridges [mm]."""

PROFILE_COLUMNS = (
    Column("x", ("position", "distance", "path"), "length"),
    Column("z", ("height", "depth"), "length"),
)


def is_matrix(path: Path) -> bool:
    """Return whether a CSV file is a bare matrix of numbers (a height map) rather than columns with headings.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool
    """
    first = read_rows(path)[0]
    try:
        [float(cell) for cell in first if cell]
    except ValueError:
        return False
    return len(first) > 2


def read_profile(path: Path) -> tuple[Floats, Floats]:
    """Read a profile ``x_mm, z_um`` (any length units in the headings); return (x, z) [mm], x ascending.

    Parameters
    ----------
    path : Path
        CSV.

    Returns
    -------
    tuple of ndarray (n,)
        x and z [mm].

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
        Unit of the stored values: nm, um, mm, m.

    Returns
    -------
    HeightMap

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
    return _plausible(values * UNITS["length"][height_unit], pitch, path, "--pitch-um")


def _plausible(height: Floats, pitch: float, path: Path, key: str) -> HeightMap:
    """Refuse a map that is too small, empty, or of heights [mm] implausible for its pitch [mm]."""
    if min(height.shape) < 32:
        raise InputError(f"{height.shape[1]} x {height.shape[0]} samples", file=path, allowed="at least 32 x 32")
    if not 1e-6 <= pitch <= 10.0:
        raise InputError(f"{pitch:g} mm", file=path, key=key, allowed="0.001 to 10000 um")
    if not np.isfinite(height).any():
        raise InputError("holds no finite height", file=path)
    known = height[np.isfinite(height)]
    span, side = float(np.ptp(known)), pitch * max(height.shape)
    if span == 0.0 or span > 0.5 * side:
        raise InputError(f"heights span {span:.4g} mm over {side:.4g} mm; are unit and pitch right?", file=path)
    return HeightMap(height, pitch)


def read_skin(
    path: Path, pitch: float | None, height_unit: str | None, form_degree: int
) -> HeightMap | RepeatedProfile:
    """Read the surface of a finger for a scene: a whole map, or a profile to be repeated, levelled, mean crest at 0.

    Parameters
    ----------
    path : Path
        NPZ with ``distance_mm`` and ``pitch_mm`` as `evanesce bench profile` writes it; CSV with a profile or a
        matrix, TIFF, OpenEXR.
    pitch : float or None
        Sample distance [mm]: needed for a map from CSV, TIFF or OpenEXR, and for no other.
    height_unit : str or None
        nm, um, mm or m: needed and not needed for the same.
    form_degree : int
        Of the form that is taken off, 1 or 2.

    Returns
    -------
    HeightMap | RepeatedProfile

    Raises
    ------
    InputError
        As :func:`read_map`; for lost samples, a key that is missing or does not belong, or a relief that no finger has.
    """
    key, suffix = "finger.height_map", path.suffix.lower()
    carries = suffix == ".npz" or (suffix == ".csv" and path.is_file() and not is_matrix(path))
    for name, value in (("pitch_um", pitch), ("height_unit", height_unit)):
        if carries and value is not None:
            raise InputError("the file says this itself", file=path, key=f"{key}.{name}", allowed="no such key")
        if not carries and value is None:
            raise InputError(
                "missing", file=path, key=f"{key}.{name}", allowed="needed for a map that does not carry it"
            )
    try:
        if suffix == ".csv" and carries:
            skin: HeightMap | RepeatedProfile = repeated_profile(*read_profile(path), form_degree)
        else:
            raw = _npz(path) if suffix == ".npz" else read_map(path, pitch or 0.0, height_unit or "")
            lost = np.argwhere(~np.isfinite(raw.height))
            if len(lost):
                raise InputError(
                    f"{len(lost)} samples without a height, the first in row {lost[0][0] + 1}, column {lost[0][1] + 1}",
                    file=path, allowed="whole maps; `evanesce bench profile` fills gaps and writes one",
                )  # fmt: skip
            skin = height_map_of_scan(raw.height, raw.pitch, form_degree)
    except WorkError as error:  # no ridge to repeat, too little data: it is this file that is unfit
        raise InputError(str(error), file=path) from None
    span, (lowest, highest) = float(np.ptp(skin.height)), RELIEF_MM
    if not lowest <= span <= highest:
        raise InputError(
            f"heights span {1e3 * span:.4g} um; is the unit right?", file=path, key=key,
            allowed=f"{1e3 * lowest:g} to {1e3 * highest:g} um",
        )  # fmt: skip
    return skin


def _npz(path: Path) -> HeightMap:
    """Read what `evanesce bench profile` writes; nothing is unpacked before its size is checked."""
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > 8 * MAX_SAMPLES + 100_000:
            raise InputError(f"unpacks to {unpacked} bytes", file=path, allowed=f"at most {MAX_SAMPLES} samples")
        with np.load(path, allow_pickle=False) as data:
            distance, pitch = np.asarray(data["distance_mm"]), np.asarray(data["pitch_mm"])
    except EvanesceError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise a dozen kinds on damaged archives
        what = f"holds no {error.args[0].split()[0]}" if isinstance(error, KeyError) else "not a readable NPZ archive"
        raise InputError(what, file=path, allowed="distance_mm (rows, cols) and pitch_mm") from None
    if distance.ndim != 2 or pitch.ndim != 0 or distance.dtype.kind not in "fiu" or pitch.dtype.kind not in "fiu":
        raise InputError(
            f"distance_mm of shape {distance.shape}, pitch_mm of shape {pitch.shape}", file=path,
            allowed="distance_mm (rows, cols) and pitch_mm, a number",
        )  # fmt: skip
    return _plausible(-distance.astype(float), float(pitch), path, "pitch_mm")


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
        # Pillow warns of damaged tags and of many pixels by warnings as well; the size is checked here.
        with warnings.catch_warnings(action="ignore"), Image.open(path) as image:
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
