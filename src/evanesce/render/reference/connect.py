"""Next-event estimation inside the plate: which light an LED sends to a point along one chain of reflections.

Glass blocks ordinary emitter sampling, but the plate's faces are parallel planes: reflected in them, an LED at depth d
becomes a row of images at unfolded depths 2 j t + d and 2 j t - d, and the guided path over any number of bounces is
one straight line to an image. A point on an image drawn at random therefore gives a complete path, with no ray traced:
its throughput is Beer-Lambert's over the line's length times the reflectance wherever the line meets the frustrated
patch; everywhere else total reflection is total. Steeper paths, which leak at each bounce, are left to plain path
tracing.

Where an LED is close (near the plate's corners) a connection is a poor guess and the scattering direction a good one;
both are drawn and combined by multiple importance sampling.

References
----------
E. Veach and L. J. Guibas, "Optimally combining sampling techniques for Monte Carlo rendering", SIGGRAPH 1995, 419.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from evanesce.optics.emitters import LedTable


@dataclass(frozen=True)
class Guide:
    """The plate as a light guide.

    Attributes
    ----------
    half_size : tuple of float
        Half its extent in x and y [mm].
    thickness : float
        It fills -thickness < z < 0 [mm].
    refractive_index : float
        [1].
    absorption : float
        [1/mm].
    air_gap_share : float
        Share of each LED's face that an air film parts from the edge [1].
    haze : tuple of float
        Shares that haze on the top and the bottom face takes of what meets them [1].
    """

    half_size: tuple[float, float]
    thickness: float
    refractive_index: float
    absorption: float
    air_gap_share: float = 0.0
    haze: tuple[float, float] = (0.0, 0.0)

    def entering(self, cos_theta: Any) -> Any:
        """Return an LED's radiance in the glass over that of a face in contact, by the angle to the edge's normal.

        Through the film a Lambertian face's radiance L enters as n^2 (1 - R) L, within the critical angle only: all of
        the power that the face sends into air, less what the glass reflects.
        """
        if self.air_gap_share == 0.0:
            return mi.Float(1.0)
        n: Any = self.refractive_index
        through = n * n * (1.0 - mi.fresnel(dr.clip(cos_theta, 0.0, 1.0), 1.0 / n)[0])
        return 1.0 + self.air_gap_share * (through - 1.0)


class LedConnector:
    """Sampler of guided connections, for the current (llvm or cuda) variant.

    Parameters
    ----------
    leds : LedTable
    guide : Guide
    patch : tuple of float, optional
        Extent (x0, x1, y0, y1) of the frustrated patch [mm].
    reflectance : callable, optional
        ``reflectance(x, y, cos_theta, active)`` of the patch for light from the glass.
    """

    def __init__(
        self,
        leds: LedTable,
        guide: Guide,
        patch: tuple[float, float, float, float] | None,
        reflectance: Callable[[Any, Any, Any, Any], Any] | None,
    ) -> None:
        self.guide, self.thickness, self.absorption = guide, guide.thickness, guide.absorption
        self.patch, self.reflectance = patch, reflectance
        self.escape2 = guide.refractive_index**-2.0
        self.cot_critical = math.sqrt(guide.refractive_index**2 - 1.0)
        self.width, self.height = leds.width, leds.height
        self.count = len(leds.radiance)
        weights = leds.radiance if self.count else np.ones(1)
        self.total = float(weights.sum())
        self.choice = mi.DiscreteDistribution(mi.Float(weights.astype(np.float32)))
        columns = (*leds.centre.T, *leds.normal.T, leds.radiance, leds.group)
        self.columns = [mi.Float(np.ascontiguousarray(c, np.float32)) for c in columns]
        self.bounces = 0
        if patch is not None:
            # A line of bounces 2 t tan(theta) apart, theta beyond the critical angle, across the patch's diagonal.
            diagonal = math.hypot(patch[1] - patch[0], patch[3] - patch[2])
            self.bounces = int(diagonal * self.cot_critical / (2 * self.thickness)) + 1

    def is_guided(self, direction: Any) -> Any:
        """Return whether a direction inside the glass lies beyond the critical angle of both faces."""
        return 1.0 - dr.square(direction.z) > self.escape2

    def _patch_transmission(self, p: Any, delta: Any, drop: Any, depth: Any, on_top: Any, cosine: Any, ok: Any) -> Any:
        """Return the product of the patch's reflectances over the line's bounces on it."""
        result = mi.Float(1.0)
        if self.patch is None or self.reflectance is None:
            return result
        x0, x1, y0, y1 = self.patch
        enter, leave = mi.Float(0.0), mi.Float(1.0)
        for start, step, low, high in ((p.x, delta.x, x0, x1), (p.y, delta.y, y0, y1)):
            safe = dr.select(dr.abs(step) > 1e-9, step, 1e-9)
            a, b = (low - start) / safe, (high - start) / safe
            enter, leave = dr.maximum(enter, dr.minimum(a, b)), dr.minimum(leave, dr.maximum(a, b))
        period = 2.0 * self.thickness
        ends = (depth + enter * drop) / period, (depth + leave * drop) / period
        first, last = dr.ceil(dr.minimum(*ends)), dr.floor(dr.maximum(*ends))
        for m in range(self.bounces):
            k = first + m
            hits = ok & (enter < leave) & (k <= last) & ~(on_top & (k == 0.0))
            part = (k * period - depth) / drop
            r = self.reflectance(p.x + part * delta.x, p.y + part * delta.y, cosine, hits)
            result *= dr.select(hits, r, 1.0)
        return result

    def _haze_transmission(self, depth: Any, drop: Any) -> Any:
        """Return what haze leaves of a line that runs from an unfolded depth over ``drop``.

        The line meets the top face at 2 k t and the bottom one at (2 k + 1) t; its start on either does not count.
        """
        result, period = mi.Float(1.0), 2.0 * self.thickness
        for share, offset in zip(self.guide.haze, (0.0, 0.5), strict=True):
            if share > 0.0:
                start, end = depth / period - offset, (depth + drop) / period - offset
                bounces = dr.select(drop > 0, dr.floor(end) - dr.floor(start), dr.ceil(start) - dr.ceil(end))
                result *= dr.power(1.0 - share, bounces)
        return result

    def _images(self, run: Any, depth: Any, on_top: Any, offset: Any) -> tuple[Any, Any]:
        """Return the lowest index and the number of the guided images of one family (2 j t minus ``offset``)."""
        reach = run * self.cot_critical
        low = dr.ceil((dr.select(on_top, 0.0, -reach) + offset) / (2 * self.thickness))
        return low, dr.floor((reach + offset) / (2 * self.thickness)) - low + 1.0

    def sample(
        self, p: Any, on_top: Any, u_led: Any, u_place: Any, u_image: Any, active: Any
    ) -> tuple[Any, Any, Any, Any]:
        """Draw a connection.

        Parameters
        ----------
        p : Point3f
            On the plate's top face or an edge, seen from inside.
        on_top : Bool
            Whether it is on the top face; it then sends light downwards only.
        u_led, u_image : Float
        u_place : Point2f
            Uniform random numbers.
        active : Bool

        Returns
        -------
        direction : Vector3f
            Of departure, in the plate's frame.
        weight : Float
            Radiance times throughput over the probability density; times the BSDF and the cosine at ``p`` it
            estimates the guided light from the LEDs.
        density : Float
            Probability density of the direction [1/sr].
        group : Float
            Number of the LED's group.
        """
        t = self.thickness
        index, reused, pmf = self.choice.sample_reuse_pmf(u_led, active)
        cx, cy, nx, ny, radiance, group = (dr.gather(mi.Float, c, index, active) for c in self.columns)
        along = (u_place.x - 0.5) * self.width
        depth_led = 0.5 * t + (u_place.y - 0.5) * self.height
        delta = mi.Vector2f(cx - ny * along - p.x, cy + nx * along - p.y)
        run = dr.norm(delta)
        depth = dr.clip(-p.z, 0.0, t)
        offset = depth - dr.select(reused < 0.5, -1.0, 1.0) * depth_led
        low, count = self._images(run, depth, on_top, offset)
        drop = 2 * t * (low + dr.minimum(dr.floor(u_image * count), count - 1.0)) - offset
        length = dr.sqrt(dr.square(run) + dr.square(drop))
        cos_led = -(delta.x * nx + delta.y * ny) / length
        ok = active & (count > 0) & (cos_led > 1e-6) & (dr.abs(drop) > 1e-6)
        density = self._density(pmf, count, length, cos_led)
        weight = radiance * self.guide.entering(cos_led) * dr.exp(-self.absorption * length) / density
        weight *= self._haze_transmission(depth, drop)
        weight *= self._patch_transmission(p, delta, drop, depth, on_top, dr.abs(drop) / length, ok)
        direction = mi.Vector3f(delta.x, delta.y, -drop) / length
        return direction, dr.select(ok, weight, 0.0), density, group

    def _density(self, pmf: Any, count: Any, length: Any, cos_led: Any) -> Any:
        """Return the probability density of a connection's direction [1/sr]."""
        return pmf * dr.square(length) / (2.0 * count * self.width * self.height * cos_led)

    def density(self, p: Any, on_top: Any, q: Any, length: Any, cos_led: Any, same_way: Any, emitted: Any) -> Any:
        """Return the density with which :meth:`sample` would have drawn a path found otherwise [1/sr].

        Parameters
        ----------
        p, on_top
            Where it started, as for :meth:`sample`.
        q : Point3f
            Where it met an LED.
        length, cos_led : Float
            Its length [mm] and the cosine at the LED.
        same_way : Bool
            Whether it arrives going down if it left going down: it does so on the images 2 j t + d.
        emitted : Float
            Radiance of the LED's face in contact.
        """
        depth, depth_led = dr.clip(-p.z, 0.0, self.thickness), dr.clip(-q.z, 0.0, self.thickness)
        run = dr.norm(mi.Vector2f(q.x - p.x, q.y - p.y))
        _, count = self._images(run, depth, on_top, depth - dr.select(same_way, depth_led, -depth_led))
        return self._density(emitted / self.total, dr.maximum(count, 1.0), length, dr.maximum(cos_led, 1e-6))
