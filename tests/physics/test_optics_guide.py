"""Closed forms of the light guide against brute integration over directions and over limiting geometries."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.optics.emitters import LedTable, led_table
from evanesce.optics.guide import (
    contact_radiance,
    escaping_radiance,
    guided_irradiance,
    halo_irradiance,
    halo_radius,
)
from evanesce.optics.interface import fresnel_reflectance
from evanesce.rig import Leds, Plate

N = 1.523


def full_edges(size=(70.0, 46.0), thickness=5.0, radiance=1.0):
    """Return a plate whose edges shine all over, in faces of 2 mm width."""
    hx, hy = size[0] / 2, size[1] / 2
    xs, ys = np.arange(-hx + 1, hx, 2.0), np.arange(-hy + 1, hy, 2.0)
    centre = [(-hx, y) for y in ys] + [(hx, y) for y in ys] + [(x, -hy) for x in xs] + [(x, hy) for x in xs]
    normal = [(1, 0)] * len(ys) + [(-1, 0)] * len(ys) + [(0, 1)] * len(xs) + [(0, -1)] * len(xs)
    level = np.full(len(centre), radiance)
    return LedTable(np.array(centre, float), np.array(normal, float), level, 2.0, thickness)


def by_directions(x, y, leds, size, thickness, absorption, thetas=400, phis=3000):
    """Integrate radiance over directions: follow each straight line to the edge and fold its depth back."""
    s2 = np.linspace(N**-2.0, 1.0, thetas + 1)
    sin2 = (s2[1:] + s2[:-1]) / 2
    theta = np.arcsin(np.sqrt(sin2))[:, None]
    phi = ((np.arange(phis) + 0.5) / phis * 2 * np.pi)[None, :]
    cos_p, sin_p = np.cos(phi), np.sin(phi)
    to_x = np.where(cos_p > 0, size[0] / 2 - x, -size[0] / 2 - x) / cos_p
    to_y = np.where(sin_p > 0, size[1] / 2 - y, -size[1] / 2 - y) / sin_p
    run = np.minimum(to_x, to_y)
    qx, qy = x + run * cos_p, y + run * sin_p
    depth = np.abs((run / np.tan(theta) + thickness) % (2 * thickness) - thickness)  # triangle wave
    seen = np.zeros(depth.shape)
    for (cx, cy), (nx, ny), radiance in zip(leds.centre, leds.normal, leds.radiance, strict=True):
        along = np.abs((qx - cx) * -ny + (qy - cy) * nx)
        off = np.abs((qx - cx) * nx + (qy - cy) * ny)
        hit = (off < 1e-6) & (along < leds.width / 2) & (np.abs(depth - thickness / 2) < leds.height / 2)
        seen += radiance * hit
    seen = seen * np.exp(-absorption * run / np.sin(theta))
    # cos dOmega = d(sin^2)/2 dphi
    return float(seen.mean(axis=1).sum() * (1 - N**-2.0) / thetas * np.pi)


def test_fully_lit_edges_fill_all_guided_directions():
    """Every guided direction ends on an edge of radiance L: E = pi L cos^2(theta_c), wherever the point lies."""
    leds = full_edges()
    expected = np.pi * (1 - N**-2.0)
    for x, y in ((3.1, -7.7), (-21.0, 11.3)):
        # The critical angle cuts one image of each face across; 24 nodes leave 1/24 of 1/(number of images ~ 8).
        assert guided_irradiance(x, y, leds, 5.0, N, nodes=24) == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("absorption", [0.0, 0.01])
def test_images_agree_with_directions(absorption):
    plate = Plate(size_mm=(70.0, 46.0), thickness_mm=5.0)
    leds = Leds(pitch_mm=17.0, emitting_width_mm=3.1, emitting_height_mm=2.2, edges=("left", "top", "bottom"))
    table = led_table(plate, leds, {"left": 0.3, "top": np.array([0.1, 0.5, 0.2, 0.4]), "bottom": 0.15})
    here = guided_irradiance(4.4, -6.1, table, 5.0, N, absorption, nodes=24)
    # Grid of directions: an LED of 3.1 mm at 20 mm spans 70 of 3000 azimuths and each image about 30 of 400 angles.
    assert here == pytest.approx(by_directions(4.4, -6.1, table, (70.0, 46.0), 5.0, absorption), rel=0.01)


def test_absorption_of_a_far_led_is_beer_lambert():
    leds = LedTable(np.array([[-400.0, 0.0]]), np.array([[1.0, 0.0]]), np.array([2.0]), 0.5, 0.5)

    def grazing(cosine):
        return (cosine < 0.05).astype(float)  # then the path is 400 mm to (1 + 0.05^2/2)

    clear = guided_irradiance(0.0, 0.0, leds, 6.0, N, 0.0, grazing)
    dim = guided_irradiance(0.0, 0.0, leds, 6.0, N, 0.003, grazing)
    assert dim / clear == pytest.approx(np.exp(-1.2), rel=2e-3)


def test_halo():
    assert halo_radius(6.0, N) == pytest.approx(12.0 / np.sqrt(N**2 - 1))  # tan(arcsin(1/n))
    assert halo_radius(6.0, N) == pytest.approx(10.5, abs=0.1)
    edge = halo_radius(4.0, N)
    inside, outside = halo_irradiance([edge * 0.97, edge * 1.0001], 1.0, 4.0, N)
    assert outside > 2 * inside  # 3 % inside the critical angle the bottom still lets most of it out


def test_halo_returns_what_does_not_escape():
    """Over the whole face the reflected flux is the source's, less what its cosine law lets out below."""
    r = np.concatenate([np.linspace(0, 40, 40001), np.geomspace(40, 1e5, 20001)[1:]])
    flux = np.trapezoid(halo_irradiance(r, 2.5, 6.0, N) * 2 * np.pi * r, r)
    mu = (np.arange(200000) + 0.5) / 200000
    reflected = (2 * mu * fresnel_reflectance(mu, N, 1.0)).mean()
    assert flux == pytest.approx(2.5 * reflected, rel=1e-4)


def test_light_leaves_with_the_square_of_the_index():
    # Normal incidence: T = 4 n/(n + 1)^2; conservation of flux over the escape cone gives the n^2.
    assert escaping_radiance(3.0, 1.0, N) == pytest.approx(3.0 * 4 * N / (N + 1) ** 2 / N**2, rel=1e-12)
    assert escaping_radiance(3.0, 0.5, N) == 0.0
    mu = np.sqrt(1 - N**-2.0) + (1 - np.sqrt(1 - N**-2.0)) * (np.arange(100000) + 0.5) / 100000
    flux_glass = (2 * np.pi * mu * (1 - fresnel_reflectance(mu, N, 1.0))).mean() * (1 - np.sqrt(1 - N**-2.0))
    air = np.sqrt(1 - N**2 * (1 - mu**2))
    # The same bundle in air: d(omega_air) cos_air = n^2 d(omega) cos
    jacobian = N**2 * mu / air
    flux_air = (2 * np.pi * escaping_radiance(1.0, mu, N) * air * jacobian).mean() * (1 - np.sqrt(1 - N**-2.0))
    assert flux_air == pytest.approx(flux_glass, rel=1e-9)


def test_contact_is_dimmer_across_a_film_and_without_body():
    leds = full_edges()
    args = (2.0, 1.0, leds, 5.0, N, 1.41)
    touching = contact_radiance(*args, 0.6, 550.0)
    assert 0 < contact_radiance(*args, 0.6, 550.0, gap=2e-4) < 0.3 * touching
    assert contact_radiance(*args, 0.0, 550.0) == 0.0
    assert contact_radiance(*args, 0.6, 550.0, absorption=0.02) < touching
