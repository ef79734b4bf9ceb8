"""The interface BSDF: energy, reciprocity, sampling, and agreement with the closed form in numpy."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.optics.interface import fresnel_reflectance, frustrated_reflectance, guided_coupling
from evanesce.render.reference.bsdf import InterfaceOptics, blended_bsdf, frustrated_bsdf
from evanesce.render.variant import select
from support.rigs import need

N1, N3, RHO, WAVELENGTH = 1.523, 1.41, 0.6, 550.0
# gap [mm], share in contact; the last is out of reach
SURFACES = [(0.0, 1.0), (1.3e-4, 0.0), (6.1e-4, 0.0), (2.2e-4, 0.37), (0.03, 0.25), (0.03, 0.0)]


@pytest.fixture(autouse=True)
def _llvm():
    need("llvm")
    select("llvm")


def interface(gap: float, share: float, rho: float = RHO, n3: float = N3):
    import mitsuba as mi

    def flat(value):
        return mi.load_dict({"type": "bitmap", "bitmap": mi.Bitmap(np.full((2, 2, 1), value, np.float32)), "raw": True})

    return frustrated_bsdf(flat(gap), flat(share), InterfaceOptics(N1, n3, rho, WAVELENGTH))


def interaction(theta, phi=0.4, count=1, below=False):
    import drjit as dr
    import mitsuba as mi

    si = dr.zeros(mi.SurfaceInteraction3f, count)
    theta = mi.Float(np.full(count, theta, np.float32))  # as data, so that one compiled kernel serves all angles
    si.wi = mi.Vector3f(dr.sin(theta) * np.cos(phi), dr.sin(theta) * np.sin(phi), dr.cos(theta) * (-1 if below else 1))
    si.uv = mi.Point2f(0.5, 0.5)
    return si


def lobe_energies(bsdf, theta, count=200_000, below=False):
    """Return the mean weight of reflection, scattering, transmission, and the standard error of their sum."""
    import mitsuba as mi

    rng = np.random.default_rng(11)
    # Flux, not radiance, so that refraction brings no factor n^2.
    ctx = mi.BSDFContext(mi.TransportMode.Importance)
    u = [mi.Float(rng.random(count).astype(np.float32)) for _ in range(3)]
    bs, weight = bsdf.sample(ctx, interaction(theta, count=count, below=below), u[0], mi.Point2f(u[1], u[2]), True)
    weight, kind = np.array(weight)[0], np.array(bs.sampled_component)
    return [weight[kind == k].sum() / count for k in range(3)], weight.std() / np.sqrt(count)


@pytest.mark.parametrize(("gap", "share"), SURFACES)
@pytest.mark.parametrize("degrees", [7.0, 38.0, 47.0, 63.0, 74.0])
def test_reflection_is_that_of_the_closed_form(gap, share, degrees):
    cos = np.cos(np.deg2rad(degrees))
    (reflected, _, transmitted), _ = lobe_energies(interface(gap, share), np.deg2rad(degrees))
    near = gap < InterfaceOptics(N1, N3, RHO, WAVELENGTH).near_gap
    bare = fresnel_reflectance(cos, N1, 1.0)
    apart = frustrated_reflectance(cos, gap, WAVELENGTH, N1, N3) if near else bare
    expected = share * fresnel_reflectance(cos, N1, N3) + (1 - share) * apart
    # Binomial choice of the lobe: 5 standard deviations, and float32.
    assert reflected == pytest.approx(expected, abs=5 * np.sqrt(expected * (1 - expected) / 200_000 + 1e-14) + 3e-6)
    through = 0.0 if near else (1 - share) * (1 - bare)
    assert transmitted == pytest.approx(through, abs=5 * np.sqrt(through * (1 - through) / 200_000 + 1e-14) + 3e-6)


@pytest.mark.parametrize(("gap", "share"), SURFACES)
@pytest.mark.parametrize("degrees", [5.0, 50.0, 66.0])
@pytest.mark.parametrize("n3", [1.41, 1.56])
def test_white_silicone_loses_nothing(gap, share, degrees, n3):
    """R + T = 1 and all that enters a body of reflectance 1 comes back, over however many internal reflections."""
    energies, error = lobe_energies(interface(gap, share, rho=1.0, n3=n3), np.deg2rad(degrees))
    # 5 standard errors; 2e-4 for linear interpolation in the table of the internal reflectance
    assert sum(energies) == pytest.approx(1.0, abs=5 * error + 2e-4)


@pytest.mark.parametrize(("gap", "share"), SURFACES)
def test_grey_silicone_loses_something(gap, share):
    energies, _ = lobe_energies(interface(gap, share), np.deg2rad(20.0))
    absorbs = share > 0 or gap < 0.002
    assert (sum(energies) < 0.999) == absorbs


@pytest.mark.parametrize("below_share", [0.0, 0.4, 1.0])
def test_outside_is_bare_glass_or_the_fingers_flank(below_share):
    theta = np.deg2rad(33.0)
    energies, error = lobe_energies(interface(0.03, below_share), theta, below=True)
    expected = (1 - below_share) + RHO * below_share
    assert sum(energies) == pytest.approx(expected, abs=5 * error + 1e-6)


@pytest.mark.parametrize(("gap", "share"), SURFACES[:5])
def test_reciprocity(gap, share):
    import mitsuba as mi

    bsdf, ctx = interface(gap, share), mi.BSDFContext()
    rng = np.random.default_rng(4)
    for _ in range(20):
        a, b = np.arccos(rng.uniform(0.05, 1.0, 2))
        there, back = interaction(a), interaction(b, phi=2.9)
        f = np.array(bsdf.eval(ctx, there, back.wi, True)).item() / np.cos(b)
        g = np.array(bsdf.eval(ctx, back, there.wi, True)).item() / np.cos(a)
        assert f == pytest.approx(g, rel=2e-4, abs=1e-7)  # float32 cancellation in 1 - R


@pytest.mark.parametrize(("gap", "share"), [(0.0, 1.0), (1.3e-4, 0.0), (2.2e-4, 0.37), (0.03, 0.25)])
@pytest.mark.parametrize("degrees", [15.0, 55.0])
def test_sampling_follows_its_density(gap, share, degrees):
    """Histogram of sampled directions against the integral of pdf over each bin (Pearson's chi square)."""
    import mitsuba as mi
    from scipy.stats import chi2

    count, bins = 400_000, 40
    bsdf, ctx, rng = interface(gap, share), mi.BSDFContext(), np.random.default_rng(8)
    u = [mi.Float(rng.random(count).astype(np.float32)) for _ in range(3)]
    si = interaction(np.deg2rad(degrees), count=count)
    bs, weight = bsdf.sample(ctx, si, u[0], mi.Point2f(u[1], u[2]), True)
    diffuse = np.array(bs.sampled_component) == 1
    wo = np.array(bs.wo)
    sin2 = (1 - wo[2] ** 2)[diffuse]
    seen = np.histogram(sin2, bins, (0, 1))[0]
    # Fine midpoint rule in sin^2: d(omega) = dphi d(sin^2)/(2 cos); the density does not depend on phi.
    fine = (np.arange(bins * 500) + 0.5) / (bins * 500)
    directions = mi.Vector3f(np.sqrt(fine).astype(np.float32), 0.0, np.sqrt(1 - fine).astype(np.float32))
    pdf = np.array(bsdf.pdf(ctx, interaction(np.deg2rad(degrees), count=fine.size), directions, True))
    expected = (pdf * np.pi / np.sqrt(1 - fine)).reshape(bins, -1).mean(axis=1) / bins * count
    filled = expected > 50
    statistic = ((seen - expected)[filled] ** 2 / expected[filled]).sum()
    assert statistic < chi2.ppf(1 - 1e-6, filled.sum())
    assert seen[~filled].sum() < 200
    azimuth = np.histogram(np.arctan2(wo[1], wo[0])[diffuse], 16, (-np.pi, np.pi))[0]
    assert ((azimuth - azimuth.mean()) ** 2 / azimuth.mean()).sum() < chi2.ppf(1 - 1e-6, 15)
    # weight = f cos/pdf, sample by sample
    value = np.array(bsdf.eval(ctx, si, bs.wo, True))[0][diffuse]
    np.testing.assert_allclose(np.array(weight)[0][diffuse], value / np.array(bs.pdf)[diffuse], rtol=2e-4, atol=1e-6)


def test_contact_agrees_with_plastic():
    """Mitsuba's own plastic is glass on a diffuse body: the blend of built-ins used in scalar variants."""
    import mitsuba as mi

    optics = InterfaceOptics(N1, N3, RHO, WAVELENGTH)
    blend = mi.load_dict(blended_bsdf({"type": "uniform", "value": 1.0}, optics))
    ours, ctx = interface(0.0, 1.0), mi.BSDFContext()
    for a, b in ((0.1, 0.9), (0.75, 0.3), (1.1, 1.0)):
        si, wo = interaction(a), interaction(b, phi=-1.2).wi
        expected = np.array(blend.eval(ctx, si, wo, True))[0]
        assert np.array(ours.eval(ctx, si, wo, True))[0] == pytest.approx(expected, rel=1e-4)


def test_coupling_weight_of_the_blend():
    optics = InterfaceOptics(N1, N3, RHO, WAVELENGTH)
    share, gap = np.array([1.0, 0.0, 0.0, 0.3]), np.array([0.5, 0.5, 1e-4, 1e-4])
    half = guided_coupling(1e-4, WAVELENGTH, N1, N3)
    np.testing.assert_allclose(optics.coupling(share, gap), [1.0, 0.0, half, 0.3 + 0.7 * half], rtol=1e-3)
