"""The plate as a light guide with emitters on its edges, and rays followed to the edges where they end.

In a parallel plate a ray keeps its angle to the normal and runs straight in plan view, so that its whole path up to an
edge is one straight line in the unfolded plate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.optics.interface import fresnel_reflectance

Array = NDArray[np.float64]
EDGES = ("left", "right", "top", "bottom")
MAX_MIRRORINGS = 200
"""At polished edges; light that is totally reflected by all of them finds an LED within about fifty."""


@dataclass(frozen=True)
class EdgeLight:
    """The plate as a light guide with rectangular emitters bonded to its edges.

    Attributes
    ----------
    size : tuple of float
        Plate extent in x and y [mm], centred on the origin.
    thickness : float
        [mm].
    refractive_index : float
        Of the glass, in air [1].
    absorption_coefficient : float
        [1/mm].
    edge_reflectance : float
        Diffuse reflectance of the edges, emitters included [1].
    positions : dict of ndarray
        Along-edge coordinate of each emitter's centre [mm], by edge (``left`` is -x, ``top`` -y).
    radiances : dict of ndarray
        Radiance of each emitter into the glass [W mm^-2 sr^-1], by edge.
    emitter_size : tuple of float
        Width along the edge and height across the thickness [mm]; centred on mid-thickness.
    edge_polish : float
        Share of the edge between the emitters that mirrors as bare glass (Fresnel) instead of scattering [1].
    air_gap_share : float
        Share of each emitter's face that an air film parts from the glass [1]; the film's light enters refracted.
    """

    size: tuple[float, float]
    thickness: float
    refractive_index: float
    absorption_coefficient: float
    edge_reflectance: float
    positions: dict[str, Array]
    radiances: dict[str, Array]
    emitter_size: tuple[float, float]
    edge_polish: float = 0.0
    air_gap_share: float = 0.0


@dataclass(frozen=True)
class EdgeHits:
    """Where straight unfolded rays end: edge number, coordinate along it, depth below the top face, attenuation.

    ``cosine`` is that to the edge's normal, ``down`` whether the ray ends downwards, ``length`` that of the way [mm].
    """

    edge: NDArray[np.int64]
    along: Array
    depth: Array
    transmission: Array
    cosine: Array
    down: NDArray[np.bool_]
    length: Array


def _cast(
    light: EdgeLight, x: Array, y: Array, depth: Array, theta: Array, phi: Array, down: NDArray[np.bool_]
) -> EdgeHits:
    """Follow rays from points inside the plate to the edge where each ends (all arguments broadcast).

    ``theta`` is the angle to the plate's normal, ``phi`` the azimuth, ``down`` whether the ray starts downwards.
    """
    half_x, half_y = light.size[0] / 2, light.size[1] / 2
    cos_phi, sin_phi = np.cos(phi), np.sin(phi)
    with np.errstate(divide="ignore"):
        to_x = np.where(cos_phi > 0, half_x - x, -half_x - x) / np.where(cos_phi == 0, np.nan, cos_phi)
        to_y = np.where(sin_phi > 0, half_y - y, -half_y - y) / np.where(sin_phi == 0, np.nan, sin_phi)
    hits_x = ~(to_y < to_x)
    run = np.where(hits_x, to_x, to_y)
    edge = np.where(hits_x, np.where(cos_phi > 0, 1, 0), np.where(sin_phi > 0, 3, 2))
    along = np.where(hits_x, y + run * sin_phi, x + run * cos_phi)
    t = light.thickness
    unfolded = run / np.tan(theta) + np.where(down, depth, -depth)
    bounces = np.floor(unfolded / t) + np.logical_not(down)  # an upward ray meets the top face at unfolded = 0
    folded = np.mod(np.abs(unfolded), 2 * t)
    end_depth = np.where(folded > t, 2 * t - folded, folded)
    reflectance = fresnel_reflectance(np.cos(theta), light.refractive_index, 1.0)
    sin_theta = np.sin(theta)
    length = run / sin_theta
    transmission = reflectance**bounces
    if light.absorption_coefficient > 0.0:
        transmission *= np.exp(-light.absorption_coefficient * length)
    cosine = sin_theta * np.abs(np.where(hits_x, cos_phi, sin_phi))
    # A ray that started upwards and ends before the top face still goes up.
    end_down = (unfolded >= 0) & (folded <= t)
    return EdgeHits(edge, along, end_depth, transmission, cosine, end_down, length)


def _mirror(light: EdgeLight, hits: EdgeHits, theta: Array, phi: Array) -> tuple[Array, Array, Array]:
    """Return x, y and azimuth of rays mirrored by the edges that they met, just inside them."""
    side = np.where(hits.edge % 2 == 0, -0.5, 0.5) * (1 - 1e-9)
    on_x = hits.edge < 2
    x = np.where(on_x, side * light.size[0], hits.along)
    y = np.where(on_x, hits.along, side * light.size[1])
    return x, y, np.where(on_x, np.pi - phi, -phi)


def radiance_entering(light: EdgeLight, cosine: Array) -> Array:
    """Return radiance inside the glass over that of an emitter in optical contact, by the angle to the edge's normal.

    Through an air film a Lambertian face's radiance L enters as n^2 (1 - R) L, and only within the critical angle.

    Parameters
    ----------
    light : EdgeLight
    cosine : ndarray
        Of the angle to the edge's normal, inside the glass [1].

    Returns
    -------
    ndarray
        Shape of ``cosine`` [1].
    """
    if light.air_gap_share == 0.0:
        return np.ones(cosine.shape)
    n = light.refractive_index
    through = n * n * (1.0 - fresnel_reflectance(np.clip(cosine, 0.0, 1.0), n, 1.0))
    return np.asarray(1.0 - light.air_gap_share + light.air_gap_share * through)


def led_count(light: EdgeLight) -> int:
    """Return the number of LEDs on all edges.

    Parameters
    ----------
    light : EdgeLight
    """
    return sum(light.positions[name].size for name in EDGES if name in light.positions)


def stacked_radiances(light: EdgeLight) -> Array:
    """Return the radiances of all LEDs, edge after edge in the order of ``EDGES`` [W mm^-2 sr^-1].

    Parameters
    ----------
    light : EdgeLight

    Returns
    -------
    ndarray (leds,)
    """
    parts = [light.radiances[name] for name in EDGES if name in light.positions]
    return np.concatenate([np.zeros(0), *parts])


def _led_met(light: EdgeLight, hits: EdgeHits) -> NDArray[np.int64]:
    """Return the number of the LED that each hit is on, in the order of :func:`stacked_radiances`; -1 for none."""
    width, height = light.emitter_size
    met = np.full(hits.along.shape, -1)
    in_height = np.abs(hits.depth - light.thickness / 2) <= height / 2
    first = 0
    for number, name in enumerate(EDGES):
        centres = light.positions.get(name)
        if centres is None or centres.size == 0:
            continue
        here = (hits.edge == number) & in_height
        order = np.argsort(centres)
        sorted_centres = centres[order]
        along = hits.along[here]
        nearest = np.minimum(np.searchsorted(sorted_centres, along), centres.size - 1)
        before = np.maximum(nearest - 1, 0)
        closer = np.abs(along - sorted_centres[before]) <= np.abs(along - sorted_centres[nearest])
        index = np.where(closer, before, nearest)
        within = np.abs(along - sorted_centres[index]) <= width / 2
        met[here] = np.where(within, first + order[index], -1)
        first += centres.size
    return met


@dataclass(frozen=True)
class Arrival:
    """Rays at the edge where they end or are mirrored: what each carries of an LED's radiance and of the edge's own.

    ``share`` is what is left of each ray when it arrives, ``length`` its whole way in the glass [mm].
    """

    hits: EdgeHits
    led: NDArray[np.int64]
    share: Array
    led_share: Array
    edge_share: Array
    length: Array


def arrivals(
    light: EdgeLight, x: Array, y: Array, depth: Array, theta: Array, phi: Array, down: NDArray[np.bool_]
) -> Iterator[Arrival]:
    """Follow rays over mirroring edges; shares include all losses since the ray's start.

    Parameters
    ----------
    light : EdgeLight
    x, y, depth : ndarray
        Where each ray starts [mm]; ``depth`` is below the top face.
    theta, phi : ndarray
        Angle to the plate's normal and azimuth [rad].
    down : ndarray of bool
        Whether it starts downwards.

    Yields
    ------
    Arrival
        At the first edge, then at each further one while any polish is left to mirror.
    """
    weight = np.ones(np.broadcast(x, theta, phi).shape)
    length: Array = np.zeros(1)
    for _ in range(MAX_MIRRORINGS):
        hits = _cast(light, x, y, depth, theta, phi, down)
        length = length + hits.length
        led = _led_met(light, hits)
        arriving = weight * hits.transmission
        polish = np.where(led >= 0, 0.0, light.edge_polish)
        entering = arriving * radiance_entering(light, hits.cosine)
        yield Arrival(hits, led, arriving, entering, arriving * (1.0 - polish), length)
        if light.edge_polish == 0.0:
            return
        mirrored = fresnel_reflectance(np.clip(hits.cosine, 0.0, 1.0), light.refractive_index, 1.0)
        weight = arriving * polish * mirrored
        if not weight.max(initial=0.0) > 1e-5:
            return
        x, y, phi = _mirror(light, hits, theta, phi)
        depth, down = hits.depth, hits.down


def segments_of(light: EdgeLight, per_edge: int) -> tuple[Array, Array]:
    """Return lower ends and lengths of the segments of each edge, shape (4,)."""
    lengths = np.array([light.size[1], light.size[1], light.size[0], light.size[0]])
    return -lengths / 2, lengths / per_edge


def segment_of(light: EdgeLight, hits: EdgeHits, per_edge: int) -> NDArray[np.int64]:
    """Return the number of the segment that each hit is on: edge after edge in the order of ``EDGES``.

    Parameters
    ----------
    light : EdgeLight
    hits : EdgeHits
    per_edge : int
        Segments of each edge.
    """
    start, step = segments_of(light, per_edge)
    inside = np.floor((hits.along - start[hits.edge]) / step[hits.edge]).astype(np.int64)
    return hits.edge * per_edge + np.clip(inside, 0, per_edge - 1)
