"""Haze on a face of the plate as a Mitsuba BSDF, around the BSDF of the clean face (llvm and cuda).

The law is that of :mod:`evanesce.optics.haze`: a share s of what meets the face from either side is scattered, half to
each side, evenly over projected solid angle, f = s/(2 pi). Here nothing is left out: the rest, 1 - s, goes on as at the
clean face, so that haze depletes guided light; scattered light may be guided and scattered again.

Light that the clean face lets through, as every camera ray is, is scattered with a probability of its own and weighted
for it: with that of the law, s, a picture of haze would be noise. Light is scattered into random directions, but the
lobe is declared a delta one: it is drawn, never connected to an LED.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from evanesce.optics.haze import clouds
from evanesce.rig import Scene

PASSING_PROBABILITY = 0.5
"""Of scattering where the clean face lets all light through. In proportion to what it lets through: a path that is
reflected to and fro must not gain weight each time."""


def face_share(scene: Scene, face: str) -> float:
    """Return the mean share that a face scatters [1].

    Parameters
    ----------
    scene : Scene
    face : {"top", "bottom"}
    """
    if scene.surroundings is None:
        return 0.0
    haze = scene.surroundings.haze
    return haze.top_share if face == "top" else haze.bottom_share


def hazy(scene: Scene, face: str, inner: Any, *, glass_front: bool, contact: Callable[[Any, Any], Any] | None) -> Any:
    """Return a face's BSDF with the scene's haze; ``inner`` itself where there is none.

    Parameters
    ----------
    scene : Scene
    face : {"top", "bottom"}
    inner : dict or mitsuba.BSDF
        Of the clean face.
    glass_front : bool
        Whether the shape's normal points into the glass.
    contact : callable, optional
        ``contact(si, active)``, the share that touches the finger and has no haze.
    """
    share = face_share(scene, face)
    if share == 0.0:
        return inner
    import mitsuba as mi

    inner = mi.load_dict(inner) if isinstance(inner, dict) else inner
    return _hazy_bsdf(inner, _HazeTerms(scene, face, share, glass_front, contact))


class _HazeTerms:
    """Shares and probabilities of a hazy face, in Dr.Jit arithmetic."""

    def __init__(
        self, scene: Scene, face: str, share: float, glass_front: bool, contact: Callable[[Any, Any], Any] | None
    ) -> None:
        import mitsuba as mi

        assert scene.surroundings is not None
        haze = scene.surroundings.haze
        self.share, self.front, self.contact = share, 1.0 if glass_front else -1.0, contact
        self.refractive_index = scene.plate.refractive_index
        drawn = clouds(scene.plate.size_mm, haze.contrast, haze.correlation_mm, haze.pattern, face)
        self.first, self.pitch, (self.rows, self.cols) = drawn.first, float(drawn.pitch), drawn.factor.shape
        tensor = mi.TensorXf(np.ascontiguousarray(drawn.factor[:, :, None], np.float32))
        # Plain linear interpolation: a GPU's own has eight bits.
        texture: Any = mi.Texture2f
        self.factor = texture(tensor, False)

    def cloud(self, p: Any) -> Any:
        """Return the pattern at a point, 1 on average; what light loses has no pattern."""
        import mitsuba as mi

        u = ((p.x - self.first[0]) / self.pitch + 0.5) / self.cols
        v = ((p.y - self.first[1]) / self.pitch + 0.5) / self.rows
        return self.factor.eval(mi.Point2f(u, v))[0]

    def lost(self, si: Any, active: Any) -> Any:
        """Return the share that is taken from the light."""
        import mitsuba as mi

        bare = mi.Float(1.0) if self.contact is None else 1.0 - self.contact(si, active)
        return self.share * bare

    def probability(self, si: Any, lost: Any) -> Any:
        """Return the probability of scattering."""
        import mitsuba as mi

        out: Any = 1.0 / self.refractive_index
        through = 1.0 - mi.fresnel(self.front * mi.Frame3f.cos_theta(si.wi), out)[0]
        return lost * (1.0 + through * (PASSING_PROBABILITY / self.share - 1.0))


def _hazy_bsdf(inner: Any, terms: _HazeTerms) -> Any:
    """Return the BSDF of a hazy face for the current variant."""
    import drjit as dr
    import mitsuba as mi

    flags = mi.BSDFFlags
    scattered_as = flags.DeltaTransmission | flags.FrontSide | flags.BackSide
    base: Any = mi.BSDF

    class Hazy(base):
        """See the module's text."""

        def __init__(self) -> None:
            mi.BSDF.__init__(self, mi.Properties())
            self.m_components = [*(inner.flags(k) for k in range(inner.component_count())), scattered_as]
            self.m_flags = inner.flags() | scattered_as

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> tuple[Any, Any]:
            lost = terms.lost(si, active)
            chance = terms.probability(si, lost)
            scatters = sample1 < chance
            rest = dr.clip((sample1 - chance) / (1.0 - chance), 0.0, dr.one_minus_epsilon(mi.Float))
            clean, weight = inner.sample(ctx, si, rest, sample2, active)
            weight = weight * (1.0 - lost) / (1.0 - chance)
            out = mi.warp.square_to_cosine_hemisphere(sample2)
            up = sample1 < 0.5 * chance
            wo = mi.Vector3f(out.x, out.y, dr.select(up, out.z, -out.z))
            bs: Any = dr.zeros(mi.BSDFSample3f)
            bs.wo = dr.select(scatters, wo, clean.wo)
            bs.eta = dr.select(scatters, 1.0, clean.eta)
            bs.pdf = dr.select(scatters, chance * out.z / (2.0 * dr.pi), clean.pdf * (1.0 - chance))
            bs.sampled_component = dr.select(scatters, mi.UInt32(inner.component_count()), clean.sampled_component)
            bs.sampled_type = dr.select(scatters, mi.UInt32(+flags.DeltaTransmission), clean.sampled_type)
            # f cos/pdf: s/(2 pi) over chance/(2 pi).
            own = terms.cloud(si.p) * lost / dr.maximum(chance, 1e-12)
            return bs, dr.select(scatters & active, mi.Spectrum(own), weight)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return inner.eval(ctx, si, wo, active) * (1.0 - terms.lost(si, active))

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return inner.pdf(ctx, si, wo, active) * (1.0 - terms.probability(si, terms.lost(si, active)))

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            value, density = inner.eval_pdf(ctx, si, wo, active)
            lost = terms.lost(si, active)
            return value * (1.0 - lost), density * (1.0 - terms.probability(si, lost))

        def traverse(self, callback: Any) -> None:
            return

        def to_string(self) -> str:
            return f"Hazy[{inner}, share={terms.share}]"

    return Hazy()
