"""Xydas and Kao: soft fingers whose contact radius is a power law of the force."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import beta, betainc

from evanesce.contact.analytic.hertz import hertz_gap
from evanesce.contact.patch import AxisymmetricContact

Array = NDArray[np.float64]


def xydas_kao_radius(force: ArrayLike, c: float, gamma: float) -> Array:
    """Return the contact radius a = c N^gamma, zero without force.

    Parameters
    ----------
    force : array_like
        Normal force N [N], not negative.
    c : float
        Contact radius at 1 N [mm].
    gamma : float
        Exponent, 0 (ideal soft finger) to 1/3 (Hertz).

    Returns
    -------
    ndarray
        [mm].

    Raises
    ------
    ValueError
        For a negative force, c that is not positive, or gamma outside [0, 1/3].

    References
    ----------
    N. Xydas, I. Kao, Int. J. Robotics Research 18 (1999) 941.
    """
    force = np.asarray(force, dtype=float)
    if not (np.all(force >= 0) and np.all(np.isfinite(force))):
        raise ValueError(f"normal force {float(np.min(force)):g} N is negative or not finite")
    if not c > 0:
        raise ValueError(f"c = {c:g} mm is not positive")
    if not 0.0 <= gamma <= 1.0 / 3.0:
        raise ValueError(f"gamma = {gamma:g} is outside 0 to 1/3")
    return np.where(force > 0, c * force**gamma, 0.0)


def xydas_kao_pressure(r: ArrayLike, force: float, contact_radius: float, k: float = 2.0) -> Array:
    """Return p = C_k (N/(pi a^2)) (1 - (r/a)^k)^(1/k), zero outside; C_k keeps the force.

    Parameters
    ----------
    r : array_like
        [mm].
    force : float
        N [N].
    contact_radius : float
        a [mm], positive.
    k : float
        Shape: 2 is Hertz's ellipse, larger is flatter.

    Returns
    -------
    ndarray
        [MPa].

    Raises
    ------
    ValueError
        If ``contact_radius`` or ``k`` is not positive.

    References
    ----------
    Xydas and Kao (1999), who also give C_k; here 1/C_k = (2/k) B(2/k, 1 + 1/k), the same integral as a beta function.
    """
    if not (contact_radius > 0 and k > 0):
        raise ValueError(f"contact radius {contact_radius:g} mm and k = {k:g} must be positive")
    scale = force / (np.pi * contact_radius**2) / (2.0 / k * beta(2.0 / k, 1.0 + 1.0 / k))
    ratio = np.asarray(r, dtype=float) / contact_radius
    return scale * np.clip(1.0 - ratio**k, 0.0, None) ** (1.0 / k)


def xydas_kao_force_within(r: ArrayLike, force: float, contact_radius: float, k: float = 2.0) -> Array:
    """Return the force inside r [N], the integral of :func:`xydas_kao_pressure` (regularised incomplete beta).

    Parameters
    ----------
    r : array_like
        [mm].
    force : float
        [N].
    contact_radius : float
        [mm].
    k : float
        Exponent of the pressure.

    Returns
    -------
    ndarray
        [N].
    """
    if not (contact_radius > 0 and k > 0):
        raise ValueError(f"contact radius {contact_radius:g} mm and k = {k:g} must be positive")
    ratio = np.clip(np.asarray(r, dtype=float) / contact_radius, 0.0, 1.0)
    return force * betainc(2.0 / k, 1.0 + 1.0 / k, ratio**k)


def xydas_kao_contact(force: float, tip_radius: float, c: float, gamma: float, k: float = 2.0) -> AxisymmetricContact:
    """Return Xydas and Kao's contact.

    The law gives neither the gap outside contact nor the depth: the gap is that of a parabola of radius
    ``tip_radius`` [mm] resting on the circle (Hertz), the depth is NaN.

    Parameters
    ----------
    force : float
        [N].
    tip_radius : float
        [mm].
    c : float
        Contact radius at 1 N [mm].
    gamma : float
        Exponent of force.
    k : float
        Exponent of the pressure.

    Returns
    -------
    AxisymmetricContact
    """
    radius = float(xydas_kao_radius(force, c, gamma))
    return AxisymmetricContact(
        contact_radius=radius,
        normal_force=float(force),
        depth=float("nan") if radius > 0 else 0.0,
        force_within=lambda r: xydas_kao_force_within(r, force, radius, k) if radius > 0 else np.zeros_like(r),
        gap=lambda r: hertz_gap(r, radius, tip_radius),
        shape_exponent=k,
    )
