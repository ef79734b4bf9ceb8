"""Bins, warming, droop and sag of an LED strip, against circuits and closed forms written here."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from evanesce.core.errors import InputError
from evanesce.optics.led import emitter_radiance, led_positions, led_powers, led_radiances, scale_leds
from evanesce.optics.led_circuit import (
    radiant_power,
    relative_efficiency,
    segment_current,
    series_resistor,
    strip_voltages,
)
from evanesce.rig import LedCircuit, Leds, Plate

K_PER_E = 8.617333262e-5
PLATE = Plate(size_mm=(71.0, 44.0))


def strip(**more: object) -> Leds:
    return Leds(pitch_mm=13.0, emitting_width_mm=3.0, emitting_height_mm=2.0, **more)


# --- temperature -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("current_A", [0.3e-3, 7e-3, 20e-3])
def test_warm_segment_obeys_kirchhoff_with_shockleys_diodes(current_A: float) -> None:
    circuit = LedCircuit(forward_voltage_V=3.07, warming_K=34.0, forward_voltage_drop_V_per_K=0.0027)

    def voltage(current: float, forward: float, kelvin: float) -> float:
        slope = circuit.ideality * K_PER_E * kelvin
        junction = forward - 20e-3 * circuit.led_resistance_ohm  # I_s taken out by comparing with the rated current
        diode = junction + slope * np.log(current / 20e-3)
        return 3 * (diode + current * circuit.led_resistance_ohm) + current * series_resistor(circuit)

    supply = voltage(current_A, 3.07 - 34.0 * 0.0027, 334.0)
    assert supply < voltage(current_A, 3.07, 300.0)
    # the diode's -1, dropped above, is I_s/I < 1e-16
    assert segment_current(circuit, supply) == pytest.approx(current_A, rel=1e-9)


def test_warming_lowers_the_forward_voltage_and_the_efficacy() -> None:
    cold = LedCircuit(forward_voltage_drop_V_per_K=0.0023, efficacy_loss_per_K=0.0015)
    warm = cold.model_copy(update={"warming_K": 40.0})

    def supply_for(circuit: LedCircuit, current: float) -> float:
        return brentq(lambda v: float(segment_current(circuit, v)) - current, 5.0, 13.0, xtol=1e-12)

    # Three LEDs at the rated current, where both definitions meet.
    assert supply_for(cold, 20e-3) - supply_for(warm, 20e-3) == pytest.approx(3 * 40 * 0.0023, rel=1e-8)
    per_ampere = radiant_power(warm, 9.3) / segment_current(warm, 9.3) / cold.efficacy_W_per_A
    assert per_ampere == pytest.approx(np.exp(-0.06), rel=1e-12)


# --- droop -----------------------------------------------------------------------------------------------------------


def test_droop_is_the_abc_model() -> None:
    """Rates written with carrier density n: I = A n + B n^2 + C n^3, light B n^2; no square roots, no cubic."""
    a, b, c = 0.7, 0.11, 0.0009
    n = np.geomspace(0.01, 900.0, 400)
    current, light = a * n + b * n**2 + c * n**3, b * n**2
    n_peak = np.sqrt(a / c)
    peak = a * n_peak + b * n_peak**2 + c * n_peak**3
    expected = (light / current) / (b * n_peak**2 / peak)
    found = relative_efficiency(current, peak, np.sqrt(a * c) / b)
    np.testing.assert_allclose(found, expected, rtol=1e-11)
    assert relative_efficiency(0.0, peak, 0.2) == 0.0
    assert (relative_efficiency(current, peak, 0.0) == 1.0).all()


def test_rated_power_is_kept_and_low_voltages_lose_most() -> None:
    plain, drooping = LedCircuit(), LedCircuit(droop=0.12, peak_current_mA=3.0)
    assert radiant_power(drooping, 12.0) == pytest.approx(float(radiant_power(plain, 12.0)), rel=1e-12)
    ratio = radiant_power(drooping, np.array([7.0, 7.8, 9.2])) / radiant_power(plain, np.array([7.0, 7.8, 9.2]))
    assert ratio[0] < ratio[1] < ratio[2]
    assert ratio[2] > 1  # nearer the peak than the rated current is


# --- sag -------------------------------------------------------------------------------------------------------------


def test_ladder_conserves_current_and_power() -> None:
    """Integrate along the rails segment by segment: Ohm's law between LEDs, and nothing left at the far end."""
    circuit, r = LedCircuit(forward_voltage_V=2.93), 0.04
    x = np.array([3.1, 17.0, 20.2, 48.0, 90.3])
    v = strip_voltages(circuit, 10.2, x, r)
    drawn = segment_current(circuit, v) / circuit.leds_per_segment
    rail, at, node, heat = drawn.sum(), 0.0, 10.2, 0.0
    for place, voltage, own in zip(x, v, drawn, strict=True):
        node -= r * (place - at) * rail
        heat += r * (place - at) * rail**2
        assert voltage == pytest.approx(node, abs=1e-11)
        rail, at = rail - own, place
    assert rail == pytest.approx(0.0, abs=1e-15)
    assert 10.2 * drawn.sum() == pytest.approx((v * drawn).sum() + heat, rel=1e-12)
    assert (np.diff(v) < 0).all()
    assert v[0] - v[-1] > 0.02  # the sag is not a rounding error


def test_little_sag_is_the_current_without_sag_times_the_resistance() -> None:
    circuit, r, x = LedCircuit(), 1e-7, np.array([5.0, 21.7, 60.0])
    own = float(segment_current(circuit, 9.4)) / 3
    expected = r * own * np.minimum(x[:, None], x[None, :]).sum(axis=1)
    # second order: relative change of the current, r x g/3 < 1e-6 with g < 1/100 ohm
    np.testing.assert_allclose(9.4 - strip_voltages(circuit, 9.4, x, r), expected, rtol=1e-5)


def test_many_linear_loads_sag_as_a_hyperbolic_cosine() -> None:
    """Above the knee a segment is a conductance: v'' = (r/d) g (v - v_knee), no current at the end."""
    circuit, r, d, count = LedCircuit(), 0.0022, 0.5, 400
    low, high = segment_current(circuit, np.array([11.5, 12.0])) / 3
    g = (high - low) / 0.5
    knee = 12.0 - high / g
    v = strip_voltages(circuit, 12.0, (np.arange(count) + 0.5) * d, r)
    k, length = np.sqrt(r * g / d), count * d
    x = (np.arange(count) + 0.5) * d
    expected = knee + (12.0 - knee) * np.cosh(k * (length - x)) / np.cosh(k * length)
    assert 0.3 < 12.0 - v[-1] < 0.8
    # The chord from 11.5 to 12 V stands for a curve: its current is wrong by at most (0.5 V)^2/8 of its curvature,
    # 0.5 % of it here; the lumped ladder errs by (k d)^2/8 = 1e-6.
    np.testing.assert_allclose(12.0 - v, 12.0 - expected, rtol=0.01)


# --- LED by LED ------------------------------------------------------------------------------------------------------


def test_without_departures_all_leds_of_an_edge_are_as_one() -> None:
    leds = strip(edges=("left", "bottom"), edge={"bottom": {"offset_mm": 4.0, "voltage_V": 11.0}})
    found, powers = led_radiances(PLATE, leds), led_powers(leds)
    assert {k: v.size for k, v in found.items()} == {k: v.size for k, v in led_positions(PLATE, leds).items()}
    for edge, radiance in found.items():
        np.testing.assert_allclose(radiance, emitter_radiance(leds, powers[edge]), rtol=1e-15)


def test_relative_powers_multiply_and_must_fit() -> None:
    leds = strip(edges=("top",))
    once = scale_leds(PLATE, leds, {"top": np.array([0.0, 1.0, 2.0, 0.5, 1.0, 1.0])})
    twice = scale_leds(PLATE, once, {"top": np.array([7.0, 1.0, 0.5, 3.0, 1.0, 1.0])})
    ratio = led_radiances(PLATE, twice)["top"] / led_radiances(PLATE, leds)["top"]
    np.testing.assert_allclose(ratio, [0.0, 1.0, 1.0, 1.5, 1.0, 1.0])
    with pytest.raises(InputError, match=r"leds\.edge\.top\.relative_power.*6 figures"):
        led_radiances(PLATE, strip(edges=("top",), edge={"top": {"relative_power": (1.0, 2.0)}}))
