"""Hertz: a smooth elastic sphere on rigid glass, with a reduced modulus that may depend on the force."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.contact.patch import AxisymmetricContact

Array = NDArray[np.float64]


def reduced_modulus(force: ArrayLike, intercept: float, slope: float = 0.0) -> Array:
    """Return E*(F) = intercept + slope F.

    Parameters
    ----------
    force : array_like
        Normal force [N].
    intercept : float
        Reduced modulus at vanishing force [MPa].
    slope : float
        [MPa/N].

    Returns
    -------
    ndarray
        [MPa], shape of ``force``.

    Raises
    ------
    ValueError
        Where the law gives no positive modulus.

    References
    ----------
    A. E. Macaulay, thesis, University of Sheffield (2024), section 5.5.1 fits such lines.
    """
    modulus = intercept + slope * np.asarray(force, dtype=float)
    if not np.all(modulus > 0):
        raise ValueError(f"reduced modulus {float(np.min(modulus)):g} MPa is not positive")
    return modulus


def hertz_radius(force: ArrayLike, tip_radius: float, modulus: ArrayLike) -> Array:
    """Return the contact radius a = (3 F R / (4 E*))^(1/3).

    Parameters
    ----------
    force : array_like
        Normal force [N], not negative.
    tip_radius : float
        R [mm].
    modulus : array_like
        Reduced modulus E* [MPa].

    Returns
    -------
    ndarray
        [mm].

    Raises
    ------
    ValueError
        For a negative force, or a radius or modulus that is not positive.

    Notes
    -----
    Valid for a << R, small strains and a parabolic tip: at r/R = 0.3 the sphere lies 2 % higher
    than the parabola. It is used beyond that, as in the thesis, because the fitted modulus absorbs the difference.

    References
    ----------
    H. Hertz, J. reine angew. Math. 92 (1882) 156; K. L. Johnson, *Contact Mechanics* (1985), eqs 4.22 to 4.24.
    """
    force, modulus = np.asarray(force, dtype=float), np.asarray(modulus, dtype=float)
    _require(force, tip_radius, modulus)
    return np.cbrt(3.0 * force * tip_radius / (4.0 * modulus))


def hertz_depth(force: ArrayLike, tip_radius: float, modulus: ArrayLike) -> Array:
    """Return the approach a^2/R of distant points [mm].

    Parameters
    ----------
    force : array_like
        Normal force [N].
    tip_radius : float
        [mm].
    modulus : array_like
        E* [MPa].

    Returns
    -------
    ndarray
        [mm].
    """
    return hertz_radius(force, tip_radius, modulus) ** 2 / tip_radius


def hertz_pressure(r: ArrayLike, force: float, contact_radius: float) -> Array:
    """Return p = p0 sqrt(1 - r^2/a^2) with p0 = 3 F/(2 pi a^2), zero outside.

    Parameters
    ----------
    r : array_like
        Distance from the contact's centre [mm].
    force : float
        [N].
    contact_radius : float
        a [mm], positive.

    Returns
    -------
    ndarray
        [MPa].

    Raises
    ------
    ValueError
        If ``contact_radius`` is not positive.

    References
    ----------
    Johnson (1985), eq 3.39.
    """
    if not contact_radius > 0:
        raise ValueError(f"contact radius {contact_radius:g} mm is not positive")
    peak = 1.5 * force / (np.pi * contact_radius**2)
    return peak * np.sqrt(np.clip(1.0 - (np.asarray(r, dtype=float) / contact_radius) ** 2, 0.0, None))


def hertz_force_within(r: ArrayLike, force: float, contact_radius: float) -> Array:
    """Return the force carried inside radius r [N]: F (1 - (1 - r^2/a^2)^(3/2)), the integral of the pressure.

    Parameters
    ----------
    r : array_like
        [mm].
    force : float
        [N].
    contact_radius : float
        [mm].

    Returns
    -------
    ndarray
        [N].
    """
    if not contact_radius > 0:
        raise ValueError(f"contact radius {contact_radius:g} mm is not positive")
    inner = np.clip(1.0 - (np.asarray(r, dtype=float) / contact_radius) ** 2, 0.0, None)
    return force * (1.0 - inner**1.5)


def hertz_gap(r: ArrayLike, contact_radius: float, tip_radius: float) -> Array:
    """Return the gap between the deformed parabolic tip and the glass, zero in contact.

    ``g = (a^2/(pi R)) [sqrt(r^2/a^2 - 1) + (r^2/a^2 - 2) arccos(a/r)]``; r^2/(2R) for a = 0.

    Parameters
    ----------
    r : array_like
        Distance from the contact's centre [mm].
    contact_radius : float
        a [mm], not negative.
    tip_radius : float
        R [mm].

    Returns
    -------
    ndarray
        [mm].

    Raises
    ------
    ValueError
        For a negative contact radius or a tip radius that is not positive.

    References
    ----------
    Johnson (1985), eq 3.42 gives the displacement; the gap is r^2/(2R) - a^2/R plus it.
    """
    r = np.asarray(r, dtype=float)
    if not (contact_radius >= 0 and tip_radius > 0):
        raise ValueError(f"contact radius {contact_radius:g} mm, tip radius {tip_radius:g} mm")
    if contact_radius == 0:
        return r**2 / (2.0 * tip_radius)
    ratio = np.maximum(r / contact_radius, 1.0)
    # near the edge both terms go to zero as (ratio - 1)^(1/2) and cancel to (ratio - 1)^(3/2): clip the rounding
    bracket = np.sqrt(ratio**2 - 1.0) + (ratio**2 - 2.0) * np.arccos(1.0 / ratio)
    return contact_radius**2 / (np.pi * tip_radius) * np.maximum(bracket, 0.0)


def hertz_contact(force: float, tip_radius: float, modulus: float) -> AxisymmetricContact:
    """Return Hertz's contact.

    Parameters
    ----------
    force : float
        [N].
    tip_radius : float
        [mm].
    modulus : float
        E* [MPa].

    Returns
    -------
    AxisymmetricContact
    """
    return scaled_hertz_contact(force, tip_radius, modulus, 1.0)


def scaled_hertz_contact(force: float, tip_radius: float, modulus: float, area_scale: float) -> AxisymmetricContact:
    """Return Hertz with its area multiplied by a factor, at the same force.

    The radius grows by the root of the factor, the elliptic pressure falls by the factor, the depth stays Hertz's.
    The gap is that of a parabola resting on the widened circle, so that it is continuous at the contact's edge.

    Parameters
    ----------
    force, tip_radius, modulus
        As :func:`hertz_radius`.
    area_scale : float
        Contact area over Hertz's area [1].

    Returns
    -------
    AxisymmetricContact

    Raises
    ------
    ValueError
        As :func:`hertz_radius`, or for a factor that is not positive.

    References
    ----------
    Macaulay (2024), section 5.5.1: 1.66 for Silskin 20 %.
    """
    if not area_scale > 0:
        raise ValueError(f"area scale {area_scale:g} is not positive")
    radius = float(hertz_radius(force, tip_radius, modulus))
    wide = radius * float(np.sqrt(area_scale))
    return AxisymmetricContact(
        contact_radius=wide,
        normal_force=float(force),
        depth=radius**2 / tip_radius,
        force_within=lambda r: hertz_force_within(r, force, wide) if wide > 0 else np.zeros_like(r),
        gap=lambda r: hertz_gap(r, wide, tip_radius),
        shape_exponent=2.0,
    )


def _require(force: Array, tip_radius: float, modulus: Array) -> None:
    """Refuse what the square and cube roots would turn into NaN."""
    if not (np.all(force >= 0) and np.all(np.isfinite(force))):
        raise ValueError(f"normal force {float(np.min(force)):g} N is negative or not finite")
    if not tip_radius > 0:
        raise ValueError(f"tip radius {tip_radius:g} mm is not positive")
    if not np.all(modulus > 0):
        raise ValueError(f"reduced modulus {float(np.min(modulus)):g} MPa is not positive")
