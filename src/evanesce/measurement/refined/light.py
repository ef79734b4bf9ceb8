"""From 8-bit frames to linear light: tone curve inverted, dark frame subtracted, flat field divided out.

All of it comes from the rig's own shots: the tone curve from a standard's name or a measured table, the dark light from
frames without contact, the flat field from frames of a contact that covers the view or of a uniform target.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.measurement.reference.segment import LUMA
from evanesce.measurement.refined.colour import CameraModel
from evanesce.measurement.refined.raw import RawModel

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

LEVELS = 256
FULL_SCALE = 254
"""Grey level [DN] from which a pixel counts as saturated: rounding and chroma may leave a full pixel one below 255."""

GREY_DN = 16
"""Greatest difference of a grey pixel's channels [DN]: what a lossy codec leaves."""

COLOURED_PIXELS = 100
"""Clipped coloured pixels up to which a frame counts as grey: specks."""

CURVES = ("linear", "bt709", "srgb")


def tone_table(curve: str | Sequence[float]) -> Floats:
    """Return the linear light of each 8-bit level.

    Parameters
    ----------
    curve : str or sequence of float
        ``linear``, ``bt709`` (ITU-R BT.709-6, item 1.2) or ``srgb`` (IEC 61966-2-1), or the 256 values themselves, as a
        step wedge gives them.

    Returns
    -------
    ndarray (256,)
        0 to 1.

    Raises
    ------
    InputError
        If the name is not known, or the values do not rise from level to level within 0 to 1.
    """
    level = np.arange(LEVELS) / (LEVELS - 1)
    if isinstance(curve, str):
        if curve == "linear":
            return level
        if curve == "bt709":
            return np.where(level < 4.5 * 0.018, level / 4.5, ((level + 0.099) / 1.099) ** (1 / 0.45))
        if curve == "srgb":
            return np.where(level <= 12.92 * 0.0031308, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
        raise InputError(f"{curve!r}", key="tone_curve", allowed=f"{', '.join(CURVES)}, or {LEVELS} numbers")
    table = np.asarray(curve, dtype=np.float64)
    if table.shape != (LEVELS,) or not np.isfinite(table).all() or table[0] < 0 or table[-1] > 1:
        raise InputError(f"{table.size} values", key="tone_curve", allowed=f"{LEVELS} numbers from 0 to 1")
    if np.any(np.diff(table) < 0) or table[-1] <= table[0]:
        raise InputError("falls somewhere", key="tone_curve", allowed="light that rises with the level")
    return table


@dataclass(frozen=True)
class Radiometry:
    """Conversion of a frame's grey levels to linear light.

    Attributes
    ----------
    tone : ndarray (256,)
        Linear light of each level, 0 to 1 (:func:`tone_table`).
    dark : ndarray (rows, cols) or float
        Linear light without contact: black level, ambient light, specks; a level where a camera model reads frames.
    flat : ndarray (rows, cols) or float
        Relative light of an even target, mean 1.
    camera : CameraModel, optional
        By which colour frames are read, one level a pixel; without it they are grey by the luma weights.
    raw : RawModel, optional
        By which frames of 16 bits are read: raw mosaics.
    """

    tone: Floats
    dark: Floats | float = 0.0
    flat: Floats | float = 1.0
    camera: CameraModel | None = None
    raw: RawModel | None = None

    @classmethod
    def of(
        cls,
        details: Mapping[str, Any],
        dark: Iterable[Image] = (),
        flat: Iterable[Image] = (),
        camera: CameraModel | None = None,
        raw: RawModel | None = None,
    ) -> Radiometry:
        """Combine a calibration's ``tone_curve`` (bt709 if it has none) with the rig's own dark and flat shots.

        Parameters
        ----------
        details : mapping
            Of a calibration; ``tone_curve`` is read.
        dark, flat : iterable of ndarray of uint8
            Frames without contact, and of a uniform target [DN].
        camera : CameraModel, optional
            Of a colour camera.
        raw : RawModel, optional
            Of raw mosaics, which go without shots.

        Returns
        -------
        Radiometry

        Raises
        ------
        InputError
            If the curve is not valid, shots differ in size, or a flat shot is dark somewhere.
        """
        tone = tone_table(details.get("tone_curve", "bt709"))
        if raw is not None:
            return cls(tone, raw=raw)
        if camera is not None:
            if list(flat):
                raise InputError("flat shots hold for grey frames", key="camera_model", allowed="without flat shots")
            levels = _mean_of(dark, lambda shot: camera.read(shot)[0] if shot.ndim == 3 else tone[shot], "dark")
            return cls(tone, 0.0 if levels is None else levels, camera=camera)
        black = _mean_light(dark, tone, "dark")
        even = _mean_light(flat, tone, "flat")
        if even is None:
            return cls(tone, 0.0 if black is None else black, camera=camera)
        even = even - (0.0 if black is None else black)
        if not (even > 0).all():
            raise InputError("has pixels without light", key="flat", allowed="an evenly lit shot, nowhere dark")
        return cls(tone, 0.0 if black is None else black, even / even.mean())

    def light(self, image: Image | NDArray[np.uint16]) -> tuple[Floats, NDArray[np.bool_]]:
        """Return linear light (rows, cols) and where the frame is saturated.

        Parameters
        ----------
        image : ndarray of uint8, (rows, cols) or (rows, cols, 3)
            [DN]; of colour frames each channel is made linear before the luma weights.

        Returns
        -------
        light : ndarray (rows, cols)
        saturated : ndarray of bool (rows, cols)
        """
        for name, part in (("dark", self.dark), ("flat", self.flat)):
            if isinstance(part, np.ndarray) and part.shape != image.shape[:2]:
                raise InputError(f"shot of {part.shape}", key=name, allowed=f"the frames' size {image.shape[:2]}")
        if self.raw is not None and image.dtype == np.uint16:
            return self.raw.light(np.asarray(image, np.uint16), self.dark)
        image = np.asarray(image, np.uint8)
        if self.camera is not None and image.ndim == 3:
            return self.camera.light(image, self.dark)
        full = (image if image.ndim == 2 else image.max(axis=2)) >= FULL_SCALE
        return (_linear(image, self.tone) - self.dark) / self.flat, full

    def first_full(self, image: Image | NDArray[np.uint16]) -> float:
        """Return the light at which the first channel of a frame is full, of full scale.

        Parameters
        ----------
        image : ndarray of uint8, (rows, cols) or (rows, cols, 3)

        Returns
        -------
        float
        """
        if self.raw is not None and image.dtype == np.uint16:
            return 1.0 / max(self.raw.response) / self.raw.top
        if self.camera is None or image.ndim == 2:
            return 1.0
        return min(1.0, self.camera.first / self.camera.top)

    def leaves_colour(self, image: Image | NDArray[np.uint16]) -> bool:
        """Return whether a frame has clipped coloured pixels and there is no camera model to read them by.

        Parameters
        ----------
        image : ndarray of uint8, (rows, cols) or (rows, cols, 3)
            [DN].

        Returns
        -------
        bool
        """
        if self.camera is not None or image.ndim == 2:
            return False
        brightest = image.max(axis=2)
        clipped = brightest >= FULL_SCALE
        return int((brightest[clipped] - image.min(axis=2)[clipped] > GREY_DN).sum()) > COLOURED_PIXELS


def _linear(image: Image, tone: Floats) -> Floats:
    light = tone[image]
    return light if image.ndim == 2 else np.asarray(light @ np.array(LUMA, dtype=np.float64) / 10_000)


def _mean_light(shots: Iterable[Image], tone: Floats, key: str) -> Floats | None:
    return _mean_of(shots, lambda shot: _linear(shot, tone), key)


def _mean_of(shots: Iterable[Image], read: Callable[[Image], Floats], key: str) -> Floats | None:
    total: Floats | None = None
    count = 0
    for shot in shots:
        light = read(shot)
        if total is not None and total.shape != light.shape:
            raise InputError(f"shots of {total.shape} and {light.shape}", key=key, allowed="shots of one size")
        total, count = light if total is None else total + light, count + 1
    return None if total is None else total / count
