"""Limits of a request. Imports no large package, so that excessive requests are refused at once."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from evanesce.core.errors import InputError
from evanesce.core.resources import resource

MAX_FRAMES = 50_000_000
"""Maximum number of frames of a dataset."""
MAX_FRAME_BYTES = 400_000_000
"""Maximum memory of one frame with its labels [bytes]."""
MAX_SHARD_FRAMES = 1024
"""One second at 1000 Hz."""
MIN_SIDE_PX, MAX_SIDE_PX = 8, 20_000
MAX_CONFIG_BYTES = 200_000
BYTES_PER_PIXEL = 70
"""Memory per pixel while a frame is made: charges, labels and their copies."""
BYTES_PER_SAMPLE = 320
"""Memory per sample of the plate plane."""


def require_count(frames: int) -> None:
    """Refuse an excessive count of frames.

    Raises
    ------
    InputError
        If it is not within 1 to :data:`MAX_FRAMES`.
    """
    if not 1 <= frames <= MAX_FRAMES:
        raise InputError(f"{frames} frames", key="--n", allowed=f"1 to {MAX_FRAMES}")


def resolution(resolution_px: tuple[int, int], scale: float, size_px: tuple[int, int] | None = None) -> tuple[int, int]:
    """Return (columns, rows) of the frames of a camera that ``camera.scale`` shrinks, or ``camera.size_px``."""
    if size_px is not None:
        return size_px
    cols, rows = resolution_px
    return max(8, round(cols * scale)), max(8, round(rows * scale))


def require_frame(cols: int, rows: int, grid_samples: int) -> None:
    """Refuse frames that need too much memory.

    Raises
    ------
    InputError
        If a frame needs more than :data:`MAX_FRAME_BYTES`.
    """
    need = cols * rows * BYTES_PER_PIXEL + grid_samples**2 * BYTES_PER_SAMPLE
    if need > MAX_FRAME_BYTES:
        raise InputError(
            f"a frame of {cols} x {rows} px and {grid_samples}^2 plate samples needs {need / 1e9:.3g} GB",
            key="camera.resolution_px, labels.grid_samples", allowed=f"at most {MAX_FRAME_BYTES / 1e9:g} GB a frame",
        )  # fmt: skip


def require_possible(scene: str, config: Path | None, overrides: dict[str, Any], frames: int) -> None:
    """Refuse excessive requests by the files' text; the full validation follows later.

    Parameters
    ----------
    scene : str
        TOML file, or the name of a shipped scene.
    config : Path, optional
        TOML of the dataset.
    overrides : dict
        Dotted keys of the scene.
    frames : int

    Raises
    ------
    InputError
        As :func:`require_count` and :func:`require_frame`.
    """
    require_count(frames)
    named = Path(scene)
    rig = _table(named if named.is_file() else resource("scenes", f"{named.name}.toml"))
    wanted = _table(config) if config is not None else {}
    chosen = _at(wanted, "camera", "size_px")
    size = chosen or overrides.get("camera.resolution_px", _at(rig, "camera", "resolution_px"))
    scale, samples = _at(wanted, "camera", "scale"), _at(wanted, "labels", "grid_samples")
    if isinstance(size, list) and len(size) == 2 and all(type(n) is int and 0 < n < 2**31 for n in size):
        sound = not chosen and type(scale) in (int, float) and 0.0 < scale < 1e3
        cols, rows = resolution((size[0], size[1]), float(scale) if sound else 1.0)
        require_frame(cols, rows, samples if type(samples) is int and 0 < samples < 2**31 else 0)


def _table(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > 1_000_000:
            return {}
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}


def _at(table: dict[str, Any], section: str, key: str) -> Any:
    inner = table.get(section)
    return inner.get(key) if isinstance(inner, dict) else None
