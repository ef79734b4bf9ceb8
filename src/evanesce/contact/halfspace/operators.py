"""Displacement of an elastic half-space or layer from pressures on a grid, by FFT.

Free (zero padding, Love's cells), periodic, or a layer on bone; and the preconditioner that undoes them roughly.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Array = NDArray[np.float64]
Operator = Callable[[Array], Array]


def love_influence(shape: tuple[int, int], pitch: float, modulus: float) -> Array:
    """Return the surface displacement at (row, col) cells' distance from a cell under unit pressure.

    Parameters
    ----------
    shape : tuple of int
        (rows, cols).
    pitch : float
        Side of a square cell [mm].
    modulus : float
        E* [MPa].

    Returns
    -------
    ndarray (rows, cols)
        [mm/MPa]; Boussinesq's 1/(pi E* r) integrated over the cell in closed form.

    References
    ----------
    A. E. H. Love, Phil. Trans. R. Soc. A 228 (1929) 377; K. L. Johnson, *Contact Mechanics* (1985), section 3.3.
    """
    x = (np.arange(shape[1] + 1) - 0.5)[None, :] * pitch
    y = (np.arange(shape[0] + 1) - 0.5)[:, None] * pitch
    corner = x * np.arcsinh(y / np.abs(x)) + y * np.arcsinh(x / np.abs(y))
    return np.diff(np.diff(corner, axis=0), axis=1) / (np.pi * modulus)


def free_operator(shape: tuple[int, int], pitch: float, modulus: float) -> Operator:
    """Return pressure [MPa] -> displacement [mm] of a half-space loaded on this grid only.

    Zero padding to twice the size makes the circular convolution a linear one; the influence is even, so that its
    spectrum is real.

    Parameters
    ----------
    shape : tuple of int
        Of the grid (rows, cols).
    pitch : float
        [mm].
    modulus : float
        E* [MPa].

    Returns
    -------
    callable
        Pressure (rows, cols) [MPa] -> displacement (rows, cols) [mm].
    """
    rows, cols = shape
    padded = tuple(fft.next_fast_len(2 * n - 1, real=True) for n in shape)
    quadrant = love_influence((padded[0] // 2 + 1, padded[1] // 2 + 1), pitch, modulus)
    down = np.minimum(np.arange(padded[0]), padded[0] - np.arange(padded[0]))
    right = np.minimum(np.arange(padded[1]), padded[1] - np.arange(padded[1]))
    spectrum = fft.rfft2(quadrant[np.ix_(down, right)], workers=-1).real.copy()

    def displacement(pressure: Array) -> Array:
        # row transforms of the padding are zero: leave them out on the way in, and what is cropped on the way out
        wave = fft.rfft(pressure, padded[1], axis=1, workers=-1)
        wave = fft.fft(wave, padded[0], axis=0, workers=-1, overwrite_x=True)
        wave *= spectrum
        wave = fft.ifft(wave, axis=0, workers=-1, overwrite_x=True)[:rows]
        return fft.irfft(wave, padded[1], axis=1, workers=-1)[:, :cols]

    return displacement


def periodic_operator(shape: tuple[int, int], pitch: float, modulus: float) -> Operator:
    """Return pressure [MPa] -> displacement [mm] of a periodic half-space: u_k = 2 p_k/(E* |k|), without its mean.

    Parameters
    ----------
    shape : tuple of int
        Of one period (rows, cols).
    pitch : float
        [mm].
    modulus : float
        E* [MPa].

    Returns
    -------
    callable
        Pressure (rows, cols) [MPa] -> displacement (rows, cols) [mm].
    """
    ky = 2.0 * np.pi * fft.fftfreq(shape[0], pitch)[:, None]
    kx = 2.0 * np.pi * fft.rfftfreq(shape[1], pitch)[None, :]
    k = np.hypot(kx, ky)
    compliance = np.divide(2.0 / modulus, k, out=np.zeros_like(k), where=k > 0)

    def displacement(pressure: Array) -> Array:
        return fft.irfft2(fft.rfft2(pressure, workers=-1) * compliance, shape, workers=-1)

    return displacement


def layered_operator(shape: tuple[int, int], pitch: float, modulus: float, thickness: float) -> Operator:
    """Return pressure [MPa] -> displacement [mm] of an incompressible layer bonded to rigid bone.

    u_k = p_k (sinh 2q - 2q)/(2 G k (cosh 2q + 2 q^2 + 1)), q = k thickness, G = E*/4: a half-space for short waves, p_k
    k^2 thickness^3/(3 G) for long ones. Tissue does not give where it is pressed evenly. The grid is padded by its own
    size; a layer's influence ends within a few thicknesses.

    Parameters
    ----------
    shape : tuple of int
        Of the grid (rows, cols).
    pitch : float
        [mm].
    modulus : float
        E* of the layer's material [MPa].
    thickness : float
        [mm].

    Returns
    -------
    callable
        Pressure (rows, cols) [MPa] -> displacement (rows, cols) [mm].

    References
    ----------
    K. L. Johnson, Contact Mechanics (1985), section 5.8; S. A. Chidlow, W. W. F. Chong and M. Teodorescu, Eur. J.
    Mech. A 43 (2014) 102 (transforms of layers).
    """
    rows, cols = shape
    padded = tuple(fft.next_fast_len(2 * n, real=True) for n in shape)
    k = np.hypot(
        2.0 * np.pi * fft.rfftfreq(padded[1], pitch)[None, :], 2.0 * np.pi * fft.fftfreq(padded[0], pitch)[:, None]
    )
    q = np.maximum(k * thickness, 1e-4)
    # divided by cosh 2q, so that nothing overflows
    decay = 2.0 * np.exp(-2.0 * q) / (1.0 + np.exp(-4.0 * q))
    share = (np.tanh(2.0 * q) - 2.0 * q * decay) / (1.0 + (2.0 * q**2 + 1.0) * decay)
    compliance = np.where(k > 0, 2.0 / modulus * share / np.maximum(k, 1e-12), 0.0)

    def displacement(pressure: Array) -> Array:
        wave = fft.rfft2(pressure, padded, workers=-1) * compliance
        return np.asarray(fft.irfft2(wave, padded, workers=-1)[:rows, :cols])

    return displacement


def wave_number_preconditioner(shape: tuple[int, int]) -> Operator:
    """Return gap -> direction of descent: each wave by its wave number, the inverse of a half-space's compliance.

    Multiples of the wave number are the same preconditioner; this one has ones on its diagonal, so that a single
    cell's overlap asks for as much pressure as without it. The grid is taken as a period, whatever the operator.

    Parameters
    ----------
    shape : tuple of int
        Of the grid (rows, cols).

    Returns
    -------
    callable
        Array (rows, cols) -> array (rows, cols) of the same unit.

    References
    ----------
    H. M. Stanley, T. Kato, J. Tribology 119 (1997) 481 (the compliance of a wave).
    """
    ky = fft.fftfreq(shape[0])[:, None]
    k = np.hypot(fft.rfftfreq(shape[1])[None, :], ky)
    k /= np.hypot(fft.fftfreq(shape[1])[None, :], ky).mean()

    def descent(gap: Array) -> Array:
        return np.asarray(fft.irfft2(fft.rfft2(gap, workers=-1) * k, shape, workers=-1))

    return descent
