"""Johnson, Kendall and Roberts: an elastic sphere on glass with adhesion. 0.001 N/mm of adhesion is 1 J/m^2."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.contact.analytic.hertz import hertz_force_within, hertz_gap
from evanesce.contact.patch import AxisymmetricContact

Array = NDArray[np.float64]


def jkr_pull_off_force(tip_radius: float, work_of_adhesion: float) -> float:
    """Return the normal force at which the sphere separates [N]: -(3/2) pi w R.

    Parameters
    ----------
    tip_radius : float
        R [mm].
    work_of_adhesion : float
        w [N/mm]; 1 N/mm is 1000 J/m^2.

    Returns
    -------
    float
        [N].

    References
    ----------
    K. L. Johnson, K. Kendall, A. D. Roberts, Proc. R. Soc. A 324 (1971) 301.
    """
    return -1.5 * np.pi * work_of_adhesion * tip_radius


def jkr_radius(force: ArrayLike, tip_radius: float, modulus: ArrayLike, work_of_adhesion: float) -> Array:
    """Return the stable contact radius a^3 = (3R/4E*) (F + 3 pi w R + sqrt(6 pi w R F + (3 pi w R)^2)).

    Parameters
    ----------
    force : array_like
        Normal force [N], not below the pull-off force.
    tip_radius : float
        R [mm].
    modulus : array_like
        E* [MPa].
    work_of_adhesion : float
        w [N/mm].

    Returns
    -------
    ndarray
        [mm].

    Raises
    ------
    ValueError
        Below pull-off, for a negative work of adhesion, or a radius or modulus that is not positive.

    Notes
    -----
    Valid for a << R and for large, soft, sticky spheres: Tabor's parameter (R w^2/(E*^2 z0^3))^(1/3) above about 5.

    References
    ----------
    Johnson, Kendall, Roberts (1971).
    """
    force, modulus = np.asarray(force, dtype=float), np.asarray(modulus, dtype=float)
    if not (work_of_adhesion >= 0 and tip_radius > 0 and np.all(modulus > 0)):
        raise ValueError("work of adhesion must not be negative, tip radius and modulus must be positive")
    pull = 3.0 * np.pi * work_of_adhesion * tip_radius
    if not np.all(force >= -0.5 * pull):
        raise ValueError(f"normal force {float(np.min(force)):g} N is below the pull-off force {-0.5 * pull:g} N")
    root = np.sqrt(np.clip(2.0 * pull * force + pull**2, 0.0, None))
    return np.cbrt(0.75 * tip_radius / modulus * (force + pull + root))


def jkr_depth(force: ArrayLike, tip_radius: float, modulus: ArrayLike, work_of_adhesion: float) -> Array:
    """Return the approach a^2/R - sqrt(2 pi w a/E*) [mm].

    Parameters
    ----------
    force : array_like
        [N].
    tip_radius : float
        [mm].
    modulus : array_like
        E* [MPa].
    work_of_adhesion : float
        [N/mm].

    Returns
    -------
    ndarray
        [mm].
    """
    radius = jkr_radius(force, tip_radius, modulus, work_of_adhesion)
    return radius**2 / tip_radius - np.sqrt(2.0 * np.pi * work_of_adhesion * radius / np.asarray(modulus, dtype=float))


def jkr_pressure(
    r: ArrayLike, contact_radius: float, tip_radius: float, modulus: float, work_of_adhesion: float
) -> Array:
    """Return Hertz's pressure less that of a flat punch, zero outside; it falls to minus infinity at the edge.

    ``p = (2 E* a/(pi R)) sqrt(1 - r^2/a^2) - sqrt(2 E* w/(pi a)) / sqrt(1 - r^2/a^2)``

    Parameters
    ----------
    r : array_like
        [mm].
    contact_radius, tip_radius : float
        a and R [mm].
    modulus : float
        E* [MPa].
    work_of_adhesion : float
        w [N/mm].

    Returns
    -------
    ndarray
        [MPa].

    References
    ----------
    K. L. Johnson, *Contact Mechanics* (1985), section 5.5.
    """
    r = np.asarray(r, dtype=float)
    inner = np.clip(1.0 - (r / contact_radius) ** 2, 0.0, None)
    root = np.sqrt(inner)
    hertz = 2.0 * modulus * contact_radius / (np.pi * tip_radius) * root
    punch = np.sqrt(2.0 * modulus * work_of_adhesion / (np.pi * contact_radius))
    if punch == 0:
        return hertz
    with np.errstate(divide="ignore"):
        return np.where(r <= contact_radius, hertz - punch / root, 0.0)


def jkr_force_within(
    r: ArrayLike, contact_radius: float, tip_radius: float, modulus: float, work_of_adhesion: float
) -> Array:
    """Return the integral of :func:`jkr_pressure` from the centre to r [N], finite at the edge too.

    Parameters
    ----------
    r : array_like
        [mm].
    contact_radius : float
        [mm].
    tip_radius : float
        [mm].
    modulus : float
        E* [MPa].
    work_of_adhesion : float
        [N/mm].

    Returns
    -------
    ndarray
        [N].
    """
    hertz = 4.0 * modulus * contact_radius**3 / (3.0 * tip_radius)
    punch = np.sqrt(8.0 * np.pi * work_of_adhesion * modulus * contact_radius**3)
    inner = np.clip(1.0 - (np.asarray(r, dtype=float) / contact_radius) ** 2, 0.0, None)
    return hertz_force_within(r, hertz, contact_radius) - punch * (1.0 - np.sqrt(inner))


def jkr_gap(r: ArrayLike, contact_radius: float, tip_radius: float, modulus: float, work_of_adhesion: float) -> Array:
    """Return the gap outside contact: Hertz's plus the neck sqrt(8 a w/(pi E*)) arccos(a/r); zero in contact.

    Parameters
    ----------
    r : array_like
        [mm].
    contact_radius : float
        [mm].
    tip_radius : float
        [mm].
    modulus : float
        E* [MPa].
    work_of_adhesion : float
        [N/mm].

    Returns
    -------
    ndarray
        [mm].

    References
    ----------
    Johnson (1985), section 3.4: displacement outside a flat punch, superposed on Hertz's gap.
    """
    ratio = np.maximum(np.asarray(r, dtype=float) / contact_radius, 1.0)
    neck = np.sqrt(8.0 * contact_radius * work_of_adhesion / (np.pi * modulus))
    return hertz_gap(r, contact_radius, tip_radius) + neck * np.arccos(1.0 / ratio)


def jkr_contact(force: float, tip_radius: float, modulus: float, work_of_adhesion: float) -> AxisymmetricContact:
    """Return the contact of Johnson, Kendall and Roberts; errors as :func:`jkr_radius`.

    Parameters
    ----------
    force : float
        [N].
    tip_radius : float
        [mm].
    modulus : float
        E* [MPa].
    work_of_adhesion : float
        [N/mm].

    Returns
    -------
    AxisymmetricContact
    """
    radius = float(jkr_radius(force, tip_radius, modulus, work_of_adhesion))
    if radius == 0:  # no force and no adhesion
        return AxisymmetricContact(0.0, 0.0, 0.0, np.zeros_like, lambda r: hertz_gap(r, 0.0, tip_radius), None)
    return AxisymmetricContact(
        contact_radius=radius,
        normal_force=float(force),
        depth=float(jkr_depth(force, tip_radius, modulus, work_of_adhesion)),
        force_within=lambda r: jkr_force_within(r, radius, tip_radius, modulus, work_of_adhesion),
        gap=lambda r: jkr_gap(r, radius, tip_radius, modulus, work_of_adhesion),
        shape_exponent=None,
    )
