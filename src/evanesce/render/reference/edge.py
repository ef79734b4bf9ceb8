"""The plate's edge between the LEDs as a Mitsuba BSDF: ground, polished, or some of both."""

from __future__ import annotations

from typing import Any


def edge_bsdf(reflectance: float, polish: float, refractive_index: float) -> Any:
    """Return the BSDF of the edge, seen from the glass, for the current (llvm or cuda) variant.

    A share ``polish`` of it mirrors as bare glass does, R(theta) by Fresnel, and lets the rest out of the plate, where
    nothing sends it back; the other share scatters as a Lambertian. The shape's normal points into the glass.

    Parameters
    ----------
    reflectance : float
        Diffuse reflectance of the ground share [1].
    polish : float
        [1].
    refractive_index : float
        Of the glass, in air [1].
    """
    import drjit
    import mitsuba

    # Their contents depend on the variant set last, which their stubs do not know.
    dr: Any = drjit
    mi: Any = mitsuba
    flags = mi.BSDFFlags
    lobes = [flags.DeltaReflection | flags.FrontSide, flags.DiffuseReflection | flags.FrontSide]
    scattered = (1.0 - polish) * reflectance
    base: Any = mi.BSDF

    class Edge(base):
        """See the function's text."""

        def __init__(self) -> None:
            mi.BSDF.__init__(self, mi.Properties())
            self.m_components = lobes
            self.m_flags = lobes[0] | lobes[1]

        def _mirrored(self, cos_theta: Any) -> Any:
            return polish * mi.fresnel(cos_theta, 1.0 / refractive_index)[0]

        def _mirror_share(self, mirrored: Any) -> Any:
            """Return the probability of mirroring, given that the edge sends light back."""
            total = mirrored + scattered
            return dr.select(total > 0, mirrored / total, 0.0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> tuple[Any, Any]:
            cos_i = mi.Frame3f.cos_theta(si.wi)
            mirrored = self._mirrored(cos_i)
            share = self._mirror_share(mirrored)
            mirrors = sample1 < share
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            bs = mi.BSDFSample3f()
            bs.wo = dr.select(mirrors, mi.reflect(si.wi), wo)
            bs.eta = mi.Float(1.0)
            bs.pdf = dr.select(mirrors, share, (1.0 - share) * wo.z / dr.pi)
            bs.sampled_component = dr.select(mirrors, mi.UInt32(0), mi.UInt32(1))
            bs.sampled_type = dr.select(mirrors, mi.UInt32(+flags.DeltaReflection), mi.UInt32(+flags.DiffuseReflection))
            valid = active & (cos_i > 0) & (bs.pdf > 0)
            # Either lobe's weight over its probability is the same: all that comes back.
            return bs, dr.select(valid, mi.Spectrum(mirrored + scattered), 0.0)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            active = active & (cos_i > 0) & (cos_o > 0)
            share = self._mirror_share(self._mirrored(cos_i))
            value = mi.Spectrum(dr.select(active, scattered * cos_o / dr.pi, 0.0))
            return value, dr.select(active, (1.0 - share) * cos_o / dr.pi, 0.0)

        def traverse(self, callback: Any) -> None:
            return

        def to_string(self) -> str:
            return f"Edge[reflectance={reflectance}, polish={polish}]"

    return Edge()
