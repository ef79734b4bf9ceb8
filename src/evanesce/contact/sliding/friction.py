"""What a silicone interface resists: pressure, slip, speed, and the area that shear takes away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.materials.tables import material

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class InterfaceFriction:
    """Local shear strength tau = (tau0 + alpha p) f(slip) g(speed), with mu_s = tau0/p + alpha at rest.

    Attributes
    ----------
    tau0 : float
        Shear strength without pressure [MPa]; 0 is Coulomb's law.
    alpha : float
        Pressure coefficient.
    dynamic_ratio : float
        Dynamic over static strength, 0 to 1; 1 is no drop.
    weakening_distance : float
        Slip over which the strength falls to the dynamic one by a factor e [mm].
    healing_time : float
        Rest over which a slid element regains its static strength by a factor e [s].
    speed_exponent : float
        Strength grows as (speed/reference_speed)^exponent; 0 is no dependence.
    reference_speed : float
        [mm/s].

    References
    ----------
    B. J. Briscoe and D. Tabor, J. Adhesion 9 (1978) 145 (tau0 + alpha p).
    """

    tau0: float
    alpha: float
    dynamic_ratio: float = 1.0
    weakening_distance: float = 0.05
    healing_time: float = 1.0
    speed_exponent: float = 0.0
    reference_speed: float = 1.0

    def __post_init__(self) -> None:
        if self.tau0 < 0 or self.alpha < 0 or self.tau0 + self.alpha == 0:
            raise ValueError("tau0 and alpha must not be negative, and not both zero")
        if not 0.0 < self.dynamic_ratio <= 1.0:
            raise ValueError(f"dynamic ratio {self.dynamic_ratio:g} is not in (0, 1]")
        if min(self.weakening_distance, self.healing_time, self.reference_speed) <= 0:
            raise ValueError("weakening distance, healing time and reference speed must be positive")
        if not 0.0 <= self.speed_exponent <= 1.0:
            raise ValueError(f"speed exponent {self.speed_exponent:g} is not in [0, 1]")

    def coefficient(self, mean_pressure: ArrayLike, speed: float | None = None) -> Floats:
        """Return the static coefficient at mean pressures [MPa] and a speed [mm/s] (the reference speed if None)."""
        mu = self.tau0 / np.asarray(mean_pressure, dtype=float) + self.alpha
        return mu * self.speed_factor(self.reference_speed if speed is None else speed)

    def speed_factor(self, speed: ArrayLike) -> Floats:
        """Return g(speed); speeds in mm/s, > 0."""
        return (np.asarray(speed, dtype=float) / self.reference_speed) ** self.speed_exponent

    def weakening(self, slipped: ArrayLike) -> Floats:
        """Return f(slip) between 1 and the dynamic ratio; slip in mm."""
        fresh = np.exp(-np.abs(np.asarray(slipped, dtype=float)) / self.weakening_distance)
        return self.dynamic_ratio + (1.0 - self.dynamic_ratio) * fresh


def coulomb(friction: float) -> InterfaceFriction:
    """Return Coulomb's law with one coefficient."""
    return InterfaceFriction(tau0=0.0, alpha=friction)


def interface_of(name: str) -> InterfaceFriction:
    """Return the interfacial rheology that the thesis fitted on glass (chapter 6).

    Raises
    ------
    InputError
        For an unknown material.
    ValueError
        For a material without friction data.
    """
    found = material(name).friction
    if found is None:
        raise ValueError(f"no friction was measured for {name!r}")
    return InterfaceFriction(found.tau0_MPa, found.alpha)


def area_under_shear(area: ArrayLike, tangential_force: ArrayLike, area_loss: float) -> Floats:
    """Return A = A_0 - alpha_A Q^2 [mm^2].

    Parameters
    ----------
    area : array_like
        A_0 [mm^2] without shear.
    tangential_force : array_like
        Q [N].
    area_loss : float
        alpha_A [mm^2/N^2], >= 0.

    Raises
    ------
    ValueError
        Where nothing would be left.

    References
    ----------
    R. Sahli et al., PNAS 115 (2018) 471.
    """
    left = np.asarray(area, dtype=float) - area_loss * np.asarray(tangential_force, dtype=float) ** 2
    if area_loss < 0 or np.any(left < 0):
        raise ValueError("the shear would take more area than there is: outside the law's range")
    return left


def area_loss_scaled(area: ArrayLike, loss_at_reference: float, reference_area: float) -> Floats:
    """Return alpha_A = alpha_ref (A_0/A_ref)^(-3/2): Sahli's scaling, seen over four decades of area (2018)."""
    return loss_at_reference * (np.asarray(area, dtype=float) / reference_area) ** -1.5


def area_loss_for(area: float, sliding_force: float, remaining: float) -> float:
    """Return the alpha_A [mm^2/N^2] at which a share of the area [mm^2] remains under the force of full sliding [N]."""
    if not 0.0 < remaining <= 1.0 or sliding_force <= 0 or area <= 0:
        raise ValueError("area and force must be positive, the remaining share in (0, 1]")
    return area * (1.0 - remaining) / sliding_force**2


def tilted_compliance(axial_stiffness: float, bending_stiffness: float, angle: float) -> Floats:
    """Return the 2 x 2 compliance [mm/N] of a finger tilted in the sliding plane; axes (tangential, normal).

    Parameters
    ----------
    axial_stiffness, bending_stiffness : float
        Of the shaft along and across its axis [N/mm].
    angle : float
        Between the finger's axis and the plate's normal [rad], 0 to pi/4 in the thesis.

    Notes
    -----
    Off the diagonal stands what makes a tilted finger dig in or lift when it is dragged: (1/k_a - 1/k_b) sin cos.
    """
    if axial_stiffness <= 0 or bending_stiffness <= 0:
        raise ValueError("stiffnesses must be positive")
    if not 0.0 <= angle < np.pi / 2:
        raise ValueError(f"contact angle {np.degrees(angle):g} deg is not between 0 and 90")
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return turn.T @ np.diag([1.0 / bending_stiffness, 1.0 / axial_stiffness]) @ turn


def shaft_stiffness(
    youngs_modulus: float,
    radius: float,
    length: float,
    *,
    normal_force: float = 0.0,
    tip_radius: float = 0.0,
    poisson_ratio: float = 0.5,
) -> tuple[float, float]:
    """Return (axial, bending) stiffness [N/mm] of a solid round finger held at its top.

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

    Raises
    ------
    ValueError
        For non-positive sizes, or a normal force beyond Euler's load: the finger folds.

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
    """Tell whether a contact stays on the hemispherical tip of a finger tilted by an angle [rad].

    While it does, the law of the upright finger holds: a sphere looks the same from every side.
    """
    if contact_radius >= tip_radius:
        return False
    return bool(angle + np.arcsin(contact_radius / tip_radius) <= np.pi / 2)
