"""LED strips along the plate's edges."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from evanesce.core.quantities import Strict, field

Edge = Literal["left", "right", "top", "bottom"]

SPECTRA = ("white", "red", "infrared")
"""Known LED types; any other spectrum is a CSV file."""


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


# What a key of the circuit is, where the scene does not give it and the LEDs are not white.
#
# Red, AlGaInP: OSRAM LR T67F (data sheet 1.2, 2019): 2.05 V at 20 mA; an older version names 65 lm/W, which over the
# 160 lm/W of its spectrum (optics/spectrum.py) is 0.8 W/A; assumed to hold for a strip. Kingbright
# WP710A10SEC/E (2018): -1.9 mV/K at 20 mA. Carriers leak over AlGaInP's low barriers as the junction warms, while Auger
# recombination matters little (E. F. Schubert, Light-Emitting Diodes, Cambridge 2006): no droop by current, and a loss
# per K that is assumed to be two and a half times a white LED's. Five in series: assumed, as many as leave to the
# resistor what a white segment leaves it of 12 V; three-colour strips have three.
#
# Infrared, GaAlAs: Vishay VSMY1850 (data sheet 83397, 2016): 1.65 V at 0.1 A and 2.9 V at 1 A, hence 1.3 ohm and
# 1.46 V at 20 mA; -1.18 mV/K at 10 mA; 50 mW at 100 mA; -0.35 %/K. Six in series: assumed, as above.
CIRCUITS: Mapping[str, Mapping[str, float | int]] = MappingProxyType(
    {
        "red": MappingProxyType(
            {
                "leds_per_segment": 5,
                "forward_voltage_V": 2.05,
                "efficacy_W_per_A": 0.8,
                "droop": 0.0,
                "forward_voltage_drop_V_per_K": 0.0019,
                "efficacy_loss_per_K": 0.005,
            }
        ),
        "infrared": MappingProxyType(
            {
                "leds_per_segment": 6,
                "forward_voltage_V": 1.46,
                "led_resistance_ohm": 1.3,
                "efficacy_W_per_A": 0.5,
                "droop": 0.0,
                "forward_voltage_drop_V_per_K": 0.0012,
                "efficacy_loss_per_K": 0.0035,
            }
        ),
    }
)


def circuit_defaults(spectrum: str) -> dict[str, Any]:
    """Return what each key of a circuit is where a scene does not give it.

    Parameters
    ----------
    spectrum : str
        Of the LEDs; a CSV file leaves the figures of white ones.

    Returns
    -------
    dict
        Of the fields of :class:`LedCircuit`, with their sources in this module.
    """
    own = {name: info.default for name, info in LedCircuit.model_fields.items()}
    return {**own, **CIRCUITS.get(spectrum, {})}


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

    Edges as the camera sees them: ``left`` is -x, ``right`` +x, ``top`` -y, ``bottom`` +y. Keys of the circuit that are
    not given take the figures of the LED type (:func:`circuit_defaults`).
    """

    spectrum: str = Field(
        "white",
        min_length=1,
        max_length=4096,
        description="white, red (AlGaInP), infrared (850 nm), or a CSV file beside the scene: wavelength_nm,power",
    )
    spectrum_sha256: str | None = Field(
        None, pattern="^[0-9a-f]{64}$", description="of the CSV file; filled in on reading, checked where it is given"
    )
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

    @field_validator("spectrum")
    @classmethod
    def _known_or_a_file(cls, value: str) -> str:
        if value not in SPECTRA and not value.lower().endswith(".csv"):
            raise ValueError(f"{value!r} is not a spectrum (allowed: {', '.join(SPECTRA)}, or a file ending in .csv)")
        return value

    @model_validator(mode="after")
    def _circuit_of_the_type(self) -> Self:
        """Give keys of the circuit that are not given the figures of the LED type."""
        figures = CIRCUITS.get(self.spectrum)
        if figures is not None:
            given = {name: getattr(self.circuit, name) for name in self.circuit.model_fields_set}
            # frozen for users; a validator that ran before the fields would make them strict about JSON's lists
            self.__dict__["circuit"] = LedCircuit.model_validate({**figures, **given})
        return self
