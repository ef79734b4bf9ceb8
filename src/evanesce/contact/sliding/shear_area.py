"""Contact area under shear from physics: an adhesive edge that peels, and a body that lays itself on and lifts off.

Peeling. Shear adds to the energy that an adhesive edge releases, so that less of it holds normally. With JKR's punch
load P' = 4 E* a^3/(3 R) - N, and fixed forces, energy balance about the mean of the edge is

    P'^2 / (8 pi a^3 E*) + Q^2 / (8 pi a^3 G*) = w,   per unit area, 2 a G* the contact's tangential stiffness,

which is JKR at Q = 0. It has no solution beyond a largest shear, where the edge snaps to Hertz's circle (Savkoor and
Briggs 1977).

Large strain. A sheared body bulges ahead, where skin is laid on, and is pulled off behind: the share of area by mean
shear strain Q/(A G) is that of the slide that was solved by finite elements (:mod:`evanesce.contact.fem`) of the same
silicone, solid or over a bone; beyond its last it stays. That it depends on this strain alone is assumed.

Reference: A. R. Savkoor and G. A. D. Briggs, Proc. R. Soc. A 356 (1977) 103.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.analytic.hertz import hertz_radius
from evanesce.contact.fem.library import FAR_SLIDES, library_press, library_slide
from evanesce.materials import tables

Floats = NDArray[np.float64]
Share = Callable[[float], float]
STEPS = 24
"""Of strain, over each of which the share of a solved slide is averaged."""


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


@lru_cache(maxsize=8)
def _solved(material: str, bone: str) -> tuple[Floats, Floats]:
    """Return the mean shear strain of a solved slide [1], ascending, and the share of area left."""
    found, fit = (
        library_slide(FAR_SLIDES[_nearest(material), bone][0]),
        tables.material(_nearest(material)).mooney_rivlin,
    )
    assert fit is not None  # of both materials
    share = found.scalars["area"] / found.scalars["area"][0]
    # coarse elements have too large an area: strain is by that of the fine press at the same force
    area = library_press(_nearest(material), bone).area(float(found.scalars["normal_force"][0]))
    strain = np.abs(found.scalars["tangential_force"]) / (area * fit.shear_modulus_MPa)
    # elements that spring off one by one, and skin that folds, make single steps jump
    steps = np.minimum((strain / strain.max() * STEPS).astype(int), STEPS - 1)
    count = np.bincount(steps, minlength=STEPS)
    means = [np.bincount(steps, one, STEPS)[count > 0] / count[count > 0] for one in (strain, share)]
    return np.append(0.0, means[0]), np.append(1.0, means[1])


def _nearest(material: str) -> str:
    """Return the solved material that stands for one: Silskin 0 % for what has no slide of its own."""
    return material if (material, "none") in FAR_SLIDES else "silskin_0"


def solved_strain(material: str, bone: str) -> float:
    """Return the largest mean shear strain Q/(A G) of the solved slides [1], beyond which the share of area stays.

    Parameters
    ----------
    material : str
    bone : {"none", "half"}
    """
    return float(_solved(material, bone)[0][-1])


def bulging_share(area: float, shear_modulus: float, material: str, bone: str) -> Share:
    """Return the share of area that is left under a shear force [N], by finite elements.

    Parameters
    ----------
    area : float
        Without shear [mm^2].
    shear_modulus : float
        G [MPa].
    material : str
        Whose slide was solved; Silskin 0 % stands for others.
    bone : {"none", "half"}

    Returns
    -------
    callable
        Q [N] -> share.
    """
    strain, share = _solved(material, bone)
    return lambda q: float(np.interp(abs(q) / (area * shear_modulus), strain, share))
