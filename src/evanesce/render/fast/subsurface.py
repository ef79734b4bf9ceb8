"""Subsurface scattering in the fast renderer: light that enters the silicone at a contact and leaves beside it."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from evanesce.optics.interface import frustrated_transmittance, internal_diffuse_reflectance
from evanesce.optics.patch_light import Interface
from evanesce.optics.subsurface import open_film_transmittance, open_inside_reflectance, profile_kernel
from evanesce.render.kept import kept

Array = NDArray[np.float64]
Image = NDArray[np.float32]

LARGEST_CELL_MM = 0.0625
"""Largest cell of the grid on which scattered light is solved [mm]: an eighth of a ridge of the thesis."""


SOLVED = 1e-5
"""Residual of the light in the body over what enters it, root mean squares, at which it is solved."""

ROUNDED = 1e-6
"""Reflectances that differ by less are the same [1]."""

BOX_CELLS, SHAPES_KEPT = 16, 16
"""Sides of what is solved are multiples of so many cells: transforms for so many shapes are kept."""


class Spread:
    """How light that enters one cell of the surface spreads over it, where the surface is the same everywhere.

    What reaches a surface of reflectance R from inside is partly sent back, and spreads again: K + K R K + ... of what
    the body returns once, K. In an endless plane that is a product of Fourier transforms.

    Parameters
    ----------
    kernel : ndarray (2 reach + 1, 2 reach + 1)
        K: of what enters a cell, the share that comes back to the surface in each cell around it; the same to either
        side.
    beyond : float
        R [1].
    """

    def __init__(self, kernel: Array, beyond: float = 0.0) -> None:
        self.beyond = beyond
        self.kernel = kernel if beyond == 0.0 else _returned(kernel, beyond)
        self._over: OrderedDict[tuple[int, int], Callable[[Image], Image]] = OrderedDict()

    def over(self, shape: tuple[int, int]) -> Callable[[Image], Image]:
        """Return what spreads irradiance over a grid (rows, cols) of that shape.

        Parameters
        ----------
        shape : tuple of int
        """
        if shape not in self._over:
            self._over[shape] = self._made(*shape)
            while len(self._over) > SHAPES_KEPT:
                self._over.popitem(last=False)
        self._over.move_to_end(shape)
        return self._over[shape]

    def _made(self, rows: int, cols: int) -> Callable[[Image], Image]:
        middle = [n // 2 for n in self.kernel.shape]
        reach_y, reach_x = (min(n - 1, m) for n, m in zip((rows, cols), middle, strict=True))
        cut = self.kernel[middle[0] - reach_y : middle[0] + reach_y + 1, middle[1] - reach_x : middle[1] + reach_x + 1]
        # Padded by one reach: what wraps falls outside the rows and columns that are kept.
        shape: Any = [fft.next_fast_len(n + r, real=True) for n, r in ((rows, reach_y), (cols, reach_x))]
        transform = fft.rfft2(_about_origin(cut, shape).astype(np.float32))
        return lambda field: fft.irfft2(fft.rfft2(field, shape) * transform, shape)[:rows, :cols]


def _about_origin(kernel: Array, shape: tuple[int, int]) -> Array:
    """Return a kernel, odd in its sides, on a periodic grid with its middle at the first cell."""
    found = np.zeros(shape)
    at = [np.arange(-(n // 2), n // 2 + 1) % size for n, size in zip(kernel.shape, shape, strict=True)]
    found[np.ix_(*at)] = kernel
    return found


def _returned(kernel: Array, beyond: float) -> Array:
    """Return K / (1 - R K) of a kernel K (2 reach + 1, 2 reach + 1), as far as that reaches."""
    # So far apart that what wraps around has been sent back once more than what the kernel reaches.
    shape: Any = [fft.next_fast_len(n + n // 2, real=True) for n in kernel.shape]
    once = fft.rfft2(_about_origin(kernel, shape).astype(np.float32))
    found = fft.irfft2(once / (1.0 - beyond * once), shape)
    at = [np.arange(-(n // 2), n // 2 + 1) for n in kernel.shape]
    return np.asarray(found[np.ix_(*at)])


@dataclass(frozen=True)
class Subsurface:
    """What of subsurface scattering is computed once per rig.

    Attributes
    ----------
    cell : float
        [mm].
    spread : Spread
        Of :func:`evanesce.optics.subsurface.profile_kernel` in cells, below an open surface.
    inside : ndarray (gaps,)
        Reflectance that the body's light meets at its surface [1]; the open surface has the largest.
    leave : ndarray (gaps,)
        Radiance in air towards the lens per irradiance that reaches the surface from inside [1/sr].
    share : float
        Of the returned light that is scattered; the rest leaves where it entered [1].
    """

    cell: float
    spread: Spread
    inside: Array
    leave: Array
    share: float = 1.0


def spread_of(reflectance: float, length: float, size: float, pitch: float, beyond: float) -> tuple[float, Spread]:
    """Return the side of the cells on which scattered light is solved [mm], and its spread below an open surface.

    Parameters
    ----------
    reflectance : float
        Diffuse reflectance of the body [1].
    length : float
        Transport mean free path in the silicone [mm].
    size : float
        Side of the contact grid [mm].
    pitch : float
        Its pitch [mm].
    beyond : float
        Reflectance of the open surface from inside [1].
    """
    cell = min(LARGEST_CELL_MM, max(length / 4, pitch))
    return cell, Spread(profile_kernel(reflectance, length, cell, math.ceil(size / cell)), beyond)


def surface_of(interface: Interface, gaps: Array, view: float, window: float) -> tuple[Array, Array]:
    """Return :attr:`Subsurface.inside` and :attr:`Subsurface.leave` at the gaps of the tables.

    Parameters
    ----------
    interface : Interface
    gaps : ndarray
        Gaps of the tables [mm]; the last stands for all wider ones.
    view : float
        Angle inside the glass under which the lens sees the contact [rad].
    window : float
        Radiance in air over radiance at the top face, on the way to the lens [1].
    """
    n1, n3 = interface.n_glass, interface.n_silicone
    by_gap = kept(
        "inside reflectance",
        f"{gaps.size} {gaps[-1]:.17g} {interface.wavelength:.17g} {n1:.17g} {n3:.17g}",
        lambda: np.array(internal_diffuse_reflectance(gaps, interface.wavelength, n1, n3)),
    )
    open_inside = open_inside_reflectance(n3, n1)
    # The lens's aperture averages the fringes of wider films, by which some films reflect a thousandth more than these.
    inside = np.minimum(by_gap, open_inside)
    inside[-1] = open_inside
    through = np.array(frustrated_transmittance(np.cos(view), gaps, interface.wavelength, n1, n3))
    cos_inside = math.sqrt(1.0 - min(1.0, (n1 / n3 * math.sin(view)) ** 2))
    through[-1] = open_film_transmittance(cos_inside, n3, n1)
    return inside, np.asarray(through / np.pi * (n1 / n3) ** 2 * window)


def body_light(spread: Spread, irradiance: Array, inside: Array) -> Array:
    """Return the irradiance that reaches the surface from inside: J = K * (E + R J).

    With L the light's spread below a surface of reflectance R' everywhere, J = L * (E + (R - R') J): unknown is J only
    where R differs from R'. With z = sqrt(|R - R'|) J the equation is symmetric and positive definite there, and solved
    by conjugate gradients.

    Parameters
    ----------
    spread : Spread
        L; R' is also that of the surface beyond the grid.
    irradiance : ndarray (rows, cols)
        E: enters through the surface [W/mm^2].
    inside : ndarray (rows, cols)
        R: reflectance of the surface from inside [1]; nowhere below R' or nowhere above it.

    Raises
    ------
    ValueError
        If R is below R' at one place and above it at another.
    """
    differs = inside.astype(np.float32) - np.float32(spread.beyond)
    sign = np.float32(-1.0 if differs.min() < 0.0 else 1.0)
    if (sign * differs).min() < -ROUNDED:
        raise ValueError("a surface that reflects more at one place and less at another than beyond the grid")
    box = _box((np.abs(differs) > ROUNDED) | (irradiance != 0.0))
    entering = irradiance[box].astype(np.float32)
    root = np.sqrt(np.abs(differs[box]))
    own = spread.over((entering.shape[0], entering.shape[1]))
    once = own(entering)
    residual = root * once
    found, way = np.zeros_like(residual), residual
    square, enough = float(np.vdot(residual, residual)), SOLVED**2 * float(np.vdot(once, once))
    for _ in range(200):
        if square <= enough:
            break
        image = way - sign * root * own(root * way)
        length = square / float(np.vdot(way, image))
        found, residual = found + length * way, residual - length * image
        before, square = square, float(np.vdot(residual, residual))
        way = residual + (square / before) * way
    rows, cols = irradiance.shape
    whole = np.zeros((rows, cols), np.float32)
    whole[box] = entering + sign * root * found
    return spread.over((rows, cols))(whole).astype(float)


def _box(some: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the rows and columns of a box about some cells, sides in steps of :data:`BOX_CELLS` where they can be."""
    col, row, wide, high = cv2.boundingRect(some.astype(np.uint8))
    found = []
    for first, length, count in ((row, high, some.shape[0]), (col, wide, some.shape[1])):
        side = min(max(-(-length // BOX_CELLS) * BOX_CELLS, 1), count)
        start = min(first, count - side)
        found.append(slice(start, start + side))
    return found[0], found[1]


def subsurface_radiance(
    tables: Subsurface,
    irradiance: Image,
    share: Image,
    low: NDArray[np.int32],
    part: Image,
    pitch: float,
    within: tuple[tuple[slice, slice], tuple[int, int]],
) -> Image:
    """Return the radiance towards the lens on the whole refined grid; only a part of it couples light.

    Parameters
    ----------
    tables : Subsurface
    irradiance : ndarray (rows, cols)
        That enters the silicone in that part [W/mm^2].
    share : ndarray (rows, cols)
        Share in contact; asperities are finer than the scattering length, so that the body sees the mean of both parts.
    low, part : ndarray (rows, cols)
        Position of the other part's gap in the tables: node below, and the fraction beyond it.
    pitch : float
        Of the refined grid [mm].
    within : tuple
        Rows and columns of the part, and the grid's shape.
    """
    place, shape = within

    def whole(inside: Image, beside: float) -> Image:
        found = np.full(shape, beside, np.float32)
        found[place] = inside
        return found

    def at(table: Array) -> Image:
        table32 = table.astype(np.float32)
        apart = np.take(table32, low) * (1 - part) + np.take(table32[1:], low) * part
        return whole(share * table32[0] + (1 - share) * apart, float(table32[-1]))

    rows, cols = shape
    coarse = (max(1, round(cols * pitch / tables.cell)), max(1, round(rows * pitch / tables.cell)))
    entering = cv2.resize(whole(irradiance, 0.0), coarse, interpolation=cv2.INTER_AREA).astype(float)
    inside = cv2.resize(at(tables.inside), coarse, interpolation=cv2.INTER_AREA).astype(float)
    found = body_light(tables.spread, entering, inside)
    body = cv2.resize(np.asarray(found, np.float32), (cols, rows), interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.maximum(body, 0.0) * at(tables.leave), np.float32)
