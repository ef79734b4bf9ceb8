"""A stored calibration: the camera matrix, its distortion and the area of a pixel, as one JSON file."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError, WorkError
from evanesce.core.plain import plain

MAX_CALIBRATION_BYTES = 50_000_000
MAX_SIDE_PX = 100_000


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Calibration of a camera.

    Attributes
    ----------
    image_size : tuple of int
        (cols, rows) of the frames it holds for [px].
    camera_matrix : ndarray (3, 3)
        OpenCV's form, [px]; integer coordinates are pixel centres.
    distortion : ndarray (5,)
        k1, k2, p1, p2, k3 (OpenCV's order and sign).
    mm2_per_px : float or None
        Area of a pixel of the undistorted view [mm^2]; None before a square card has been measured.
    square_side_mm : float or None
        Side of that square card [mm].
    details : mapping
        Whatever else the calibration reported: corners, residuals, standard errors, warnings.
    """

    image_size: tuple[int, int]
    camera_matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]
    mm2_per_px: float | None = None
    square_side_mm: float | None = None
    details: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, shape in (("camera_matrix", (3, 3)), ("distortion", (5,))):
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.shape != shape:
                raise ValueError(f"Calibration.{name} has shape {array.shape}, not {shape}")
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def save(self, path: str | Path) -> None:
        """Write this calibration as JSON, whole or not at all; :func:`load_calibration` reads it.

        Raises
        ------
        WorkError
            If the file cannot be written.
        """
        save_calibration(path, self)


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration that :meth:`Calibration.save` or ``evanesce calibrate --json`` wrote.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If the file is absent, too large, not JSON, or a value in it is missing, not finite or out of range.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", file=path, allowed="a JSON file of `evanesce calibrate`")
    if path.stat().st_size > MAX_CALIBRATION_BYTES:
        raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_CALIBRATION_BYTES} bytes")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError, OSError) as error:
        raise InputError(f"not readable as JSON: {error}", file=path) from None
    if not isinstance(data, dict):
        raise InputError("is not a JSON object", file=path, allowed="a JSON file of `evanesce calibrate`")
    return _from_plain(data, path)


def save_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration as JSON, whole or not at all.

    Parameters
    ----------
    path : str or Path
    calibration : Calibration

    Raises
    ------
    WorkError
        If the file cannot be written.
    """
    path = Path(path)
    text = json.dumps(as_plain(calibration), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix="." + path.name)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                stream.write(text)
            os.chmod(name, 0o644)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise WorkError(f"{path}: cannot write: {error.strerror}") from None


def as_plain(calibration: Calibration) -> dict[str, Any]:
    """Return a calibration as JSON-able data.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    dict
        The details beside the calibration's own keys, which win; NaN becomes None.
    """
    return {
        **{str(key): plain(value) for key, value in calibration.details.items()},
        "image_size": [int(n) for n in calibration.image_size],
        "camera_matrix": calibration.camera_matrix.tolist(),
        "distortion": calibration.distortion.tolist(),
        "mm2_per_px": calibration.mm2_per_px,
        "square_side_mm": calibration.square_side_mm,
    }


_OWN_KEYS = ("image_size", "camera_matrix", "distortion", "mm2_per_px", "square_side_mm")


def _from_plain(data: dict[str, Any], path: Path) -> Calibration:
    size = _numbers(data, "image_size", (2,), path, "two whole numbers, columns and rows")
    if np.any(size != np.round(size)) or np.any(size < 2) or np.any(size > MAX_SIDE_PX):
        raise InputError(
            f"{data['image_size']}", file=path, key="image_size", allowed=f"whole numbers from 2 to {MAX_SIDE_PX}"
        )
    matrix = _numbers(data, "camera_matrix", (3, 3), path, "three rows of three numbers")
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or not np.array_equal(matrix[2], [0, 0, 1]) or matrix[1, 0] != 0:
        raise InputError(
            f"{data['camera_matrix']}", file=path, key="camera_matrix", allowed="[[fx, s, cx], [0, fy, cy], [0, 0, 1]]"
        )
    return Calibration(
        image_size=(int(size[0]), int(size[1])),
        camera_matrix=matrix,
        distortion=_numbers(data, "distortion", (5,), path, "five numbers k1 k2 p1 p2 k3"),
        mm2_per_px=_positive(data, "mm2_per_px", path),
        square_side_mm=_positive(data, "square_side_mm", path),
        details={key: value for key, value in data.items() if key not in _OWN_KEYS},
    )


def _numbers(data: dict[str, Any], key: str, shape: tuple[int, ...], path: Path, allowed: str) -> NDArray[np.float64]:
    if key not in data:
        raise InputError("is missing", file=path, key=key, allowed=allowed)
    leaves = [data[key]]
    for _ in shape:  # unpack level by level: a ragged or textual array must not reach numpy
        leaves = [item for leaf in leaves for item in (leaf if isinstance(leaf, list) else [None])]
    good = len(leaves) == math.prod(shape) and all(_is_finite(leaf) for leaf in leaves)
    array = np.array(leaves, dtype=np.float64).reshape(shape) if good else np.empty(0)
    if array.tolist() != data[key]:
        raise InputError(f"{str(data[key])[:80]}", file=path, key=key, allowed=allowed)
    return array


def _positive(data: dict[str, Any], key: str, path: Path) -> float | None:
    value = data.get(key)
    if value is None:
        return None
    if not _is_finite(value) or value <= 0:
        raise InputError(f"{str(value)[:80]}", file=path, key=key, allowed="a number above 0, or null")
    return float(value)


def _is_finite(value: Any) -> bool:
    # abs() < 1e300 also refuses whole numbers too large for a float
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300
