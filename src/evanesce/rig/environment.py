"""The room in which the rig stands."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field


class Environment(Strict):
    """Temperature of the silicone: with it, presses and slides depend on rate and time."""

    temperature_C: float = field(
        20.0, unit="degC", bounds=(0.0, 50.0), source="thesis, section 3.2: swept from 0 to 50 degC"
    )
