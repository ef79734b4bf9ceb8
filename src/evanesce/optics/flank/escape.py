"""Light of LEDs and edges that leaves the plate's top face towards points above it: a quadrature over their images.

Mirrored in the plate's faces, a stretch of edge is a column of images, one below the other. Seen from above the plate
through its top face each image fills a range of angles: its ends follow from Snell's law, and between them the light
is smooth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evanesce.core.quadrature import gauss_legendre
from evanesce.optics.edge_rays import EDGES, EdgeLight, led_count, radiance_entering
from evanesce.optics.interface import fresnel_reflectance
from evanesce.optics.path_sums import MOMENTS

Array = NDArray[np.float64]

SOLVE_STEPS, CLOSE = 8, 1e-3
"""Steps of Halley's method for the angle at most, and the relative change after which the next one, of its third power,
changes less than 1e-9: after three."""

GRAZING = 1e6
"""Slope of the flattest path that is considered [1]."""

ON_GLASS = 1e-9
"""Height below which a point lies on the glass [mm]; rounding must not let it receive light that grazes the plate."""

FURTHER_IMAGES = 3
"""Images below the one that is seen at the critical angle; more of them change the light by less than 1e-4."""

ANGLES = 5
"""Angles within an image: light of the LEDs comes to 0.03 % of its largest, of the edges to 0.08 %."""

_CHUNK = 1 << 15
"""Paths at a time: as many as a processor's cache holds."""


def exit_slope(run: Array, drop: Array, height: Array, refractive_index: float) -> Array:
    """Return the slope in the air, horizontal over vertical, of the path from a depth in the glass to a height above.

    Solves drop tan(theta) + height tan(theta') = run with n sin(theta) = sin(theta') (arguments broadcast).

    Parameters
    ----------
    run : ndarray
        Horizontal distance of the two ends, above 0 [mm].
    drop, height : ndarray
        Depth of the one below the top face, height of the other above it, not both 0 [mm].
    refractive_index : float
        Of the glass [1].

    Returns
    -------
    ndarray
        [1]; at most :data:`GRAZING`, which stands for no path at all where ``height`` is 0.
    """
    n2 = refractive_index**2
    least = max(n2 - 1.0, 1e-12)
    flattest = np.sqrt(least)
    height = np.where(height > ON_GLASS, height, 0.0)
    bent = drop + height * refractive_index - run * flattest
    with np.errstate(divide="ignore", invalid="ignore"):
        # What the way in the glass takes of the run lies below slope / n and below 1 / sqrt(n^2 - 1), and above
        # slope / (n + sqrt(n^2 - 1) slope).
        low = np.maximum(run / (drop / refractive_index + height), (run - drop / flattest) / height)
        root = np.sqrt(bent**2 + 4.0 * flattest * refractive_index * height * run)
        high = np.where(
            bent > 0, 2.0 * refractive_index * run / (bent + root), (root - bent) / (2.0 * flattest * height)
        )
        on_glass = refractive_index * run / np.sqrt(np.maximum(drop**2 - least * run**2, 0.0))
    low, high = (np.minimum(np.where(height > 0, bound, on_glass), GRAZING) for bound in (low, high))
    slope = np.sqrt(low * high)
    for _ in range(SOLVE_STEPS):
        root2 = n2 + least * slope**2
        inverse = 1.0 / np.sqrt(root2)
        missing = run - (drop * inverse + height) * slope
        first = np.maximum(drop * n2 / root2 * inverse + height, 1e-30)
        # Halley's step; the law's second derivative is below 0.
        second = 3.0 * least * (first - height) * slope / root2
        closer = slope + 2.0 * missing * first / np.maximum(2.0 * first**2 - missing * second, first**2)
        closer = np.minimum(np.maximum(closer, low), high)
        settled = np.all(np.abs(closer - slope) <= CLOSE * closer)
        slope = closer
        if settled:
            break
    return np.asarray(slope)


def _image_columns(light: EdgeLight, near: float, far: float, reach: float) -> tuple[Array, Array, Array]:
    """Return upper and lower ends [mm] of the images of a stretch between two depths, and each one's mirrorings."""
    t = light.thickness
    images = int(np.ceil(reach * np.sqrt(max(light.refractive_index**2 - 1.0, 0.0)) / t)) + FURTHER_IMAGES
    number = np.arange(images)
    even = number % 2 == 0
    top = number * t + np.where(even, near, t - far)
    bottom = top + (far - near)
    return np.asarray(top, float), np.asarray(bottom, float), np.asarray(number, float)


def _irradiance(
    light: EdgeLight, points: Array, normals: Array, edge: int, along: Array, depths: tuple[float, float], emitter: bool
) -> Array:
    """Return the irradiance from upright lines of an edge per length and radiance.

    Summed by paths, (kinds, moments, points, lines) [sr/mm]. Kinds are light of the glass itself and, of an emitter,
    that which enters from it, maybe through an air film.

    Parameters
    ----------
    light : EdgeLight
    points, normals : ndarray (points, 3)
    edge : int
        Its number in ``EDGES``.
    along : ndarray (lines,)
        Positions along the edge [mm].
    depths : tuple of float
        Upper and lower end of the lines [mm].
    emitter : bool
    """
    on_x, side = edge < 2, (-1.0, 1.0)[edge % 2]
    across, lengthwise = (0, 1) if on_x else (1, 0)
    away = light.size[across] / 2 - side * points[:, across]
    beside = along[None, :] - points[:, lengthwise, None]
    inward = np.maximum(away, 1e-9)[:, None]
    run = np.hypot(inward, beside)
    top, bottom, mirrored = _image_columns(light, *depths, float(run.max()))
    where = run[..., None], points[:, None, None, 2]
    # Images of a whole edge hang together: each end is that of two of them.
    ends, place = np.unique(np.round(np.concatenate([bottom, top]), 12), return_inverse=True)
    slope = exit_slope(where[0], ends[None, None, :], where[1], light.refractive_index)
    # Tangent of half the angle: what an integrand asks for is rational in it, where sine and cosine take most of the
    # time.
    seen = slope / (1.0 + np.sqrt(1.0 + slope**2))
    low, high = seen[..., place[: bottom.size]], seen[..., place[bottom.size :]]
    # The path to the source, horizontally, in the sense of the normal.
    towards = (normals[:, across, None] * side * inward + normals[:, lengthwise, None] * beside) / run
    u, w = gauss_legendre(ANGLES)
    film = emitter and light.air_gap_share > 0.0
    total = np.zeros((1 + film, MOMENTS, *run.shape))
    for node, weight in zip(u, w, strict=True):
        half = 0.5 * (low + high) + 0.5 * (high - low) * node
        inverse = 1.0 / (1.0 + half**2)
        sine, cosine = 2.0 * half * inverse, (1.0 - half**2) * inverse
        sine_glass = sine / light.refractive_index
        cos_glass = np.sqrt(1.0 - sine_glass**2)
        facing = towards[..., None] * sine - normals[:, None, None, 2] * cosine
        reflected = fresnel_reflectance(cos_glass, light.refractive_index, 1.0)
        share = reflected**mirrored * (1.0 - reflected) * np.clip(facing, 0.0, None) * sine
        length = np.maximum(where[0] - where[1] * sine / np.maximum(cosine, 1e-12), 0.0)
        length /= np.maximum(sine_glass, 1e-12)
        if light.absorption_coefficient > 0.0:
            share *= np.exp(-light.absorption_coefficient * length)
        share *= weight * (high - low) * inverse  # d(angle) = 2 d(half) / (1 + half^2)
        parts = [share]
        if film:
            parts.append(share * radiance_entering(light, sine_glass * (inward / run)[..., None]))
        for into, part in zip(total, parts, strict=True):
            for sums in into:
                sums += part.sum(axis=-1)
                part = part * length
    # d(azimuth) = away/run^2 d(along)
    found = np.where(away[:, None] > 0.0, total / light.refractive_index**2 * inward / run**2, 0.0)
    return np.broadcast_to(found, (1 + emitter, *found.shape[1:]))


def escaping_irradiance(
    light: EdgeLight, points: Array, normals: Array, *, per_edge: int = 48, across: int = 4
) -> tuple[Array, Array]:
    """Return the irradiance on points above the plate from light that leaves the top face, no edge having mirrored it.

    Parameters
    ----------
    light : EdgeLight
        Its radiances do not count.
    points, normals : ndarray (points, 3)
        Above the top face, z = 0 [mm]; outward unit normals. A convex body does not shade itself beyond its horizon,
        and nothing else stands on the plate.
    per_edge : int
        Segments of each edge.
    across : int
        Nodes over the width of an LED; a segment has one.

    Returns
    -------
    led : ndarray (moments, leds, points)
        Per radiance of each LED [sr], summed by paths (:mod:`evanesce.optics.path_sums`).
    edge : ndarray (moments, segments, points)
        Per diffuse radiance of each segment [sr].
    """
    led, edge = (np.zeros((MOMENTS, sources, points.shape[0])) for sources in (led_count(light), 4 * per_edge))
    width, height = light.emitter_size
    middle = light.thickness / 2
    face = middle - height / 2, middle + height / 2
    first = 0
    for number, name in enumerate(EDGES):
        length = light.size[1] if number < 2 else light.size[0]
        step = length / per_edge
        centres = np.asarray((np.arange(per_edge) + 0.5) * step - length / 2, float)
        every = slice(number * per_edge, (number + 1) * per_edge)
        whole = _strips(light, points, normals, number, centres, step, (0.0, light.thickness), 1, False)
        edge[:, every] = (1.0 - light.edge_polish) * whole[0]
        leds = light.positions.get(name, np.zeros(0))
        if leds.size == 0:
            continue
        strips = _strips(light, points, normals, number, leds, width, face, across, True)
        own, led[:, first : first + leds.size] = strips
        # Emitters do not mirror: there the edge is as it is without polish.
        segment = np.clip(((leds + length / 2) / step).astype(int), 0, per_edge - 1)
        np.add.at(edge.swapaxes(0, 1), every.start + segment, light.edge_polish * own.swapaxes(0, 1))
        first += leds.size
    return led, edge


def _strips(
    light: EdgeLight,
    points: Array,
    normals: Array,
    edge: int,
    centres: Array,
    width: float,
    depths: tuple[float, float],
    nodes: int,
    emitter: bool,
) -> Array:
    """Return the irradiance from rectangles of an edge, (kinds, moments, centres, points) [sr], as of the lines."""
    u, w = gauss_legendre(nodes)
    along = (centres[:, None] + u * width / 2).ravel()
    found = np.empty((1 + emitter, MOMENTS, points.shape[0], along.size))
    step = max(1, _CHUNK // (along.size * 32))
    for start in range(0, points.shape[0], step):
        some = slice(start, start + step)
        found[:, :, some] = _irradiance(light, points[some], normals[some], edge, along, depths, emitter)
    strips = found.reshape(1 + emitter, MOMENTS, points.shape[0], centres.size, nodes) @ (w * width / 2)
    return np.asarray(strips.swapaxes(2, 3))
