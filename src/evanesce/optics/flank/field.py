"""Light that escapes from the plate through its top face and falls on the finger's flank.

LEDs and edges also send light below the critical angle. It leaves the top face within a few thicknesses of the edge,
flat over the glass, and lights the finger from the side: a dim ring around the contact that no contact makes. And a
part of what the contact sends down is reflected at the bottom face and leaves beside the contact.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from evanesce.optics.flank.escape import ON_GLASS, escaping_irradiance
from evanesce.optics.guided_field import EdgeLight, _arrivals, _segment_of, led_count
from evanesce.optics.interface import fresnel_reflectance
from evanesce.optics.patch_light import Interface, external_diffuse_reflectance, returned_radiance

Array = NDArray[np.float64]

EPSILON = 1e-6
"""Station of the flat part's rim below 0, where the surface has a kink."""


@dataclass(frozen=True)
class Profile:
    """Surface of revolution, tip down: a cap of a sphere on a cylinder, lowered onto the glass and flattened there.

    Attributes
    ----------
    centre : tuple of float
        Of the axis on the plate [mm].
    tip_radius, half_width, length : float
        Of the sphere; of the cylinder; from the unpressed tip to the top [mm].
    """

    centre: tuple[float, float]
    tip_radius: float
    half_width: float
    length: float

    @property
    def cap(self) -> float:
        """Polar angle at which the cap meets the cylinder [rad]."""
        return float(np.arcsin(min(1.0, self.half_width / self.tip_radius)))

    @property
    def _wall(self) -> float:
        """Height of the cylinder's wall [mm]."""
        return max(self.length - self.tip_radius * (1 - float(np.cos(self.cap))), 1e-9)

    def surface(self, station: Array, azimuth: Array, depth: Array) -> tuple[Array, Array]:
        """Return points and outward normals (..., 3) of the pressed surface.

        ``station`` runs from -1 at the axis to below 0 over the flat part, from 0 to 1 over the rest of the cap and to
        2 at the cylinder's top: the kinks stay where they are when the depth changes.
        """
        first = np.arccos(1.0 - depth / self.tip_radius)
        polar = first + (self.cap - first) * np.clip(station, 0.0, 1.0)
        rise = np.maximum(station - 1.0, 0.0) * self._wall
        flat, on_cap = station < 0.0, station < 1.0
        radius = self.tip_radius * np.sin(polar) * np.where(flat, 1.0 + station, 1.0)
        height = np.maximum(self.tip_radius * (1 - np.cos(polar)) + rise - depth, 0.0)
        slant = np.where(on_cap, np.sin(polar), 1.0) * ~flat
        down = np.where(on_cap, -np.cos(polar), 0.0) * ~flat - flat
        cos_a, sin_a = np.cos(azimuth), np.sin(azimuth)
        shape = np.broadcast(station, azimuth, depth).shape
        points = (self.centre[0] + radius * cos_a, self.centre[1] + radius * sin_a, height)
        normals = (slant * cos_a, slant * sin_a, down)
        return (
            np.stack([np.broadcast_to(p, shape) for p in points], -1),
            np.stack([np.broadcast_to(p, shape) for p in normals], -1),
        )

    def meet(self, x: Array, y: Array, slope_x: Array, slope_y: Array, depth: float) -> tuple[Array, Array]:
        """Return station and azimuth where rays that leave the glass at (x, y) meet the surface; NaN where they miss.

        ``slope`` is dx/dz and dy/dz of each ray above the glass.
        """
        px, py = x - self.centre[0], y - self.centre[1]
        # The sphere's centre is at height tip_radius - depth.
        up = self.tip_radius - depth
        a = 1 + slope_x**2 + slope_y**2
        b = px * slope_x + py * slope_y - up
        root = b * b - a * (px**2 + py**2 + up**2 - self.tip_radius**2)
        z = np.where(root >= 0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, np.nan)
        # Where the tip is flattened the ray meets it on the glass.
        flat = z <= 0.0
        z = np.where(flat, 0.0, z)
        qx, qy = px + z * slope_x, py + z * slope_y
        radius = np.hypot(qx, qy)
        polar = np.arcsin(np.clip(radius / self.tip_radius, 0.0, 1.0))
        cap = np.isfinite(z) & (polar <= self.cap + 1e-9) & (z + depth <= self.tip_radius)
        # The cylinder, for rays that pass beside the cap.
        a2 = slope_x**2 + slope_y**2
        b2 = px * slope_x + py * slope_y
        root2 = b2 * b2 - a2 * (px**2 + py**2 - self.half_width**2)
        with np.errstate(divide="ignore", invalid="ignore"):
            z2 = (-b2 - np.sqrt(np.maximum(root2, 0.0))) / a2
        start = self.tip_radius * (1 - np.cos(self.cap))
        rise = (z2 + depth - start) / self._wall
        wall = ~cap & (root2 > 0) & (rise >= 0) & (rise <= 1) & (z2 > 0)
        azimuth = np.where(cap, np.arctan2(qy, qx), np.arctan2(py + z2 * slope_y, px + z2 * slope_x))
        first = float(np.arccos(1.0 - depth / self.tip_radius))
        on_cap = np.clip((polar - first) / (self.cap - first), 0.0, 1.0)
        inner = np.minimum(radius / max(self.tip_radius * np.sin(first), 1e-9) - 1.0, -EPSILON)
        station = np.where(cap, np.where(flat, inner, on_cap), np.where(wall, 1.0 + rise, np.nan))
        return station, azimuth


def flank_irradiance(
    light: EdgeLight, points: Array, normals: Array, *, samples: int = 4096, per_edge: int = 48
) -> tuple[Array, Array]:
    """Return the irradiance on points above the plate from light that leaves the top face.

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
    led : ndarray (leds, points)
        Per radiance of each LED [sr].
    edge : ndarray (segments, points)
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
    """Return the same by quasi-random ways, of light that edges have mirrored at least ``mirrorings`` times.

    Points of the top face, denser towards the edges and below the point; from each the straight way is
    followed back into the glass. A convex body does not shade itself beyond its horizon, and nothing else stands on
    the plate. Points on the glass itself get nothing: no way leads there from beside it.
    """
    n = light.refractive_index
    leds, segments, count = led_count(light), 4 * per_edge, points.shape[0]
    led, edge = np.zeros((leds + 1, count)), np.zeros((segments, count))
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
        # Both ways of drawing a place could have drawn any: the mean of their densities keeps the weights bounded.
        density = 0.5 * (_edge_density(light, qx[good], qy[good]) + solid[good] / np.pi)
        sin_glass = np.sqrt(1 - cos_air[good] ** 2) / n
        theta = np.arcsin(np.clip(sin_glass, 1e-9, 1.0))
        weight = solid[good] / density / u.shape[0] / 2
        weight = weight * (1 - fresnel_reflectance(np.cos(theta), n, 1.0)) / n**2
        # The light comes from the other side, downwards as seen from the top face.
        phi = np.arctan2(-dy[good], -dx[good])
        zero = np.zeros_like(theta)
        start = (qx[good] * (1 - 1e-9), qy[good] * (1 - 1e-9), zero, theta, phi, np.ones(theta.shape, bool))
        for met in itertools.islice(_arrivals(light, *start), mirrorings, None):
            led[:, k] += np.bincount(met.led + 1, met.led_share * weight, leds + 1)
            edge[:, k] += np.bincount(_segment_of(light, met.hits, per_edge), met.edge_share * weight, segments)
    return led[1:], edge


def _towards_edges(light: EdgeLight, u: Array) -> tuple[Array, Array]:
    """Draw places of the top face, their density 1/(distance + thickness) from the edges inwards."""
    hx, hy, t = light.size[0] / 2, light.size[1] / 2, light.thickness
    number = np.searchsorted(np.cumsum([hy, hy, hx]) / (2 * (hx + hy)), u[:, 0])
    reach = np.where(number < 2, hx, hy)
    inward = t * np.expm1(u[:, 1] * np.log1p(reach / t))
    along = (2 * u[:, 2] - 1) * np.where(number < 2, hy, hx)
    side = np.where(number % 2 == 0, -1.0, 1.0)
    x = np.where(number < 2, side * (hx - inward), along)
    return x, np.where(number < 2, along, side * (hy - inward))


def _edge_density(light: EdgeLight, x: Array, y: Array) -> Array:
    """Return the density [1/mm^2] of :func:`_towards_edges`; each place is in two strips, one of each pair of edges."""
    hx, hy, t = light.size[0] / 2, light.size[1] / 2, light.thickness
    total = np.zeros_like(x)
    for distance, limit in ((hx - np.abs(x), hx), (hy - np.abs(y), hy)):
        total += 1.0 / ((distance + t) * np.log1p(limit / t)) / (4 * (hx + hy))
    return total


def _below(point: Array, normal: Array, u: Array) -> tuple[Array, Array]:
    """Draw places of the plane z = 0 in cosine-weighted directions about a point's normal; far away where it is up."""
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
    open_way = low < 1.0 - 1e-9
    sine = np.minimum(0.5 * (low + high), 1.0 - 1e-9)
    cos_air, cos_glass = np.sqrt(1 - sine**2), np.sqrt(1 - (sine / n) ** 2)
    slope = 2 * thickness * cos_air / (n * cos_glass**3) + height / cos_air**2
    solid = sine / (run * slope)  # solid angle in the air per area of the contact
    facing = -((normals[:, None, 0] * dx + normals[:, None, 1] * dy) / run * sine + normals[:, None, 2] * cos_air)
    bare = fresnel_reflectance(cos_glass, n, 1.0)
    radiance = returned_radiance(0.0, np.arccos(cos_glass), interface) * bare * (1 - bare) / n**2
    radiance = radiance * np.exp(-absorption_coefficient * 2 * thickness / cos_glass)
    return np.asarray(np.where(open_way, radiance * solid * np.clip(facing, 0.0, None), 0.0))


def mirrored_exchange(points: Array, normals: Array, reflectance: float, refractive_index: float) -> Array:
    """Return the flank's irradiance, its own light mirrored by the plate included, over that without.

    Both faces mirror; the shift between them, a few millimetres, is ignored. Each element is taken as a disc. Where the
    surface lies flat on the glass, light goes to and fro through the top face only.

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
