"""LED strips along the plate's edges."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from evanesce.core.quantities import Strict, field

Edge = Literal["left", "right", "top", "bottom"]


class LedCircuit(Strict):
    """One segment of the strip: LEDs in series with a resistor."""

    leds_per_segment: int = field(3, unit="1", bounds=(1, 20), doc="LEDs in series")
    forward_voltage_V: float = field(
        3.1, unit="V", bounds=(1.0, 5.0), doc="forward voltage of one LED at the rated current: its bin"
    )
    rated_current_mA: float = field(20.0, unit="mA", bounds=(0.1, 5000.0), doc="segment current at the rated voltage")
    rated_voltage_V: float = field(12.0, unit="V", bounds=(1.0, 60.0), doc="strip voltage at the rated current")
    ideality: float = field(2.0, unit="1", bounds=(1.0, 8.0), doc="diode ideality factor n")
    led_resistance_ohm: float = field(5.0, unit="ohm", bounds=(0.0, 100.0), doc="series resistance inside one LED")
    temperature_K: float = field(300.0, unit="K", bounds=(230.0, 400.0), doc="junction temperature")
    efficacy_W_per_A: float = field(
        0.9, unit="W/A", bounds=(0.001, 10.0), doc="radiant power of one LED per ampere of segment current, when rated"
    )
    droop: float = field(
        0.0,
        unit="1",
        bounds=(0.0, 2.0),
        null=0.0,
        source="1/Q of Karpov, Opt. Quantum Electron. 47 (2015) 1293: good blue LEDs have Q of about 10",
        doc="efficiency lost on either side of its peak; 0: light proportional to current",
    )
    peak_current_mA: float = field(
        2.0, unit="mA", bounds=(1e-4, 1000.0), doc="segment current of the best efficiency; not published"
    )
    warming_K: float = field(
        0.0, unit="K", bounds=(0.0, 150.0), null=0.0, doc="junction above temperature_K, where the bin was measured"
    )
    forward_voltage_drop_V_per_K: float = field(
        0.0023,
        unit="V/K",
        bounds=(0.0, 0.01),
        source="GaN LED, Xi and Schubert, Appl. Phys. Lett. 85 (2004) 2163",
        doc="forward voltage of one LED at the rated current falls by this with warming",
    )
    efficacy_loss_per_K: float = field(
        0.002, unit="1/K", bounds=(0.0, 0.02), doc="relative; common in data sheets of white mid-power LEDs"
    )


class StripEdge(Strict):
    """Settings of one edge's strip that differ from the others'."""

    offset_mm: float = field(0.0, unit="mm", bounds=(-500.0, 500.0), doc="shift of the strip along its edge")
    voltage_V: float | None = field(None, unit="V", bounds=(0.0, 60.0), doc="own supply voltage")
    strip_resistance_ohm_per_mm: float | None = field(
        None, unit="ohm/mm", bounds=(0.0, 10.0), doc="own resistance of both rails together"
    )
    relative_power: tuple[float, ...] = field(
        (),
        unit="1",
        bounds=(0.0, 100.0),
        doc="power of each LED over that of its circuit, from -x or -y on; empty: all 1",
        max_length=1000,
    )


class Leds(Strict):
    """Identical strips on the named edges, emitting into the glass through the polished edge.

    Edges as the camera sees them: ``left`` is -x, ``right`` +x, ``top`` -y, ``bottom`` +y.
    """

    edges: tuple[Edge, ...] = Field(("left", "right", "top", "bottom"), min_length=1)
    pitch_mm: float = field(unit="mm", bounds=(0.5, 500.0), doc="distance of neighbouring LEDs; not published")
    emitting_width_mm: float = field(unit="mm", bounds=(0.05, 100.0), doc="emitting size along the edge")
    emitting_height_mm: float = field(unit="mm", bounds=(0.05, 50.0), doc="emitting size across the plate's thickness")
    voltage_V: float = field(9.0, unit="V", bounds=(0.0, 60.0), source="thesis, chapter 5", doc="supply voltage")
    strip_resistance_ohm_per_mm: float = field(
        0.0, unit="ohm/mm", bounds=(0.0, 10.0), null=0.0, doc="both rails together; fed at the strip's -x or -y end"
    )
    air_gap_share: float = field(
        0.0, unit="1", bounds=(0.0, 1.0), null=0.0, doc="share of the LED faces that an air film parts from the edge"
    )
    circuit: LedCircuit = LedCircuit()
    edge: dict[Edge, StripEdge] = Field(default_factory=dict)
