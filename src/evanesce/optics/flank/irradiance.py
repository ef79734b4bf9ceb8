"""Irradiance on the finger's flank: light that leaves the plate's top face, the contact's own, and its reflections.

LEDs and edges also emit below the critical angle. That light leaves the top face within a few thicknesses of the edge,
at grazing angles, and lights the finger from the side: a dim annulus around the contact, without contact. A part of
what the contact sends down is reflected at the bottom face and leaves beside the contact.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from evanesce.optics.edge_rays import EdgeLight, arrivals, led_count, segment_of
from evanesce.optics.flank.escape import ON_GLASS, escaping_irradiance
from evanesce.optics.interface import fresnel_reflectance
from evanesce.optics.patch_light import Interface, external_diffuse_reflectance, returned_radiance
from evanesce.optics.path_sums import MOMENTS, add_paths

Array = NDArray[np.float64]


def flank_sums(
    light: EdgeLight, points: Array, normals: Array, *, samples: int = 4096, per_edge: int = 48
) -> tuple[Array, Array]:
    """Return the irradiance from light that leaves the top face, summed by paths (:mod:`evanesce.optics.path_sums`).

    What no edge has mirrored by a quadrature (:func:`evanesce.optics.flank.escape.escaping_irradiance`); the rest,
    where edges are polished, by :func:`sampled_irradiance`.

    Parameters
    ----------
    light : EdgeLight
        Its radiances do not count.
    points, normals : ndarray (points, 3)
        Above the top face, z = 0 [mm]; outward unit normals.
    samples : int
        Of the top face for each point.
    per_edge : int
        Segments of each edge.

    Returns
    -------
    led : ndarray (moments, leds, points)
        Per radiance of each LED [sr].
    edge : ndarray (moments, segments, points)
        Per diffuse radiance of each segment [sr].
    """
    led, edge = escaping_irradiance(light, points, normals, per_edge=per_edge)
    if light.edge_polish > 0.0:
        more = sampled_irradiance(light, points, normals, samples=samples, per_edge=per_edge, mirrorings=1)
        led, edge = led + more[0], edge + more[1]
    return led, edge


def sampled_irradiance(
    light: EdgeLight,
    points: Array,
    normals: Array,
    *,
    samples: int = 4096,
    per_edge: int = 48,
    mirrorings: int = 0,
) -> tuple[Array, Array]:
    """Return :func:`flank_sums` by quasi-random paths, for at least ``mirrorings`` reflections at edges.

    Points of the top face, denser towards the edges and below the point; from each the straight path is
    followed back into the glass. A convex body does not shade itself beyond its horizon, and nothing else stands on
    the plate. Points on the glass itself get nothing: no path leads there from beside it.

    Parameters
    ----------
    light, points, normals, samples, per_edge
        As for :func:`flank_sums`.
    mirrorings : int
        Fewest reflections at edges.

    Returns
    -------
    led, edge : ndarray
        As of :func:`flank_sums`.
    """
    n = light.refractive_index
    leds, segments, count = led_count(light), 4 * per_edge, points.shape[0]
    led, edge = (np.zeros((MOMENTS, sources, count)) for sources in (leds + 1, segments))
    u = qmc.Sobol(5, scramble=True, rng=np.random.default_rng(5)).random(samples // 2)
    strips_x, strips_y = _towards_edges(light, u[:, :3])
    for k in np.flatnonzero(points[:, 2] > ON_GLASS):
        here_x, here_y = _below(points[k], normals[k], u[:, 3:])
        qx, qy = np.concatenate([strips_x, here_x]), np.concatenate([strips_y, here_y])
        dx, dy, dz = points[k, 0] - qx, points[k, 1] - qy, points[k, 2]
        length2 = np.maximum(dx * dx + dy * dy + dz * dz, 1e-24)
        length = np.sqrt(length2)
        facing = -(normals[k, 0] * dx + normals[k, 1] * dy + normals[k, 2] * dz) / length
        cos_air = dz / length
        solid = np.clip(facing, 0.0, None) * cos_air / length2
        inside = (np.abs(qx) < light.size[0] / 2) & (np.abs(qy) < light.size[1] / 2)
        good = (solid > 0) & inside
        if not good.any():
            continue
        # Either way of drawing could have drawn any position: the mean of both densities keeps the weights bounded.
        density = 0.5 * (_edge_density(light, qx[good], qy[good]) + solid[good] / np.pi)
        sin_glass = np.sqrt(1 - cos_air[good] ** 2) / n
        theta = np.arcsin(np.clip(sin_glass, 1e-9, 1.0))
        weight = solid[good] / density / u.shape[0] / 2
        weight = weight * (1 - fresnel_reflectance(np.cos(theta), n, 1.0)) / n**2
        # The light comes from the other side, downwards as seen from the top face.
        phi = np.arctan2(-dy[good], -dx[good])
        zero = np.zeros_like(theta)
        start = (qx[good] * (1 - 1e-9), qy[good] * (1 - 1e-9), zero, theta, phi, np.ones(theta.shape, bool))
        for met in itertools.islice(arrivals(light, *start), mirrorings, None):
            add_paths(led[:, :, k], met.led + 1, met.led_share * weight, met.length)
            add_paths(edge[:, :, k], segment_of(light, met.hits, per_edge), met.edge_share * weight, met.length)
    return led[:, 1:], edge


def _towards_edges(light: EdgeLight, u: Array) -> tuple[Array, Array]:
    """Draw positions on the top face, their density 1/(distance + thickness) from the edges inwards."""
    hx, hy, t = light.size[0] / 2, light.size[1] / 2, light.thickness
    number = np.searchsorted(np.cumsum([hy, hy, hx]) / (2 * (hx + hy)), u[:, 0])
    reach = np.where(number < 2, hx, hy)
    inward = t * np.expm1(u[:, 1] * np.log1p(reach / t))
    along = (2 * u[:, 2] - 1) * np.where(number < 2, hy, hx)
    side = np.where(number % 2 == 0, -1.0, 1.0)
    x = np.where(number < 2, side * (hx - inward), along)
    return x, np.where(number < 2, along, side * (hy - inward))


def _edge_density(light: EdgeLight, x: Array, y: Array) -> Array:
    """Return the density [1/mm^2] of :func:`_towards_edges`; a position is in two strips, one of each pair of edges."""
    hx, hy, t = light.size[0] / 2, light.size[1] / 2, light.thickness
    total = np.zeros_like(x)
    for distance, limit in ((hx - np.abs(x), hx), (hy - np.abs(y), hy)):
        total += 1.0 / ((distance + t) * np.log1p(limit / t)) / (4 * (hx + hy))
    return total


def _below(point: Array, normal: Array, u: Array) -> tuple[Array, Array]:
    """Draw positions in the plane z = 0 in cosine-weighted directions about a point's normal; far away above."""
    across = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.7 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    around, radius = 2 * np.pi * u[:, 1], np.sqrt(u[:, 0])
    direction = np.sqrt(1 - u[:, 0])[:, None] * normal
    direction = direction + (radius * np.cos(around))[:, None] * across
    direction = direction + (radius * np.sin(around))[:, None] * np.cross(normal, across)
    run = np.where(direction[:, 2] < -1e-9, -point[2] / np.minimum(direction[:, 2], -1e-9), 1e9)
    return point[0] + run * direction[:, 0], point[1] + run * direction[:, 1]


def contact_on_flank(
    points: Array, normals: Array, nodes: Array, thickness: float, interface: Interface, absorption_coefficient: float
) -> Array:
    """Return the irradiance on points above the plate that contacts send there over the bottom face.

    A ray that leaves a contact at angle theta comes out 2 t tan(theta) farther and goes on under theta', n sin(theta) =
    sin(theta'): one angle leads from a contact to a point.

    Parameters
    ----------
    points, normals : ndarray (points, 3)
        Above the top face, z = 0 [mm]; outward unit normals.
    nodes : ndarray (nodes, 2)
        Contacts on the top face [mm].
    thickness : float
        [mm].
    interface : Interface
    absorption_coefficient : float
        [1/mm].

    Returns
    -------
    ndarray (points, nodes)
        Per irradiance inside a contact and per area of it [1/mm^2].
    """
    n = interface.n_glass
    dx, dy = (points[:, None, i] - nodes[None, :, i] for i in (0, 1))
    height = np.broadcast_to(points[:, None, 2], dx.shape)
    run = np.maximum(np.hypot(dx, dy), 1e-6)
    low, high = np.zeros(run.shape), np.full(run.shape, 1.0)
    for _ in range(50):
        sine = 0.5 * (low + high)  # of theta'
        reach = 2 * thickness * (sine / n) / np.sqrt(1 - (sine / n) ** 2) + height * sine / np.sqrt(1 - sine**2)
        low, high = np.where(reach < run, sine, low), np.where(reach < run, high, sine)
    # Beyond the critical angle nothing comes out.
    open_path = low < 1.0 - 1e-9
    sine = np.minimum(0.5 * (low + high), 1.0 - 1e-9)
    cos_air, cos_glass = np.sqrt(1 - sine**2), np.sqrt(1 - (sine / n) ** 2)
    slope = 2 * thickness * cos_air / (n * cos_glass**3) + height / cos_air**2
    solid = sine / (run * slope)  # solid angle in the air per area of the contact
    facing = -((normals[:, None, 0] * dx + normals[:, None, 1] * dy) / run * sine + normals[:, None, 2] * cos_air)
    bare = fresnel_reflectance(cos_glass, n, 1.0)
    radiance = returned_radiance(0.0, np.arccos(cos_glass), interface) * bare * (1 - bare) / n**2
    radiance = radiance * np.exp(-absorption_coefficient * 2 * thickness / cos_glass)
    return np.asarray(np.where(open_path, radiance * solid * np.clip(facing, 0.0, None), 0.0))


def mirrored_exchange(points: Array, normals: Array, reflectance: float, refractive_index: float) -> Array:
    """Return the flank's irradiance, its own light mirrored by the plate included, over that without.

    Both faces mirror; the shift between them, a few millimetres, is ignored. Each element is taken as a disc. Where the
    surface lies flat on the glass, light is exchanged through the top face only.

    Parameters
    ----------
    points, normals : ndarray (stations, azimuths, 3)
        One finger, from the tip upwards [mm].
    reflectance : float
        Of the finger [1].
    refractive_index : float
        Of the glass [1].

    Returns
    -------
    ndarray (stations * azimuths, stations * azimuths)
        [1].
    """
    stations, azimuths = points.shape[:2]
    along = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    width = np.concatenate([along[:1] / 2, (along[1:] + along[:-1]) / 2, along[-1:] / 2])
    radius = np.hypot(*np.moveaxis(points[..., :2] - points[:1, :, :2].mean(axis=1, keepdims=True), -1, 0))
    area = (width * radius * 2 * np.pi / azimuths).ravel()
    p, n = points.reshape(-1, 3), normals.reshape(-1, 3)
    mirror = np.array([1.0, 1.0, -1.0])
    way = (p * mirror)[None, :, :] - p[:, None, :]
    length2 = np.maximum((way**2).sum(-1), 1e-12)
    way /= np.sqrt(length2)[..., None]
    cos_here, cos_there = (way * n[:, None, :]).sum(-1), -(way * (n * mirror)[None, :, :]).sum(-1)
    face = fresnel_reflectance(np.clip(-way[..., 2], 0.0, 1.0), 1.0, refractive_index)
    form = np.clip(cos_here, 0.0, None) * np.clip(cos_there, 0.0, None) * area / (np.pi * length2 + area)
    flat = p[:, 2] <= 1e-9
    form = form * (2 * face / (1 + face)) * ~(flat[:, None] | flat[None, :])
    form[flat, flat] = external_diffuse_reflectance(refractive_index)
    return np.asarray(np.linalg.inv(np.eye(stations * azimuths) - reflectance * form))
