"""Friction laws of a silicone interface: shear strength by pressure, slip and speed."""

from __future__ import annotations

from dataclasses import dataclass, replace

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

    def times(self, factor: float) -> InterfaceFriction:
        """Return the same law of another strength.

        Parameters
        ----------
        factor : float
            Over this one's.

        Returns
        -------
        InterfaceFriction
        """
        return replace(self, tau0=factor * self.tau0, alpha=factor * self.alpha)

    def coefficient(self, mean_pressure: ArrayLike, speed: float | None = None) -> Floats:
        """Return the static coefficient of friction.

        Parameters
        ----------
        mean_pressure : array_like
            [MPa].
        speed : float, optional
            [mm/s]; the reference speed by default.

        Returns
        -------
        ndarray
            In the shape of ``mean_pressure``.
        """
        mu = self.tau0 / np.asarray(mean_pressure, dtype=float) + self.alpha
        return mu * self.speed_factor(self.reference_speed if speed is None else speed)

    def speed_factor(self, speed: ArrayLike) -> Floats:
        """Return the factor g of speed.

        Parameters
        ----------
        speed : array_like
            [mm/s], above 0.

        Returns
        -------
        ndarray
        """
        return (np.asarray(speed, dtype=float) / self.reference_speed) ** self.speed_exponent

    def weakening(self, slipped: ArrayLike) -> Floats:
        """Return the factor f of slip, between 1 and the dynamic ratio.

        Parameters
        ----------
        slipped : array_like
            [mm].

        Returns
        -------
        ndarray
        """
        static_share = np.exp(-np.abs(np.asarray(slipped, dtype=float)) / self.weakening_distance)
        return self.dynamic_ratio + (1.0 - self.dynamic_ratio) * static_share


def coulomb(friction: float) -> InterfaceFriction:
    """Return Coulomb's law.

    Parameters
    ----------
    friction : float
        Coefficient of friction.

    Returns
    -------
    InterfaceFriction
        With tau0 = 0.
    """
    return InterfaceFriction(tau0=0.0, alpha=friction)


def interface_of(name: str) -> InterfaceFriction:
    """Return the interfacial rheology that the thesis fitted on glass (chapter 6).

    Parameters
    ----------
    name : str
        Material.

    Returns
    -------
    InterfaceFriction

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
