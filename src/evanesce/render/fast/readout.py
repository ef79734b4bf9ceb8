"""A camera from mean charge to 8 bits, as the fast exposure takes it, and the table of normals of its noise.

A colour camera is taken to its balanced mosaic on 16 bits; what follows looks at neighbours.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

Image = NDArray[np.float32]

NORMALS = 1 << 16
MOST_STEPS = 24
"""Steps of the staircase of a dark pixel up to which it is used."""


@functools.cache
def normal_table() -> Image:
    """Return the means of the normal distribution's 2^16 equal shares, scaled to variance 1."""
    edges = ndtri(np.linspace(0.0, 1.0, NORMALS + 1))
    density = np.exp(-0.5 * edges**2) / np.sqrt(2 * np.pi)
    means = -np.diff(density) * NORMALS
    return np.asarray(means / np.sqrt(np.mean(means**2)), np.float32)


@dataclass(frozen=True)
class Readout:
    """A camera from mean charge to what is looked up by raw number.

    Pixels repeat in 2 x 2 places on a colour camera, row by row; on a monochrome one all are of one kind.

    Attributes
    ----------
    shape : tuple of int
        (rows, cols).
    dark_e : float
        Mean charge without light [e-].
    full_well_e, read_noise_e : float
        [e-].
    gain : float
        [DN/e-].
    black_DN : float
        [DN].
    tone : ndarray of uint8 (2^bits,), or of uint16 (4, 2^bits)
        8-bit value of each raw number; of a colour camera the balanced value by place.
    share : tuple of float
        Share of the charge that a place collects, on a colour camera [1].
    """

    shape: tuple[int, int]
    dark_e: float
    full_well_e: float
    read_noise_e: float
    gain: float
    black_DN: float
    tone: NDArray[Any]
    share: tuple[float, ...] = ()

    @property
    def top(self) -> int:
        """Highest raw number [DN]."""
        return int(self.tone.shape[-1]) - 1


@dataclass(frozen=True)
class ChargeBox:
    """Mean charge by light in the part of a frame that it falls on.

    Attributes
    ----------
    row, col : int
        Of its upper left pixel.
    charge : ndarray of float32 (rows, cols)
        Mean charge by light [e-].
    """

    row: int
    col: int
    charge: Image


def raw_numbers(charge: NDArray[Any], z: Image, readout: Readout) -> NDArray[np.uint16]:
    """Return the raw numbers [DN] of charges [e-], read noise by its standard normal values ``z``.

    Parameters
    ----------
    charge, z : ndarray of float32, one shape
    readout : Readout
    """
    signal = z * np.float32(readout.read_noise_e) + charge
    signal = signal * np.float32(readout.gain) + np.float32(readout.black_DN + 0.5)
    return np.clip(signal, np.float32(0), np.float32(readout.top)).astype(np.uint16)


@dataclass(frozen=True)
class DarkSteps:
    """The 8-bit value of a pixel without charge, as a staircase over the upper 16 bits of its random word.

    Of a colour camera the raw number.

    Attributes
    ----------
    base : int
        Value at 0.
    rises : tuple of (int, int)
        Where it rises, and by how much.
    """

    base: int
    rises: tuple[tuple[int, int], ...]


def dark_steps(readout: Readout) -> DarkSteps | None:
    """Return the staircase of a camera without dark charge; None with such charge or over ``MOST_STEPS``.

    Parameters
    ----------
    readout : Readout
    """
    if readout.dark_e != 0.0:
        return None
    values = readout.tone if not readout.share else np.arange(readout.top + 1, dtype=np.uint16)
    return _dark_steps(
        readout.full_well_e, readout.read_noise_e, readout.gain, readout.black_DN, values.tobytes(), values.dtype.char
    )  # fmt: skip


def dark_values(readout: Readout) -> NDArray[Any]:
    """Return the 8-bit value, of a colour camera the raw number, of a pixel without charge by its upper 16 bits.

    Parameters
    ----------
    readout : Readout
        Of a camera without dark charge.

    Returns
    -------
    ndarray (65536,)
    """
    dark = raw_numbers(np.zeros(NORMALS, np.float32), normal_table(), readout)
    return dark if readout.share else np.asarray(readout.tone[dark])


@functools.lru_cache(maxsize=4)
def _dark_steps(full_well: float, noise: float, gain: float, black: float, tone: bytes, kind: str) -> DarkSteps | None:
    staircase = dark_values(Readout((1, 1), 0.0, full_well, noise, gain, black, np.frombuffer(tone, kind))).astype(int)
    rise = np.diff(staircase)
    positions = np.flatnonzero(rise)
    if positions.size > MOST_STEPS or (rise < 0).any():
        return None
    return DarkSteps(int(staircase[0]), tuple((int(p) + 1, int(rise[p])) for p in positions))
