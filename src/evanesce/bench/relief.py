"""Scans as the relief of a finger's tip: levelled height maps, and profiles that repeat as parallel ridges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.bench.profile import fill_gaps, level, remove_form, ridges_of_profile
from evanesce.core.errors import WorkError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class HeightMap:
    """A surface for the contact solvers.

    Attributes
    ----------
    height : ndarray (rows, cols)
        Towards the glass [mm]; 0 at the mean crest, furrows negative.
    pitch : float
        Sample distance in x and y [mm].
    """

    height: Floats
    pitch: float

    @property
    def size(self) -> tuple[float, float]:
        """Length along the columns' and the rows' direction, (x, y) [mm]."""
        rows, cols = self.height.shape
        return cols * self.pitch, rows * self.pitch

    @property
    def distance(self) -> Floats:
        """Undeformed distance from the glass with the mean crest touching [mm]: what the half-space solver presses."""
        return -self.height


@dataclass(frozen=True)
class RepeatedProfile:
    """A measured profile cut to a whole number of ridges, which it repeats without end.

    Attributes
    ----------
    height : ndarray (n,)
        One period, evenly sampled, towards the glass [mm]; 0 at the mean crest, furrows negative.
    pitch : float
        Sample distance [mm].
    """

    height: Floats
    pitch: float

    @property
    def period(self) -> float:
        """Length after which the profile repeats [mm]."""
        return len(self.height) * self.pitch


def height_map_of_scan(height: ArrayLike, pitch: float, form_degree: int = 1) -> HeightMap:
    """Return a scanned map as a finger's height map: levelled (:func:`~evanesce.bench.profile.level`), gaps filled,
    mean crest at 0.

    Parameters
    ----------
    height : array_like (rows, cols)
        [mm], NaN where lost.
    pitch : float
        [mm].
    form_degree : int
        Of the polynomial form removed.

    Returns
    -------
    HeightMap
    """
    z = fill_gaps(level(height, form_degree))
    return HeightMap(z - _crest(z), pitch)


def repeated_profile(x: ArrayLike, z: ArrayLike, form_degree: int = 1) -> RepeatedProfile:
    """Return a measured profile as one period of an endless row of ridges, the profile's middle at the period's start.

    The profile is levelled and cut to a whole number of ridges, so that its repetition has no step.

    Parameters
    ----------
    x, z : array_like (n,)
        Position and height [mm].
    form_degree : int
        As :func:`.analyse_profile`.

    Returns
    -------
    RepeatedProfile

    Raises
    ------
    WorkError
        With fewer than two whole ridges in the profile.
    """
    x = np.asarray(x, dtype=float)
    z = remove_form(fill_gaps(np.asarray(z, dtype=float)), form_degree)
    middles = sorted(ridge.middle for ridge in ridges_of_profile(x, z))
    if len(middles) < 2:
        raise WorkError(f"{len(middles)} whole ridge in the profile; at least 2 are needed to repeat it")
    start, period = middles[0], middles[-1] - middles[0]
    samples = max(16, round(period / float(np.median(np.diff(x)))))
    pitch = period / samples
    row = np.interp(start + np.mod(0.5 * (x[0] + x[-1]) - start + np.arange(samples) * pitch, period), x, z)
    return RepeatedProfile(row - _crest(row), pitch)


def height_map_of_profile(
    x: ArrayLike, z: ArrayLike, shape: tuple[int, int], pitch: float, form_degree: int = 1
) -> HeightMap:
    """Return a height map of parallel ridges along y that repeat one measured profile.

    Parameters
    ----------
    x, z, form_degree
        As :func:`repeated_profile`.
    shape : tuple of int
        (rows, cols).
    pitch : float
        Sample distance of the map [mm].

    Returns
    -------
    HeightMap

    Raises
    ------
    WorkError
        With fewer than two whole ridges in the profile.
    """
    endless = repeated_profile(x, z, form_degree)
    at = (np.arange(shape[1]) - (shape[1] - 1) / 2) * pitch
    row = np.interp(at, np.arange(len(endless.height)) * endless.pitch, endless.height, period=endless.period)
    return HeightMap(np.tile(row - _crest(row), (shape[0], 1)), pitch)


def _crest(z: Floats) -> float:
    """Return the mean height of the upper tenth."""
    return float(z[z >= np.percentile(z, 90)].mean())
