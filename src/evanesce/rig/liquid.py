"""A liquid between finger and glass."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field


class Liquid(Strict):
    """Sweat, water or a lubricant about the contact: it fills the narrowest gaps, and carries load at speed."""

    volume_uL: float = field(unit="uL", bounds=(0.0, 1000.0), null=0.0, doc="about the contact; 1 uL is 1 mm^3")
    refractive_index: float = field(
        1.333, unit="1", bounds=(1.3, 1.5), source="water at 589 nm 1.333; glycerol 1.473 (CRC Handbook)"
    )
    viscosity_mPa_s: float = field(
        1.0, unit="mPa s", bounds=(0.01, 1e5), source="water at 20 degC 1.00; glycerol 1410 (CRC Handbook)"
    )
    roughness_um: float = field(
        1.0,
        unit="um",
        bounds=(0.001, 100.0),
        doc="rms height of the skin, which the film must exceed; not published",
    )
