"""Checkerboard corners as values, and read from a lab's own files (CSV, or MATLAB's ``.mat``)."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from numpy.typing import NDArray

from evanesce.core.errors import InputError

Array = NDArray[np.float64]

COLUMNS = ("view", "world_x_mm", "world_y_mm", "image_x_px", "image_y_px")
MAX_FILE_BYTES = 200_000_000
MAX_POINTS = 2_000_000
MIN_POINTS_PER_VIEW = 4
_MATLAB_FIELDS = ("imagePoints", "worldPoints")


@dataclass(frozen=True)
class BoardView:
    """Corners of a flat board in one picture.

    Attributes
    ----------
    name : str
        Of the picture.
    world : ndarray (n, 2)
        Corner positions on the board [mm].
    image : ndarray (n, 2)
        The same corners in the picture, (x, y) [px]; integer coordinates are pixel centres.
    """

    name: str
    world: Array
    image: Array

    def __post_init__(self) -> None:
        if self.world.shape != self.image.shape or self.world.ndim != 2 or self.world.shape[1] != 2:
            raise ValueError(f"BoardView: world {self.world.shape} and image {self.image.shape} are not both (n, 2)")

    def __len__(self) -> int:
        return len(self.world)


def read_points(path: str | Path) -> list[BoardView]:
    """Read corners from a CSV or a MATLAB file, by the file's ending.

    Parameters
    ----------
    path : str or Path
        Ends in ``.csv`` or ``.mat``.

    Returns
    -------
    list of BoardView
        In the order of the file.

    Raises
    ------
    InputError
        If the file cannot be read, or a value in it is missing, not finite or given twice; names row or index.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", file=path, key="--points", allowed="a .csv or .mat file")
    if path.stat().st_size > MAX_FILE_BYTES:
        raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_FILE_BYTES} bytes")
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return read_csv_points(path)
    if suffix == ".mat":
        return read_mat_points(path)
    raise InputError(f"ending '{path.suffix}'", file=path, key="--points", allowed=".csv or .mat")


def read_csv_points(path: Path) -> list[BoardView]:
    """Read a CSV with the columns ``view, world_x_mm, world_y_mm, image_x_px, image_y_px`` (OpenCV pixel convention).

    Further columns are ignored; a view is the set of rows with the same text in ``view``.

    Parameters
    ----------
    path : Path

    Returns
    -------
    list of BoardView

    Raises
    ------
    InputError
        Naming the line at fault.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        rows = list(csv.reader(io.StringIO(text)))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"not readable as CSV: {error}", file=path) from None
    if not rows:
        raise InputError("is empty", file=path, allowed="a header " + ",".join(COLUMNS))
    header = [name.strip() for name in rows[0]]
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise InputError(f"no column {', '.join(missing)}", file=path, key="line 1", allowed=",".join(COLUMNS))
    where = [header.index(name) for name in COLUMNS]
    views: dict[str, list[tuple[float, ...]]] = {}
    lines: dict[str, list[str]] = {}
    for number, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        if len(row) != len(header):
            raise InputError(
                f"{len(row)} values", file=path, key=f"line {number}", allowed=f"{len(header)}, as the header has"
            )
        values = tuple(_number(row[i], path, number, header[i]) for i in where[1:])
        views.setdefault(row[where[0]].strip(), []).append(values)
        lines.setdefault(row[where[0]].strip(), []).append(f"line {number}")
    if not views:
        raise InputError("has a header but no corners", file=path)
    checked = []
    for name, values_of in views.items():
        table = np.array(values_of)
        checked.append(_checked(BoardView(name, table[:, :2], table[:, 2:]), lines[name], path))
    return checked


def _number(text: str, path: Path, line: int, column: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InputError(f"'{text[:40]}'", file=path, key=f"line {line}, {column}", allowed="a finite number")
    return value


def read_mat_points(path: Path) -> list[BoardView]:
    """Read ``imagePoints`` (n, 2, views) and ``worldPoints`` (n, 2) of a MATLAB calibration.

    MATLAB counts pixels from 1, so 1 is subtracted. Points that the detector left out (NaN in ``imagePoints``, as
    partial boards have them) are dropped; a point with only one coordinate is an error. The two arrays may stand at
    the top or in a structure one level below.

    Parameters
    ----------
    path : Path

    Returns
    -------
    list of BoardView

    Raises
    ------
    InputError
        If the file is of version 7.3 (HDF5), damaged, or the arrays are absent or do not belong together.
    """
    with path.open("rb") as stream:
        head = stream.read(520)
    if b"MATLAB 7.3" in head[:128] or b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:520]):
        raise InputError("MATLAB 7.3 file (HDF5)", file=path, allowed="a file saved in MATLAB with save(..., '-v7')")
    arrays = _load_mat(path)
    world = _real_array(arrays, "worldPoints", path)
    image = _real_array(arrays, "imagePoints", path)
    if world.ndim != 2 or world.shape[1] != 2:
        raise InputError(f"shape {world.shape}", file=path, key="worldPoints", allowed="(points, 2)")
    if image.ndim == 2:
        image = image[:, :, None]
    if image.ndim != 3 or image.shape[:2] != world.shape or image.shape[2] == 0:
        raise InputError(
            f"shape {image.shape}",
            file=path,
            key="imagePoints",
            allowed=f"({len(world)}, 2, views), to match worldPoints",
        )
    if image.size > 2 * MAX_POINTS:
        raise InputError(f"{image.size // 2} corners", file=path, key="imagePoints", allowed=f"at most {MAX_POINTS}")
    bad = np.flatnonzero(~np.isfinite(world).all(axis=1))
    if bad.size:
        raise InputError(
            f"{world[bad[0]].tolist()}", file=path, key=f"worldPoints({bad[0] + 1},:)", allowed="finite numbers"
        )
    return [_mat_view(world, image[:, :, k], k, path) for k in range(image.shape[2])]


def _mat_view(world: Array, image: Array, k: int, path: Path) -> BoardView:
    absent = np.isnan(image).all(axis=1)
    bad = np.flatnonzero(~absent & ~np.isfinite(image).all(axis=1))
    if bad.size:
        raise InputError(
            f"{image[bad[0]].tolist()}",
            file=path,
            key=f"imagePoints({bad[0] + 1},:,{k + 1})",
            allowed="two finite numbers, or NaN for both",
        )
    keep = np.flatnonzero(~absent)
    names = [f"imagePoints({i + 1},:,{k + 1})" for i in keep]
    return _checked(BoardView(str(k + 1), world[keep], image[keep] - 1.0), names, path)


def _load_mat(path: Path) -> dict[str, Any]:
    """Return the arrays asked for, from the top or from inside a structure; nothing else is unpacked."""
    try:
        listed = scipy.io.whosmat(path)
        for name, shape, _ in listed:
            if name in _MATLAB_FIELDS and math.prod(shape) > 2 * MAX_POINTS:  # before the compressed data is unpacked
                raise InputError(f"shape {shape}", file=path, key=name, allowed=f"at most {MAX_POINTS} corners")
        wanted = [name for name, _, kind in listed if name in _MATLAB_FIELDS or kind == "struct"]
        variables = scipy.io.loadmat(path, variable_names=wanted)
    except InputError:
        raise
    except Exception as error:  # a damaged file makes scipy's reader fail in a dozen ways without a common base
        raise InputError(f"not readable as a MATLAB file: {error}", file=path) from None
    found: dict[str, Any] = {key: variables[key] for key in _MATLAB_FIELDS if key in variables}
    for name in wanted:
        value = variables.get(name)
        if not isinstance(value, np.ndarray) or value.dtype.names is None or value.size != 1:
            continue
        for key in _MATLAB_FIELDS:
            if key in value.dtype.names:
                found.setdefault(key, value[key].flat[0])
    return found


def _real_array(arrays: dict[str, Any], key: str, path: Path) -> Array:
    value = arrays.get(key)
    if value is None:
        raise InputError(
            "is not in the file (a cameraParameters object is closed to other programs: save its fields as arrays)",
            file=path,
            key=key,
            allowed="arrays " + " and ".join(_MATLAB_FIELDS),
        )
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
        raise InputError("is not an array of real numbers", file=path, key=key)
    return value.astype(np.float64)


def _checked(view: BoardView, names: Sequence[str], path: Path) -> BoardView:
    """Refuse views too small to use, and corners given twice on the board or in the picture."""
    if len(view) < MIN_POINTS_PER_VIEW:
        raise InputError(
            f"{len(view)} corners", file=path, key=f"view {view.name}", allowed=f"at least {MIN_POINTS_PER_VIEW}"
        )
    for kind, points in (("world", view.world), ("image", view.image)):
        first: dict[tuple[float, ...], int] = {}
        for i, point in enumerate(map(tuple, points.tolist())):
            if point in first:
                raise InputError(
                    f"{kind} point {point} of view {view.name} stands already at {names[first[point]]}",
                    file=path,
                    key=names[i],
                    allowed="each corner once",
                )
            first[point] = i
    spread = view.world - view.world.mean(axis=0)
    if np.linalg.matrix_rank(spread, tol=1e-9 * float(np.abs(spread).max())) < 2:
        raise InputError("all corners lie on one line", file=path, key=f"view {view.name}", allowed="a flat grid")
    return view
