"""What one colour of a Bayer sensor resolves: closed form, and a frame of stripes, edges or grooves to compare with.

Light of one narrow colour reaches one pixel in four; bilinear interpolation fills in the others. Lengths are in pixels.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.studies.voltage.grey import bilinear

Array = NDArray[np.float64]

FINE = 32
"""Samples a pixel of the light that pixels integrate."""


def pixel_transfer(frequency: ArrayLike) -> Array:
    """Return the modulation transfer of square pixels, |sinc(f)|.

    Parameters
    ----------
    frequency : array_like
        Along a row [cycles/px].

    Returns
    -------
    ndarray
        [1].
    """
    return np.abs(np.sinc(np.asarray(frequency, float)))


def red_transfer(frequency: ArrayLike) -> Array:
    """Return the modulation transfer of bilinear red, |sinc(f)| cos^2(pi f), valid up to its Nyquist limit of 1/4.

    Red samples are 2 px apart; the kernel (1, 2, 1)/2 between them has the transfer (1 + cos 2 pi f)/2.

    Parameters
    ----------
    frequency : array_like
        Along a row [cycles/px].

    Returns
    -------
    ndarray
        [1].
    """
    f = np.asarray(frequency, float)
    return pixel_transfer(f) * np.cos(np.pi * f) ** 2


def sampled(light: Callable[[Array], Array], pixels: int = 64) -> Array:
    """Return what pixels collect of light that varies along the rows only.

    Parameters
    ----------
    light : callable
        Of positions [px], 0 at the middle of the frame.
    pixels : int
        Side of the frame.

    Returns
    -------
    ndarray (pixels, pixels)
        Mean over each pixel, by the midpoint rule.
    """
    x = (np.arange(pixels * FINE) + 0.5) / FINE - pixels / 2
    row = light(x).reshape(pixels, FINE).mean(axis=1)
    return np.repeat(row[None, :], pixels, axis=0)


def as_red(collected: Array) -> Array:
    """Return the red channel of a mosaic that only red pixels see, bilinear (rows, cols).

    Parameters
    ----------
    collected : ndarray (rows, cols)

    Returns
    -------
    ndarray (rows, cols)
    """
    return bilinear(collected, "RGGB")[..., 0]


def edge_transfer(frequency: ArrayLike, red: bool, phases: int = 32) -> Array:
    """Return the modulation transfer measured on a simulated edge that is moved in fractions of the sampling.

    Parameters
    ----------
    frequency : array_like (n,)
        [cycles/px].
    red : bool
        Of red; else of a monochrome sensor.
    phases : int
        Positions of the edge within two pixels.

    Returns
    -------
    ndarray (n,)
        [1].
    """
    positions, values = [], []
    for shift in 2.0 * np.arange(phases) / phases:
        frame = sampled(lambda x, shift=shift: (x > shift).astype(float))  # type: ignore[misc]
        row = (as_red(frame) if red else frame)[32]
        positions.append(np.arange(64) + 0.5 - 32 - shift)
        values.append(row)
    x, e = np.concatenate(positions), np.concatenate(values)
    order = np.argsort(x, kind="stable")
    x, e = x[order], e[order]
    inner = np.abs(x) < 24
    spread, middle = np.diff(e[inner]), (x[inner][1:] + x[inner][:-1]) / 2
    f = np.atleast_1d(np.asarray(frequency, float))
    return np.asarray(np.abs(np.exp(-2j * np.pi * f[:, None] * middle[None, :]) @ spread))


def narrowest_groove(seen: Callable[[Array], Array], cut: float, blur: float, widths: Array, phases: int = 8) -> float:
    """Return the narrowest dark groove of a bright plain that a threshold separates wherever it lies.

    Parameters
    ----------
    seen : callable
        From collected light, 1 on the plain (rows, cols), to values of which the bright exceed ``cut``.
    cut : float
    blur : float
        Standard deviation of the lens [px].
    widths : ndarray
        Tried, rising [px].
    phases : int
        Positions within two pixels.

    Returns
    -------
    float
        [px]; infinite where none is separated.
    """
    from scipy.special import erf

    root = np.sqrt(2.0) * max(blur, 1e-6)
    for width in widths:
        gaps = []
        for shift in 2.0 * np.arange(phases) / phases:

            def light(x: Array, at: float = shift, half: float = width / 2) -> Array:
                return np.asarray(1.0 - (erf((x - at + half) / root) - erf((x - at - half) / root)) / 2)

            gaps.append(bool((seen(sampled(light, 32))[12:20, 8:24] <= cut).any(axis=1).all()))
        if all(gaps):
            return float(width)
    return float("inf")
