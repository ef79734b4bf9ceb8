"""Voltage lost along the strips' copper: LEDs far from the fed end are fainter, the more so the brighter all are."""

from __future__ import annotations

from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.quantities import Strict, field
from evanesce.rig import Scene


class Parameters(Strict):
    """The copper's resistance."""

    resistance_ohm_per_mm: float = field(
        0.0,
        unit="ohm/mm",
        bounds=(0.0, 0.05),
        null=0.0,
        doc="added, both rails together; two 3 mm rails of 35 um copper have 0.0003",
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Add the resistance to that of the strips; :func:`evanesce.optics.led.strip_voltages` solves the ladder."""
    total = scene.leds.strip_resistance_ohm_per_mm + parameters.resistance_ohm_per_mm
    leds = scene.leds.model_copy(update={"strip_resistance_ohm_per_mm": total})
    return scene.model_copy(update={"leds": leds})


EFFECT = Effect(
    id="supply_sag",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("resistance_ohm_per_mm",),
    apply=apply,
    # From copper rails (0.0003) to a thin film or a bad joint (0.02), nearer to the first.
    fitted={"resistance_ohm_per_mm": 0.002},
    needs=("press", "voltage"),
    scaling="grows with LED current: far ends of the strips fainter, the more so at high voltage",
)
