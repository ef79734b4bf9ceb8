"""Imbalance of the LEDs: their power is a plane over the plate."""

from __future__ import annotations

import math

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.optics.led import led_positions, scale_leds
from evanesce.rig import Scene


class Parameters(Strict):
    """Contrast, and direction of the brighter side."""

    contrast: float = field(
        0.0,
        unit="1",
        bounds=(-0.95, 0.95),
        null=0.0,
        doc="(brightest - dimmest)/(their sum), if LEDs sat on the plate's two extreme corners of that direction",
    )
    direction_deg: float = field(0.0, unit="deg", bounds=(-180.0, 180.0), doc="brighter side, from +x towards +y")


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Multiply each LED's power by 1 + contrast (x cos + y sin)/reach, reach the corners' largest x cos + y sin.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.contrast == 0.0:
        return scene
    half_x, half_y = scene.plate.size_mm[0] / 2, scene.plate.size_mm[1] / 2
    angle = math.radians(parameters.direction_deg)
    cos, sin = math.cos(angle), math.sin(angle)
    reach = half_x * abs(cos) + half_y * abs(sin)
    factors = {}
    for edge, along in led_positions(scene.plate, scene.leds).items():
        match edge:
            case "left" | "right":
                place = (half_x if edge == "right" else -half_x) * cos + along * sin
            case _:
                place = along * cos + (half_y if edge == "bottom" else -half_y) * sin
        factors[edge] = 1.0 + parameters.contrast * place / reach
    return scene.model_copy(update={"leds": scale_leds(scene.plate, scene.leds, factors)})


EFFECT = Effect(
    id="led_imbalance",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("contrast",),
    apply=apply,
    # Assumed: twice the width of a flux bin.
    fitted={"contrast": 0.2, "direction_deg": 60.0},
    scaling="follows LED power: a slope over the contact, the same share at every voltage",
    # Directions have no derivative without a contrast. A start is entered forwards only, so all sides are tried.
    start={"contrast": (0.2,), "direction_deg": (0.0, 45.0, 90.0, 135.0, 180.0, -135.0, -90.0, -45.0)},
)
