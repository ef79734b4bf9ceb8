"""Colour pixels of the IMX477: white points against libcamera's own tuning, limits, and what red and infrared make."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.optics.illuminants import black_body, daylight
from evanesce.optics.spectrum import LINES, Spectrum, led_line, spectrum_of
from evanesce.rig import load_scene
from evanesce.sensor.filters import SENSORS, filter_response, relative_sensitivity
from evanesce.sensor.tuning import _WHITE_IMX477

# CIE standard illuminant D65, relative spectral power at 400, 410, ... 700 nm (CIE 15, table T.1).
D65 = [
    *(82.7549, 91.4860, 93.4318, 86.6823, 104.865, 117.008, 117.812, 114.861, 115.923, 108.811, 109.354),
    *(107.802, 104.790, 107.689, 104.405, 104.046, 100.0, 96.3342, 95.7880, 88.6856, 90.0062, 89.5991),
    *(87.6987, 83.2886, 83.6992, 80.0268, 80.2146, 82.2778, 78.2842, 69.7213, 71.6091),
]


def test_daylight_is_d65_and_a_black_body_is_wiens() -> None:
    np.testing.assert_allclose(daylight(6504.0).power, D65, atol=0.03)
    w = np.linspace(300.0, 2000.0, 17_001)
    for temperature in (2400.0, 5000.0):
        peak = w[np.argmax(black_body(temperature, w).power)]
        assert peak == pytest.approx(2.897771955e6 / temperature, abs=0.1)  # Wien's displacement law
    with pytest.raises(ValueError, match="4000 to 25000"):
        daylight(3000.0)


@pytest.mark.parametrize("kelvin", [row[0] for row in _WHITE_IMX477])
def test_white_cards_have_the_colour_that_libcamera_measured(kelvin: float) -> None:
    """Rationale: the tuning's curve is measured on cameras; sensitivities and filter are from elsewhere, unfitted.

    Expected: red over green of a white card within 7 %, blue within 15 %: the spectra of the tuning's lamps are not
    published, and its blue jumps by 10 % from 2848 to 2903 K. Black bodies below 4000 K, daylight above.
    """
    _, red, blue = _WHITE_IMX477[np.flatnonzero(_WHITE_IMX477[:, 0] == kelvin)[0]]
    r, g, b = filter_response(daylight(kelvin) if kelvin > 4000 else black_body(kelvin))
    assert r / g == pytest.approx(red, rel=0.07)
    assert b / g == pytest.approx(blue, rel=0.15)


def test_without_the_infrared_cut_filter_the_same_cards_are_far_off() -> None:
    """The comparison above can fail: it is the filter that takes red down."""
    r, g, _ = filter_response(black_body(2848.0), infrared_cut=False)
    assert r / g > 1.8 * _WHITE_IMX477[1, 1]


def test_a_line_without_width_has_the_curves_value_and_a_flat_spectrum_their_mean() -> None:
    for at in (455.0, 530.0, 634.0):
        w = at + 0.01 * np.arange(-20, 21)
        found = filter_response(Spectrum(w, led_line(w, at, 0.05)))
        np.testing.assert_allclose(found, relative_sensitivity(at), rtol=1e-3)
    # every photon of a spectrum of equal photons counts alike
    w = np.arange(400.0, 701.0)
    flat = filter_response(Spectrum(w, 1.0 / w))
    np.testing.assert_allclose(flat, np.trapezoid(relative_sensitivity(w), w, axis=0) / 300.0, rtol=2e-3)


def test_responses_are_shares_of_the_highest_sensitivity() -> None:
    bare = SENSORS["imx477"].sensitivity
    assert bare.max() == 1.0
    assert (bare >= 0).all()
    assert np.argmax(bare, axis=0).tolist() == [20, 12, 6]  # 600, 520 and 460 nm
    w = np.linspace(300.0, 1100.0, 801)
    assert (relative_sensitivity(w) <= relative_sensitivity(w, infrared_cut=False)).all()
    assert not relative_sensitivity([350.0, 1050.0]).any()
    with pytest.raises(ValueError, match="imx477"):
        relative_sensitivity(500.0, sensor="ov5647")


def test_red_leds_fill_red_pixels_first_and_leak_as_the_one_real_frame_allows() -> None:
    """docs/validation/sensor-colour.md: green 0.04 to 0.3 and blue 0.01 to 0.15 of red, by that frame's colours."""
    for warming in (0.0, 30.0):
        leds = load_scene("thesis", {"leds.spectrum": "red", "leds.circuit": {"warming_K": warming}}).leds
        red, green, blue = filter_response(spectrum_of(leds))
        assert 0.04 < green / red < 0.3
        assert 0.01 < blue / red < 0.15
    # longer light leaves green less
    assert green / red < 0.25


def test_infrared_light_is_grey_without_the_filter_and_dark_with_it() -> None:
    leds = load_scene("thesis", {"leds.spectrum": "infrared", "leds.circuit": {}}).leds
    bare, cut = (np.array(filter_response(spectrum_of(leds), infrared_cut=c)) for c in (False, True))
    assert np.ptp(bare) < 0.1 * bare.mean()  # dyes are transparent at 850 nm
    assert (cut < 2e-3 * bare.max() + 1e-12).all()
    assert LINES["infrared"].peak_nm == 850.0
