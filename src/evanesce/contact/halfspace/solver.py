"""Contact of an elastic half-space with rigid glass for any height map: Polonsky and Keer's conjugate gradients.

The finger is taken as a half-space that carries its shape as a height map; frictionless, small slopes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.halfspace.operators import (
    Array,
    Operator,
    free_operator,
    layered_operator,
    periodic_operator,
    wave_number_preconditioner,
)
from evanesce.core.errors import WorkError

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
    directions are no longer conjugate, and takes a fifth of the iterations. Preconditioning by the wave number, which
    undoes a half-space's compliance, takes a quarter of these; where the contact is stable, the gap follows from the
    last response without a transform.

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
    precondition = wave_number_preconditioner(heights.shape)
    direction, before = np.zeros_like(pressure), np.zeros_like(pressure)
    gap = heights + operator(pressure)
    last, residual, iterations = 1.0, np.inf, 0
    for _ in range(max_iterations):
        iterations += 1
        touching = pressure > 0
        gap -= gap[touching].mean()
        residue = np.where(touching, gap, 0.0)
        descent = precondition(residue)
        square = float((residue * descent).sum())
        conjugate = max(0.0, float((descent * (residue - before)).sum()) / last) if iterations > 1 else 0.0
        direction = descent + conjugate * direction
        # on the contact and without a mean, so that the force stays
        direction = np.where(touching, direction - direction[touching].mean(), 0.0)
        before, last = residue, square
        response = operator(direction)
        curvature = float((response * direction).sum())
        if square == 0.0 or curvature <= 0.0:  # the start already solves the problem
            residual = 0.0
            break
        step = float((residue * direction).sum()) / curvature
        stepped = pressure - step * direction
        update = np.maximum(stepped, 0.0)
        overlap = (update == 0) & (gap < 0)
        update[overlap] -= step * gap[overlap]
        update *= total / update.sum()
        residual = float(np.abs(update - pressure).sum()) / total
        stable = stepped.min() >= 0 and not overlap.any()
        pressure = update
        if residual < tolerance:
            break
        gap = gap - step * response if stable else heights + operator(pressure)
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
