"""The electrical circuit of an LED strip: from the voltage at a segment to current and radiant power."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import wrightomega

from evanesce.core.errors import InputError
from evanesce.rig import LedCircuit

Array = NDArray[np.float64]
BOLTZMANN_V_PER_K = 8.617333262e-5  # k/e, CODATA 2018
PHOTON_W = 2e-19
"""A photon a second at 1 um, h c/lambda [W]."""


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

    Parameters
    ----------
    circuit : LedCircuit

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


@dataclass(frozen=True)
class _Series:
    """A segment as one diode with a resistor: V = scale ln(1 + I/saturation) + I resistance."""

    saturation: float
    scale: float
    resistance: float


def _series(circuit: LedCircuit) -> _Series:
    """Return a segment's constants as warm as its junctions are; the resistor keeps the value of the cold strip."""
    rated = circuit.rated_current_mA * 1e-3
    forward = circuit.forward_voltage_V - circuit.forward_voltage_drop_V_per_K * circuit.warming_K
    temperature = circuit.temperature_K + circuit.warming_K
    try:
        saturation = saturation_current(forward, rated, circuit.ideality, circuit.led_resistance_ohm, temperature)
    except ValueError as error:
        raise InputError(
            f"{circuit.led_resistance_ohm:g} ohm: {error}",
            key="leds.circuit.led_resistance_ohm",
            allowed=f"below {forward / rated:g} ohm",
        ) from None
    resistance = series_resistor(circuit) + circuit.leds_per_segment * circuit.led_resistance_ohm
    return _Series(
        saturation, circuit.leds_per_segment * circuit.ideality * BOLTZMANN_V_PER_K * temperature, resistance
    )


def segment_current(circuit: LedCircuit, voltage: ArrayLike) -> Array:
    """Return the current of one strip segment [A] at a supply voltage [V].

    The forward voltage (the LED's bin) fixes I_s and the rated voltage the resistor, both at the rated current. Warm
    junctions (``warming_K``) lower the forward voltage at the rated current and widen the exponential.

    Parameters
    ----------
    circuit : LedCircuit
    voltage : array_like
        [V].

    Returns
    -------
    ndarray
        Shape of ``voltage``.

    Raises
    ------
    InputError
        If the circuit's figures contradict each other.
    """
    series = _series(circuit)
    temperature = circuit.temperature_K + circuit.warming_K
    return series_current(
        voltage, series.saturation, circuit.leds_per_segment, circuit.ideality, series.resistance, temperature
    )


def relative_efficiency(current: ArrayLike, peak_current: float, droop: float) -> Array:
    """Return an LED's efficiency over that at its peak, by the ABC model of recombination.

    Non-radiative loss A n dominates below the peak and Auger loss C n^3 above it. In terms of s, the square root of
    light output over that at the peak, and d = 1/Q: efficiency (1 + 2d)/(1 + d (s + 1/s)), and the current follows as
    I/I_peak = s (d s^2 + s + d)/(1 + 2d), a cubic that is solved here.

    Parameters
    ----------
    current : array_like
        [A], not negative.
    peak_current : float
        Current of the best efficiency [A].
    droop : float
        d = 1/Q [1]; 0 gives 1 at every current.

    References
    ----------
    S. Karpov, "ABC-model for interpretation of internal quantum efficiency and its droop in III-nitride LEDs: a
    review", Optical and Quantum Electronics 47 (2015) 1293.
    """
    current = np.asarray(current, float)
    if droop == 0.0:
        return np.ones_like(current)
    c = (1.0 + 2.0 * droop) * current / peak_current
    # Each term of the cubic alone is at most c: an upper bound, from which Newton on a convex function only descends.
    s = np.minimum(np.minimum(np.sqrt(c), np.cbrt(c / droop)), c / droop)
    for _ in range(40):
        step = (s * (droop * s * s + s + droop) - c) / (3.0 * droop * s * s + 2.0 * s + droop)
        s = s - step
        if np.all(np.abs(step) <= 1e-15 * s):
            break
    return np.asarray((1.0 + 2.0 * droop) * s / (droop * s * s + s + droop))


def radiant_power(circuit: LedCircuit, voltage: ArrayLike) -> Array:
    """Return the radiant power of one LED [W] at a supply voltage [V].

    ``efficacy_W_per_A`` times the segment's current, times the efficiency relative to that at the rated current
    (:func:`relative_efficiency`), times what warming leaves; none where that is less than a photon a second.

    Parameters
    ----------
    circuit : LedCircuit
    voltage : array_like
        [V].

    Returns
    -------
    ndarray
        Shape of ``voltage``.
    """
    current = segment_current(circuit, voltage)
    rated, peak = circuit.rated_current_mA * 1e-3, circuit.peak_current_mA * 1e-3
    efficiency = relative_efficiency(current, peak, circuit.droop) / relative_efficiency(rated, peak, circuit.droop)
    warm = math.exp(-circuit.efficacy_loss_per_K * circuit.warming_K)
    power = np.asarray(circuit.efficacy_W_per_A * current * efficiency * warm)
    # A supply that is off leaves the exponential's last 1e-58 W, which single precision takes for nothing.
    return np.where(power < PHOTON_W, 0.0, power)


def strip_voltages(circuit: LedCircuit, supply: float, distance: ArrayLike, resistance_per_mm: float) -> Array:
    """Return the voltage at each LED of a strip whose rails have a resistance.

    Kirchhoff's laws for a ladder fed at one end: V_k = V_0 - sum_j r min(x_k, x_j) i(V_j), each LED drawing its share,
    one of ``leds_per_segment``, of its segment's current where it sits. Solved by Newton's method; the current grows
    with the voltage and the resistances are positive, so that there is exactly one solution.

    Parameters
    ----------
    circuit : LedCircuit
    supply : float
        V_0 at the fed end [V].
    distance : array_like (leds,)
        From the fed end [mm], not negative.
    resistance_per_mm : float
        Of both rails together [ohm/mm].

    Returns
    -------
    ndarray (leds,)
        [V].
    """
    x = np.asarray(distance, float)
    voltage = np.full(x.shape, float(supply))
    if resistance_per_mm == 0.0 or x.size == 0:
        return voltage
    series, share = _series(circuit), 1.0 / circuit.leds_per_segment
    ladder = resistance_per_mm * np.minimum(x[:, None], x[None, :])
    for _ in range(100):
        segment = segment_current(circuit, voltage)
        conductance = share / (series.scale / (segment + series.saturation) + series.resistance)
        excess = voltage + ladder @ (share * segment) - supply
        step = np.linalg.solve(np.eye(x.size) + ladder * conductance[None, :], excess)
        voltage = voltage - step
        if np.abs(step).max() < 1e-13 * max(abs(supply), 1.0):
            break
    return voltage
