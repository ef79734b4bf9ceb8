"""Deflection of a thin rectangular plate under a load on a patch: simply supported (Navier) or clamped (Ritz).

References
----------
S. Timoshenko and S. Woinowsky-Krieger, "Theory of Plates and Shells", 2nd ed., McGraw-Hill (1959), articles 30 and 34,
tables 23 and 37.
J. Shen, "Efficient spectral-Galerkin method I", SIAM Journal on Scientific Computing 15 (1994) 1489: a basis of
Legendre polynomials that vanishes with its slope at both ends.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Array = NDArray[np.float64]
Support = Literal["simply supported", "clamped"]

GLASS_MODULUS_MPA = 70_000.0
GLASS_POISSON = 0.2
"""Soda-lime float glass, EN 572-1:2012."""

NAVIER_TERMS = 300
RITZ_TERMS = 30


def rigidity(thickness: float, modulus: float = GLASS_MODULUS_MPA, poisson: float = GLASS_POISSON) -> float:
    """Return the flexural rigidity D = E t^3 / (12 (1 - nu^2)) [N mm] of a plate of a thickness [mm]."""
    return modulus * thickness**3 / (12.0 * (1.0 - poisson**2))


def deflection(
    force: float,
    at: tuple[float, float],
    patch: tuple[float, float],
    size: tuple[float, float],
    bending: float,
    support: Support = "simply supported",
) -> float:
    """Return the deflection under the middle of an evenly loaded rectangle [mm].

    Parameters
    ----------
    force : float
        On the whole patch [N].
    at : tuple of float
        Middle of the patch, from the plate's middle [mm].
    patch, size : tuple of float
        Sides of patch and plate along x and y [mm]; the patch lies within the plate.
    bending : float
        :func:`rigidity` [N mm].
    support : {"simply supported", "clamped"}
        Of all four edges.
    """
    for centre, side, length in zip(at, patch, size, strict=True):
        if not (side > 0 and abs(centre) + side / 2 <= length / 2):
            raise ValueError(f"a patch of {side:g} mm at {centre:g} mm does not lie within {length:g} mm")
    solve = _navier if support == "simply supported" else _ritz
    return force / bending * solve(at, patch, size)


def _navier(at: tuple[float, float], patch: tuple[float, float], size: tuple[float, float]) -> float:
    """Return deflection times rigidity per force [mm^2] by the double sine series."""
    n = np.arange(1, NAVIER_TERMS + 1)
    shapes, loads, waves = [], [], []
    for centre, side, length in zip(at, patch, size, strict=True):
        wave = n * np.pi / length
        shape = np.sin(wave * (centre + length / 2))
        shapes.append(shape)
        loads.append(2.0 / length * shape * np.sinc(wave * side / 2 / np.pi))
        waves.append(wave**2)
    stiffness = (waves[0][:, None] + waves[1][None, :]) ** 2
    return float((shapes[0] * loads[0]) @ (1.0 / stiffness) @ (shapes[1] * loads[1]))


def _basis(count: int) -> Array:
    """Return Shen's basis as Legendre coefficients (count, count + 4): zero with its slope at -1 and 1."""
    k = np.arange(count)
    found = np.zeros((count, count + 4))
    found[k, k] = 1.0
    found[k, k + 2] = -2.0 * (2 * k + 5) / (2 * k + 7)
    found[k, k + 4] = (2 * k + 3) / (2 * k + 7)
    # Of unit curvature, so that the stiffness matrix is well conditioned.
    return found / np.sqrt(2.0 * (2 * k + 3) ** 2 * (2 * k + 5))[:, None]


def _ritz(at: tuple[float, float], patch: tuple[float, float], size: tuple[float, float]) -> float:
    """Return deflection times rigidity per force [mm^2] by minimal energy over products of the basis."""
    coefficients = _basis(RITZ_TERMS)
    nodes, weights = legendre.leggauss(RITZ_TERMS + 8)
    by_order = [
        np.array([legendre.legval(nodes, legendre.legder(c, order) if order else c) for c in coefficients])
        for order in (0, 2)
    ]
    mass, mixed, curved = ((by_order[a] * weights) @ by_order[b].T for a, b in ((0, 0), (1, 0), (1, 1)))
    load, value = [], []
    half = [length / 2 for length in size]
    for centre, side, reach in zip(at, patch, half, strict=True):
        low, high = (centre - side / 2) / reach, (centre + side / 2) / reach
        inner = 0.5 * (low + high) + 0.5 * (high - low) * nodes
        load.append(np.array([legendre.legval(inner, c) for c in coefficients]) @ weights / 2)
        value.append(np.array([legendre.legval(centre / reach, c) for c in coefficients]))
    a, b = half
    stiffness = (
        np.kron(curved, mass) * b / a**3 + np.kron(mass, curved) * a / b**3
        + (np.kron(mixed, mixed.T) + np.kron(mixed.T, mixed)) / (a * b)
    )  # fmt: skip
    amplitude = np.linalg.solve(stiffness, np.kron(load[0], load[1]))
    return float(np.kron(value[0], value[1]) @ amplitude)
