"""Subsurface scattering in the fast renderer: light that enters the silicone at a contact and leaves beside it."""

from __future__ import annotations

import math
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


@dataclass(frozen=True)
class Subsurface:
    """What of subsurface scattering is computed once per rig.

    Attributes
    ----------
    cell : float
        [mm].
    kernel : ndarray (2 reach + 1, 2 reach + 1)
        Of :func:`evanesce.optics.subsurface.profile_kernel`, sides in cells.
    inside : ndarray (gaps,)
        Reflectance that the body's light meets at its surface [1].
    leave : ndarray (gaps,)
        Radiance in air towards the lens per irradiance that reaches the surface from inside [1/sr].
    share : float
        Of the returned light that is scattered; the rest leaves where it entered [1].
    """

    cell: float
    kernel: Array
    inside: Array
    leave: Array
    share: float = 1.0


def subsurface_of(
    interface: Interface, length: float, size: float, pitch: float, gaps: Array, view: float, window: float
) -> Subsurface:
    """Return the tables of subsurface scattering.

    Parameters
    ----------
    interface : Interface
    length : float
        Transport mean free path in the silicone [mm].
    size : float
        Side of the contact grid [mm].
    pitch : float
        Its pitch [mm].
    gaps : ndarray
        Gaps of the tables [mm]; the last stands for all wider ones.
    view : float
        Angle inside the glass under which the lens sees the contact [rad].
    window : float
        Radiance in air over radiance at the top face, on the way to the lens [1].
    """
    cell = min(LARGEST_CELL_MM, max(length / 4, pitch))
    kernel = profile_kernel(interface.body_reflectance, length, cell, math.ceil(size / cell))
    n1, n3 = interface.n_glass, interface.n_silicone
    by_gap = kept(
        "inside reflectance",
        f"{gaps.size} {gaps[-1]:.17g} {interface.wavelength:.17g} {n1:.17g} {n3:.17g}",
        lambda: np.array(internal_diffuse_reflectance(gaps, interface.wavelength, n1, n3)),
    )
    inside = by_gap.copy()
    through = np.array(frustrated_transmittance(np.cos(view), gaps, interface.wavelength, n1, n3))
    # The lens's aperture averages the fringes of wider films.
    inside[-1] = open_inside_reflectance(n3, n1)
    cos_inside = math.sqrt(1.0 - min(1.0, (n1 / n3 * math.sin(view)) ** 2))
    through[-1] = open_film_transmittance(cos_inside, n3, n1)
    leave = through / np.pi * (n1 / n3) ** 2 * window
    return Subsurface(cell, kernel, inside, np.asarray(leave))


def body_light(kernel: Array, irradiance: Array, inside: Array) -> Array:
    """Return the irradiance that reaches the surface from inside: J = K * (E + R J).

    Light that the surface sends back enters anew where it is, and spreads again. With z = sqrt(R) J the equation is
    symmetric and positive definite: (1 - sqrt(R) K sqrt(R)) z = sqrt(R) K E, solved by conjugate gradients.

    Parameters
    ----------
    kernel : ndarray (2 rows + 1, 2 cols + 1) or larger, odd
        K: of what enters a cell, the share that comes back to the surface in each cell around it; the same to either
        side.
    irradiance : ndarray (rows, cols)
        E: enters through the surface [W/mm^2].
    inside : ndarray (rows, cols)
        R: reflectance of the surface from inside [1].
    """
    rows, cols = irradiance.shape
    middle_y, middle_x = kernel.shape[0] // 2, kernel.shape[1] // 2
    reach_y, reach_x = min(rows - 1, middle_y), min(cols - 1, middle_x)
    cut = kernel[middle_y - reach_y : middle_y + reach_y + 1, middle_x - reach_x : middle_x + reach_x + 1]
    shape: Any = [fft.next_fast_len(n + r, real=True) for n, r in ((rows, reach_y), (cols, reach_x))]
    # Padded by one reach: what wraps falls outside the rows and columns that are kept.
    around = np.zeros(shape, np.float32)
    index_y, index_x = np.arange(-reach_y, reach_y + 1) % shape[0], np.arange(-reach_x, reach_x + 1) % shape[1]
    around[index_y[:, None], index_x[None, :]] = cut
    transform = fft.rfft2(around)

    def spread(field: Array) -> Array:
        return np.asarray(fft.irfft2(fft.rfft2(field, shape) * transform, shape)[:rows, :cols])

    root, once = np.sqrt(inside).astype(np.float32), spread(irradiance.astype(np.float32))
    residual = root * once
    found, way = np.zeros_like(residual), residual
    square, enough = float(np.vdot(residual, residual)), SOLVED**2 * float(np.vdot(once, once))
    for _ in range(200):
        if square <= enough:
            break
        image = way - root * spread(root * way)
        length = square / float(np.vdot(way, image))
        found, residual = found + length * way, residual - length * image
        before, square = square, float(np.vdot(residual, residual))
        way = residual + (square / before) * way
    return np.asarray(once + spread(root * found), float)


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
    found = body_light(tables.kernel, entering, inside)
    body = cv2.resize(np.asarray(found, np.float32), (cols, rows), interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.maximum(body, 0.0) * at(tables.leave), np.float32)
