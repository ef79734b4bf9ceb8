"""Unit fields of the empty plate: what each LED and each stretch of edge sends to points of the top face, by angle.

Light is linear in the power of every LED, so that these serve all voltages, LED bins and dead LEDs of a plate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from evanesce.core.quadrature import gauss_legendre
from evanesce.optics.edge_rays import EDGES, EdgeLight, arrivals, led_count, radiance_entering, segment_of
from evanesce.optics.guided_field import EdgeExchange, edge_response, exchange_sums
from evanesce.optics.interface import fresnel_reflectance
from evanesce.optics.path_sums import MOMENTS, add_paths

Array = NDArray[np.float64]

SUB_NODES = 4
"""Angles per bin over which tables are averaged."""

_CHUNK = 1 << 19


@dataclass(frozen=True)
class AngleBins:
    """Bins of s = sin^2(theta) inside the glass, from 0 to where the silicone takes light no more.

    In s the irradiance is pi times the mean radiance: cos(theta) d(omega) = ds dphi / 2.

    Attributes
    ----------
    borders : ndarray (bins + 1,)
        Of s; closer together at the critical angles, where the coupling has vertical tangents.
    critical : int
        Number of the first bin beyond the critical angle to air.
    """

    borders: Array
    critical: int

    @classmethod
    def of(cls, n_glass: float, n_silicone: float, *, steep: int = 16, guided: int = 48) -> AngleBins:
        """Return ``steep`` bins below the critical angle to air and ``guided`` beyond it."""
        low, high = min(1.0, n_glass**-2.0), min(1.0, (n_silicone / n_glass) ** 2)

        def part(a: float, b: float, count: int) -> Array:
            u = np.linspace(0.0, 1.0, count + 1)
            return a + (b - a) * u * u * (3.0 - 2.0 * u)

        if high <= low:
            return cls(part(0.0, high, steep), steep)
        return cls(np.concatenate([part(0.0, low, steep), part(low, high, guided)[1:]]), steep)

    @property
    def count(self) -> int:
        """Number of bins."""
        return self.borders.size - 1

    @property
    def cosines(self) -> Array:
        """Cosines of ``SUB_NODES`` angles in each bin, shape (bins, SUB_NODES)."""
        part = (np.arange(SUB_NODES) + 0.5) / SUB_NODES
        s = self.borders[:-1, None] + np.diff(self.borders)[:, None] * part
        return np.asarray(np.sqrt(1.0 - s))

    @property
    def centres(self) -> Array:
        """Angle at the middle of each bin [rad]."""
        return np.asarray(np.arcsin(np.sqrt(0.5 * (self.borders[1:] + self.borders[:-1]))))


@dataclass(frozen=True)
class UnitFields:
    """The plate's linear response to its sources.

    Attributes
    ----------
    led : ndarray (leds, points, bins)
        Irradiance on the glass side of the top face, by bin, per radiance of each LED [sr].
    edge : ndarray (segments, points, bins)
        The same per diffuse radiance of each segment of the edges [sr].
    exchange : EdgeExchange
        What the segments receive from LEDs and from each other.
    segment_area : ndarray (segments,)
        [mm^2].
    """

    led: Array
    edge: Array
    exchange: EdgeExchange
    segment_area: Array

    def irradiance(self, radiances: Array, edge_reflectance: float) -> Array:
        """Return the irradiance of each point by bin, (points, bins), for LED radiances [W mm^-2 sr^-1]."""
        edges = edge_response(self.exchange, edge_reflectance) @ (self.exchange.from_led @ radiances)
        return np.asarray(np.tensordot(radiances, self.led, 1) + np.tensordot(edges, self.edge, 1))


def segment_areas(light: EdgeLight, per_edge: int) -> Array:
    """Return the area of each segment of the edges [mm^2].

    Parameters
    ----------
    light : EdgeLight
    per_edge : int
        Segments of each edge.

    Returns
    -------
    ndarray (4 per_edge,)
    """
    lengths = np.array([light.size[1], light.size[1], light.size[0], light.size[0]])
    return np.asarray(np.repeat(lengths, per_edge) / per_edge * light.thickness)


def _direct_fields(light: EdgeLight, points: Array, bins: AngleBins, *, across: int = 4, down: int = 8) -> Array:
    """Return light of the LEDs that no edge has mirrored, (moments, leds, points, bins).

    Reflected in the plate's faces an LED at depth d becomes a column of images at depths 2 j t + d and 2 j t - d; the
    integral over each image's face is smooth and takes few nodes (``across`` by ``down``).
    """
    width, height = light.emitter_size
    n, t, leds = light.refractive_index, light.thickness, led_count(light)
    ua, wa = gauss_legendre(across)
    ud, wd = gauss_legendre(down)
    farthest = float(np.hypot(*light.size))
    # Guided light, and as many images again for what leaks near the critical angle.
    images = int(np.ceil(farthest * np.sqrt(n * n - 1.0) / (2 * t))) + 8
    j = np.arange(images)[:, None]
    inside = t / 2 + ud * height / 2
    drop = np.stack([2 * j * t + inside, 2 * (j + 1) * t - inside]).reshape(-1)
    drop_weight = np.tile(wd * height / 2, 2 * images)
    found = np.zeros((MOMENTS, leds, points.shape[0] * bins.count))
    target = np.arange(points.shape[0])[:, None] * bins.count
    led = 0
    for number, name in enumerate(EDGES):
        for centre in light.positions.get(name, np.zeros(0)):
            for along, weight in zip(centre + ua * width / 2, wa * width / 2, strict=True):
                on_x = number < 2
                wall = (-0.5, 0.5)[number % 2] * (light.size[0] if on_x else light.size[1])
                normal = np.abs(points[:, 0 if on_x else 1] - wall)
                run2 = normal**2 + (points[:, 1 if on_x else 0] - along) ** 2
                length2 = run2[:, None] + drop**2
                length = np.sqrt(length2)
                cosine, cos_led = drop / length, normal[:, None] / length
                s = 1.0 - cosine**2
                bounces = np.floor(drop / t)
                share = fresnel_reflectance(cosine, n, 1.0) ** bounces
                share *= np.exp(-light.absorption_coefficient * length) * radiance_entering(light, cos_led)
                value = share * cosine * cos_led / length2 * drop_weight * weight
                index = np.searchsorted(bins.borders, s) - 1
                value[index >= bins.count] = 0.0
                flat = (target + np.clip(index, 0, bins.count - 1)).ravel()
                add_paths(found[:, led], flat, value.ravel(), length.ravel())
            led += 1
    return found.reshape(MOMENTS, leds, points.shape[0], bins.count)


def _points_fields(light: EdgeLight, points: Array, bins: AngleBins, rays: int, per_edge: int) -> tuple[Array, Array]:
    """Return light of LEDs and edges at points by quasi-random rays from each, (moments, sources, points, bins).

    Each point has the same Sobol points shifted by its own offset, so that neighbours' errors are independent and a
    smooth fit takes them out. Steep light is dim far from the edges and gets an eighth of the rays.
    """
    leds, segments, count = led_count(light), 4 * per_edge, bins.count
    found = [np.zeros((MOMENTS, sources, points.shape[0], count)) for sources in (leds + 1, segments)]
    # Through an air film light enters within the critical angle only: a steep edge within an image's face.
    finer = 2 if light.air_gap_share > 0.0 else 1
    found[0][:, 1:] = _direct_fields(light, points, bins, across=4 * finer, down=8 * finer)
    offset = qmc.Halton(2, scramble=True, rng=np.random.default_rng(7)).random(points.shape[0])
    edges_of_part = (0, bins.critical, count)
    for first, last, number in zip(edges_of_part[:-1], edges_of_part[1:], (rays // 8, rays), strict=True):
        if first == last:
            continue
        low, high = bins.borders[first], bins.borders[last]
        sample = qmc.Sobol(2, scramble=True, rng=np.random.default_rng(11)).random(number)
        step = max(1, _CHUNK // number)
        for start in range(0, points.shape[0], step):
            which = np.arange(start, min(start + step, points.shape[0]))
            u = np.mod(sample[None, :, :] + offset[which][:, None, :], 1.0)
            s, phi = low + (high - low) * u[..., 0], 2 * np.pi * u[..., 1]
            theta = np.arcsin(np.sqrt(np.clip(s, 1e-12, 1.0 - 1e-12)))
            target = (which - start)[:, None] * count + np.clip(np.searchsorted(bins.borders, s) - 1, first, last - 1)
            zero = np.zeros_like(s)
            x, y = points[which, 0][:, None] + zero, points[which, 1][:, None] + zero
            weight = np.pi * (high - low) / number
            followed = arrivals(light, x, y, zero, theta, phi, np.ones(s.shape, bool))
            for mirrorings, met in enumerate(followed):
                segment = segment_of(light, met.hits, per_edge)
                parts = [(found[1], segment, met.edge_share)]
                if mirrorings > 0:
                    parts.append((found[0], met.led + 1, met.led_share))
                for into, source, share in parts:
                    flat = (source * (which.size * count) + target).ravel()
                    here = np.zeros((MOMENTS, into.shape[1] * which.size * count))
                    add_paths(here, flat, share.ravel() * weight, met.length.ravel())
                    into[:, :, which] += here.reshape(MOMENTS, into.shape[1], which.size, count)
    return found[0][:, 1:], found[1]


def fields_of_sums(
    light: EdgeLight, led: Array, edge: Array, from_led: Array, from_edge: Array, *, per_edge: int = 48
) -> UnitFields:
    """Return the unit fields of a plate.

    Parameters
    ----------
    light : EdgeLight
    led, edge, from_led, from_edge : ndarray
        As of :func:`unit_sums`, in that plate's glass: without moments.
    per_edge : int
        Segments of each edge.
    """
    return UnitFields(led, edge, EdgeExchange(from_led, from_edge), segment_areas(light, per_edge))


def unit_sums(
    light: EdgeLight, points: Array, bins: AngleBins, *, rays: int = 1 << 14, per_edge: int = 48
) -> tuple[Array, Array, Array, Array]:
    """Compute what LEDs and edges send, summed by paths (:mod:`evanesce.optics.path_sums`).

    Parameters
    ----------
    light : EdgeLight
        Its radiances and its edges' reflectance do not count.
    points : ndarray (points, 2)
        On the top face [mm].
    bins : AngleBins
    rays : int
        From each point into guided angles, a power of two.
    per_edge : int
        Segments of each edge.

    Returns
    -------
    led, edge : ndarray (moments, sources, points, bins)
        As of :class:`UnitFields`.
    from_led, from_edge : ndarray (moments, segments, sources)
        As of :class:`~evanesce.optics.guided_field.EdgeExchange`.
    """
    exchange = exchange_sums(light, per_edge=per_edge, rays=rays // 4)
    return *_points_fields(light, points, bins, rays, per_edge), *exchange
