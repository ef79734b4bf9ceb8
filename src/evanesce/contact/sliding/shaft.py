"""Stiffness of the finger's shaft, upright or tilted, in series with its contact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

BONED = 3.1
"""Stiffness along the slide of the silicone between contact and bone, over shear modulus and tip radius [1]: that of
the solved slides over a bone of half the width at 1 N, less a half-space's compliance; 1 % less on the finer mesh."""


def tilted_compliance(axial_stiffness: float, bending_stiffness: float, angle: float) -> Floats:
    """Return the 2 x 2 compliance [mm/N] of a finger tilted in the sliding plane; axes (tangential, normal).

    Parameters
    ----------
    axial_stiffness, bending_stiffness : float
        Of the shaft along and across its axis [N/mm].
    angle : float
        Between the finger's axis and the plate's normal [rad], 0 to pi/4 in the thesis.

    Returns
    -------
    ndarray (2, 2)

    Raises
    ------
    ValueError
        For stiffnesses that are not positive, or an angle outside 0 to pi/2.

    Notes
    -----
    The off-diagonal term presses a tilted finger down or lifts it when it is dragged: (1/k_a - 1/k_b) sin cos.
    """
    if axial_stiffness <= 0 or bending_stiffness <= 0:
        raise ValueError("stiffnesses must be positive")
    if not 0.0 <= angle < np.pi / 2:
        raise ValueError(f"contact angle {np.degrees(angle):g} deg is not between 0 and 90")
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return turn.T @ np.diag([1.0 / bending_stiffness, 1.0 / axial_stiffness]) @ turn


def boned_stiffness(shear_modulus: float, tip_radius: float) -> float:
    """Return the stiffness along the slide of a finger that a rigid bone holds, in series with its contact [N/mm].

    A linear solid's, by its geometry alone: that of the slides solved by finite elements, whatever the tilt.

    Parameters
    ----------
    shear_modulus : float
        [MPa].
    tip_radius : float
        [mm].
    """
    return BONED * shear_modulus * tip_radius


def shaft_stiffness(
    youngs_modulus: float,
    radius: float,
    length: float,
    *,
    normal_force: float = 0.0,
    tip_radius: float = 0.0,
    poisson_ratio: float = 0.5,
) -> tuple[float, float]:
    """Return axial and bending stiffness of a solid round finger held at its top.

    A Timoshenko cantilever; a normal force bends it further once it is bent, by 1/(1 - N/N_cr) with Euler's N_cr. On a
    spherical tip that rolls the normal force always points through the sphere's centre, so that the column ends there.

    Parameters
    ----------
    youngs_modulus : float
        [MPa].
    radius, length : float
        [mm].
    normal_force : float
        [N], below Euler's load.
    tip_radius : float
        Of the spherical tip [mm], less than the length.
    poisson_ratio : float

    Returns
    -------
    axial, bending : float
        [N/mm].

    Raises
    ------
    ValueError
        For non-positive sizes, or a normal force beyond Euler's load: the finger buckles.

    References
    ----------
    G. R. Cowper, J. Appl. Mech. 33 (1966) 335 (shear coefficient); S. P. Timoshenko and J. M. Gere, Theory of Elastic
    Stability (1961), section 1.11 (amplification).
    """
    if min(youngs_modulus, radius, length) <= 0 or not 0 <= tip_radius < length:
        raise ValueError("modulus, radius and length must be positive, the tip radius less than the length")
    section, inertia = np.pi * radius**2, np.pi * radius**4 / 4.0
    shear = youngs_modulus / (2.0 * (1.0 + poisson_ratio))
    coefficient = 6.0 * (1.0 + poisson_ratio) / (7.0 + 6.0 * poisson_ratio)
    euler = np.pi**2 * youngs_modulus * inertia / (4.0 * (length - tip_radius) ** 2)
    if normal_force >= euler:
        raise ValueError(f"{normal_force:g} N is beyond the load of {euler:.3g} N at which the finger folds")
    bending = length**3 / (3.0 * youngs_modulus * inertia) + length / (coefficient * shear * section)
    return float(youngs_modulus * section / length), float((1.0 - normal_force / euler) / bending)


def tip_contact_fits(contact_radius: float, tip_radius: float, angle: float) -> bool:
    """Return whether a contact stays on the hemispherical tip of a tilted finger.

    While it does, the law of the upright finger holds: a sphere looks the same from every side.

    Parameters
    ----------
    contact_radius, tip_radius : float
        [mm].
    angle : float
        Between the finger's axis and the plate's normal [rad].

    Returns
    -------
    bool
    """
    if contact_radius >= tip_radius:
        return False
    return bool(angle + np.arcsin(contact_radius / tip_radius) <= np.pi / 2)
