"""Twisting an axisymmetric contact about its normal: partial slip from the edge inwards, by superposed rigid rotations.

A disc of radius x that is turned rigidly by d psi on a half-space of shear modulus G carries the azimuthal traction
(4 G/pi) r/sqrt(x^2 - r^2) d psi and the torque (16/3) G x^3 d psi (Reissner and Sagoci). A twist that grows steadily is
a sum of such discs from the edge down to the stick radius c; where it slips, the sum is the shear strength, which
is Abel's equation. With I(x) = integral of strength(r)/sqrt(r^2 - x^2) from x to a:

    density of rotation  G d psi/dx = -I'(x)/2,  twist = I(c)/(2 G),  torque = (8/3) c^3 I(c) + 8 integral of x^2 I dx.

For Hertz's pressure and Coulomb's law this is Lubkin's solution.

References: E. Reissner and H. F. Sagoci, J. Appl. Phys. 15 (1944) 652; J. L. Lubkin, J. Appl. Mech. 18 (1951) 183;
K. L. Johnson, Contact Mechanics (1985).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import brentq

from evanesce.contact.patch import AxisymmetricContact, axisymmetric_state
from evanesce.core.states import ContactState, PlateGrid, SurfaceState
from evanesce.materials.friction import InterfaceFriction

Floats = NDArray[np.float64]

NODES = 512


@dataclass(frozen=True)
class Twist:
    """A twisted contact.

    Attributes
    ----------
    torque : float
        [N mm].
    angle : float
        Of the finger over the far glass [rad].
    stick_radius : float
        [mm].
    radii : ndarray (n,)
        [mm], from 0 to the contact's radius.
    traction, slip : ndarray (n,)
        Azimuthal, of the finger on the glass [MPa] and over it [mm].
    strength : ndarray (n,)
        Traction at which it slips [MPa].
    """

    torque: float
    angle: float
    stick_radius: float
    radii: Floats
    traction: Floats
    slip: Floats
    strength: Floats


def sliding_torque(contact: AxisymmetricContact, friction: InterfaceFriction) -> float:
    """Return the torque at which the whole contact slips [N mm]: 2 pi times the integral of r^2 strength.

    Parameters
    ----------
    contact : AxisymmetricContact
    friction : InterfaceFriction

    Returns
    -------
    float
        [N mm].
    """
    r, strength = _tables(contact, friction)[:2]
    return float(2.0 * np.pi * np.trapezoid(r**2 * strength, r))


def twisted(contact: AxisymmetricContact, friction: InterfaceFriction, shear_modulus: float, share: float) -> Twist:
    """Twist a contact steadily from rest up to a share of the sliding torque.

    Parameters
    ----------
    contact : AxisymmetricContact
        With a contact radius above 0.
    friction : InterfaceFriction
        Its static strength tau0 + alpha p is used.
    shear_modulus : float
        G of the half-space [MPa].
    share : float
        Of the torque of full sliding, 0 to below 1; full sliding needs an infinite twist.

    Returns
    -------
    Twist

    Raises
    ------
    ValueError
        For a share or a modulus out of range, or without contact.
    """
    a = contact.contact_radius
    if not (a > 0 and shear_modulus > 0 and 0 <= share < 1):
        raise ValueError(f"contact radius {a:g} mm, G {shear_modulus:g} MPa, share {share:g}")
    r, strength, x, integral, below = _tables(contact, friction)

    def torque_at(c: float) -> float:
        i = float(np.interp(c, x, integral))
        rest = float(below[-1] - np.interp(c, x, below))
        return 8.0 / 3.0 * c**3 * i + 8.0 * rest

    full = torque_at(0.0)
    wanted = share * full
    c = a if share == 0 else float(brentq(lambda at: torque_at(at) - wanted, 0.0, a, xtol=1e-12 * a))
    angle = float(np.interp(c, x, integral)) / (2.0 * shear_modulus)
    traction, slip = _traction(x, c, a, r, strength, integral), _slip(x, c, integral, shear_modulus)
    return Twist(wanted, angle, c, x, traction, slip, np.interp(x, r, strength))


@lru_cache(maxsize=4)  # a twist grows at one force
def _tables(contact: AxisymmetricContact, friction: InterfaceFriction) -> tuple[Floats, ...]:
    """Return radii and strength; nodes x with I(x), and the integral of x^2 I up to x."""
    a = contact.contact_radius
    r, strength = _strength(contact, friction)
    # Nodes crowd at the edge, where the pressure falls as a root.
    x = a * np.sin(np.linspace(0.0, np.pi / 2, NODES + 1))
    integral = np.array([_abel(float(at), a, r, strength) for at in x[1:]])
    integral = np.append(integral[0], integral)  # logarithmic at the middle, where x^2 takes it away
    tables = r, strength, x, integral, cumulative_trapezoid(x**2 * integral, x, initial=0.0)
    for table in tables:
        table.setflags(write=False)
    return tables


def twisted_state(
    grid: PlateGrid,
    centre: tuple[float, float],
    contact: AxisymmetricContact,
    twist: Twist,
    *,
    near_gap: float = 0.01,
    time: float = 0.0,
) -> ContactState:
    """Put a twisted contact on the plate's grid; positive torque turns from x towards y.

    Parameters
    ----------
    grid : PlateGrid
    centre : tuple of float
    contact : AxisymmetricContact
        Without twist.
    twist : Twist
    near_gap : float
        Gap below which a surface counts as near [mm].
    time : float
        [s].

    Returns
    -------
    ContactState
    """
    state = axisymmetric_state(grid, centre, contact, law="hertz+torsion", time=time)
    x, y = grid.x[None, :] - centre[0], grid.y[:, None] - centre[1]
    radius = np.hypot(x, y)
    per = 1.0 / np.maximum(radius, 1e-12)
    inside = radius <= contact.contact_radius
    strength = np.where(inside, np.interp(radius, twist.radii, twist.strength), 0.0)
    fields = []
    for table in (twist.traction, twist.slip):
        value = np.where(inside, np.interp(radius, twist.radii, table), 0.0)
        fields.append(np.stack([-value * y * per, value * x * per]))
    surface = np.where(np.asarray(state.gap) < near_gap, np.uint8(SurfaceState.NEAR), np.uint8(SurfaceState.NONE))
    touching = np.asarray(state.contact_mask) >= 0.5
    surface[touching] = SurfaceState.SLIP
    surface[touching & (radius < twist.stick_radius)] = SurfaceState.STICK
    ratio = (twist.stick_radius / contact.contact_radius) ** 2
    return replace(
        state,
        traction=fields[0],
        slip=fields[1],
        strength=strength,
        state=surface,
        parameters={
            "torque_N_mm": twist.torque,
            "twist_rad": twist.angle,
            "stick_ratio": ratio,
            "stick_radius_mm": twist.stick_radius,
        },
    )


def _strength(contact: AxisymmetricContact, friction: InterfaceFriction) -> tuple[Floats, Floats]:
    """Return radii [mm] and shear strength there [MPa], from annuli that carry the contact's exact force."""
    a = contact.contact_radius
    edges = a * np.sin(np.linspace(0.0, np.pi / 2, 4 * NODES + 1))
    pressure = np.diff(contact.force_within(edges)) / (np.pi * np.diff(edges**2))
    middle = np.sqrt(0.5 * (edges[1:] ** 2 + edges[:-1] ** 2))
    strength = friction.tau0 + friction.alpha * np.maximum(pressure, 0.0)
    r = np.concatenate([[0.0], middle, [a]])
    return r, np.concatenate([strength[:1], strength, [friction.tau0]])


def _abel(x: float, a: float, r: Floats, strength: Floats) -> float:
    """Return the integral of strength(r)/sqrt(r^2 - x^2) dr from x to a; r^2 = x^2 + s^2 takes the root away."""
    top = np.sqrt(max(a * a - x * x, 0.0))
    # Cubic crowding at s = 0, where 1/r is steep for small x, and at the edge's root by the strength's own nodes.
    v = np.linspace(0.0, 1.0, 400)
    s = top * np.sin(0.5 * np.pi * v) ** 2
    radius = np.sqrt(x * x + s * s)
    return float(np.trapezoid(np.interp(radius, r, strength) / np.maximum(radius, 1e-12), s))


def _elements(x: Floats, c: float, integral: Floats) -> tuple[Floats, Floats]:
    """Return borders from the stick radius to the edge of contact, and G d psi of each annulus between them."""
    beyond = x > c
    edges = np.append(c, x[beyond])
    values = np.append(np.interp(c, x, integral), integral[beyond])
    return edges, 0.5 * -np.diff(values)


def _traction(x: Floats, c: float, a: float, r: Floats, strength: Floats, integral: Floats) -> Floats:
    """Return the azimuthal traction: the strength where it slips, the discs' sum where it sticks."""
    found = np.interp(x, r, strength)
    edges, rotation = _elements(x, c, integral)
    if len(rotation) == 0:
        return np.zeros_like(x)
    density = rotation / np.diff(edges)
    stuck = x < c
    at = x[stuck][:, None]
    ratio = edges[None, :] / np.maximum(at, 1e-12)
    angle = np.arccosh(np.maximum(ratio, 1.0))
    found[stuck] = 4.0 / np.pi * x[stuck] * (np.diff(angle, axis=1) @ density)
    return found


def _slip(x: Floats, c: float, integral: Floats, shear_modulus: float) -> Floats:
    """Return how far the finger's surface has slipped [mm]: rigid rotation less what the inner discs turn along."""
    edges, rotation = _elements(x, c, integral)
    if len(rotation) == 0:
        return np.zeros_like(x)
    disc = 0.5 * (edges[1:] + edges[:-1])
    ratio = np.minimum(disc[None, :] / np.maximum(x[:, None], 1e-12), 1.0)
    share = 1.0 - 2.0 / np.pi * (np.arcsin(ratio) - ratio * np.sqrt(1.0 - ratio**2))
    return np.asarray(x * (share @ rotation) / shear_modulus)
