"""The frustrated interface as a Mitsuba BSDF: glass, air film of varying thickness, diffuse silicone.

Model
-----
The shape's normal points into the glass (index n1). At each point a share ``s`` of the surface is in contact (gap 0),
the rest stands off by the gap g of a texture. Where g is below ``near_gap`` the silicone (index n3) lies right behind
the film; farther away only glass and air are local, light leaves by refraction and meets the finger as a separate body.

Behind the film the silicone is a Lambertian body of reflectance rho. Let T(theta, g) be the transmittance of glass,
film and silicone, seen from the glass, and R_i(g) the reflectance that diffuse light in the silicone meets at the film
(:func:`evanesce.optics.interface.internal_diffuse_reflectance`). Irradiance E_i from direction i puts E_i T(i) into
the silicone; the body returns rho of what reaches it, the film sends R_i of that back, and so on: the exitance just
inside is E_i T(i) rho/(1 - rho R_i), its radiance that over pi. Going out, L/n^2 is invariant up to T(o), hence

    f(i, o) = (n1/n3)^2 rho / (pi (1 - rho R_i)) T(i) T(o).

It is symmetric (reciprocal), and because 1 - R_i = (n1/n3)^2 times the integral of T d(sin^2 theta) the albedo is
R(i) + T(i) rho (1 - R_i)/(1 - rho R_i): exactly 1 for rho = 1, below it otherwise. A mixture of such surfaces by area,
and of them with a plain dielectric, keeps both properties.

From outside, the wedge between finger and glass is closed where they are near: the finger's flank, Lambertian with rho.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.optics.interface import guided_coupling, internal_diffuse_reflectance

NEAR_WAVELENGTHS = 4.0
# Share of diffuse samples that go where the plate guides light (there the LEDs are); the rest go where it escapes.
GUIDED_SHARE = 0.85
_TABLE = 2048
_NM_PER_MM = 1e6


@dataclass(frozen=True)
class InterfaceOptics:
    """Constants of the interface.

    Attributes
    ----------
    glass_index, silicone_index : float
        [1].
    reflectance : float
        Of the silicone body [1].
    wavelength : float
        [nm].
    """

    glass_index: float
    silicone_index: float
    reflectance: float
    wavelength: float

    @property
    def near_gap(self) -> float:
        """Gap [mm] from which on glass and silicone are separate bodies."""
        return NEAR_WAVELENGTHS * self.wavelength / _NM_PER_MM

    def body_factor(self, gap: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (n1/n3)^2 rho/(pi (1 - rho R_i)) [1/sr] for gaps [mm]."""
        inner = internal_diffuse_reflectance(gap, self.wavelength, self.glass_index, self.silicone_index)
        ratio = (self.glass_index / self.silicone_index) ** 2
        return np.asarray(ratio * self.reflectance / (np.pi * (1.0 - self.reflectance * inner)))

    def coupling(self, share: NDArray[Any], gap: NDArray[Any]) -> NDArray[np.float64]:
        """Return the weight of contact in a blend of contact and bare glass: the share of guided light coupled."""
        table = np.linspace(0.0, self.near_gap, _TABLE)
        curve = guided_coupling(table, self.wavelength, self.glass_index, self.silicone_index)
        return np.asarray(share + (1.0 - share) * np.interp(gap, table, curve, right=0.0))


def _backend() -> tuple[Any, Any]:
    """Return mitsuba and drjit, whose contents depend on the variant set last."""
    import drjit
    import mitsuba

    return mitsuba, drjit


def _film_reflectance(mi: Any, dr: Any, cos_theta: Any, gap: Any, optics: InterfaceOptics) -> Any:
    """Return the unpolarised reflectance of glass, air film and silicone in Dr.Jit arithmetic.

    The real form of :func:`evanesce.optics.interface.frustrated_reflectance`: numerator and denominator are multiplied
    by e^{-i beta} where the film's wave propagates, which leaves cos(beta) and sin(beta)/beta, and kept as they are
    (1 + e^{-x})/2 and (1 - e^{-x})/x, x = 2 |beta|, where it is evanescent, so that nothing overflows.
    """
    n1, n3 = optics.glass_index, optics.silicone_index
    k_gap = gap * (2 * np.pi * _NM_PER_MM / optics.wavelength)
    sin2 = n1 * n1 * (1.0 - cos_theta * cos_theta)
    film2 = 1.0 - sin2
    guided = film2 < 0.0
    beta = k_gap * dr.sqrt(dr.abs(film2))
    x = dr.maximum(2.0 * beta, 1e-4)
    mean = dr.select(guided, 0.5 * (1.0 + dr.exp(-2.0 * beta)), dr.cos(beta))
    safe = dr.maximum(beta, 1e-4)
    thick = k_gap * dr.select(guided, (1.0 - dr.exp(-x)) / x, dr.sin(safe) / safe)
    c3 = n3 * n3 - sin2
    root3 = dr.sqrt(dr.abs(c3))
    total = mi.Float(0.0)
    for w1, w3 in ((1.0, 1.0), (n1**-2.0, n3**-2.0)):
        a = n1 * cos_theta * w1
        real, imag = dr.select(c3 > 0, root3 * w3, 0.0), dr.select(c3 > 0, 0.0, root3 * w3)
        n_re, n_im = (a - real) * mean + a * imag * thick, -imag * mean - (a * real - film2) * thick
        d_re, d_im = (a + real) * mean + a * imag * thick, imag * mean - (a * real + film2) * thick
        below = d_re * d_re + d_im * d_im
        total += 0.5 * dr.select(below > 0, (n_re * n_re + n_im * n_im) / below, 1.0)
    return dr.clip(total, 0.0, 1.0)


class _InterfaceTerms:
    """The interface's reflectances, scattering and sampling, in Dr.Jit arithmetic; see the module's text.

    Parameters
    ----------
    gap, share : mitsuba.Texture
        Gap [mm] and share of the surface in contact [1], by the shape's uv.
    optics : InterfaceOptics
    """

    def __init__(self, gap: Any, share: Any, optics: InterfaceOptics) -> None:
        mi, _ = _backend()
        self.gap, self.share, self.optics = gap, share, optics
        self.n1, self.n3 = optics.glass_index, optics.silicone_index
        self.cone2, self.escape2 = min(1.0, (self.n3 / self.n1) ** 2), min(1.0, self.n1**-2.0)
        self.guided_share = GUIDED_SHARE if self.cone2 > self.escape2 else 0.0
        factors = optics.body_factor(np.linspace(0.0, optics.near_gap, _TABLE))
        self.contact_factor = float(factors[0])
        self.factor_table = mi.Texture1f(mi.TensorXf(np.ascontiguousarray(factors[:, None], np.float32)))

    def local(self, si: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """Return share in contact, gap, whether it is near, and the body factor at that gap."""
        mi, dr = _backend()
        s = dr.clip(self.share.eval_1(si, active), 0.0, 1.0)
        g = dr.maximum(self.gap.eval_1(si, active), 0.0)
        near = g < self.optics.near_gap
        # Texel centres lie at (i + 1/2)/N; the table's nodes at i/(N - 1).
        u = (dr.minimum(g / self.optics.near_gap, 1.0) * (_TABLE - 1) + 0.5) / _TABLE
        return s, g, near, self.factor_table.eval(mi.Point1f(u))[0]

    def reflectances(self, cos_theta: Any, g: Any, near: Any) -> tuple[Any, Any]:
        """Return the reflectances of the share in contact and of the rest, from the glass."""
        mi, dr = _backend()
        in_contact = mi.fresnel(cos_theta, self.n3 / self.n1)[0]
        apart = dr.select(
            near,
            _film_reflectance(mi, dr, cos_theta, dr.minimum(g, self.optics.near_gap), self.optics),
            mi.fresnel(cos_theta, 1.0 / self.n1)[0],
        )
        return in_contact, apart

    def diffuse(self, ri: Any, ro: Any, s: Any, near: Any, factor: Any) -> Any:
        """Return f(i, o) [1/sr] from the reflectances of both directions."""
        _, dr = _backend()
        in_contact = s * self.contact_factor * (1.0 - ri[0]) * (1.0 - ro[0])
        return in_contact + dr.select(near, (1.0 - s) * factor * (1.0 - ri[1]) * (1.0 - ro[1]), 0.0)

    def direction_pdf(self, cos_theta: Any) -> Any:
        """Return the probability density of a direction of :meth:`direction` [1/sr]."""
        _, dr = _backend()
        sin2 = 1.0 - cos_theta * cos_theta
        escape, guided = (
            (1.0 - self.guided_share) / self.escape2,
            self.guided_share / max(self.cone2 - self.escape2, 1e-9),
        )
        return cos_theta / dr.pi * dr.select(sin2 < self.escape2, escape, dr.select(sin2 < self.cone2, guided, 0.0))

    def direction(self, u: Any) -> Any:
        """Draw a direction into the glass, most of them where light is guided, from two uniform numbers."""
        mi, dr = _backend()
        to_guided = u.x < self.guided_share
        a = dr.select(
            to_guided, u.x / max(self.guided_share, 1e-9), (u.x - self.guided_share) / (1.0 - self.guided_share)
        )
        sin2 = dr.select(to_guided, self.escape2 + a * (self.cone2 - self.escape2), a * self.escape2)
        sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * u.y)
        radius = dr.sqrt(sin2)
        return mi.Vector3f(radius * cos_phi, radius * sin_phi, dr.sqrt(dr.maximum(1.0 - sin2, 0.0)))

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any) -> tuple[Any, Any]:
        """Draw a direction; see ``mitsuba.BSDF.sample``."""
        mi, dr = _backend()
        flags = mi.BSDFFlags
        cos_i = mi.Frame3f.cos_theta(si.wi)
        front = cos_i > 0
        s, g, near, factor = self.local(si, active)
        # From the air side only the bare share is open: see the module's text.
        bare, cos_t, eta_it, eta_ti = mi.fresnel(cos_i, 1.0 / self.n1)
        r = self.reflectances(dr.abs(cos_i), g, near)
        open_share = dr.select(near, 0.0, 1.0 - s)
        p_reflect = dr.select(front, s * r[0] + (1.0 - s) * r[1], open_share * bare)
        p_transmit = open_share * (1.0 - bare)
        p_diffuse = dr.maximum(1.0 - p_reflect - p_transmit, 0.0)
        reflect = sample1 < p_reflect
        transmit = ~reflect & (sample1 < p_reflect + p_transmit)

        inward, outward = self.direction(sample2), mi.warp.square_to_cosine_hemisphere(sample2)
        wo = dr.select(front, inward, mi.Vector3f(outward.x, outward.y, -outward.z))
        cos_o = dr.abs(wo.z)
        direction_pdf = dr.select(front, self.direction_pdf(cos_o), cos_o / dr.pi)
        ro = self.reflectances(cos_o, g, near)
        diffuse_pdf = p_diffuse * direction_pdf
        scattered = dr.select(
            front, self.diffuse(r, ro, s, near, factor) * cos_o / diffuse_pdf, self.optics.reflectance
        )
        through = mi.refract(si.wi, cos_t, eta_ti)
        scale = dr.square(eta_ti) if ctx.mode == mi.TransportMode.Radiance else 1.0

        bs = mi.BSDFSample3f()
        bs.wo = dr.select(reflect, mi.reflect(si.wi), dr.select(transmit, through, wo))
        bs.eta = dr.select(transmit, eta_it, 1.0)
        bs.pdf = dr.select(reflect, p_reflect, dr.select(transmit, p_transmit, diffuse_pdf))
        bs.sampled_component = dr.select(reflect, mi.UInt32(0), dr.select(transmit, mi.UInt32(2), mi.UInt32(1)))
        bs.sampled_type = dr.select(
            reflect,
            mi.UInt32(+flags.DeltaReflection),
            dr.select(transmit, mi.UInt32(+flags.DeltaTransmission), mi.UInt32(+flags.DiffuseReflection)),
        )
        weight = dr.select(reflect, 1.0, dr.select(transmit, scale, scattered))
        valid = active & (bs.pdf > 0)
        return bs, dr.select(valid, mi.Spectrum(weight), 0.0)

    def eval_pdf(self, si: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        """Return value times cosine, and probability density [1/sr]; see ``mitsuba.BSDF.eval_pdf``."""
        mi, dr = _backend()
        cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        active = active & (cos_i * cos_o > 0)
        front, cos_i, cos_o = cos_i > 0, dr.abs(cos_i), dr.abs(cos_o)
        s, g, near, factor = self.local(si, active)
        ri, ro = self.reflectances(cos_i, g, near), self.reflectances(cos_o, g, near)
        closed = dr.select(near, 1.0, s)
        value = dr.select(front, self.diffuse(ri, ro, s, near, factor), closed * self.optics.reflectance / dr.pi)
        p_diffuse = s * (1.0 - ri[0]) + dr.select(near, (1.0 - s) * (1.0 - ri[1]), 0.0)
        pdf = dr.select(front, p_diffuse * self.direction_pdf(cos_o), closed * cos_o / dr.pi)
        return mi.Spectrum(dr.select(active, value * cos_o, 0.0)), dr.select(active, pdf, 0.0)

    def reflectance(self, u: Any, v: Any, cos_theta: Any, active: Any, haze: float = 0.0) -> Any:
        """Return the specular reflectance at uv for light from the glass, over what haze leaves of it elsewhere."""
        mi, dr = _backend()
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.uv = mi.Point2f(u, v)
        s, g, near, _ = self.local(si, active)
        in_contact, apart = self.reflectances(cos_theta, g, near)
        # Haze is where nothing touches.
        return (s * in_contact + (1.0 - s) * apart) * ((1.0 - haze * (1.0 - s)) / (1.0 - haze))


def frustrated_bsdf(gap: Any, share: Any, optics: InterfaceOptics) -> Any:
    """Return the interface BSDF for the current (llvm or cuda) variant.

    Parameters
    ----------
    gap, share : mitsuba.Texture
        Gap [mm] and share of the surface in contact [1], by the shape's uv.
    optics : InterfaceOptics
    """
    mi, _ = _backend()
    flags = mi.BSDFFlags
    both = flags.FrontSide | flags.BackSide
    lobes = [flags.DeltaReflection | both, flags.DiffuseReflection | both, flags.DeltaTransmission | both]
    terms = _InterfaceTerms(gap, share, optics)
    base: Any = mi.BSDF

    class FrustratedInterface(base):
        """See the module's text."""

        def __init__(self) -> None:
            mi.BSDF.__init__(self, mi.Properties())
            self.m_components = lobes
            self.m_flags = lobes[0] | lobes[1] | lobes[2]

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> tuple[Any, Any]:
            return terms.sample(ctx, si, sample1, sample2, active)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return terms.eval_pdf(si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return terms.eval_pdf(si, wo, active)[1]

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            return terms.eval_pdf(si, wo, active)

        def reflectance(self, u: Any, v: Any, cos_theta: Any, active: Any, haze: float = 0.0) -> Any:
            """Return the specular reflectance at uv for light from the glass, over what haze leaves elsewhere."""
            return terms.reflectance(u, v, cos_theta, active, haze)

        def traverse(self, callback: Any) -> None:
            return

        def to_string(self) -> str:
            return f"FrustratedInterface[{optics}]"

    return FrustratedInterface()


def blended_bsdf(weight: Any, optics: InterfaceOptics) -> dict[str, Any]:
    """Return the interface as a dictionary of built-in plugins, for scalar variants.

    ``blendbsdf`` mixes bare glass with ``plastic``, which is glass in contact with a diffuse body. Exact where the
    weight is 0 or 1; in between the angular dependence of the coupling is replaced by its mean over guided light, and
    escaping light still meets the finger as a separate body. The shape's normal points into the glass.

    Parameters
    ----------
    weight : dict
        Texture of :meth:`InterfaceOptics.coupling`.
    optics : InterfaceOptics
    """
    mi, _ = _backend()
    n1, n3 = optics.glass_index, optics.silicone_index
    # plastic takes its internal diffuse reflectance from a polynomial fit; give it the body reflectance with which its
    # formula (1/eta^2) rho'/(pi (1 - rho' fit)) is the exact factor.
    wanted = float(optics.body_factor(np.zeros(1))[0]) * np.pi * (n3 / n1) ** 2
    fit = float(np.ravel(np.array(mi.fresnel_diffuse_reflectance(n1 / n3)))[0])
    body = {
        "type": "plastic",
        "int_ior": n3,
        "ext_ior": n1,
        "diffuse_reflectance": wanted / (1.0 + wanted * fit),
        "nonlinear": True,
    }
    bare = {"type": "dielectric", "int_ior": 1.0, "ext_ior": n1}
    # Children are taken in alphabetical order: weight 0 is a_bare, 1 is b_body.
    return {"type": "blendbsdf", "weight": weight, "a_bare": bare, "b_body": body}
