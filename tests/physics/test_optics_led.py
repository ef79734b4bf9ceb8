"""LED circuit: the closed form against a root finder, its limits, and the LEDs' positions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from evanesce.core.errors import InputError
from evanesce.optics.led import emitter_radiance, led_positions, led_powers
from evanesce.optics.led_circuit import radiant_power, segment_current, series_current, series_resistor
from evanesce.rig import LedCircuit, Leds, Plate

VT = 8.617333262e-5


@settings(max_examples=200, deadline=None)
@given(
    voltage=st.floats(0.05, 60.0),
    log_saturation=st.floats(-80.0, -6.0),
    leds=st.integers(1, 12),
    ideality=st.floats(1.0, 6.0),
    log_resistance=st.floats(-2.0, 4.0),
    temperature=st.floats(240.0, 390.0),
)
def test_current_solves_the_circuit(voltage, log_saturation, leds, ideality, log_resistance, temperature):
    saturation, resistance = 10.0**log_saturation, 10.0**log_resistance
    scale = leds * ideality * VT * temperature

    def excess(log_current):
        current = np.exp(log_current)
        return scale * np.log1p(current / saturation) + current * resistance - voltage

    expected = np.exp(brentq(excess, -300.0, np.log(voltage / resistance), xtol=1e-13, rtol=1e-14))
    found = series_current(voltage, saturation, leds, ideality, resistance, temperature)
    # brentq stops at |d ln I| ~ 1e-12; the closed form is good to a few ulp of its largest term V/scale ~ 1e3.
    assert found == pytest.approx(expected, rel=2e-10)


def test_rated_voltage_gives_rated_current():
    circuit = LedCircuit(leds_per_segment=3, forward_voltage_V=2.93, rated_current_mA=17.0, led_resistance_ohm=6.5)
    assert segment_current(circuit, circuit.rated_voltage_V) == pytest.approx(17e-3, rel=1e-12)
    assert series_resistor(circuit) == pytest.approx((12.0 - 3 * 2.93) / 17e-3)


@pytest.mark.parametrize(("bin_voltage", "percent"), [(2.9, 5.5), (3.1, 0.36), (3.3, 0.01)])
def test_bin_decides_what_is_left_at_8_volts(bin_voltage, percent):
    # A separate estimate for n = 2 and 20 mA at 12 V, with a series resistance of 7 to 8 ohm in each LED.
    circuit = LedCircuit(forward_voltage_V=bin_voltage, led_resistance_ohm=7.5)
    left = 100 * segment_current(circuit, 8.0) / 20e-3
    assert percent / 1.5 < left < percent * 1.5


def test_limits_of_the_circuit():
    circuit = LedCircuit(forward_voltage_V=3.0)
    assert segment_current(circuit, 0.0) == 0.0
    assert segment_current(circuit, -3.0) == 0.0
    tiny = segment_current(circuit, np.array([1e-6, 2e-6]))
    assert tiny[1] / tiny[0] == pytest.approx(2.0, rel=1e-4)  # ohmic far below V_T: next term V/(2 k n V_T) = 6e-6
    # Far above the knee the slope is that of the resistors alone, less k n V_T/I of the diodes (< 1 %).
    slope = np.diff(segment_current(circuit, np.array([50.0, 60.0])))[0] / 10.0
    resistance = series_resistor(circuit) + 3 * circuit.led_resistance_ohm
    assert slope == pytest.approx(1 / resistance, rel=0.01)


def test_less_than_a_photon_a_second_is_dark():
    circuit = LedCircuit(forward_voltage_V=3.0)
    assert segment_current(circuit, 0.2) > 0.0
    assert radiant_power(circuit, 0.2) == 0.0
    assert radiant_power(circuit, 3.0) > 1e-19


def test_no_resistance_is_shockley():
    assert series_current(0.4, 1e-9, 2, 1.5, 0.0, 310.0) == pytest.approx(
        1e-9 * (np.exp(0.4 / (2 * 1.5 * VT * 310.0)) - 1), rel=1e-12
    )


def test_hotter_led_of_the_same_bin_keeps_its_rated_point():
    cold, hot = LedCircuit(temperature_K=290.0), LedCircuit(temperature_K=340.0)
    for circuit in (cold, hot):
        assert radiant_power(circuit, 12.0) == pytest.approx(0.9 * 20e-3, rel=1e-12)
    assert radiant_power(hot, 7.0) > radiant_power(cold, 7.0)  # a wider exponential dims more slowly


def test_contradictory_circuits_are_input_errors():
    with pytest.raises(InputError, match="rated_voltage_V"):
        segment_current(LedCircuit(leds_per_segment=6, forward_voltage_V=3.0), 9.0)
    with pytest.raises(InputError, match="led_resistance_ohm"):
        segment_current(LedCircuit(forward_voltage_V=1.0, led_resistance_ohm=80.0), 9.0)


def _strip(**more):
    return Leds(pitch_mm=13.0, emitting_width_mm=3.0, emitting_height_mm=2.0, **more)


def test_positions_and_powers_by_edge():
    leds = _strip(edges=("left", "bottom"), edge={"bottom": {"offset_mm": 4.0, "voltage_V": 11.0}}, voltage_V=9.0)
    plate = Plate(size_mm=(71.0, 44.0))
    found = led_positions(plate, leds)
    assert set(found) == {"left", "bottom"}
    np.testing.assert_allclose(found["left"], [-19.5, -6.5, 6.5, 19.5])  # 3 pitches + 3 mm fit into 44 mm
    # six fit into 71 mm, centred; the shift carries the last (36.5 + 1.5 mm) past the corner at 35.5 mm
    np.testing.assert_allclose(found["bottom"], np.array([-32.5, -19.5, -6.5, 6.5, 19.5]) + 4.0)
    powers = led_powers(leds)
    assert powers["bottom"] > powers["left"] > 0
    assert powers["bottom"] == radiant_power(leds.circuit, 11.0)


def test_lambertian_face_sends_its_power():
    leds = _strip()
    assert emitter_radiance(leds, 0.7) * np.pi * 3.0 * 2.0 == pytest.approx(0.7)
