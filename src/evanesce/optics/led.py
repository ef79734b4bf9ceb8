"""LED strips: from the supply voltage to radiant power, and where the LEDs sit on the plate's edges."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import wrightomega

from evanesce.errors import InputError
from evanesce.rig import LedCircuit, Leds, Plate

Array = NDArray[np.float64]
BOLTZMANN_V_PER_K = 8.617333262e-5  # k/e, CODATA 2018


def saturation_current(
    forward_voltage: float, current: float, ideality: float, resistance: float, temperature: float
) -> float:
    """Return the I_s [A] with which one LED carries ``current`` at ``forward_voltage``.

    Parameters
    ----------
    forward_voltage : float
        [V].
    current : float
        [A].
    ideality : float
        [1].
    resistance : float
        Series resistance inside the LED [ohm].
    temperature : float
        [K].

    Raises
    ------
    ValueError
        If the resistance alone takes the whole forward voltage.
    """
    junction = forward_voltage - current * resistance
    if junction <= 0:
        raise ValueError("the series resistance takes the whole forward voltage")
    return current / math.expm1(junction / (ideality * BOLTZMANN_V_PER_K * temperature))


def series_current(
    voltage: ArrayLike, saturation: float, leds: int, ideality: float, resistance: float, temperature: float
) -> Array:
    """Return the current of ``leds`` diodes in series with a resistance.

    Solves V = k n V_T ln(1 + I/I_s) + I R exactly: with w = (I + I_s) R/(k n V_T), w + ln w is known and w is
    Wright's omega of it, that is Lambert's W of an exponential that is never formed and so cannot overflow.

    Parameters
    ----------
    voltage : array_like
        Supply [V]; below 0 the current is 0 (reverse leakage is not light).
    saturation : float
        I_s of one LED [A].
    leds : int
        k.
    ideality : float
        n [1].
    resistance : float
        Of the whole segment, LEDs' own included [ohm].
    temperature : float
        [K].

    Returns
    -------
    ndarray
        [A].

    References
    ----------
    T. C. Banwell and A. Jayakumar, "Exact analytical solution for current flow through diode with series resistance",
    Electronics Letters 36 (2000) 291.
    """
    v = np.maximum(np.asarray(voltage, float), 0.0)
    scale = leds * ideality * BOLTZMANN_V_PER_K * temperature
    if resistance == 0.0:
        return np.asarray(saturation * np.expm1(v / scale))
    share = saturation * resistance / scale
    w = wrightomega(v / scale + share + math.log(share)).real
    current = np.maximum(w * scale / resistance - saturation, 0.0)
    # The difference loses digits where the current is below I_s; one Newton step on the circuit's equation restores
    # them.
    residual = scale * np.log1p(current / saturation) + current * resistance - v
    return np.asarray(np.maximum(current - residual / (scale / (saturation + current) + resistance), 0.0))


def series_resistor(circuit: LedCircuit) -> float:
    """Return the resistor [ohm] that lets the rated current flow at the rated voltage.

    Raises
    ------
    InputError
        If the LEDs alone need more than the rated voltage.
    """
    drop = circuit.rated_voltage_V - circuit.leds_per_segment * circuit.forward_voltage_V
    if drop < 0:
        raise InputError(
            f"{circuit.rated_voltage_V:g} V cannot drive {circuit.leds_per_segment} LEDs of"
            f" {circuit.forward_voltage_V:g} V in series",
            key="leds.circuit.rated_voltage_V",
            allowed=f"at least {circuit.leds_per_segment * circuit.forward_voltage_V:g} V",
        )
    return drop / (circuit.rated_current_mA * 1e-3)


def segment_current(circuit: LedCircuit, voltage: ArrayLike) -> Array:
    """Return the current of one strip segment [A] at a supply voltage [V].

    The forward voltage (the LED's bin) fixes I_s and the rated voltage the resistor, both at the rated current.

    Raises
    ------
    InputError
        If the circuit's figures contradict each other.
    """
    rated = circuit.rated_current_mA * 1e-3
    try:
        saturation = saturation_current(
            circuit.forward_voltage_V, rated, circuit.ideality, circuit.led_resistance_ohm, circuit.temperature_K
        )
    except ValueError as error:
        raise InputError(
            f"{circuit.led_resistance_ohm:g} ohm: {error}",
            key="leds.circuit.led_resistance_ohm",
            allowed=f"below {circuit.forward_voltage_V / rated:g} ohm",
        ) from None
    resistance = series_resistor(circuit) + circuit.leds_per_segment * circuit.led_resistance_ohm
    return series_current(
        voltage, saturation, circuit.leds_per_segment, circuit.ideality, resistance, circuit.temperature_K
    )


def radiant_power(circuit: LedCircuit, voltage: ArrayLike) -> Array:
    """Return the radiant power of one LED [W] at a supply voltage [V]: proportional to the segment's current."""
    return np.asarray(circuit.efficacy_W_per_A * segment_current(circuit, voltage))


def led_powers(leds: Leds) -> dict[str, float]:
    """Return the radiant power of one LED [W] on each lit edge, at that edge's own voltage."""
    powers = {}
    for edge in leds.edges:
        own = leds.edge.get(edge)
        voltage = leds.voltage_V if own is None or own.voltage_V is None else own.voltage_V
        powers[str(edge)] = float(radiant_power(leds.circuit, voltage))
    return powers


def led_positions(plate: Plate, leds: Leds) -> dict[str, Array]:
    """Return the along-edge coordinate of each LED's centre [mm], by edge.

    The strip is centred on its edge, as many LEDs as fit whole, then shifted by the edge's offset; LEDs that the shift
    carries past the plate's corner are left out.

    Returns
    -------
    dict of ndarray
        y of the LEDs on ``left`` (-x) and ``right`` (+x), x of those on ``top`` (-y) and ``bottom`` (+y).
    """
    found = {}
    for edge in leds.edges:
        length = plate.size_mm[1] if edge in ("left", "right") else plate.size_mm[0]
        count = int((length - leds.emitting_width_mm) / leds.pitch_mm + 1e-9) + 1
        own = leds.edge.get(edge)
        centres = (np.arange(count) - (count - 1) / 2) * leds.pitch_mm + (own.offset_mm if own else 0.0)
        inside = np.abs(centres) + leds.emitting_width_mm / 2 <= length / 2 + 1e-9
        found[str(edge)] = centres[inside]
    return found


def emitter_radiance(leds: Leds, power: float) -> float:
    """Return the radiance [W mm^-2 sr^-1] of one LED's emitting face that sends ``power`` [W] as a Lambertian."""
    return power / (math.pi * leds.emitting_width_mm * leds.emitting_height_mm)
