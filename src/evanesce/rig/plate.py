"""The glass plate."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field


class Plate(Strict):
    """Glass plate; its top face is z = 0 and carries the contact."""

    size_mm: tuple[float, float] = field(unit="mm", bounds=(10.0, 1000.0), doc="extent in x and y; not published")
    thickness_mm: float = field(6.0, unit="mm", bounds=(0.1, 50.0), source="thesis, chapter 5", doc="thickness")
    refractive_index: float = field(
        1.523, unit="1", bounds=(1.0, 2.5), source="soda-lime at 589 nm, Rubin 1985", doc="refractive index"
    )
    absorption_coefficient_per_mm: float = field(
        0.0, unit="1/mm", bounds=(0.0, 1.0), null=0.0, doc="bulk absorption along the path"
    )
    edge_reflectance: float = field(
        0.5, unit="1", bounds=(0.0, 1.0), doc="diffuse reflectance of the edge between the LEDs; not published"
    )
    edge_polish: float = field(
        0.0, unit="1", bounds=(0.0, 1.0), null=0.0, doc="share of the edge between the LEDs that mirrors as bare glass"
    )
