"""Voltage drop along the strips: LEDs far from the fed end are dimmer, the more so the larger the current."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.optics.led import edge_resistance, edge_supply
from evanesce.optics.led_circuit import segment_current
from evanesce.rig import Scene
from evanesce.rig.leds import StripEdge

LEAST_CURRENT = 1e-6
"""Of the rated current; less gives no visible light."""


class Parameters(Strict):
    """The copper's and its joints' resistance."""

    resistance_ohm_per_mm: float = field(
        0.0,
        unit="ohm/mm",
        bounds=(0.0, 10.0),
        null=0.0,
        doc="added, both rails and the joints between segments together; two 3 mm rails of 35 um copper have 0.0003",
    )
    growth: float = field(
        0.0,
        unit="1",
        bounds=(-3.0, 3.0),
        doc="power of the segments' current, over the rated one, by which it grows: clipped joints warm and loosen",
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Add the resistance to that of the strips; :func:`evanesce.optics.led_circuit.strip_voltages` solves the ladder.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.resistance_ohm_per_mm == 0.0:
        return scene
    leds, edges = scene.leds, dict(scene.leds.edge)
    for edge in leds.edges:
        # Each joint by its own strip's current: a strip may have a supply of its own.
        now, rated = segment_current(leds.circuit, [edge_supply(leds, edge), leds.circuit.rated_voltage_V])
        added = parameters.resistance_ohm_per_mm * float(max(now / rated, LEAST_CURRENT) ** parameters.growth)
        total = {"strip_resistance_ohm_per_mm": edge_resistance(leds, edge) + added}
        edges[edge] = edges.get(edge, StripEdge()).model_copy(update=total)
    return scene.model_copy(update={"leds": leds.model_copy(update={"edge": edges})})


EFFECT = Effect(
    id="supply_sag",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("resistance_ohm_per_mm",),
    apply=apply,
    # Copper rails (0.0003) do not show. What shows is a joint of some ohms between segments that were cut and clipped.
    # A wire's resistance is the same at any current, one of a loose joint is not: to the square root of it, assumed.
    fitted={"resistance_ohm_per_mm": 0.3, "growth": 0.5},
    needs=("press", "voltage"),
    scaling="grows with LED current: far ends of the strips dimmer, the more so at high voltage",
)
