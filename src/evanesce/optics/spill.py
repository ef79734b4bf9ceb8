"""Light that the strips spill above the plate, on points there.

The band above an edge in front of an LED is a Lambertian rectangle, upright on the edge, from the top face up to a
height, that faces the plate's middle. A point above the plate is lit by it directly and by its image in the plate: a
parallel plate mirrors 2R/(1 + R) of unpolarised light, R that of one face (all orders, added as powers; the shift
between the faces' images, a few millimetres, is ignored). Under grazing incidence that is nearly all.

References
----------
R. W. Boyd, *Radiometry and the Detection of Optical Radiation* (1983), chapter 2 (exchange between elements).
M. Born and E. Wolf, *Principles of Optics*, 7th ed. (1999), section 1.5.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evanesce.core.quadrature import gauss_legendre
from evanesce.optics.edge_rays import EDGES, EdgeLight, led_count
from evanesce.optics.flank.escape import ON_GLASS
from evanesce.optics.interface import fresnel_reflectance

Array = NDArray[np.float64]

NODES_ALONG, NODES_UP = 2, 3
"""Gauss-Legendre nodes over a band's width and height; points are many widths away."""


def plate_reflectance(cosine: Array, refractive_index: float) -> Array:
    """Return the reflectance of a clear parallel plate for light from the air: 2R/(1 + R).

    Parameters
    ----------
    cosine : ndarray
        Of the angle of incidence, 0 to 1 [1].
    refractive_index : float
        Of the glass [1].

    Returns
    -------
    ndarray
        Shape of ``cosine`` [1].
    """
    face = fresnel_reflectance(np.clip(cosine, 0.0, 1.0), 1.0, refractive_index)
    return np.asarray(2.0 * face / (1.0 + face))


def spilled_irradiance(
    light: EdgeLight, points: Array, normals: Array, height_mm: float, shadow: tuple[float, float, float] | None = None
) -> Array:
    """Return the irradiance on points above the plate from the bands of all LEDs.

    E = integral of L cos(at the band) cos(at the point) / r^2 over each band and its mirrored image, where
    L = P/(pi width height) for a power P spilled.

    Parameters
    ----------
    light : EdgeLight
        Its radiances do not count.
    points, normals : ndarray (points, 3)
        Above the top face, z = 0 [mm]; outward unit normals. A convex body does not shade itself beyond its horizon;
        points on the glass itself get nothing.
    height_mm : float
        Upper end of the bands [mm].
    shadow : tuple of float, optional
        Axis (x, y) and radius [mm] of an upright cylinder that shades; none if not given.

    Returns
    -------
    ndarray (leds, points)
        Per radiance of each LED, if all its power were spilled [sr].
    """
    width, face_height = light.emitter_size
    along, along_weight = gauss_legendre(NODES_ALONG)
    up, up_weight = gauss_legendre(NODES_UP)
    # The same power from a band of another height: radiance by the ratio of areas.
    per_led = face_height / height_mm
    found, led = np.zeros((led_count(light), len(points))), 0
    for number, name in enumerate(EDGES):
        on_x, side = number < 2, (-1.0, 1.0)[number % 2]
        wall = side * (light.size[0] if on_x else light.size[1]) / 2
        for centre in light.positions.get(name, np.zeros(0)):
            for u, wu in zip(along, along_weight, strict=True):
                at = centre + u * width / 2
                source = np.array([wall, at] if on_x else [at, wall])
                away = side * (wall - points[:, 0 if on_x else 1])
                lit = np.ones(len(points), bool) if shadow is None else ~_shaded(source, points[:, :2], shadow)
                for v, wv in zip(up, up_weight, strict=True):
                    area = wu * width / 2 * wv * height_mm / 2
                    z = (1 + v) * height_mm / 2
                    exchanged = _exchange(source, z, away, points, normals, light.refractive_index)
                    found[led] += np.where(lit, exchanged, 0.0) * (area * per_led)
            led += 1
    return np.where(points[:, 2] > ON_GLASS, found, 0.0)


def _exchange(source: Array, z: float, away: Array, points: Array, normals: Array, refractive_index: float) -> Array:
    """Return cos(at source) cos(at point)/r^2 of a source at height z and of its image in the plate [1/mm^2]."""
    beside = source[None, :] - points[:, :2]
    total = np.zeros(len(points))
    for height in (z, -z):
        rise = height - points[:, 2]
        length2 = (beside**2).sum(axis=1) + rise**2
        length = np.sqrt(length2)
        facing = (normals[:, 0] * beside[:, 0] + normals[:, 1] * beside[:, 1] + normals[:, 2] * rise) / length
        share = np.clip(facing, 0.0, None) * np.clip(away, 0.0, None) / (length * length2)
        if height < 0:
            share = share * plate_reflectance(-rise / length, refractive_index)
        total += share
    return total


def _shaded(source: Array, points: Array, shadow: tuple[float, float, float]) -> NDArray[np.bool_]:
    """Return whether a circle (x, y, radius) in plan view lies between the source and each point (points, 2)."""
    way = points - source[None, :]
    towards = np.array(shadow[:2])[None, :] - source[None, :]
    length2 = np.maximum((way**2).sum(axis=1), 1e-12)
    part = np.clip((way * towards).sum(axis=1) / length2, 0.0, 1.0)
    nearest = ((way * part[:, None] - towards) ** 2).sum(axis=1)
    return np.asarray(nearest < shadow[2] ** 2)
