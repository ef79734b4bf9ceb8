"""The light that the empty plate carries: radiance at the top face by angle, from the LEDs on the edges.

In a parallel plate a guided ray keeps its angle to the normal and runs straight in plan view, so that its whole path
up to an edge is one straight line in the unfolded plate. The field is therefore an integral over directions, with no
path to be sampled; only the diffuse light of the edges themselves needs a small linear system. The path tracer is its
independent check, and this is the path tracer's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import qmc

from evanesce.optics.edge_rays import (
    EDGES,
    Arrival,
    EdgeLight,
    arrivals,
    led_count,
    radiance_entering,
    segment_of,
    segments_of,
    stacked_radiances,
)
from evanesce.optics.path_sums import MOMENTS, add_paths

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EdgeExchange:
    """Irradiance on segments of the edges, averaged over the thickness.

    Attributes
    ----------
    from_led : ndarray (segments, leds)
        Per radiance of each LED [sr].
    from_edge : ndarray (segments, segments)
        Per diffuse radiance of each segment [sr].
    """

    from_led: Array
    from_edge: Array


def edge_exchange(light: EdgeLight, *, per_edge: int = 24, rays: int = 4096) -> EdgeExchange:
    """Return what the edges receive from the LEDs and from each other over the empty plate.

    Parameters
    ----------
    light, per_edge, rays
        As for :func:`exchange_sums`.
    """
    from_led, from_edge = exchange_sums(light, per_edge=per_edge, rays=rays)
    return EdgeExchange(from_led[0], from_edge[0])


def exchange_sums(light: EdgeLight, *, per_edge: int = 24, rays: int = 4096) -> tuple[Array, Array]:
    """Return what the edges receive over the empty plate, summed by paths (:mod:`evanesce.optics.path_sums`).

    Parameters
    ----------
    light : EdgeLight
        Its radiances do not count.
    per_edge : int
        Segments of each edge.
    rays : int
        Quasi-random rays from each segment.

    Returns
    -------
    from_led : ndarray (moments, segments, leds)
        From the LEDs, per radiance of each [sr].
    from_edge : ndarray (moments, segments, segments)
        From each other, per diffuse radiance of each [sr].
    """
    segments = 4 * per_edge
    start, step = segments_of(light, per_edge)
    from_edge = np.zeros((MOMENTS, segments, segments))
    for row, sample in enumerate(_shifted(rays, segments, 20240611)):
        number, part = divmod(row, per_edge)
        along = start[number] + (part + sample[:, 3]) * step[number]
        for met in _from_edge(light, number, along, sample[:, 2] * light.thickness, sample[:, :2]):
            segment = segment_of(light, met.hits, per_edge)
            add_paths(from_edge[:, row], segment, met.edge_share * (np.pi / rays), met.length)
    return _from_leds(light, per_edge, rays), from_edge


def _shifted(rays: int, count: int, seed: int) -> Iterator[Array]:
    """Yield quasi-random points (rays, 4), each time shifted anew: errors that all sources share would not average."""
    sample = qmc.Sobol(4, scramble=True, rng=np.random.default_rng(seed)).random(rays)
    for shift in qmc.Halton(4, scramble=True, rng=np.random.default_rng(seed + 1)).random(count):
        yield np.mod(sample + shift, 1.0)


def _from_edge(light: EdgeLight, number: int, along: Array, depth: Array, u: Array) -> Iterator[Arrival]:
    """Follow cosine-weighted rays from points of an edge; ``u`` (rays, 2) are uniform numbers for their directions."""
    inward = np.deg2rad([0.0, 180.0, 90.0, 270.0])[number]
    sin_a, around = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    normal, tangent, up = np.sqrt(1 - u[:, 0]), sin_a * np.cos(around), sin_a * np.sin(around)
    theta = np.arccos(np.clip(np.abs(up), 1e-9, 1.0))
    # Just inside, so that the ray does not end where it starts.
    side = np.full(along.shape, (-0.5, 0.5)[number % 2] * (1 - 1e-9))
    along = along * (1 - 1e-9)
    x, y = (side * light.size[0], along) if number < 2 else (along, side * light.size[1])
    return arrivals(light, x, y, depth, theta, inward + np.arctan2(tangent, normal), np.asarray(up < 0))


def _from_leds(light: EdgeLight, per_edge: int, rays: int) -> Array:
    """Return what segments receive from LEDs, (moments, segments, leds): rays from each, all of which arrive."""
    segments = 4 * per_edge
    width, height = light.emitter_size
    _, step = segments_of(light, per_edge)
    area = np.repeat(step, per_edge) * light.thickness
    found = np.zeros((MOMENTS, segments, led_count(light)))
    samples = _shifted(rays, led_count(light), 20240613)
    led = 0
    for number, name in enumerate(EDGES):
        for centre in light.positions.get(name, np.zeros(0)):
            sample = next(samples)
            along = centre + (sample[:, 3] - 0.5) * width
            depth = light.thickness / 2 + (sample[:, 2] - 0.5) * height
            entering = radiance_entering(light, np.sqrt(1 - sample[:, 0]))
            for met in _from_edge(light, number, along, depth, sample[:, :2]):
                segment = segment_of(light, met.hits, per_edge)
                add_paths(found[:, :, led], segment, met.share * entering, met.length)
            led += 1
    return np.asarray(found * (np.pi * width * height / rays) / area[:, None])


def edge_response(exchange: EdgeExchange, reflectance: float) -> Array:
    """Return the diffuse radiance of each segment per irradiance that falls on each from elsewhere [1/sr].

    L = (rho/pi)(E + K L), solved for L.

    Parameters
    ----------
    exchange : EdgeExchange
    reflectance : float
        Diffuse, of the edges [1].

    Returns
    -------
    ndarray (segments, segments)
    """
    factor = reflectance / np.pi
    unity = np.eye(exchange.from_edge.shape[0])
    return np.asarray(np.linalg.solve(unity - factor * exchange.from_edge, factor * unity))


def edge_radiance(light: EdgeLight, *, per_edge: int = 24, rays: int = 4096) -> Array:
    """Return the diffuse radiance that each edge sends back into the plate.

    Parameters
    ----------
    light : EdgeLight
    per_edge, rays : int
        As for :func:`edge_exchange`.

    Returns
    -------
    ndarray (4, per_edge)
        [W mm^-2 sr^-1], edges in the order of ``EDGES``.
    """
    if light.edge_reflectance == 0.0:
        return np.zeros((4, per_edge))
    exchange = edge_exchange(light, per_edge=per_edge, rays=rays)
    solved = edge_response(exchange, light.edge_reflectance) @ (exchange.from_led @ stacked_radiances(light))
    return np.asarray(solved, np.float64).reshape(4, per_edge)


def azimuthal_radiance(
    light: EdgeLight,
    x: ArrayLike,
    y: ArrayLike,
    theta: ArrayLike,
    *,
    azimuths: int = 1440,
    diffuse: Array | None = None,
) -> Array:
    """Return the radiance that falls on the empty plate's top face from below, averaged over azimuth.

    Parameters
    ----------
    light : EdgeLight
    x, y : array_like (points,)
        Points on the top face [mm].
    theta : array_like (angles,)
        Angles to the normal inside the glass [rad], 0 < theta < pi/2.
    azimuths : int
        Directions around; each is spread over its step by a fixed offset that differs with point and angle.
    diffuse : ndarray (4, per_edge), optional
        From :func:`edge_radiance`; computed if not given.

    Returns
    -------
    ndarray (points, angles)
        [W mm^-2 sr^-1].
    """
    diffuse = edge_radiance(light) if diffuse is None else diffuse
    per_edge = diffuse.shape[1]
    x, y, theta = (np.atleast_1d(np.asarray(a, float)) for a in (x, y, theta))
    radiances = np.append(stacked_radiances(light), 0.0)  # the last stands for no LED, number -1
    golden = 0.6180339887498949
    steps = np.arange(azimuths)
    total = np.zeros((x.size, theta.size))
    for k, (px, py) in enumerate(zip(x, y, strict=True)):
        offset = np.mod((np.arange(theta.size) + k * theta.size) * golden, 1.0)
        phi = (steps[None, :] + offset[:, None]) * (2 * np.pi / azimuths)
        zero: Any = np.zeros_like(phi)
        for met in arrivals(light, px + zero, py + zero, zero, theta[:, None] + zero, phi, np.asarray(zero == 0)):
            seen = met.led_share * radiances[met.led]
            seen += met.edge_share * diffuse.ravel()[segment_of(light, met.hits, per_edge)]
            total[k] += seen.mean(axis=1)
    return total
