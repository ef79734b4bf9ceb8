"""LED strips on the plate's edges: where the LEDs are, and the power and radiance of each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import cast

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.optics.led_circuit import radiant_power, strip_voltages
from evanesce.rig import Leds, Plate
from evanesce.rig.leds import Edge, StripEdge

Array = NDArray[np.float64]


def edge_supply(leds: Leds, edge: str) -> float:
    """Return the voltage that feeds an edge's strip [V].

    Parameters
    ----------
    leds : Leds
    edge : str
        One of left, right, top, bottom.
    """
    own = leds.edge.get(cast(Edge, edge))
    return leds.voltage_V if own is None or own.voltage_V is None else own.voltage_V


def edge_resistance(leds: Leds, edge: str) -> float:
    """Return the resistance of the rails of an edge's strip [ohm/mm].

    Parameters
    ----------
    leds : Leds
    edge : str
        One of left, right, top, bottom.
    """
    own = leds.edge.get(cast(Edge, edge))
    every = leds.strip_resistance_ohm_per_mm
    return every if own is None or own.strip_resistance_ohm_per_mm is None else own.strip_resistance_ohm_per_mm


def led_powers(leds: Leds) -> dict[str, float]:
    """Return the radiant power [W] of one LED at the fed end of each lit edge, at that edge's own voltage.

    Parameters
    ----------
    leds : Leds
    """
    return {str(edge): float(radiant_power(leds.circuit, edge_supply(leds, edge))) for edge in leds.edges}


def each_led_power(plate: Plate, leds: Leds) -> dict[str, Array]:
    """Return the radiant power of each LED [W], by edge, in the order of :func:`led_positions`.

    Each LED at the voltage that its strip leaves it (:func:`strip_voltages`), times its ``relative_power``.

    Parameters
    ----------
    plate : Plate
    leds : Leds

    Returns
    -------
    dict of ndarray (leds,)

    Raises
    ------
    InputError
        If an edge's ``relative_power`` has not one entry for each LED.
    """
    found = {}
    for edge, centres in led_positions(plate, leds).items():
        length = plate.size_mm[1] if edge in ("left", "right") else plate.size_mm[0]
        voltage = strip_voltages(
            leds.circuit, edge_supply(leds, edge), centres + length / 2, edge_resistance(leds, edge)
        )
        found[edge] = radiant_power(leds.circuit, voltage) * _relative_power(leds, edge, centres.size)
    return found


def led_radiances(plate: Plate, leds: Leds) -> dict[str, Array]:
    """Return the radiance of each LED's emitting face [W mm^-2 sr^-1], by edge; see :func:`each_led_power`.

    Parameters
    ----------
    plate : Plate
    leds : Leds

    Returns
    -------
    dict of ndarray (leds,)
    """
    return {edge: emitter_radiance(leds, 1.0) * power for edge, power in each_led_power(plate, leds).items()}


def _relative_power(leds: Leds, edge: str, count: int) -> Array:
    own = leds.edge.get(cast(Edge, edge))
    if own is None or not own.relative_power:
        return np.ones(count)
    if len(own.relative_power) != count:
        raise InputError(
            f"{len(own.relative_power)} figures for {count} LEDs",
            key=f"leds.edge.{edge}.relative_power",
            allowed=f"{count} figures, or none",
        )
    return np.array(own.relative_power)


def scale_leds(plate: Plate, leds: Leds, factors: Mapping[str, Array]) -> Leds:
    """Return strips whose LEDs have their power multiplied, LED by LED.

    Parameters
    ----------
    plate : Plate
    leds : Leds
    factors : mapping of ndarray
        By edge, in the order of :func:`led_positions`; edges left out stay.
    """
    edges = dict(leds.edge)
    for edge, factor in factors.items():
        named = cast(Edge, edge)
        power = _relative_power(leds, edge, len(factor)) * factor
        own = edges.get(named, StripEdge())
        edges[named] = own.model_copy(update={"relative_power": tuple(float(p) for p in power)})
    return leds.model_copy(update={"edge": edges})


def led_positions(plate: Plate, leds: Leds) -> dict[str, Array]:
    """Return the along-edge coordinate of each LED's centre [mm], by edge.

    The strip is centred on its edge, as many LEDs as fit whole, then shifted by the edge's offset; LEDs that the shift
    carries past the plate's corner are left out.

    Parameters
    ----------
    plate : Plate
    leds : Leds

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
    """Return the radiance [W mm^-2 sr^-1] of one LED's emitting face that sends ``power`` [W] as a Lambertian.

    Parameters
    ----------
    leds : Leds
    power : float
        [W].
    """
    return power / (math.pi * leds.emitting_width_mm * leds.emitting_height_mm)
