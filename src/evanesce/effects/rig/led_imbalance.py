"""Imbalance of the LEDs: their power is a plane over the plate."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.optics.led import led_positions, scale_leds
from evanesce.rig import Scene


class Parameters(Strict):
    """Contrast from side to side along each axis of the plate."""

    contrast_x: float = field(
        0.0,
        unit="1",
        bounds=(-0.95, 0.95),
        null=0.0,
        doc="(right edge - left edge)/(their sum); with contrast_y below 1, signs aside",
    )
    contrast_y: float = field(
        0.0, unit="1", bounds=(-0.95, 0.95), null=0.0, doc="(bottom edge - top edge)/(their sum): y points down"
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Multiply each LED's power by 1 + contrast_x x / (width / 2) + contrast_y y / (height / 2).

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
        If an LED in a corner would have no power.
    """
    along_x, along_y = parameters.contrast_x, parameters.contrast_y
    if not along_x and not along_y:
        return scene
    if (most := abs(along_x) + abs(along_y)) >= 1.0:
        raise InputError(
            f"contrast_x and contrast_y add to {most:g}, signs aside", key="effects.led_imbalance", allowed="below 1"
        )
    half_x, half_y = scene.plate.size_mm[0] / 2, scene.plate.size_mm[1] / 2
    factors: dict[str, NDArray[Any]] = {}
    for edge, along in led_positions(scene.plate, scene.leds).items():
        match edge:
            case "left" | "right":
                side = along_x if edge == "right" else -along_x
                factors[edge] = 1.0 + side + along_y * along / half_y
            case _:
                side = along_y if edge == "bottom" else -along_y
                factors[edge] = 1.0 + side + along_x * along / half_x
    return scene.model_copy(update={"leds": scale_leds(scene.plate, scene.leds, factors)})


EFFECT = Effect(
    id="led_imbalance",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("contrast_x", "contrast_y"),
    apply=apply,
    null_when="all",
    # Assumed: one and a half times the width of a flux bin, along either axis.
    fitted={"contrast_x": 0.15, "contrast_y": 0.15},
    scaling="follows LED power: a slope over the contact, the same share at every voltage",
)
