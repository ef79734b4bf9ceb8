"""Ridges as a height map: where the crests run (pattern or orientation field) and how a ridge is shaped across.

Every pattern is the distance from a core, so that crests lie exactly one pitch apart everywhere: a line (parallel), a
point (concentric), a segment (whorl: crests stretched along it) or a half-line (loop: arches around its end that run
into parallels). Measured or other orientation fields are filled by growing ridges along them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.special import erf

from evanesce.contact.ridges.profile import profile_exponent

Array = NDArray[np.float64]
Pattern = Literal["parallel", "concentric", "loop", "whorl"]


@dataclass(frozen=True)
class RidgeRow:
    """Ridges as moulded.

    Attributes
    ----------
    pattern : {"parallel", "concentric", "loop", "whorl"}
        Parallel and loop have a crest on their core, concentric and whorl a furrow (crests at (k + 1/2) pitch).
    pitch, width, height : float
        Crest to crest, width at half height, crest to valley [mm].
    orientation : float
        Direction along parallel ridges, of a whorl's segment, or into which a loop opens, from +x towards +y [rad].
    rounding : float or None
        Standard deviation of the Gaussian that rounds a flat-topped ridge [mm]; None: a ridge without flats,
        |sin|^m of :mod:`~evanesce.contact.ridges.profile`.
    core_length : float
        Length of a whorl's segment [mm].
    """

    pattern: Pattern
    pitch: float
    width: float
    height: float
    orientation: float = 0.0
    rounding: float | None = None
    core_length: float = 0.0

    def locate(self, x: Array, y: Array) -> tuple[NDArray[np.int64], Array]:
        """Return ridge number and distance from its crest [mm] of points relative to the tip [mm].

        Parameters
        ----------
        x, y : ndarray
            From the tip [mm]; broadcast.

        Returns
        -------
        number : ndarray of int
        distance : ndarray
            From the nearest crest [mm].
        """
        along, across = self._axes(x, y)
        match self.pattern:
            case "parallel":
                distance = across
            case "concentric":
                distance = np.hypot(x, y) - 0.5 * self.pitch
            case "whorl":
                beyond = np.maximum(np.abs(along) - 0.5 * self.core_length, 0.0)
                distance = np.hypot(beyond, across) - 0.5 * self.pitch
            case "loop":
                distance = np.hypot(np.minimum(along, 0.0), across)
        number = np.rint(distance / self.pitch)
        return number.astype(np.int64), distance - number * self.pitch

    def orientation_field(self, x: Array, y: Array) -> Array:
        """Return the direction of the crests at points relative to the tip [rad], modulo pi.

        Parameters
        ----------
        x, y : ndarray
            From the tip [mm]; broadcast.

        Returns
        -------
        ndarray
            [rad].
        """
        along, across = self._axes(x, y)
        match self.pattern:
            case "parallel":
                normal_along = np.zeros_like(along + across)
            case "concentric":
                normal_along = along
            case "whorl":
                normal_along = np.sign(along) * np.maximum(np.abs(along) - 0.5 * self.core_length, 0.0)
            case "loop":
                normal_along = np.minimum(along, 0.0)
        across = np.where((normal_along == 0) & (across == 0), 1.0, across)
        return np.mod(np.arctan2(across, normal_along) + 0.5 * np.pi + self.orientation, np.pi)

    def heights(self, x: Array, y: Array) -> Array:
        """Return the depth below the crests [mm] of points relative to the tip [mm].

        Parameters
        ----------
        x, y : ndarray
            From the tip [mm]; broadcast.

        Returns
        -------
        ndarray
            [mm].
        """
        return furrow_depth(self.locate(x, y)[1], self.pitch, self.width, self.height, self.rounding)

    def parameters(self) -> dict[str, Any]:
        """Return what a contact state records of the ridges.

        Returns
        -------
        dict
        """
        named: dict[str, Any] = {
            "ridge_pattern": self.pattern,
            "ridge_pitch_mm": self.pitch,
            "ridge_width_mm": self.width,
            "ridge_height_mm": self.height,
            "ridge_orientation_rad": self.orientation,
        }
        if self.rounding is not None:
            named["ridge_rounding_mm"] = self.rounding
        return named

    def _axes(self, x: Array, y: Array) -> tuple[Array, Array]:
        cos, sin = np.cos(self.orientation), np.sin(self.orientation)
        return x * cos + y * sin, -x * sin + y * cos


def furrow_depth(distance: Array, pitch: float, width: float, height: float, rounding: float | None = None) -> Array:
    """Return how far the surface lies below the crest at a distance across the ridge.

    Parameters
    ----------
    distance : ndarray
        From the crest [mm].
    pitch, width, height : float
        Crest to crest, width at half height, crest to valley [mm].
    rounding : float or None
        As :class:`RidgeRow`.

    Returns
    -------
    ndarray
        0 at the crest, ``height`` midway between crests [mm].

    Raises
    ------
    ValueError
        If the width is not between 0 and the pitch, or a rounding is so large that nothing of the ridge is left.
    """
    if rounding is None:
        return height * np.abs(np.sin(np.pi * distance / pitch)) ** profile_exponent(width, pitch)
    profile_exponent(width, pitch)  # refuses an impossible width
    if not 0 < rounding < pitch:
        raise ValueError(f"ridge rounding {rounding:g} mm must lie between 0 and the pitch {pitch:g} mm")

    def ridge(d: Array) -> Array:
        images = range(-1 - int(5 * rounding / pitch), 2 + int(5 * rounding / pitch))
        scale = np.sqrt(2.0) * rounding
        return sum(
            (
                0.5 * (erf((0.5 * width - d + k * pitch) / scale) + erf((0.5 * width + d - k * pitch) / scale))
                for k in images
            ),
            start=np.zeros_like(d),
        )

    top, bottom = ridge(np.array(0.0)), ridge(np.array(0.5 * pitch))
    if top - bottom < 1e-6:
        raise ValueError(f"ridge rounding {rounding:g} mm leaves no ridge of a pitch of {pitch:g} mm")
    return height * (top - ridge(np.asarray(distance, dtype=float))) / (top - bottom)


def grow_ridges(orientation: Array, pitch: float, spacing: float, rng: np.random.Generator, rounds: int = 40) -> Array:
    """Grow ridges along an orientation field from noise, with the endings and forks that a field makes necessary.

    Each round filters the map, at each point along its own orientation, with a complex band-pass around the ridges'
    frequency, and keeps the phase only.

    Parameters
    ----------
    orientation : ndarray (rows, cols)
        Direction of the crests [rad], modulo pi.
    pitch : float
        Crest to crest [mm].
    spacing : float
        Sampling of the field [mm].
    rng : numpy.random.Generator
    rounds : int

    Returns
    -------
    ndarray (rows, cols)
        Distance from the nearest crest [mm], 0 to pitch/2, for :func:`furrow_depth`. Periodic at the border.

    Raises
    ------
    ValueError
        If the sampling leaves fewer than four samples to a pitch.

    References
    ----------
    After the iterative oriented filtering of synthetic fingerprints: D. Maltoni, D. Maio, A. K. Jain, S. Prabhakar,
    *Handbook of Fingerprint Recognition* (2009), chapter 6.
    """
    if 4 * spacing > pitch:
        raise ValueError(f"{spacing:g} mm per sample is too coarse for a pitch of {pitch:g} mm")
    kx = fft.fftfreq(orientation.shape[1], spacing)[None, :]
    ky = fft.fftfreq(orientation.shape[0], spacing)[:, None]
    directions = 24
    angles = np.arange(directions) * np.pi / directions
    # Gaussian band-pass, a third of an octave wide, one-sided: its real part is even, its imaginary part odd
    width = 0.25 / pitch
    filters = [
        np.exp(-((kx + np.sin(a) / pitch) ** 2 + (ky - np.cos(a) / pitch) ** 2) / (2 * width**2)) for a in angles
    ]
    position = np.mod(orientation, np.pi) * directions / np.pi
    lower = np.floor(position).astype(int) % directions
    share = position - np.floor(position)
    wave = rng.standard_normal(orientation.shape)
    cosine = wave
    for _ in range(rounds):
        spectrum = fft.fft2(wave)
        real, odd2 = np.zeros_like(wave), np.zeros_like(wave)
        for index, band in enumerate(filters):
            weight = np.where(lower == index, 1 - share, np.where((lower + 1) % directions == index, share, 0.0))
            if weight.any():
                filtered = fft.ifft2(spectrum * band)
                real += weight * filtered.real
                odd2 += weight * filtered.imag**2
        cosine = real / np.maximum(np.sqrt(real**2 + odd2), 1e-300)
        wave = cosine
    return pitch / (2.0 * np.pi) * np.arccos(np.clip(cosine, -1.0, 1.0))
