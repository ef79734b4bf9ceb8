"""Cattaneo and Mindlin: a Hertz contact under a rising tangential force slips from its edge inwards; closed forms.

The tangential compliance is that of an elastic body of Poisson ratio nu on rigid glass. Normal and tangential problem
are uncoupled, exactly so for nu = 1/2. Tractions and displacements are averaged over the azimuth; the small
displacement across the force (zero on average) is left out, as in the classical solution.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def tangential_modulus(reduced_modulus: ArrayLike, poisson_ratio: float) -> Floats:
    """Return G* = 4 G/(2 - nu) = 2 (1 - nu)/(2 - nu) E* of a body on rigid glass [MPa]; 2/3 E* when incompressible.

    A sticking circle of radius a has the tangential stiffness 2 a G*.

    Parameters
    ----------
    reduced_modulus : array_like
        E* [MPa].
    poisson_ratio : float
        0 to 0.5.

    Returns
    -------
    ndarray
        [MPa].

    References
    ----------
    R. D. Mindlin, J. Appl. Mech. 16 (1949) 259.
    """
    if not 0.0 <= poisson_ratio <= 0.5:
        raise ValueError(f"Poisson ratio {poisson_ratio:g} is not between 0 and 0.5")
    return 2.0 * (1.0 - poisson_ratio) / (2.0 - poisson_ratio) * np.asarray(reduced_modulus, dtype=float)


def _load_share(normal_force: float, tangential_force: ArrayLike, friction: float) -> Floats:
    if normal_force <= 0 or friction <= 0:
        raise ValueError("normal force and coefficient of friction must be positive")
    share = np.abs(np.asarray(tangential_force, dtype=float)) / (friction * normal_force)
    if np.any(share > 1.0 + 1e-12):
        raise ValueError(f"tangential force is {float(share.max()):g} times mu N: the contact slides as a whole")
    return np.minimum(share, 1.0)


def stick_radius(contact_radius: float, normal_force: float, tangential_force: ArrayLike, friction: float) -> Floats:
    """Return c = a (1 - Q/(mu N))^(1/3) [mm].

    Parameters
    ----------
    contact_radius : float
        a [mm].
    normal_force : float
        N [N], > 0.
    tangential_force : array_like
        Q [N], at most mu N in magnitude.
    friction : float
        mu > 0.

    Returns
    -------
    ndarray
        [mm].

    Raises
    ------
    ValueError
        Beyond gross slip.

    References
    ----------
    C. Cattaneo, Rend. Accad. Naz. Lincei 27 (1938) 342; R. D. Mindlin (1949); K. L. Johnson, Contact Mechanics (1985),
    section 7.2.
    """
    return contact_radius * np.cbrt(1.0 - _load_share(normal_force, tangential_force, friction))


def traction(
    r: ArrayLike, contact_radius: float, normal_force: float, tangential_force: float, friction: float
) -> Floats:
    """Return the tangential traction [MPa] at radii [mm]: mu p, less the same of radius c where it sticks.

    Parameters
    ----------
    r : array_like
        [mm].
    contact_radius : float
        [mm].
    normal_force : float
        [N].
    tangential_force : float
        [N].
    friction : float
        Coefficient of friction.

    Returns
    -------
    ndarray
        [MPa].
    """
    r = np.asarray(r, dtype=float)
    a, c = contact_radius, float(stick_radius(contact_radius, normal_force, tangential_force, friction))
    peak = friction * 1.5 * normal_force / (np.pi * a**2)
    outer = np.sqrt(np.clip(1.0 - (r / a) ** 2, 0.0, None))
    inner = np.sqrt(np.clip(c**2 - r**2, 0.0, None)) / a
    return np.sign(tangential_force) * peak * (outer - inner)


def rigid_displacement(
    contact_radius: float,
    normal_force: float,
    tangential_force: ArrayLike,
    friction: float,
    modulus: float,
) -> Floats:
    """Return the tangential displacement of the distant body [mm]: 3 mu N/(4 G* a) [1 - (1 - Q/(mu N))^(2/3)].

    ``modulus`` is G* of :func:`tangential_modulus`.

    Parameters
    ----------
    contact_radius : float
        [mm].
    normal_force : float
        [N].
    tangential_force : array_like
        [N].
    friction : float
        Coefficient of friction.
    modulus : float
        G* [MPa].

    Returns
    -------
    ndarray
        [mm].
    """
    q = np.asarray(tangential_force, dtype=float)
    share = _load_share(normal_force, q, friction)
    return np.sign(q) * 0.75 * friction * normal_force / (modulus * contact_radius) * (1.0 - np.cbrt(1.0 - share) ** 2)


def slip(
    r: ArrayLike,
    contact_radius: float,
    normal_force: float,
    tangential_force: float,
    friction: float,
    modulus: float,
) -> Floats:
    """Return the slip of the body over the glass [mm] at radii [mm] inside the contact: 0 where it sticks, NaN outside.

    The rigid displacement, less the surface's own under the two semi-elliptic tractions of radius a and c.

    Parameters
    ----------
    r : array_like
        [mm].
    contact_radius : float
        [mm].
    normal_force : float
        [N].
    tangential_force : float
        [N].
    friction : float
        Coefficient of friction.
    modulus : float
        G* [MPa].

    Returns
    -------
    ndarray
        [mm].
    """
    r = np.asarray(r, dtype=float)
    a, c = contact_radius, float(stick_radius(contact_radius, normal_force, tangential_force, friction))
    front = friction * 1.5 * normal_force / (np.pi * a**2)  # mu p0

    def displaced(b: float) -> Floats:
        """Displacement under mu p0/a sqrt(b^2 - r^2), inside and outside radius b."""
        if b == 0.0:
            return np.zeros_like(r)
        ratio = np.maximum(r / b, 1.0)
        far = ((2.0 - ratio**2) * np.arcsin(1.0 / ratio) + np.sqrt(ratio**2 - 1.0)) / np.pi
        near = 1.0 - 0.5 * (r / b) ** 2
        return front * np.pi * b**2 / (2.0 * a * modulus) * np.where(r <= b, near, far)

    whole = float(rigid_displacement(a, normal_force, abs(tangential_force), friction, modulus))
    moved = np.where(r <= c, 0.0, whole - (displaced(a) - displaced(c)))
    return np.where(r <= a, np.sign(tangential_force) * moved, np.nan)
