"""Contact area under shear from physics: an adhesive edge that peels, and a body that lays itself on and lifts off.

Peeling. Shear adds to the energy that an adhesive edge releases, so that less of it holds normally. With JKR's punch
load P' = 4 E* a^3/(3 R) - N, and fixed forces, energy balance about the mean of the edge is

    P'^2 / (8 pi a^3 E*) + Q^2 / (8 pi a^3 G*) = w,   per unit area, 2 a G* the contact's tangential stiffness,

which is JKR at Q = 0. It has no solution beyond a largest shear, where the edge snaps to Hertz's circle (Savkoor and
Briggs 1977).

Large strain. A sheared body bulges ahead, where skin is laid on, and is pulled off behind: the share of area by mean
shear strain Q/(A G) is that of the slides solved by finite elements (:mod:`evanesce.contact.fem`), solid or over a
bone, between points; beyond the last it stays. That it depends on this strain alone is assumed.

Reference: A. R. Savkoor and G. A. D. Briggs, Proc. R. Soc. A 356 (1977) 103.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.analytic.hertz import hertz_radius

Floats = NDArray[np.float64]
Share = Callable[[float], float]
TABLE = Path(__file__).resolve().parent / "solved_shear.toml"


def peeled_radius(force: float, shear: float, radius: float, modulus: float, tangential: float, work: float) -> float:
    """Return the contact radius of an adhesive sphere under normal force and shear, stuck everywhere [mm].

    Parameters
    ----------
    force, shear : float
        N and Q [N], N not negative.
    radius : float
        Of the sphere [mm].
    modulus, tangential : float
        E* and G* [MPa].
    work : float
        Of adhesion [N/mm].

    Returns
    -------
    float
        JKR's without shear; it shrinks until no equilibrium is left, where the edge snaps back to Hertz's circle.
    """
    hertz = float(hertz_radius(force, radius, modulus))
    punch, edge = 4.0 * modulus / (3.0 * radius), 8.0 * np.pi * modulus * work
    # x = a^3 less Hertz's: punch^2 x^2 - edge x + Q^2 E*/G* - edge a_hertz^3 = 0, the outer root
    inside = edge**2 - 4.0 * punch**2 * (shear**2 * modulus / tangential - edge * hertz**3)
    if inside < 0.0:
        return hertz
    return float(np.cbrt(hertz**3 + (edge + np.sqrt(inside)) / (2.0 * punch**2)))


def peeling_share(force: float, radius: float, modulus: float, tangential: float, work: float) -> Share:
    """Return the share of JKR's area that is left under a shear force [N].

    Parameters
    ----------
    force, radius, modulus, tangential, work : float
        As for :func:`peeled_radius`.

    Returns
    -------
    callable
        Q [N] -> share.
    """
    full = peeled_radius(force, 0.0, radius, modulus, tangential, work)
    return lambda q: (peeled_radius(force, abs(q), radius, modulus, tangential, work) / full) ** 2


@lru_cache(maxsize=1)
def _solved() -> dict[str, tuple[Floats, Floats]]:
    tables = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    return {bone: (np.array(one["shear"]), np.array(one["share"])) for bone, one in tables.items()}


def solved_strain(bone: str) -> float:
    """Return the largest mean shear strain Q/(A G) of the solved slides [1], beyond which the share of area stays.

    Parameters
    ----------
    bone : {"none", "half"}
    """
    return float(_solved()[bone][0][-1])


def bulging_share(area: float, shear_modulus: float, bone: str) -> Share:
    """Return the share of area that is left under a shear force [N], by finite elements.

    Parameters
    ----------
    area : float
        Without shear [mm^2].
    shear_modulus : float
        G [MPa].
    bone : {"none", "half"}

    Returns
    -------
    callable
        Q [N] -> share.
    """
    strain, share = _solved()[bone]
    return lambda q: float(np.interp(abs(q) / (area * shear_modulus), strain, share))
