"""Spread of LED efficacy: each LED has its own, drawn once for the rig."""

from __future__ import annotations

import numpy as np

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.optics.led import led_positions, scale_leds
from evanesce.rig import Scene


class Parameters(Strict):
    """Width of the distribution."""

    spread: float = field(
        0.0,
        unit="1",
        bounds=(0.0, 0.6),
        null=0.0,
        doc="standard deviation of the logarithm of power; flux bins of white LEDs are about 0.1 wide",
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Multiply each LED's power by exp(spread z - spread^2/2), z a fixed normal number of its own: mean 1.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.spread == 0.0:
        return scene
    rng, s = context.generator("led_spread", per_frame=False), parameters.spread
    factors = {
        edge: np.exp(s * rng.standard_normal(centres.size) - 0.5 * s * s)
        for edge, centres in led_positions(scene.plate, scene.leds).items()
    }
    return scene.model_copy(update={"leds": scale_leds(scene.plate, scene.leds, factors)})


EFFECT = Effect(
    id="led_spread",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("spread",),
    apply=apply,
    # Flux bins are 10 % wide.
    fitted={"spread": 0.1},
    scaling="follows LED power: a smooth unevenness over the contact that does not change",
)
