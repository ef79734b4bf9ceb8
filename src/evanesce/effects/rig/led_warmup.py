"""Warm-up of the LED junctions after switching on: forward voltage falls, and so does the light per ampere."""

from __future__ import annotations

import math

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene


class Parameters(Strict):
    """Temperature rise, time constant and time since switching on."""

    warming_K: float = field(0.0, unit="K", bounds=(0.0, 100.0), null=0.0, doc="rise of the junctions in the end")
    time_constant_s: float = field(60.0, unit="s", bounds=(0.1, 10_000.0), doc="of the strip on its plate")
    fall: float = field(
        0.0,
        unit="1",
        bounds=(-0.5, 0.9),
        null=0.0,
        doc="share of the light lost in the end beside the junctions': phosphor, driver, red LEDs at 1 % a kelvin",
    )
    on_before_s: float = field(0.0, unit="s", bounds=(0.0, 1e6), doc="how long the LEDs were on at time 0")


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Add warming_K (1 - exp(-(t + on_before)/time_constant)) to the junctions' temperature; light falls alike.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    elapsed = max(context.time_s + parameters.on_before_s, 0.0)
    done = -math.expm1(-elapsed / parameters.time_constant_s)
    circuit = scene.leds.circuit
    efficacy = circuit.efficacy_W_per_A * (1.0 - parameters.fall * done)
    rise = parameters.warming_K * done
    warm = circuit.model_copy(update={"warming_K": circuit.warming_K + rise, "efficacy_W_per_A": efficacy})
    return scene.model_copy(update={"leds": scene.leds.model_copy(update={"circuit": warm})})


EFFECT = Effect(
    id="led_warmup",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("warming_K", "fall"),
    apply=apply,
    null_when="all",
    # Assumed: some ten kelvin within minutes. Near its threshold voltage a warm strip draws more current and is
    # brighter; what falls with temperature beside that is some per cent.
    fitted={"warming_K": 15.0, "time_constant_s": 40.0, "fall": 0.05},
    needs=("press", "time"),
    scaling="goes with time as 1 - exp(-t/tau); a rise that is larger at low voltage, or the same fall at all",
)
