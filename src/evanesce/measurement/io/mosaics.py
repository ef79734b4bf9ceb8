"""Read raw mosaics: one plane of 16 bits, PNG or TIFF, as a camera's raw values come before demosaicing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.measurement.io.images import Loaded, load_pixels


@dataclass(frozen=True, kw_only=True)
class MosaicFormat:
    """What a raw mosaic must be.

    Attributes
    ----------
    full_DN : float
        Raw value of a full pixel [DN].
    shape : tuple of int, optional
        (rows, cols).
    """

    full_DN: float
    shape: tuple[int, int] | None = None

    def checked(self, given: NDArray[np.generic], file: Path | None = None) -> Loaded:
        """Return a mosaic with its picture in 8 bits.

        Parameters
        ----------
        given : ndarray
            As decoded [DN].
        file : Path, optional
            For messages.

        Returns
        -------
        Loaded
            ``raw`` is the mosaic, ``data`` the same in 8 bits by full scale.

        Raises
        ------
        InputError
            If it is not one plane of 16 bits, of another size, or has levels above full scale.
        """
        if given.ndim != 2 or given.dtype.kind != "u" or given.dtype.itemsize != 2:
            planes = 1 if given.ndim == 2 else given.shape[-1] if given.ndim == 3 else 0
            what = f"{planes} plane(s) of {given.dtype}"
            raise InputError(what, file=file, key="raw", allowed="a raw mosaic, 1 plane of uint16")
        if self.shape is not None and given.shape != self.shape:
            what, (rows, cols) = f"{given.shape[1]} x {given.shape[0]} pixels", self.shape
            raise InputError(what, file=file, key="raw", allowed=f"{cols} x {rows}, as calibrated")
        raw = np.ascontiguousarray(given, np.uint16)  # in this machine's order of bytes
        if raw.max() > self.full_DN:
            allowed = f"0 to {self.full_DN:g} by camera.pixel.bits of the camera model, not shifted to the upper bits"
            raise InputError(f"level {raw.max()} DN", file=file, key="raw", allowed=allowed)
        return Loaded(np.asarray(raw * (255.0 / self.full_DN), np.uint8), raw=raw)

    def load(self, path: Path) -> Loaded:
        """Read a file; as :meth:`checked`.

        Parameters
        ----------
        path : Path

        Returns
        -------
        Loaded

        Raises
        ------
        Unreadable
            If the file is damaged or no image.
        InputError
            As :meth:`checked`.
        """
        return self.checked(load_pixels(path), path)
