"""Path tracing through the plate for llvm and cuda: connections to the LEDs, exact absorption, unbiased ends.

Paths start at the camera. Wherever one scatters inside the plate, guided light from the LEDs is added by a connection
through the faces' mirror images (:mod:`evanesce.render.reference.connect`), and the path goes on to gather the rest;
an LED that it then meets along a path which a connection could have made counts by the share that connections left to
it. Where a path crosses the glass its throughput falls by Beer-Lambert's law; where it scatters it survives with the
probability of the scattering weight (Russian roulette on diffuse bounces only), so that throughput stays near one and
a high depth limit costs nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from evanesce.render.reference.connect import Guide, LedConnector

# Connections at the first scattering point, which all of the path's light passes; one at each later point.
FIRST_CONNECTIONS = 4


class PathTerms:
    """What a path through the plate gathers and loses at the surfaces that it meets, in Dr.Jit arithmetic.

    Parameters
    ----------
    guide : Guide
    connector : LedConnector or None
    groups : sequence of str
        Names of LED groups.
    group_of : mapping
        Number of the group of each emitting shape, by the shape's name.
    """

    def __init__(
        self, guide: Guide, connector: LedConnector | None, groups: Sequence[str], group_of: Mapping[str, int]
    ) -> None:
        self.guide, self.connector, self.groups, self.group_of = guide, connector, tuple(groups), group_of
        self.group_table = mi.Float(0.0)
        self.connects = connector is not None and connector.count > 0

    def learn_emitters(self, scene: Any) -> None:
        """Take down which group each emitter of a loaded scene belongs to, by its number in Dr.Jit's registry."""
        if not self.groups:
            return
        found = {}
        for shape in scene.shapes():
            if shape.is_emitter():
                pointer: Any = dr.reinterpret_array(mi.UInt32, mi.EmitterPtr(shape.emitter()))
                found[int(pointer[0])] = self.group_of[shape.id()]
        table = np.full(max(found, default=0) + 1, -1.0, np.float32)
        table[list(found)] = list(found.values())
        self.group_table = mi.Float(table)

    def deposit(self, channels: list[Any], group: Any, value: Any) -> list[Any]:
        """Return the groups' radiances with ``value`` added to that of a group."""
        return [c + dr.select(group == float(k), value, 0.0) for k, c in enumerate(channels)]

    def met_group(self, emitter: Any) -> Any:
        """Return the group of an emitter that a path met; -1 for none."""
        number: Any = dr.reinterpret_array(mi.UInt32, emitter)
        known: Any = (number > 0) & (number < dr.width(self.group_table))
        return dr.select(known, dr.gather(mi.Float, self.group_table, number, known), -1.0)

    def crossing(self, ray: Any, si: Any, hit: Any) -> Any:
        """Return the transmittance of the glass along a segment that ends at ``si``."""
        middle = ray(0.5 * dr.select(hit, si.t, 0.0))
        inside = hit & (dr.abs(middle.z + 0.5 * self.guide.thickness) < 0.5 * self.guide.thickness)
        inside &= (dr.abs(middle.x) < self.guide.half_size[0]) & (dr.abs(middle.y) < self.guide.half_size[1])
        return dr.select(inside, dr.exp(-self.guide.absorption * si.t), 1.0)

    def in_plate(self, si: Any) -> Any:
        """Return whether a point that scatters does so into the glass: the patch or an edge, seen from inside."""
        level = (si.p.z < 1e-3) & (si.p.z > -self.guide.thickness - 1e-3)
        return level & (mi.Frame3f.cos_theta(si.wi) > 0)

    def connections(
        self, ctx: Any, sampler: Any, si: Any, bsdf: Any, first: Any, scale: Any, channels: list[Any], active: Any
    ) -> Any:
        """Estimate the guided light from the LEDs that ``si`` scatters back along the path, times ``scale``.

        The mean of several connections at the path's first scattering point, of one later on. Returns it, and the
        groups' radiances with their parts of it added.
        """
        assert self.connector is not None
        total, number = mi.Float(0.0), dr.select(first, float(FIRST_CONNECTIONS), 1.0)
        for k in range(FIRST_CONNECTIONS):
            wanted = active & (first | (k == 0))
            u_led, u_image, u_place = sampler.next_1d(wanted), sampler.next_1d(wanted), sampler.next_2d(wanted)
            direction, weight, density, group = self.connector.sample(
                si.p, si.n.z < -0.5, u_led, u_place, u_image, wanted
            )
            usable = wanted & (weight > 0)
            value, scatter = bsdf.eval_pdf(ctx, si, si.to_local(direction), usable)
            part = dr.select(usable, weight * value.x / (1.0 + scatter / (number * density)), 0.0)
            total += part
            channels = self.deposit(channels, group, scale * part / number)
        return scale * total / number, channels

    def share(self, start: Any, si: Any, emitted: Any) -> Any:
        """Return what an LED counts that a path meets: what connections have not already contributed."""
        assert self.connector is not None
        found = self.connector.density(
            start.p, start.on_top, si.p, start.length, si.wi.z, start.down == (si.to_world(si.wi).z > 0), emitted
        )
        return dr.select(start.covered & (emitted > 0), start.pdf / (start.pdf + start.number * found), 1.0)

    def covered(self, direction: Any) -> Any:
        """Return whether a connection could have made a path that leaves in this direction."""
        assert self.connector is not None
        return self.connector.is_guided(direction)


def _start_type() -> Any:
    """Return the record of where a path last scattered, of the current variant's types."""

    class Start:
        """Where the path last scattered inside the plate, and how: what a connection there would have known."""

        DRJIT_STRUCT: ClassVar[dict[str, Any]] = {
            "p": mi.Point3f,
            "on_top": mi.Bool,
            "down": mi.Bool,
            "covered": mi.Bool,
            "pdf": mi.Float,
            "number": mi.Float,
            "length": mi.Float,
        }

    return Start


@dr.syntax
def _sample(  # type: ignore[no-untyped-def]
    self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
):
    ctx = mi.BSDFContext()
    ray = mi.Ray3f(ray)
    throughput, radiance = mi.Float(1.0), mi.Float(0.0)
    channels = [mi.Float(0.0) for _ in self.groups]
    depth, walking = mi.UInt32(0), mi.Bool(active)
    first = mi.Bool(True)
    start: Any = dr.zeros(self.start_type)
    while walking:
        si = scene.ray_intersect(ray, mi.RayFlags.All, False, walking)
        hit = walking & si.is_valid()
        if dr.hint(self.terms.guide.absorption > 0, mode="scalar"):
            throughput *= self.terms.crossing(ray, si, hit)
        emitter = si.emitter(scene, walking)
        face = emitter.eval(si, walking).x
        emitted = face * self.terms.guide.entering(si.wi.z)
        if dr.hint(self.terms.connects, mode="scalar"):
            start.length += dr.select(hit, si.t, 0.0)
            emitted *= self.terms.share(start, si, face)
        radiance += throughput * emitted
        if dr.hint(len(self.groups) > 0, mode="scalar"):
            channels = self.terms.deposit(channels, self.terms.met_group(emitter), throughput * emitted)
        bsdf = si.bsdf(ray)
        smooth = hit & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        if dr.hint(self.terms.connects, mode="scalar"):
            joins = smooth & self.terms.in_plate(si)
            if joins:
                part, channels = self.terms.connections(ctx, sampler, si, bsdf, first, throughput, channels, joins)
                radiance += part
        bs, weight = bsdf.sample(ctx, si, sampler.next_1d(hit), sampler.next_2d(hit), hit)
        w = weight.x
        scatters = mi.has_flag(bs.sampled_type, mi.BSDFFlags.DiffuseReflection)
        # A polished edge mirrors in part; light mirrored there could not have come by a connection.
        turns = mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaReflection) & (dr.abs(si.n.z) < 0.5)
        survival = dr.select((scatters | turns) & ~first, dr.minimum(w, 1.0), 1.0)
        walking = hit & (w > 0) & (sampler.next_1d(hit) < survival) & (depth + 1 < self.max_depth)
        throughput *= dr.select(walking, w / survival, 1.0)
        ray = si.spawn_ray(si.to_world(bs.wo))
        if dr.hint(self.terms.connects, mode="scalar"):
            passes = mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaTransmission)
            begins = scatters & self.terms.in_plate(si)
            start.p = dr.select(begins, si.p, start.p)
            start.on_top = dr.select(begins, si.n.z < -0.5, start.on_top)
            start.down = dr.select(begins, ray.d.z < 0, start.down)
            start.pdf = dr.select(begins, bs.pdf, start.pdf)
            start.number = dr.select(begins, dr.select(first, float(FIRST_CONNECTIONS), 1.0), start.number)
            start.length = dr.select(begins, 0.0, start.length)
            start.covered = dr.select(begins, self.terms.covered(ray.d), start.covered & ~passes & ~scatters & ~turns)
        first &= ~scatters
        depth += 1
    return mi.Spectrum(radiance), mi.Bool(active), channels


def guided_integrator(
    guide: Guide,
    max_depth: int,
    connector: LedConnector | None = None,
    groups: Sequence[str] = (),
    group_of: Mapping[str, int] | None = None,
) -> Any:
    """Return the integrator for the current (llvm or cuda) variant.

    Parameters
    ----------
    guide : Guide
    max_depth : int
        Surfaces met at most; a guard against endless paths.
    connector : LedConnector, optional
        Without it paths find the LEDs by chance: the same mean, far more noise.
    groups : sequence of str
        Names of LED groups; each becomes a channel of the image behind that of all light, filled by the same paths.
    group_of : mapping, optional
        Number of the group of each emitting shape, by the shape's name.
    """

    class GuidedIntegrator(mi.SamplingIntegrator):
        """See the module's text."""

        def __init__(self) -> None:
            mi.SamplingIntegrator.__init__(self, mi.Properties())
            # Attributes, because Dr.Jit's rewritten function does not see the enclosing one's variables.
            self.terms = PathTerms(guide, connector, groups, group_of or {})
            self.groups, self.max_depth, self.start_type = self.terms.groups, max_depth, _start_type()

        def aov_names(self) -> list[str]:
            return list(self.groups)

        def learn_emitters(self, scene: Any) -> None:
            """See :meth:`PathTerms.learn_emitters`."""
            self.terms.learn_emitters(scene)

        sample = _sample

        def to_string(self) -> str:
            return f"GuidedIntegrator[max_depth={self.max_depth}]"

    return GuidedIntegrator()
