"""Friction force and torque of a contact that slides and spins at once, and friction that depends on direction.

A contact that slips everywhere moves as a rigid patch, about an instantaneous centre. The friction of each element
opposes its own velocity, so that force and torque are integrals of the strength's direction over the contact: a point
of the limit surface, convex, whose normal is the motion (Goyal, Ruina and Papadopoulos 1991). An ellipsoid through the
largest force and the largest torque comes near it (Howe and Cutkosky 1996).

Across parallel ridges friction may differ from that along them. Of all friction forces that an ellipse of strength
allows, the one that resists most acts: the force across the sliding direction follows.

References: S. Goyal, A. Ruina and J. Papadopoulos, Wear 143 (1991) 307; R. D. Howe and M. R. Cutkosky, Int. J. Robotics
Research 15 (1996) 557; A. Zmitrowicz, Int. J. Solids Struct. 25 (1989) 837 (orthotropic friction).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.patch import AxisymmetricContact
from evanesce.materials.friction import InterfaceFriction

Floats = NDArray[np.float64]


def sliding_wrench(
    contact: AxisymmetricContact, friction: InterfaceFriction, speed: float, spin: float, *, rings: int = 400
) -> tuple[float, float]:
    """Return friction force [N] and torque [N mm] of a contact that slides and spins.

    Parameters
    ----------
    contact : AxisymmetricContact
        Touching.
    friction : InterfaceFriction
        Its static strength tau0 + alpha p is used.
    speed : float
        Of the contact's middle [mm/s], not negative.
    spin : float
        About it [rad/s]; not both zero.
    rings : int
        Annuli of the quadrature.

    Returns
    -------
    force, torque : float
        Against the motion: the force along it, the torque about the middle.
    """
    a = contact.contact_radius
    edges = a * np.sin(np.linspace(0.0, np.pi / 2, rings + 1))
    load = friction.alpha * np.diff(contact.force_within(edges)) + friction.tau0 * np.pi * np.diff(edges**2)
    r = np.sqrt(0.5 * (edges[1:] ** 2 + edges[:-1] ** 2))[:, None]
    angle = (np.arange(256) + 0.5) / 256 * np.pi
    vx, vy = speed - spin * r * np.sin(angle), spin * r * np.cos(angle)
    # the other half circle turns the other sign of sin
    wx = speed + spin * r * np.sin(angle)
    for_vx, for_wx = np.maximum(np.hypot(vx, vy), 1e-300), np.maximum(np.hypot(wx, vy), 1e-300)
    force = 0.5 * (vx / for_vx + wx / for_wx).mean(axis=1)
    turning = (
        r[:, 0]
        * 0.5
        * (
            (-vx * np.sin(angle) + vy * np.cos(angle)) / for_vx + (wx * np.sin(angle) + vy * np.cos(angle)) / for_wx
        ).mean(axis=1)
    )
    return float(load @ force), float(load @ turning)


def ellipsoid_wrench(largest_force: float, largest_torque: float, speed: float, spin: float) -> tuple[float, float]:
    """Return force and torque on the ellipsoid of Howe and Cutkosky at which the motion is its normal.

    Parameters
    ----------
    largest_force, largest_torque : float
        Of sliding alone [N] and of spinning alone [N mm].
    speed, spin : float
        [mm/s], [rad/s].

    Returns
    -------
    force, torque : float
        [N], [N mm].
    """
    power = math.hypot(largest_force * speed, largest_torque * spin)
    return largest_force**2 * speed / power, largest_torque**2 * spin / power


def directional_friction(ratio: float, angle: float) -> tuple[float, float]:
    """Return friction along the motion and across it, over friction across the ridges.

    Parameters
    ----------
    ratio : float
        Friction along the ridges over that across them.
    angle : float
        From the motion to the ridges [rad], counted from x towards y.

    Returns
    -------
    along, across : float
        Against the motion; and to its left, from x towards y, of the finger on the glass.
    """
    with_ridges, over = math.cos(angle), -math.sin(angle)  # the motion's components along and across the ridges
    power = math.hypot(ratio * with_ridges, over)
    along_ridges, across_ridges = ratio**2 * with_ridges / power, over / power
    return power, along_ridges * math.sin(angle) + across_ridges * math.cos(angle)


class FrictionEllipse:
    """Tractions within unit strength, where friction along ridges is another than across them.

    Parameters
    ----------
    ratio : float
        Friction along the ridges over that across them.
    angle : float
        Of the ridges [rad].

    Attributes
    ----------
    widest : float
        Strength in the strongest direction.
    """

    def __init__(self, ratio: float = 1.0, angle: float = 0.0) -> None:
        self.widest, self._even = max(ratio, 1.0), ratio == 1.0
        along = np.array([math.cos(angle), math.sin(angle)])
        ridges = np.outer(along, along)
        self._matrix = np.eye(2) + (ratio - 1.0) * ridges
        self._inverse = np.eye(2) + (1.0 / ratio - 1.0) * ridges

    def stretched(self, vector: Floats) -> Floats:
        """Return vectors (2, ...) of a disc as those of the ellipse."""
        return vector if self._even else np.tensordot(self._matrix, vector, 1)

    def rounded(self, vector: Floats) -> Floats:
        """Return vectors (2, ...) of the ellipse as those of a disc."""
        return vector if self._even else np.tensordot(self._inverse, vector, 1)

    def strength(self, traction: Floats) -> Floats:
        """Return the strength in each traction's direction [1]; across the ridges where there is none."""
        if self._even:
            return np.ones(traction.shape[1:])
        size, disc = np.hypot(*traction), np.hypot(*self.rounded(traction))
        return np.divide(size, disc, out=np.ones_like(size), where=disc > 0.0)
