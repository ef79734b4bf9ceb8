"""Closed forms of light in a plate with total reflection: what the renderer has to agree with.

A plate's parallel faces act as mirrors for guided light, so that an LED on an edge becomes a row of images in the
unfolded plate and every guided path a straight line. Scattering at edges and contacts is left out: the forms hold
for black edges between the LEDs and for contacts too small to act back on the light.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.core.quadrature import gauss_legendre
from evanesce.optics.emitters import LedTable
from evanesce.optics.interface import (
    critical_angle,
    fresnel_reflectance,
    frustrated_transmittance,
    internal_diffuse_reflectance,
)

Array = NDArray[np.float64]


def halo_radius(thickness: float, refractive_index: float) -> float:
    """Return where light scattered at the top face comes back by total reflection at the bottom: 2 t tan(theta_c) [mm].

    Parameters
    ----------
    thickness : float
        [mm].
    refractive_index : float
        Of the plate, in air [1].
    """
    return 2.0 * thickness * math.tan(critical_angle(refractive_index))


def halo_irradiance(
    radius: ArrayLike, flux: float, thickness: float, refractive_index: float, absorption: float = 0.0
) -> Array:
    """Return the irradiance on the top face by a small Lambertian source in it, after one reflection at the bottom.

    The source's image lies 2 t deep: E = (flux/pi) cos^4(theta)/(2 t)^2 R(theta), tan(theta) = r/(2 t), times
    Beer-Lambert. R jumps to 1 at the halo's radius.

    Parameters
    ----------
    radius : array_like
        Distance from the source [mm].
    flux : float
        Radiant power that the source sends into the glass [W].
    thickness, refractive_index : float
        [mm], [1].
    absorption : float
        [1/mm].

    Returns
    -------
    ndarray
        [W mm^-2].
    """
    depth = 2.0 * thickness
    cos2 = depth**2 / (np.asarray(radius, float) ** 2 + depth**2)
    reflectance = fresnel_reflectance(np.sqrt(cos2), refractive_index, 1.0)
    return np.asarray(flux / np.pi * cos2**2 / depth**2 * reflectance * np.exp(-absorption * depth / np.sqrt(cos2)))


def escaping_radiance(radiance: ArrayLike, cos_theta: ArrayLike, refractive_index: float) -> Array:
    """Return the radiance in air of light that leaves the glass: L T(theta)/n^2, 0 beyond the critical angle.

    Parameters
    ----------
    radiance : array_like
        In the glass [W mm^-2 sr^-1].
    cos_theta : array_like
        In the glass [1].
    refractive_index : float
        [1].
    """
    t = 1.0 - fresnel_reflectance(cos_theta, refractive_index, 1.0)
    return np.asarray(np.asarray(radiance, float) * t / refractive_index**2)


def guided_irradiance(
    x: float,
    y: float,
    leds: LedTable,
    thickness: float,
    refractive_index: float,
    absorption: float = 0.0,
    coupling: Callable[[Array], Array] | None = None,
    *,
    entering: Callable[[Array], Array] | None = None,
    nodes: int = 12,
) -> float:
    """Return the guided irradiance [W mm^-2] from below on a point of the empty plate's top face.

    Sums the LEDs' images at unfolded depths 2 j t +- d that lie beyond the critical angle, integrating over each
    emitting face: E = sum of integrals of L T(theta) e^{-mu s} cos(theta) cos(theta_led)/s^2 dA.

    Parameters
    ----------
    x, y : float
        Point on the plate [mm].
    leds : LedTable
    thickness, refractive_index, absorption : float
        Of the plate [mm], [1], [1/mm].
    coupling : callable, optional
        Weight of a direction by the cosine of its angle to the normal; 1 if not given.
    entering : callable, optional
        Radiance in the glass over that of an LED in contact, by the cosine to the edge's normal; 1 if not given.
    nodes : int
        Gauss-Legendre nodes along each side of an emitting face. The critical angle cuts faces at a sharp line, which
        limits the error to about 1/nodes of the share of faces cut.
    """
    node, weight = gauss_legendre(nodes)
    along, depth = np.meshgrid(node * leds.width / 2, thickness / 2 + node * leds.height / 2)
    area = np.outer(weight, weight) * leds.width * leds.height / 4
    total = 0.0
    for (cx, cy), (nx, ny), radiance in zip(leds.centre, leds.normal, leds.radiance, strict=True):
        dx, dy = cx - ny * along - x, cy + nx * along - y
        run = np.hypot(dx, dy)
        reach = run * math.sqrt(refractive_index**2 - 1.0)
        facing = -(dx * nx + dy * ny)
        for j in range(int(reach.max() / (2 * thickness)) + 2):
            for family in (1.0, -1.0):
                drop = 2 * thickness * j + family * depth
                guided = (drop > 0) & (drop < reach)
                distance = np.hypot(run, drop)
                part = drop * facing / distance**4 * np.exp(-absorption * distance) * guided
                if coupling is not None:
                    part = part * coupling(drop / distance)
                if entering is not None:
                    part = part * entering(facing / distance)
                total += float(radiance) * float((part * area).sum())
    return total


def contact_radiance(
    x: float,
    y: float,
    leds: LedTable,
    thickness: float,
    glass_index: float,
    silicone_index: float,
    reflectance: float,
    wavelength: float,
    absorption: float = 0.0,
    *,
    gap: float = 0.0,
    cos_theta: float = 1.0,
    entering: Callable[[Array], Array] | None = None,
    nodes: int = 12,
) -> float:
    """Return the radiance [W mm^-2 sr^-1] in air at which the camera sees a small contact, edges black between LEDs.

    The coupled irradiance goes into a Lambertian body behind the interface, is re-emitted with the factor
    (n1/n3)^2 rho/(pi (1 - rho R_i)), passes the interface again, the glass once, and leaves through the bottom.

    Parameters
    ----------
    x, y : float
        The contact [mm].
    leds : LedTable
    thickness, glass_index, absorption : float
        Of the plate [mm], [1], [1/mm].
    silicone_index, reflectance : float
        [1].
    wavelength : float
        [nm].
    gap : float
        Of the film [mm].
    cos_theta : float
        Of the camera's direction inside the glass [1].
    entering : callable, optional
        See :func:`guided_irradiance`.
    nodes : int
        See :func:`guided_irradiance`.
    """

    def coupled(cosine: Array) -> Array:
        return frustrated_transmittance(cosine, gap, wavelength, glass_index, silicone_index)

    irradiance = guided_irradiance(
        x, y, leds, thickness, glass_index, absorption, coupled, entering=entering, nodes=nodes
    )
    inner = float(internal_diffuse_reflectance(gap, wavelength, glass_index, silicone_index))
    factor = (glass_index / silicone_index) ** 2 * reflectance / (math.pi * (1.0 - reflectance * inner))
    upward = irradiance * factor * float(coupled(np.array(cos_theta))) * math.exp(-absorption * thickness / cos_theta)
    return float(escaping_radiance(upward, cos_theta, glass_index))
