"""The plate's edge between the LEDs as a Mitsuba BSDF: ground, polished, or some of both."""

from __future__ import annotations

from typing import Any


def _backend() -> tuple[Any, Any]:
    """Return mitsuba and drjit, whose contents depend on the variant set last, which their stubs do not know."""
    import drjit
    import mitsuba

    return mitsuba, drjit


class _EdgeTerms:
    """Reflection at the edge: a share that mirrors, a share that scatters, in Dr.Jit arithmetic."""

    def __init__(self, reflectance: float, polish: float, refractive_index: float) -> None:
        self.polish, self.refractive_index = polish, refractive_index
        self.scattered = (1.0 - polish) * reflectance

    def mirrored(self, cos_theta: Any) -> Any:
        """Return the mirror reflectance."""
        mi, _ = _backend()
        return self.polish * mi.fresnel(cos_theta, 1.0 / self.refractive_index)[0]

    def mirror_share(self, mirrored: Any) -> Any:
        """Return the probability of mirroring, given that the edge sends light back."""
        _, dr = _backend()
        total = mirrored + self.scattered
        return dr.select(total > 0, mirrored / total, 0.0)

    def sample(self, si: Any, sample1: Any, sample2: Any, active: Any) -> tuple[Any, Any]:
        """Draw a direction; see ``mitsuba.BSDF.sample``."""
        mi, dr = _backend()
        flags = mi.BSDFFlags
        cos_i = mi.Frame3f.cos_theta(si.wi)
        mirrored = self.mirrored(cos_i)
        share = self.mirror_share(mirrored)
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
        return bs, dr.select(valid, mi.Spectrum(mirrored + self.scattered), 0.0)

    def eval_pdf(self, si: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        """Return value times cosine, and probability density [1/sr]; see ``mitsuba.BSDF.eval_pdf``."""
        mi, dr = _backend()
        cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        active = active & (cos_i > 0) & (cos_o > 0)
        share = self.mirror_share(self.mirrored(cos_i))
        value = mi.Spectrum(dr.select(active, self.scattered * cos_o / dr.pi, 0.0))
        return value, dr.select(active, (1.0 - share) * cos_o / dr.pi, 0.0)


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
    mi, _ = _backend()
    flags = mi.BSDFFlags
    lobes = [flags.DeltaReflection | flags.FrontSide, flags.DiffuseReflection | flags.FrontSide]
    terms = _EdgeTerms(reflectance, polish, refractive_index)
    base: Any = mi.BSDF

    class Edge(base):
        """See the function's text."""

        def __init__(self) -> None:
            mi.BSDF.__init__(self, mi.Properties())
            self.m_components = lobes
            self.m_flags = lobes[0] | lobes[1]

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> tuple[Any, Any]:
            return terms.sample(si, sample1, sample2, active)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return terms.eval_pdf(si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return terms.eval_pdf(si, wo, active)[1]

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            return terms.eval_pdf(si, wo, active)

        def traverse(self, callback: Any) -> None:
            return

        def to_string(self) -> str:
            return f"Edge[reflectance={reflectance}, polish={polish}]"

    return Edge()
