"""Air gap between LEDs and edge: their light enters refracted, within the critical angle of the edge's normal."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene


class Parameters(Strict):
    """Share of the LED faces with an air gap."""

    share: float = field(
        0.0, unit="1", bounds=(0.0, 1.0), null=0.0, doc="share of the LED faces in contact that an air film separates"
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Separate a share of the faces in contact.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.share == 0.0:
        return scene
    apart = 1.0 - (1.0 - scene.leds.air_gap_share) * (1.0 - parameters.share)
    return scene.model_copy(update={"leds": scene.leds.model_copy(update={"air_gap_share": apart})})


EFFECT = Effect(
    id="led_air_gap",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("share",),
    apply=apply,
    # Bonded, pressed on or apart: not published.
    fitted={"share": 0.5},
    scaling="all light by nearly one factor, the same at every voltage and force",
)
