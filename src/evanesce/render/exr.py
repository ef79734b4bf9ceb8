"""Linear light and contact truth in one multichannel OpenEXR file, pixel for pixel on the distortion-free view."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
from numpy.typing import NDArray

from evanesce.core.errors import InputError, WorkError
from evanesce.core.states import ContactState, PlateLight
from evanesce.optics.projection import IdealView, Projection
from evanesce.rig import Scene

UNITS = {
    "radiance": "W mm^-2 sr^-1",
    "variance": "(W mm^-2 sr^-1)^2",
    "gap": "mm",
    "pressure": "MPa",
    "mask": "1",
}
MAX_BYTES = 4_000_000_000
_PREFIX = "evanesce:"


@dataclass(frozen=True)
class LightFile:
    """What :func:`read_light` returns.

    Attributes
    ----------
    light : PlateLight
    contact : dict of ndarray (rows, cols)
        ``gap`` [mm] (NaN beyond the contact grid), ``pressure`` [MPa], ``mask`` [1]; empty without contact.
    provenance : dict
    """

    light: PlateLight
    contact: dict[str, NDArray[np.float32]]
    provenance: dict[str, Any]


def contact_channels(scene: Scene, state: ContactState, view: IdealView) -> dict[str, NDArray[np.float32]]:
    """Carry a contact state to the pixel centres of a view.

    Parameters
    ----------
    scene : Scene
    state : ContactState
    view : IdealView

    Returns
    -------
    dict of ndarray of float32 (rows, cols)
        ``gap`` is NaN, ``pressure`` and ``mask`` are 0 beyond the contact grid.
    """
    projection = Projection.of(scene.camera, scene.plate)
    rows, cols = view.shape
    px, py = view.principal_point
    u, v = np.meshgrid((np.arange(cols) - px) / view.focal_px, (np.arange(rows) - py) / view.focal_px)
    at_row, at_col = state.grid.index(*projection.ray_to_plate(u, v))
    maps = at_col.astype(np.float32), at_row.astype(np.float32)

    def carried(values: NDArray[Any], beyond: float) -> NDArray[np.float32]:
        found = cv2.remap(
            np.ascontiguousarray(values, np.float32),
            *maps,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=beyond,
        )
        return np.asarray(found, np.float32)

    return {
        "gap": carried(state.gap, float("nan")),
        "pressure": carried(state.pressure, 0.0),
        "mask": carried(state.contact_mask, 0.0),
    }


def write_light(
    path: Path, scene: Scene, light: PlateLight, state: ContactState | None, provenance: Mapping[str, Any]
) -> None:
    """Write radiance, variance and, where there is contact, gap, pressure and mask; whole or not at all.

    Parameters
    ----------
    path : Path
    scene : Scene
        Its camera and plate locate the contact in the view.
    light : PlateLight
    state : ContactState or None
    provenance : mapping
        JSON-able; goes into the header.

    Raises
    ------
    WorkError
        If the file cannot be written.
    """
    rows, cols = light.radiance.shape
    view = IdealView((rows, cols), light.focal_px, light.principal_point)
    channels = {
        "radiance": np.ascontiguousarray(light.radiance, np.float32),
        "variance": np.ascontiguousarray(light.variance, np.float32),
    }
    if state is not None:
        channels |= contact_channels(scene, state, view)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        _PREFIX + "units": json.dumps({name: UNITS[name] for name in channels}),
        _PREFIX + "view": json.dumps(
            {"focal_px": light.focal_px, "principal_point_px": light.principal_point, "samples": light.samples}
        ),
        _PREFIX + "provenance": json.dumps(provenance),
    }
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        with OpenEXR.File(header, channels) as file:
            file.write(str(part))
        with part.open("rb+") as stream:
            os.fsync(stream.fileno())
        os.replace(part, path)
    except (OSError, RuntimeError) as error:
        raise WorkError(f"{path}: cannot write: {error}") from None
    finally:
        part.unlink(missing_ok=True)


def read_light(path: Path) -> LightFile:
    """Read a file of :func:`write_light`.

    Parameters
    ----------
    path : Path

    Returns
    -------
    LightFile

    Raises
    ------
    InputError
        If it is absent, not such a file, or broken.
    """
    if not path.is_file():
        raise InputError("no such file", file=path, allowed="an OpenEXR file of `evanesce render`")
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_BYTES} bytes")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            header = dict(file.header())  # emptied when the file closes
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
        view, provenance = (json.loads(header[_PREFIX + name]) for name in ("view", "provenance"))
        light = PlateLight(
            radiance=channels.pop("radiance"),
            variance=channels.pop("variance"),
            focal_px=float(view["focal_px"]),
            principal_point=(float(view["principal_point_px"][0]), float(view["principal_point_px"][1])),
            samples=int(view["samples"]),
        )
    except (OSError, RuntimeError, KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(f"not a readable light file: {error}", file=path) from None
    return LightFile(light, channels, provenance)
