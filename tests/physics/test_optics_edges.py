"""Polished edges, LEDs behind an air film, absorption, dispersion: brightness theorem, closed forms, real glass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from evanesce.optics.edge_rays import EdgeLight
from evanesce.optics.edge_rays import radiance_entering as entering
from evanesce.optics.guided_field import azimuthal_radiance, edge_radiance
from evanesce.optics.spectrum import (
    BAND_NM,
    luminous_efficiency,
    mean_over_bands,
    soda_lime_index,
    white_led_power,
)

EDGE_LENGTHS = {"left": 31.0, "right": 31.0, "top": 47.0, "bottom": 47.0}


def plate(**changes: object) -> EdgeLight:
    positions = {edge: np.arange(-length / 2 + 4, length / 2 - 3, 9.3) for edge, length in EDGE_LENGTHS.items()}
    light = EdgeLight(
        size=(47.0, 31.0),
        thickness=5.3,
        refractive_index=1.523,
        absorption_coefficient=0.0,
        edge_reflectance=0.0,
        positions=positions,
        radiances={edge: np.full(p.size, 3.7) for edge, p in positions.items()},
        emitter_size=(3.0, 2.6),
    )
    return replace(light, **changes)


def test_light_that_polished_edges_trap_has_the_radiance_of_the_leds() -> None:
    """Brightness theorem: without losses every ray traced back ends on an LED, however many mirrors it met."""
    light = plate(edge_polish=1.0)
    # Beyond the critical angle of both faces and, at this azimuth, of all four edges:
    # sin(theta) max(|cos phi|, |sin phi|) < sqrt(1 - 1/n^2) and theta > 41 deg.
    theta = np.deg2rad([43.0, 47.0])
    found = azimuthal_radiance(light, [3.1, -7.0], [2.2, -1.3], theta, azimuths=720)
    n = light.refractive_index
    assert np.sin(theta[1]) < np.sqrt(1 - 1 / n**2)  # true of every azimuth at 47 deg: totally reflected
    # 200 mirrorings leave some rays short: one in 1e3 of a share of 8 % LEDs along the edge, 40 % of its height.
    np.testing.assert_allclose(found, 3.7, rtol=0.01)


def test_polish_does_not_move_what_a_single_crossing_sees() -> None:
    ground, polished = plate(), plate(edge_polish=0.6)
    theta = np.deg2rad([50.0, 75.0])
    dark = azimuthal_radiance(ground, [0.3], [1.1], theta)
    bright = azimuthal_radiance(polished, [0.3], [1.1], theta)
    assert (bright > 1.1 * dark).all()
    assert (bright < 3.7).all()


def test_half_polished_scattering_edge_lies_between() -> None:
    theta = np.deg2rad([55.0])
    values = []
    for polish in (0.0, 0.5, 1.0):
        light = plate(edge_reflectance=0.8, edge_polish=polish, absorption_coefficient=0.001)
        diffuse = edge_radiance(light, rays=512)
        values.append(float(azimuthal_radiance(light, [4.0], [-3.0], theta, diffuse=diffuse)[0, 0]))
        assert 0 < values[-1] < 3.7
    assert len(set(values)) == 3


def test_air_film_sends_duntleys_share_into_the_glass() -> None:
    """Flux through the film over the LED's: 1 - external diffuse Fresnel reflectance, 9.6 % at n = 1.523."""
    light = plate(air_gap_share=1.0)
    n = light.refractive_index
    through = quad(
        lambda c: 2 * c * float(entering(light, np.array(c))), np.sqrt(1 - 1 / n**2), 1.0, epsabs=1e-10, limit=200
    )[0]
    # S. Q. Duntley, J. Opt. Soc. Am. 32 (1942) 61: closed form.
    m = n
    duntley = (
        0.5
        + (m - 1) * (3 * m + 1) / (6 * (m + 1) ** 2)
        + (m**2 * (m**2 - 1) ** 2 / (m**2 + 1) ** 3) * np.log((m - 1) / (m + 1))
        - 2 * m**3 * (m**2 + 2 * m - 1) / ((m**2 + 1) * (m**4 - 1))
        + 8 * m**4 * (m**4 + 1) / ((m**2 + 1) * (m**4 - 1) ** 2) * np.log(m)
    )
    assert through == pytest.approx(1 - duntley, abs=1e-6)
    assert entering(light, np.array([0.5])) == 0.0  # outside the critical cone
    half = plate(air_gap_share=0.5)
    assert entering(half, np.array([0.5])) == 0.5


def test_absorption_is_beer_and_lambert_on_the_way_to_one_small_led() -> None:
    x, y, theta, a = -6.0, 4.0, np.deg2rad(57.0), 0.013
    one = plate(positions={"right": np.array([-2.0])}, radiances={"right": np.array([1.0])}, emitter_size=(0.4, 5.3))
    clear = azimuthal_radiance(one, [x], [y], [theta], azimuths=20_000)
    hazy = azimuthal_radiance(replace(one, absorption_coefficient=a), [x], [y], [theta], azimuths=20_000)
    near, far = (np.hypot(23.5 - x, np.array([-1.8, -2.2]) - y)) / np.sin(theta)
    assert np.exp(-a * far) <= (hazy / clear).item() <= np.exp(-a * near)


# --- wavelengths -----------------------------------------------------------------------------------------------------


def test_index_is_that_of_tabulated_window_glass() -> None:
    """n_d and Abbe number of window glass: makers state 1.52 and 58 to 64; Rubin's clear glass is at the upper end."""
    n_f, n_d, n_c = soda_lime_index([486.13, 587.56, 656.27])
    assert n_d == pytest.approx(1.523, abs=5e-4)
    assert 58 < (n_d - 1) / (n_f - n_c) < 64.5
    assert (np.diff(soda_lime_index(BAND_NM)) < 0).all()


def test_white_led_is_white() -> None:
    """Chromaticity through the eye's three curves (fits of Wyman et al.): near daylight of 5000 to 7500 K."""
    power = white_led_power()
    assert power.sum() == pytest.approx(1.0)
    assert (power >= 0).all()
    b = BAND_NM
    x_bar = 1.065 * np.exp(-0.5 * ((b - 595.8) / 33.33) ** 2) + 0.366 * np.exp(-0.5 * ((b - 446.8) / 19.44) ** 2)
    z_bar = 1.839 * np.exp(-0.5 * (np.log(b / 449.8) / 0.051) ** 2)
    big = np.array([(power * c).sum() for c in (x_bar, luminous_efficiency(b), z_bar)])
    x, y = big[:2] / big.sum()
    mccamy = (x - 0.3320) / (0.1858 - y)
    kelvin = 449.0 * mccamy**3 + 3525.0 * mccamy**2 + 6823.3 * mccamy + 5520.33
    assert 5000 < kelvin < 7500
    assert mean_over_bands(lambda nm: nm) == pytest.approx(557, abs=6)
