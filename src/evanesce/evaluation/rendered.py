"""Read what ``evanesce render`` wrote: frames, light and truth."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.chain.simulate import SimulatedFrame, solve_contact
from evanesce.core.errors import InputError
from evanesce.core.states import Frame, PlateLight, SensorLight
from evanesce.measurement.io.images import read_image
from evanesce.render.exr import read_light
from evanesce.rig import Scene, load_scene

ALLOWED = "a folder written by `evanesce render`"
MAX_RESULT_BYTES = 100_000_000


@dataclass(frozen=True)
class RenderedFrame:
    """One entry of a rendering's result.json: number, time [s], force [N]."""

    index: int
    time_s: float
    force_N: float


@dataclass(frozen=True)
class Rendered:
    """A rendering's folder.

    Attributes
    ----------
    folder : Path
    scene : Scene
    seed : int
    frames : tuple of RenderedFrame
    """

    folder: Path
    scene: Scene
    seed: int
    frames: tuple[RenderedFrame, ...]

    @property
    def has_light(self) -> bool:
        """Whether every frame's linear light is there."""
        return all(self._light_file(frame.index).is_file() for frame in self.frames)

    def _light_file(self, index: int) -> Path:
        return self.folder / f"light_{index:06d}.exr"

    def true_scene(self) -> Scene:
        """Return the true rig, after effects of the stage ``rig``.

        Returns
        -------
        Scene
        """
        return solve_contact(self.scene, None, seed=self.seed, file=self.folder / "scene.toml")[0]

    def shots(self) -> Iterator[SimulatedFrame]:
        """Yield the frames with their truth, and with their light where it is there (dark otherwise).

        Yields
        ------
        SimulatedFrame

        Raises
        ------
        InputError
            If a frame is missing or of another size than the scene's.
        """
        for entry in self.frames:
            scene, state = solve_contact(
                self.scene, entry.force_N, seed=self.seed, time_s=entry.time_s, index=entry.index,
                file=self.folder / "scene.toml",
            )  # fmt: skip
            cols, rows = scene.camera.resolution_px
            path = self.folder / f"frame_{entry.index:06d}.png"
            picture = read_image(path).data
            if picture.shape[:2] != (rows, cols):
                raise InputError(
                    f"{picture.shape[1]} x {picture.shape[0]} pixels",
                    file=path,
                    allowed=f"{cols} x {rows}, the scene's",
                )
            file = self._light_file(entry.index)
            nothing = np.zeros((1, 1), np.float32)
            light = (
                read_light(file).light
                if file.is_file()
                else PlateLight(radiance=nothing, variance=nothing, focal_px=1.0, principal_point=(0.0, 0.0))
            )
            frame = Frame(data=picture, time=entry.time_s, index=entry.index)
            yield SimulatedFrame(scene, state, light, SensorLight(irradiance=nothing), frame)


def read_rendered(folder: Path) -> Rendered:
    """Read scene, seed and frame list of a rendering.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    Rendered

    Raises
    ------
    InputError
        If something is missing, malformed or not finite.
    """
    if not folder.is_dir():
        raise InputError("no such folder", file=folder, allowed=ALLOWED)
    file = folder / "result.json"
    if not file.is_file():
        raise InputError("holds no result.json", file=folder, allowed=ALLOWED)
    if file.stat().st_size > MAX_RESULT_BYTES:
        raise InputError(f"{file.stat().st_size} bytes", file=file, allowed=f"at most {MAX_RESULT_BYTES} bytes")
    try:
        data: Any = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"not readable as JSON: {error}", file=file) from None
    try:
        seed = _whole(data["provenance"]["seed"])
        frames = tuple(
            RenderedFrame(_whole(f["index"]), _finite(f["time_s"]), _finite(f["force_N"])) for f in data["frames"]
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"not a result of `evanesce render`: {error}", file=file) from None
    if not frames:
        raise InputError("names no frame", file=file, key="frames")
    return Rendered(folder, load_scene(folder / "scene.toml"), seed, frames)


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
        raise ValueError(f"{value!r} is not a whole number from 0")
    return value


def _finite(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{value!r} is not a finite number")
    return float(value)
