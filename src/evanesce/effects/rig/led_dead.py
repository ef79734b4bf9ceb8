"""LEDs that have failed or dimmed: neighbours on a strip, because a segment's LEDs are in series."""

from __future__ import annotations

import numpy as np

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.optics.led import led_positions, scale_leds
from evanesce.rig import Scene


class Parameters(Strict):
    """Loss, and the LEDs concerned."""

    loss: float = field(0.0, unit="1", bounds=(0.0, 1.0), null=0.0, doc="share of their power that is lost; 1: dead")
    first: int = field(
        0,
        unit="1",
        bounds=(0, 10_000),
        doc="number of the first LED concerned, counted along the edges in the order of leds.edges, each from -x or -y",
    )
    count: int = field(3, unit="1", bounds=(1, 20), doc="LEDs concerned; a segment that opens goes dark as a whole")


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Multiply the power of ``count`` LEDs from ``first`` on by 1 - loss; a strip's end ends the row.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If there is no LED of that number.
    """
    positions = led_positions(scene.plate, scene.leds)
    before = 0
    for edge, centres in positions.items():
        start = parameters.first - before
        if 0 <= start < centres.size:
            factor = np.ones(centres.size)
            factor[start : start + parameters.count] = 1.0 - parameters.loss
            if parameters.loss == 0.0:
                return scene
            return scene.model_copy(update={"leds": scale_leds(scene.plate, scene.leds, {edge: factor})})
        before += centres.size
    raise InputError(f"no LED {parameters.first}", key="effects.led_dead.first", allowed=f"0 to {before - 1}")


EFFECT = Effect(
    id="led_dead",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("loss",),
    apply=apply,
    # A failed segment is off or dim; any one is as likely.
    fitted={"loss": 0.5, "first": 8.0},
    scaling="follows LED power: a smooth loss towards one location at the edge, and holes in the reflections there",
    # Which LED it is has no derivative. Numbers beyond the rig's last LED are an InputError and no start.
    start={"loss": (0.8,), "first": tuple(float(i) for i in range(0, 48, 2))},
)
