"""LEDs of another forward-voltage bin than the nominal one: decides at which supply voltage the patch vanishes."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene


class Parameters(Strict):
    """Difference of forward voltage."""

    offset_V: float = field(
        0.0,
        unit="V",
        bounds=(-0.45, 0.45),
        null=0.0,
        doc="real minus nominal forward voltage of one LED at the rated current; bins are 0.1 V wide",
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Add the offset to the forward voltage; the resistor is chosen again so that the rated current is kept.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    circuit = scene.leds.circuit
    other = circuit.model_copy(update={"forward_voltage_V": circuit.forward_voltage_V + parameters.offset_V})
    return scene.model_copy(update={"leds": scene.leds.model_copy(update={"circuit": other})})


EFFECT = Effect(
    id="led_bin",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("offset_V",),
    apply=apply,
    # One bin more or less.
    fitted={"offset_V": 0.1},
    needs=("press", "voltage"),
    scaling="all light by one factor that changes with voltage, strongest where the LEDs turn off",
)
