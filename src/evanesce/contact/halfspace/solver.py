"""Contact of an elastic half-space with rigid glass for any height map: Polonsky and Keer's conjugate gradients.

The finger is taken as a half-space that carries its shape as a height map; frictionless, small slopes. Displacements
come from pressures by FFT, free (zero padding, Love's cells) or periodic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from evanesce.core.errors import WorkError

Array = NDArray[np.float64]
Operator = Callable[[Array], Array]

_COARSEST = 96


@dataclass(frozen=True)
class HalfspaceSolution:
    """Pressed height map.

    Attributes
    ----------
    pressure : ndarray (rows, cols)
        [MPa]; negative only where adhesion pulls.
    gap : ndarray (rows, cols)
        [mm]; zero in contact.
    depth : float
        Approach [mm]: how far the height map's zero moved towards the glass. Without a far field (periodic) it is
        counted from the mean displacement.
    iterations : int
        Of the finest level.
    residual : float
        Last relative change of the pressure, summed over the contact.
    """

    pressure: Array
    gap: Array
    depth: float
    iterations: int
    residual: float


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


def press_height_map(
    heights: Array,
    pitch: float,
    modulus: float,
    force: float,
    *,
    periodic: bool = False,
    layer: float | None = None,
    tolerance: float = 1e-5,
    max_iterations: int = 2000,
    start: Array | None = None,
) -> HalfspaceSolution:
    """Press an elastic half-space of a given height map against rigid glass.

    Parameters
    ----------
    heights : ndarray (rows, cols)
        Undeformed distance from the glass [mm], up to a constant.
    pitch : float
        Sampling [mm].
    modulus : float
        Reduced modulus E* [MPa].
    force : float
        Normal force on the whole map [N], positive.
    periodic : bool
        The map repeats for ever; otherwise nothing outside it is loaded.
    layer : float, optional
        Thickness [mm] of an incompressible layer on rigid bone, instead of a half-space.
    tolerance : float
        Relative change of the pressure at which to stop.
    max_iterations : int
    start : ndarray (rows, cols), optional
        Pressure to start from [MPa]; by default the solution on a grid of half the resolution.

    Returns
    -------
    HalfspaceSolution
        A free map that is touched up to its border has lost contact it should have had: look at ``pressure`` there.

    Raises
    ------
    ValueError
        For a force, pitch or modulus that is not positive, or heights that are not finite.
    WorkError
        If the pressure has not settled after ``max_iterations``.

    References
    ----------
    I. A. Polonsky, L. M. Keer, Wear 231 (1999) 206; H. M. Stanley, T. Kato, J. Tribology 119 (1997) 481 (FFT);
    E. Polak, G. Ribiere, Rev. Fr. Inform. Rech. Oper. 3 (1969) 35.
    """
    if not (force > 0 and pitch > 0 and modulus > 0):
        raise ValueError(f"force {force:g} N, pitch {pitch:g} mm and E* {modulus:g} MPa must be positive")
    if not np.isfinite(heights).all():
        raise ValueError("heights must be finite")
    if start is None:
        start = _coarse_start(heights, pitch, modulus, force, periodic, max_iterations, layer)
    if layer is not None:
        operator = layered_operator(heights.shape, pitch, modulus, layer)
        return conjugate_gradients(
            heights, operator, pitch, force, start, tolerance=tolerance, max_iterations=max_iterations
        )
    if periodic:
        operator = periodic_operator(heights.shape, pitch, modulus)
        return conjugate_gradients(
            heights, operator, pitch, force, start, tolerance=tolerance, max_iterations=max_iterations
        )
    return _press_in_box(heights, pitch, modulus, force, start, tolerance, max_iterations)


def conjugate_gradients(
    heights: Array,
    operator: Operator,
    pitch: float,
    force: float,
    start: Array,
    *,
    tolerance: float,
    max_iterations: int,
) -> HalfspaceSolution:
    """Find p >= 0 with gap >= 0, p gap = 0 and the given force, for any displacement operator.

    ``start`` need not carry the force. Polonsky and Keer restart the conjugate directions whenever cells come into
    contact, which near closed furrows is nearly always; Polak and Ribiere's factor, cut at zero, restarts only when the
    directions are no longer conjugate, and takes a fifth of the iterations.

    Parameters
    ----------
    heights : ndarray (rows, cols)
        Undeformed distance from the glass [mm].
    operator : callable
        Pressure [MPa] -> displacement [mm].
    pitch : float
        [mm].
    force : float
        [N], above 0.
    start : ndarray (rows, cols)
        First guess of the pressure [MPa].
    tolerance : float
    max_iterations : int

    Returns
    -------
    HalfspaceSolution
    """
    total = force / pitch**2
    pressure = np.maximum(start, 0.0)
    pressure = pressure * (total / pressure.sum()) if pressure.any() else np.full(heights.shape, total / heights.size)
    direction, before = np.zeros_like(pressure), np.zeros_like(pressure)
    last, residual, iterations = 1.0, np.inf, 0
    for _ in range(max_iterations):
        iterations += 1
        touching = pressure > 0
        gap = heights + operator(pressure)
        gap -= gap[touching].mean()
        residue = np.where(touching, gap, 0.0)
        square = float((residue**2).sum())
        conjugate = max(0.0, float((residue * (residue - before)).sum()) / last) if iterations > 1 else 0.0
        direction = np.where(touching, residue + conjugate * direction, 0.0)
        before, last = residue, square
        response = operator(direction)
        response -= response[touching].mean()
        curvature = float((response * direction).sum())
        if square == 0.0 or curvature <= 0.0:  # the start already solves the problem
            residual = 0.0
            break
        step = float((residue * direction).sum()) / curvature
        update = np.maximum(pressure - step * direction, 0.0)
        overlap = (update == 0) & (gap < 0)
        update[overlap] -= step * gap[overlap]
        update *= total / update.sum()
        residual = float(np.abs(update - pressure).sum()) / total
        pressure = update
        if residual < tolerance:
            break
    else:
        raise WorkError(f"half-space contact has not settled after {max_iterations} iterations (change {residual:.1e})")
    gap = heights + operator(pressure)
    depth = float(np.average(gap, weights=pressure))
    gap -= depth
    gap = np.where(pressure > 0, 0.0, np.maximum(gap, 0.0))
    return HalfspaceSolution(pressure, gap, depth, iterations, residual)


def _coarse_start(
    heights: Array,
    pitch: float,
    modulus: float,
    force: float,
    periodic: bool,
    max_iterations: int,
    layer: float | None = None,
) -> Array:
    """Return the pressure of the half as finely sampled problem, or an even one where that is too coarse."""
    rows, cols = heights.shape
    if min(rows, cols) < 2 * _COARSEST or rows % 2 or cols % 2:
        return np.zeros(heights.shape)
    halved = heights.reshape(rows // 2, 2, cols // 2, 2).mean(axis=(1, 3))
    coarse = press_height_map(
        halved, 2 * pitch, modulus, force, periodic=periodic, layer=layer, tolerance=1e-3, max_iterations=max_iterations
    )
    return np.repeat(np.repeat(coarse.pressure, 2, axis=0), 2, axis=1)


def _press_in_box(
    heights: Array, pitch: float, modulus: float, force: float, start: Array, tolerance: float, max_iterations: int
) -> HalfspaceSolution:
    """Solve on the smallest box that holds the contact, then look outside it and widen it if something overlaps."""
    whole = (slice(0, heights.shape[0]), slice(0, heights.shape[1]))
    box = _box(start > 0, heights.shape) if start.any() else whole
    while True:
        part = heights[box]
        found = conjugate_gradients(
            part,
            free_operator(part.shape, pitch, modulus),
            pitch,
            force,
            start[box],
            tolerance=tolerance,
            max_iterations=max_iterations,
        )
        if box == whole:
            return found
        pressure = np.zeros(heights.shape)
        pressure[box] = found.pressure
        gap = heights + free_operator(heights.shape, pitch, modulus)(pressure) - found.depth
        gap[box] = found.gap
        if gap.min() >= 0 and not _touches_border(found.pressure):
            return HalfspaceSolution(pressure, gap, found.depth, found.iterations, found.residual)
        # growing by a margin each time, the box ends as the whole map at the latest
        wider = np.zeros(heights.shape, dtype=bool)
        wider[box] = True
        start, box = pressure, _box(wider | (gap < 0), heights.shape)


def _touches_border(pressure: Array) -> bool:
    return bool(pressure[[0, -1]].any() or pressure[:, [0, -1]].any())


def _box(where: NDArray[np.bool_], shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return slices around the True cells with a margin of a tenth of their extent, at least 8 cells."""
    slices = []
    for axis in (0, 1):
        hit = np.flatnonzero(where.any(axis=1 - axis))
        margin = max(8, (hit[-1] - hit[0]) // 10)
        slices.append(slice(max(0, int(hit[0]) - margin), min(shape[axis], int(hit[-1]) + 1 + margin)))
    return slices[0], slices[1]
