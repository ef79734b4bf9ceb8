"""The hyperelastic material of a finite-element finger: coefficients, the thesis's silicones, stable stretches."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.materials.tables import material as silicone
from evanesce.materials.tables import material_names

CARRIED_FROM = 0.75
"""Share of I1 - 3 at the loss of stability from which :func:`carried_on` acts: a stiffness that is to hold there has to
grow before."""


@dataclass(frozen=True)
class Rubber:
    """Nearly incompressible Mooney-Rivlin rubber of three parameters, and two more terms that are off by default.

    W = C10 (I1 - 3) + C01 (I2 - 3) + C11 (I1 - 3)(I2 - 3) + C30 (I1 - 3)^3 + CX <I1 - 3 - X>^3 with the invariants of
    the distortional deformation, <.> being zero below zero, and K/2 (J - 1)^2 of the volume.

    Attributes
    ----------
    c10, c01, c11 : float
        [MPa].
    c30 : float
        [MPa]; 0 in every published fit used here: above 0 it stiffens large stretches and the result is no longer
        that of the thesis's material.
    beyond : float
        CX [MPa]: carries on where the published fit loses its stability (:func:`carried_on`).
    beyond_from : float
        X, the value of I1 - 3 from which it acts.
    bulk_ratio : float
        Bulk over shear modulus, K/G; 500 is a Poisson ratio of 0.499.
    stretch_limit : float
        Largest principal stretch, and the inverse of the smallest, at which results are kept even of a material that
        is stable further than that.
    name : str

    References
    ----------
    R. S. Rivlin and D. W. Saunders, Phil. Trans. R. Soc. A 243 (1951) 251.
    """

    c10: float
    c01: float
    c11: float = 0.0
    c30: float = 0.0
    beyond: float = 0.0
    beyond_from: float = 0.0
    bulk_ratio: float = 500.0
    stretch_limit: float = 6.0
    name: str = "custom"

    def __post_init__(self) -> None:
        for key in ("c10", "c01", "c11", "c30", "beyond", "beyond_from", "bulk_ratio", "stretch_limit"):
            if not np.isfinite(getattr(self, key)):
                raise InputError(f"{getattr(self, key)!r}", key=key, allowed="a finite number")
        if self.c10 + self.c01 <= 0:
            raise InputError(f"c10 + c01 = {self.c10 + self.c01:g} MPa", key="material", allowed="above 0")
        for key in ("c30", "beyond", "beyond_from"):
            if getattr(self, key) < 0:
                raise InputError(f"{getattr(self, key):g}", key=key, allowed="0 or more")
        if not 5.0 <= self.bulk_ratio <= 1e5:
            raise InputError(f"{self.bulk_ratio:g}", key="bulk_ratio", allowed="5 to 100000")
        if self.stretch_limit <= 1.0:
            raise InputError(f"{self.stretch_limit:g}", key="stretch_limit", allowed="above 1")

    @property
    def shear_modulus(self) -> float:
        """Small-strain shear modulus [MPa]."""
        return 2.0 * (self.c10 + self.c01)

    @property
    def bulk_modulus(self) -> float:
        """[MPa]."""
        return self.bulk_ratio * self.shear_modulus

    @property
    def reduced_modulus(self) -> float:
        """Small-strain E/(1 - nu^2) against a rigid plane [MPa]."""
        k, g = self.bulk_modulus, self.shear_modulus
        poisson = (3 * k - 2 * g) / (6 * k + 2 * g)
        return 2 * g / (1 - poisson)

    def stable_stretches(self) -> tuple[float, float]:
        """Return the uniaxial stretches (below and above 1) at which the incompressible material loses stability.

        Stable in Drucker's sense: stress rises with log strain in every direction, that is, the energy is convex in
        the two free log strains. ``stretch_limit`` bounds the range searched.

        Returns
        -------
        tuple of float
        """
        log = np.linspace(0.0, np.log(self.stretch_limit), 601)

        def bound(sign: float) -> float:
            stretches = np.exp(sign * log[:, None] * np.array([1.0, -0.5, -0.5]))
            lost = np.flatnonzero(~self.is_stable(stretches))
            return float(np.exp(sign * log[lost[0] if lost.size else -1]))

        return bound(-1.0), bound(1.0)

    def is_stable(self, stretches: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return where the distortional material is stable in Drucker's sense.

        Parameters
        ----------
        stretches : ndarray (n, 3)
            Principal stretches; a change of volume is taken off.

        Returns
        -------
        ndarray of bool

        References
        ----------
        D. C. Drucker, J. Appl. Mech. 26 (1959) 101.
        """
        logs, h = np.log(stretches), 1e-3
        logs = logs - logs.mean(axis=1, keepdims=True)

        def at(da: float, db: float) -> Any:
            a, b = logs[:, 0] + da, logs[:, 1] + db
            gradient = np.zeros((3, 3, len(logs)))
            gradient[0, 0], gradient[1, 1], gradient[2, 2] = np.exp(a), np.exp(b), np.exp(-a - b)
            return energy(self, gradient)

        middle = 2 * at(0, 0)
        aa, bb = at(h, 0) - middle + at(-h, 0), at(0, h) - middle + at(0, -h)
        ab = 0.25 * (at(h, h) - at(h, -h) - at(-h, h) + at(-h, -h))
        return np.asarray((aa + bb > 0) & (aa * bb > ab**2))

    def identity(self) -> dict[str, Any]:
        """Return what a result depends on, for its digest; the name is left out.

        Returns
        -------
        dict
        """
        known = asdict(self)
        if self.beyond == 0.0:
            del known["beyond"], known["beyond_from"]
        return {key: value for key, value in known.items() if key != "name"}


def rubber(name: str, **changes: float) -> Rubber:
    """Return a silicone of the thesis (table 6) by name, e.g. ``"silskin_20"``.

    Parameters
    ----------
    name : str
    **changes : float
        Other coefficients of :class:`Rubber`.

    Returns
    -------
    Rubber

    Raises
    ------
    InputError
        For an unknown name or a silicone without a hyperelastic fit.
    """
    fit = silicone(name).mooney_rivlin
    if fit is None:
        fitted = ", ".join(n for n in material_names() if silicone(n).mooney_rivlin is not None)
        raise InputError(f"{name!r} has no hyperelastic fit", key="material", allowed=fitted)
    return Rubber(c10=fit.C10_Pa * 1e-6, c01=fit.C01_Pa * 1e-6, c11=fit.C11_Pa * 1e-6, name=name, **changes)


def carried_on(material: Rubber) -> Rubber:
    """Return a material that is stable up to its stretch limit: stiffened where the published fit soon is not.

    An assumption, as no fit says what the rubber does there: from three quarters of the least I1 - 3 at which the fit
    is unstable a cubic term is added, the weakest of a series of doubled ones that leaves no unstable stretch. Below
    that the material is the published one, and one that is stable everywhere is returned as it is.

    Parameters
    ----------
    material : Rubber

    Returns
    -------
    Rubber
    """
    most = np.log(material.stretch_limit)
    first, second = np.meshgrid(*2 * [np.linspace(-most, most, 181)])
    logs = np.stack([first, second, -first - second], axis=-1).reshape(-1, 3)
    stretches = np.exp(logs[(np.abs(logs) <= most).all(axis=1)])
    stable = material.is_stable(stretches)
    if stable.all():
        return material
    start = CARRIED_FROM * float(((stretches**2).sum(axis=1) - 3.0)[~stable].min())
    for doubled in range(40):
        tried = replace(material, beyond=material.shear_modulus * 2.0 ** (doubled - 20), beyond_from=start)
        if tried.is_stable(stretches).all():
            return tried
    raise InputError("no cubic term makes it stable", key="material", allowed="an energy that grows with stretch")


def _invariants(gradient: NDArray[np.float64]) -> tuple[Any, ...]:
    """Return a = J^(-2/3), I1, I2, F^-T, and dI2/dF of deformation gradients (3, 3, ...)."""
    last = np.moveaxis(gradient, (0, 1), (-2, -1))
    turned = np.moveaxis(np.linalg.inv(last), (-1, -2), (0, 1))
    scale = np.cbrt(np.linalg.det(last)) ** -2
    cauchy_green = np.einsum("mi...,mj...->ij...", gradient, gradient)
    i1 = np.einsum("ii...->...", cauchy_green)
    i2 = 0.5 * (i1**2 - np.einsum("ij...,ij...->...", cauchy_green, cauchy_green))
    by_i2 = 2.0 * (i1 * gradient - np.einsum("im...,mj...->ij...", gradient, cauchy_green))
    return scale, i1, i2, turned, by_i2, cauchy_green


def _slopes(material: Rubber, j1: Any, j2: Any) -> tuple[Any, Any]:
    """Return dW/dI1 and dW/dI2 at the distortional invariants."""
    far = np.maximum(j1 - 3.0 - material.beyond_from, 0.0)
    w1 = material.c10 + material.c11 * (j2 - 3.0) + 3.0 * (material.c30 * (j1 - 3.0) ** 2 + material.beyond * far**2)
    return w1, material.c01 + material.c11 * (j1 - 3.0)


def energy(material: Rubber, gradient: NDArray[np.float64]) -> Any:
    """Return the distortional energy density [MPa] at deformation gradients, shape (3, 3, ...).

    Parameters
    ----------
    material : Rubber
    gradient : ndarray (3, 3, ...)
        Deformation gradients.

    Returns
    -------
    ndarray (...)
        [MPa].
    """
    scale, i1, i2, *_ = _invariants(gradient)
    j1, j2 = scale * i1 - 3.0, scale**2 * i2 - 3.0
    far = np.maximum(j1 - material.beyond_from, 0.0)
    fitted = material.c10 * j1 + material.c01 * j2 + material.c11 * j1 * j2
    return fitted + material.c30 * j1**3 + material.beyond * far**3


def distortional_stress(material: Rubber, gradient: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the first Piola-Kirchhoff stress of the distortional energy [MPa], shape (3, 3, ...).

    Parameters
    ----------
    material : Rubber
    gradient : ndarray (3, 3, ...)
        Deformation gradients.

    Returns
    -------
    ndarray (3, 3, ...)
        [MPa].

    References
    ----------
    G. A. Holzapfel, Nonlinear Solid Mechanics (Wiley, 2000), section 6.4.
    """
    scale, i1, i2, turned, by_i2, _ = _invariants(gradient)
    w1, w2 = _slopes(material, scale * i1, scale**2 * i2)
    first = scale * (2.0 * gradient - (2.0 / 3.0) * i1 * turned)
    second = scale**2 * (by_i2 - (4.0 / 3.0) * i2 * turned)
    return np.asarray(w1 * first + w2 * second)


def distortional_tangent(material: Rubber, gradient: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivative of :func:`distortional_stress` by the deformation gradient [MPa], (3, 3, 3, 3, ...).

    Parameters
    ----------
    material : Rubber
    gradient : ndarray (3, 3, ...)
        Deformation gradients.

    Returns
    -------
    ndarray (3, 3, 3, 3, ...)
        [MPa].
    """
    scale, i1, i2, turned, by_i2, cauchy_green = _invariants(gradient)
    w1, w2 = _slopes(material, scale * i1, scale**2 * i2)
    first = scale * (2.0 * gradient - (2.0 / 3.0) * i1 * turned)
    second = scale**2 * (by_i2 - (4.0 / 3.0) * i2 * turned)
    s1, s2 = w1 * scale, w2 * scale**2

    def dyad(a: Any, b: Any) -> Any:
        return np.einsum("ij...,kl...->ijkl...", a, b)

    # every term in F^-T, F and dI2/dF as one outer product; what is left needs crossed indices
    mixed = s1 * (-4.0 / 3.0) * gradient + s2 * (-4.0 / 3.0) * by_i2
    total = dyad(turned, mixed + (s1 * (4.0 / 9.0) * i1 + s2 * (16.0 / 9.0) * i2) * turned)
    total += dyad(mixed, turned)
    far = np.maximum(scale * i1 - 3.0 - material.beyond_from, 0.0)
    rising = 6.0 * (material.c30 * (scale * i1 - 3.0) + material.beyond * far)
    total += dyad(first, material.c11 * second + rising * first)
    total += material.c11 * dyad(second, first)
    total += np.einsum("il...,kj...->ijkl...", ((2 / 3) * s1 * i1 + (4 / 3) * s2 * i2) * turned, turned)
    total += dyad(4.0 * s2 * gradient, gradient)
    total -= np.einsum("il...,kj...->ijkl...", 2.0 * s2 * gradient, gradient)
    left = np.einsum("im...,km...->ik...", gradient, gradient)
    for i in range(3):
        for j in range(3):
            total[i, j, i, j] += 2.0 * s1 + 2.0 * s2 * i1
            total[i, :, i, j] -= 2.0 * s2 * cauchy_green[:, j]
            total[i, j, :, j] -= 2.0 * s2 * left[i]
    return np.asarray(total)
