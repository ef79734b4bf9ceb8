"""Three-parameter Mooney-Rivlin law: stress, energy, and the stretches beyond which it is unstable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.core.errors import InputError
from evanesce.materials.tables import material, material_names

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MooneyRivlin:
    """Incompressible W = C10 (I1 - 3) + C01 (I2 - 3) + C11 (I1 - 3)(I2 - 3).

    Attributes
    ----------
    c10, c01, c11 : float
        [MPa].

    References
    ----------
    R. S. Rivlin and D. W. Saunders, Phil. Trans. R. Soc. A 243 (1951) 251.
    """

    c10: float
    c01: float
    c11: float = 0.0

    @property
    def shear_modulus(self) -> float:
        """Small-strain shear modulus 2 (C10 + C01) [MPa]."""
        return 2.0 * (self.c10 + self.c01)

    @property
    def youngs_modulus(self) -> float:
        """Small-strain Young's modulus 3 G [MPa]."""
        return 3.0 * self.shear_modulus

    def uniaxial(self, stretch: ArrayLike) -> Floats:
        """Return nominal stress [MPa] (force over undeformed section) at uniaxial stretches, any shape.

        Parameters
        ----------
        stretch : array_like
            Any shape.

        Returns
        -------
        ndarray
            [MPa], in the shape of ``stretch``.
        """
        return uniaxial_basis(stretch) @ np.array([self.c10, self.c01, self.c11])

    def simple_shear(self, shear: ArrayLike) -> Floats:
        """Return shear stress [MPa] at amounts of simple shear, any shape.

        Parameters
        ----------
        shear : array_like
            Amount of shear, any shape.

        Returns
        -------
        ndarray
            [MPa], in the shape of ``shear``.
        """
        g = np.asarray(shear, dtype=float)
        return 2.0 * g * (self.c10 + self.c01 + 2.0 * self.c11 * g**2)

    def energy(self, l1: ArrayLike, l2: ArrayLike) -> Floats:
        """Return W [MPa] at principal in-plane stretches; the third follows from incompressibility.

        Parameters
        ----------
        l1, l2 : array_like
            In-plane principal stretches; broadcast.

        Returns
        -------
        ndarray
            [MPa].
        """
        a, b = np.asarray(l1, dtype=float) ** 2, np.asarray(l2, dtype=float) ** 2
        c = 1.0 / (a * b)
        i1, i2 = a + b + c, a * b + c * (a + b)
        return self.c10 * (i1 - 3) + self.c01 * (i2 - 3) + self.c11 * (i1 - 3) * (i2 - 3)


def uniaxial_basis(stretch: ArrayLike) -> Floats:
    """Return the nominal stress per unit C10, C01, C11 at uniaxial stretches; shape (..., 3).

    Parameters
    ----------
    stretch : array_like
        Any shape.

    Returns
    -------
    ndarray (..., 3)
    """
    s = np.asarray(stretch, dtype=float)
    i1, i2 = s**2 + 2.0 / s, 2.0 * s + s**-2
    front = 2.0 * (1.0 - s**-3)
    return np.stack([front * s, front, front * (s * (i2 - 3.0) + (i1 - 3.0))], axis=-1)


def drucker_tangent(material: MooneyRivlin, l1: ArrayLike, l2: ArrayLike) -> Floats:
    """Return the smaller eigenvalue of d(Kirchhoff stress)/d(log strain) in the plane of l1, l2 [MPa].

    With the third stress at zero, the two in-plane log strains are free, and the material is stable in Drucker's sense
    where the 2 x 2 tangent is positive definite for them.

    Parameters
    ----------
    material : MooneyRivlin
    l1, l2 : array_like
        In-plane principal stretches; broadcast.

    Returns
    -------
    ndarray
        [MPa].

    References
    ----------
    D. C. Drucker, J. Appl. Mech. 26 (1959) 101.
    """
    # tau_i = dW/d(ln l_i) along incompressible paths, so the tangent is the Hessian of W in log stretches.
    a, b = np.asarray(l1, dtype=float) ** 2, np.asarray(l2, dtype=float) ** 2
    c = 1.0 / (a * b)
    i1, i2 = a + b + c, a * b + c * (a + b)
    w1, w2 = material.c10 + material.c11 * (i2 - 3.0), material.c01 + material.c11 * (i1 - 3.0)
    g1 = (2 * (a - c), 2 * (b - c))
    g2 = (2 * (a * b - 1.0 / a), 2 * (a * b - 1.0 / b))  # I2 = 1/a + 1/b + a b (incompressible)
    h1 = (4 * (a + c), 4 * (b + c), 4 * c)
    h2 = (4 * (a * b + 1.0 / a), 4 * (a * b + 1.0 / b), 4 * a * b)

    def hessian(k: int, i: int, j: int) -> Floats:
        return w1 * h1[k] + w2 * h2[k] + material.c11 * (g1[i] * g2[j] + g1[j] * g2[i])

    xx, yy, xy = hessian(0, 0, 0), hessian(1, 1, 1), hessian(2, 0, 1)
    return 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)


@dataclass(frozen=True)
class StabilityLimits:
    """First loss of stability on each path from the undeformed state; None where there is none in the range searched.

    Attributes
    ----------
    compression, tension : float or None
        Uniaxial stretch below 1 and above 1.
    equibiaxial, planar : float or None
        Stretch above 1.
    simple_shear : float or None
        Amount of shear at which the shear stress stops rising.
    """

    compression: float | None
    tension: float | None
    equibiaxial: float | None
    planar: float | None
    simple_shear: float | None


def _first_loss(stable: Callable[[Floats], Floats], start: float, stop: float) -> float | None:
    """Return where a function first turns non-positive between start and stop, to 1e-6."""
    path = np.linspace(start, stop, 4001)
    bad = np.flatnonzero(~(stable(path) > 0.0))
    if len(bad) == 0:
        return None
    if bad[0] == 0:
        return float(path[0])
    low, high = path[bad[0] - 1], path[bad[0]]
    while abs(high - low) > 1e-6:
        middle = 0.5 * (low + high)
        if stable(np.array([middle]))[0] > 0.0:
            low = middle
        else:
            high = middle
    return float(0.5 * (low + high))


def stability_limits(material: MooneyRivlin, furthest: float = 8.0) -> StabilityLimits:
    """Return the Drucker limits of a material.

    Parameters
    ----------
    material : MooneyRivlin
    furthest : float
        Largest stretch (and 1/compression) and shear searched.

    Returns
    -------
    StabilityLimits
    """

    def uniaxial(s: Floats) -> Floats:
        return drucker_tangent(material, s, s**-0.5)

    return StabilityLimits(
        compression=_first_loss(uniaxial, 1.0, 1.0 / furthest),
        tension=_first_loss(uniaxial, 1.0, furthest),
        equibiaxial=_first_loss(lambda s: drucker_tangent(material, s, s), 1.0, furthest),
        planar=_first_loss(lambda s: drucker_tangent(material, s, np.ones_like(s)), 1.0, furthest),
        simple_shear=_first_loss(
            lambda g: 2.0 * (material.c10 + material.c01) + 12.0 * material.c11 * g**2, 0.0, furthest
        ),
    )


def of_material(name: str) -> MooneyRivlin:
    """Return the law that the thesis fitted to a silicone (table 6).

    Parameters
    ----------
    name : str
        Material.

    Returns
    -------
    MooneyRivlin

    Raises
    ------
    InputError
        For an unknown material, or one without a compression test.
    """
    found = material(name).mooney_rivlin
    if found is None:
        known = ", ".join(n for n in material_names() if material(n).mooney_rivlin is not None)
        raise InputError(f"no compression test of {name!r}", key="material", allowed=known)
    return MooneyRivlin(found.C10_Pa * 1e-6, found.C01_Pa * 1e-6, found.C11_Pa * 1e-6)
