"""The limit surface of a contact that slides and spins at once: an oracle for the solver in the plane.

A contact that slips everywhere moves as a rigid patch, about an instantaneous centre. The friction of each element
opposes its own velocity, so that force and torque are integrals of the strength's direction over the contact: a point
of the limit surface, convex, whose normal is the motion (Goyal, Ruina and Papadopoulos 1991). An ellipsoid through the
largest force and the largest torque comes near it (Howe and Cutkosky 1996).

References: S. Goyal, A. Ruina and J. Papadopoulos, Wear 143 (1991) 307; R. D. Howe and M. R. Cutkosky, Int. J. Robotics
Research 15 (1996) 557.
"""

from __future__ import annotations

import math

import numpy as np

from evanesce.contact.patch import AxisymmetricContact
from evanesce.materials.friction import InterfaceFriction


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
