"""Subsurface scattering: light that leaves a scattering body beside the point where it entered.

Diffuse light enters a half-space through its surface. The share of what enters at a point that leaves at distance r,
per area, is a profile R(r) of the body's reflectance A (its integral over the plane) and of the transport mean free
path l = 1/(sigma_s' + sigma_a). Boundary index-matched: what the surface reflects back inside is left to the
caller.

References
----------
P. H. Christensen and B. Burley, "Approximate reflectance profiles for efficient subsurface scattering", Pixar technical
memo 15-04 (2015), the profile used, in its form for diffuse incidence.
H. W. Jensen, S. R. Marschner, M. Levoy and P. Hanrahan, "A practical model for subsurface light transport", SIGGRAPH
2001, 511, the dipole, for comparison: for a narrow incident beam, and far from it.
B. Hapke, "Bidirectional reflectance spectroscopy. 1. Theory", J. Geophysical Research 86 (1981) 3039, equation 41 for
diffuse light on a half-space.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from evanesce.core.quadrature import gauss_legendre
from evanesce.optics.interface import fresnel_reflectance

Array = NDArray[np.float64]
NEAR_CELLS = 8
"""Cells from the middle within which the profile is integrated, not sampled."""


def profile_scale(albedo: float, length: float) -> float:
    """Return d [mm] of :func:`profile`: l/s, s = 1.9 - A + 3.5 (A - 0.8)^2.

    Parameters
    ----------
    albedo : float
        Diffuse reflectance A of the body [1].
    length : float
        Transport mean free path l [mm].
    """
    return length / (1.9 - albedo + 3.5 * (albedo - 0.8) ** 2)


def profile(r: ArrayLike, albedo: float, length: float) -> Array:
    """Return what leaves at distance r per area, over what entered: A (e^(-r/d) + e^(-r/3d))/(8 pi d r) [1/mm^2].

    Parameters
    ----------
    r : array_like
        Distance, above 0 [mm].
    albedo : float
        Diffuse reflectance A of the body [1].
    length : float
        Transport mean free path l [mm].

    Returns
    -------
    ndarray
        Shape of ``r``.
    """
    r, d = np.asarray(r, float), profile_scale(albedo, length)
    return np.asarray(albedo * (np.exp(-r / d) + np.exp(-r / (3 * d))) / (8 * np.pi * d * r))


def share_within(r: ArrayLike, albedo: float, length: float) -> Array:
    """Return the share of what leaves that does so within r: 1 - e^(-r/d)/4 - 3 e^(-r/3d)/4.

    Parameters
    ----------
    r : array_like
        [mm].
    albedo, length : float
        As for :func:`profile`.

    Returns
    -------
    ndarray
        Shape of ``r`` [1].
    """
    x = np.asarray(r, float) / profile_scale(albedo, length)
    return np.asarray(-0.25 * np.expm1(-x) - 0.75 * np.expm1(-x / 3))


def dipole_profile(r: ArrayLike, scattering: float, absorption: float) -> Array:
    """Return the diffuse dipole of Jensen et al. for a matched boundary [1/mm^2].

    Parameters
    ----------
    r : array_like
        [mm].
    scattering, absorption : float
        sigma_s' and sigma_a [1/mm].
    """
    r, total = np.asarray(r, float), scattering + absorption
    decay = np.sqrt(3.0 * absorption * total)
    real = 1.0 / total
    virtual = real + 4.0 / (3.0 * total)
    result = np.zeros(r.shape)
    for z in (real, virtual):
        distance = np.sqrt(r * r + z * z)
        result += z * (decay * distance + 1.0) * np.exp(-decay * distance) / distance**3
    return np.asarray(scattering / total * result / (4 * np.pi))


def half_space_reflectance(single_albedo: ArrayLike) -> Array:
    """Return the diffuse reflectance of a half-space of isotropic scatterers under diffuse light (Hapke).

    Parameters
    ----------
    single_albedo : array_like
        Albedo of a single scattering [1].

    Returns
    -------
    ndarray
        Shape of ``single_albedo`` [1].
    """
    gamma = np.sqrt(1.0 - np.asarray(single_albedo, float))
    return np.asarray((1 - gamma) / (1 + gamma) * (1 - gamma / (3 * (1 + gamma))))


def absorption_coefficient(albedo: float, length: float) -> float:
    """Return sigma_a [1/mm] of a body of reflectance A and transport mean free path l [mm].

    Parameters
    ----------
    albedo : float
        A [1].
    length : float
        l [mm].
    """
    if albedo >= 1.0:
        return 0.0
    single = brentq(lambda s: float(half_space_reflectance(s)) - albedo, 0.0, 1.0)
    return float((1.0 - single) / length)


def profile_kernel(albedo: float, length: float, cell: float, reach: int) -> Array:
    """Return the share of what enters one square cell's middle that leaves in each cell around it.

    Parameters
    ----------
    albedo, length : float
        A [1], l [mm].
    cell : float
        Side of a cell [mm].
    reach : int
        Cells to either side.

    Returns
    -------
    ndarray (2 reach + 1, 2 reach + 1)
        Sums to A less what leaves beyond.
    """
    steps = np.arange(reach + 1) * cell
    r = np.hypot(steps[None, :], steps[:, None])
    r[0, 0] = cell  # integrated below
    quadrant = profile(r, albedo, length) * cell**2
    # Near the middle the profile bends within a cell.
    near, parts = min(NEAR_CELLS, reach + 1), 9
    offset = ((np.arange(parts) + 0.5) / parts - 0.5) * cell
    fine = (steps[:near, None] + offset).ravel()
    r = np.hypot(fine[None, :], fine[:, None])
    r[r == 0.0] = cell
    cells = (profile(r, albedo, length) * (cell / parts) ** 2).reshape(near, parts, near, parts)
    quadrant[:near, :near] = cells.sum(axis=(1, 3))
    # In polar coordinates the 1/r is gone: eight triangles, each the encircled share up to the cell's side.
    u, w = gauss_legendre(24)
    angle = np.pi / 8 * (u + 1)
    within = share_within(0.5 * cell / np.cos(angle), albedo, length)
    quadrant[0, 0] = albedo * 8 / (2 * np.pi) * float(np.pi / 8 * w @ within)
    half = np.concatenate([quadrant[:0:-1], quadrant])
    return np.concatenate([half[:, :0:-1], half], axis=1)


def open_film_transmittance(cos_theta: ArrayLike, n_body: float, n_glass: float) -> Array:
    """Return the transmittance from body to glass through a film of air many wavelengths thick (no interference).

    Parameters
    ----------
    cos_theta : array_like
        Cosine of the angle of incidence in the body [1].
    n_body, n_glass : float
        [1].

    Returns
    -------
    ndarray
        Shape of ``cos_theta`` [1].
    """
    cos_theta = np.asarray(cos_theta, float)
    sin2_air = np.minimum(n_body**2 * (1.0 - cos_theta**2), 1.0)
    first = fresnel_reflectance(cos_theta, n_body, 1.0)
    second = fresnel_reflectance(np.sqrt(1.0 - sin2_air), 1.0, n_glass)
    both = (1.0 - first) * (1.0 - second)
    return np.divide(both, 1.0 - first * second, out=np.zeros(cos_theta.shape), where=first < 1.0)


def open_inside_reflectance(n_body: float, n_glass: float) -> float:
    """Return the reflectance that diffuse light in the body meets at its surface across such a film from the glass.

    Parameters
    ----------
    n_body, n_glass : float
        [1].
    """
    u, w = gauss_legendre(400)
    # d(sin^2) up to the critical angle; sin^2 = s (1 - (1 - v)^2) makes the square-root end smooth.
    v, w = 0.5 * (u + 1), 0.5 * w
    sin2 = v * (2 - v) / n_body**2
    through = open_film_transmittance(np.sqrt(1.0 - sin2), n_body, n_glass)
    return float(1.0 - np.sum(w * 2 * (1 - v) / n_body**2 * through))
