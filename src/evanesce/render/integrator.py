"""Path tracing through the plate for llvm and cuda: no emitter sampling, exact absorption, unbiased ends.

Glass blocks emitter sampling: a light path between the top face and an LED nearly always bounces off the faces, which
only the interface's own sampling can find, and every guided path does end at an edge. So paths simply walk. Where a
path crosses the glass its throughput falls by Beer-Lambert's law; where it scatters it survives with the probability of the
scattering weight (Russian roulette on diffuse bounces only), so that throughput stays near one and no depth limit cuts
energy off noticeably.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi


def guided_integrator(absorption: float, thickness: float, half_size: tuple[float, float], max_depth: int) -> Any:
    """Return the integrator for the current (llvm or cuda) variant.

    Parameters
    ----------
    absorption : float
        Of the glass [1/mm].
    thickness : float
        Glass fills -thickness < z < 0 [mm].
    half_size : tuple of float
        Half the plate's extent in x and y [mm].
    max_depth : int
        Surfaces met at most; a guard against endless paths.
    """

    class GuidedIntegrator(mi.SamplingIntegrator):
        """See the module's text."""

        def __init__(self) -> None:
            mi.SamplingIntegrator.__init__(self, mi.Properties())
            # Attributes, because Dr.Jit's rewritten function does not see the enclosing one's variables.
            self.absorption, self.thickness, self.max_depth = absorption, thickness, max_depth
            self.half_x, self.half_y = half_size

        @dr.syntax
        def sample(  # type: ignore[no-untyped-def]
            self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
        ):
            ctx = mi.BSDFContext()
            ray = mi.Ray3f(ray)
            throughput, radiance = mi.Float(1.0), mi.Float(0.0)
            depth, walking = mi.UInt32(0), mi.Bool(active)
            while walking:
                si = scene.ray_intersect(ray, mi.RayFlags.All, False, walking)
                hit = walking & si.is_valid()
                if dr.hint(self.absorption > 0, mode="scalar"):
                    middle = ray(0.5 * dr.select(hit, si.t, 0.0))
                    inside = (dr.abs(middle.z + 0.5 * self.thickness) < 0.5 * self.thickness) & hit
                    inside &= (dr.abs(middle.x) < self.half_x) & (dr.abs(middle.y) < self.half_y)
                    throughput *= dr.select(inside, dr.exp(-self.absorption * si.t), 1.0)
                radiance += throughput * si.emitter(scene, walking).eval(si, walking).x
                bs, weight = si.bsdf(ray).sample(ctx, si, sampler.next_1d(hit), sampler.next_2d(hit), hit)
                w = weight.x
                scatters = mi.has_flag(bs.sampled_type, mi.BSDFFlags.DiffuseReflection)
                survival = dr.select(scatters & (depth > 1), dr.minimum(w, 1.0), 1.0)
                walking = hit & (w > 0) & (sampler.next_1d(hit) < survival) & (depth + 1 < self.max_depth)
                throughput *= dr.select(walking, w / survival, 1.0)
                ray = si.spawn_ray(si.to_world(bs.wo))
                depth += 1
            return mi.Spectrum(radiance), mi.Bool(active), []

    return GuidedIntegrator()
