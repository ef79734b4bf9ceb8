"""Haze on the plate's faces: guided light that fine dust and grease scatter out where nothing touches.

A share s of the guided irradiance E that meets a face is scattered; each half-space takes a half of it, evenly over
projected solid angle (a thin layer of many small scatterers, larger than the wavelength). So each half has the radiance

    L = s E/(2 pi),

and what starts inside the glass leaves it as (1 - R) L/n^2. Light once scattered out is not scattered again, and what
the haze takes from the guided light is neglected: s is small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from evanesce.core import rng

Array = NDArray[np.float64]

SAMPLES_PER_LENGTH = 4
"""Of the random field, per correlation length."""

LARGEST_SIDE = 2048
"""Samples of the random field along a side, at most."""

FACES = ("top", "bottom")


def haze_radiance(share: float, irradiance: Array | float) -> Array:
    """Return the radiance of either half of the light that a hazy face scatters: s E/(2 pi).

    Parameters
    ----------
    share : float
        Of the guided irradiance, scattered [1].
    irradiance : ndarray or float
        Guided, on that face [W mm^-2].

    Returns
    -------
    ndarray
        [W mm^-2 sr^-1].
    """
    return np.asarray(share * np.asarray(irradiance, float) / (2 * np.pi))


def hazy_floor(distance: Array, height: Array, polar: Array, hole: float, *, directions: int = 1024) -> Array:
    """Return the irradiance on points above an even Lambertian plane with a round hole, over pi times its radiance.

    Cosine-weighted directions about each normal, those that meet the plane outside of the hole. Without a hole this is
    (1 + cos(polar))/2.

    Parameters
    ----------
    distance, height : ndarray (points,)
        From the hole's axis, above the plane [mm].
    polar : ndarray (points,)
        Angle of the outward normal from straight down, away from the axis [rad].
    hole : float
        Radius [mm].
    directions : int

    Returns
    -------
    ndarray (points,)
        0 to 1; 0 for points on the plane.
    """
    golden = 0.6180339887498949
    k = np.arange(directions)
    sine, around = np.sqrt((k + 0.5) / directions), 2 * np.pi * np.mod(k * golden, 1.0)
    across, ahead, along = sine * np.cos(around), sine * np.sin(around), np.sqrt(1 - sine**2)
    normal, tilted = np.cos(polar)[:, None], np.sin(polar)[:, None]
    # Normal (sin, 0, -cos), first tangent (cos, 0, sin), second (0, 1, 0).
    down = along * normal - across * tilted
    out = along * tilted + across * normal
    run = np.where(down > 1e-9, height[:, None] / np.maximum(down, 1e-9), np.inf)
    with np.errstate(invalid="ignore"):
        reached = np.hypot(distance[:, None] + run * out, run * ahead)
    return np.asarray(((down > 1e-9) & (reached > hole)).mean(axis=1) * (height > 0.0))


@dataclass(frozen=True)
class Clouds:
    """A smooth random field of mean 1 over the plate, log-normal, sampled on a grid.

    Attributes
    ----------
    factor : ndarray of float32 (rows, cols)
        [1].
    first : tuple of float
        Position (x, y) of the first sample [mm].
    pitch : float
        Of the samples [mm].
    """

    factor: NDArray[np.float32]
    first: tuple[float, float]
    pitch: float


def clouds(size_mm: tuple[float, float], contrast: float, correlation_mm: float, pattern: int, face: str) -> Clouds:
    """Draw a random field: exp(sigma G - sigma^2/2), G normal with correlation exp(-r^2/(2 l^2)).

    sigma^2 = ln(1 + contrast^2), so that mean and standard deviation are 1 and ``contrast``.

    Parameters
    ----------
    size_mm : tuple of float
        Of the plate [mm].
    contrast : float
        Standard deviation over the mean [1].
    correlation_mm : float
        l [mm].
    pattern : int
        Number of the pattern.
    face : str
        One of :data:`FACES`; each has its own field.

    Returns
    -------
    Clouds
    """
    pitch = max(correlation_mm / SAMPLES_PER_LENGTH, max(size_mm) / LARGEST_SIDE)
    width = correlation_mm / pitch / math.sqrt(2.0)
    margin = math.ceil(5 * width)
    cols, rows = (math.ceil(size / pitch) + 3 for size in size_mm)
    noise = rng.generator(pattern, "haze", face).standard_normal((rows + 2 * margin, cols + 2 * margin))
    smooth = gaussian_filter(noise, width, mode="wrap", truncate=5.0)[margin:-margin, margin:-margin]
    # Variance that the filter leaves of white noise: the sum of its squared weights.
    weights = np.exp(-0.5 * (np.arange(-margin, margin + 1) / width) ** 2)
    left = float((weights**2).sum() / weights.sum() ** 2)
    sigma = math.sqrt(math.log1p(contrast**2))
    factor = np.exp(sigma * smooth / left - sigma**2 / 2)
    first = (-(cols - 1) / 2 * pitch, -(rows - 1) / 2 * pitch)
    return Clouds(factor.astype(np.float32), first, pitch)
