"""Laws of the LEDs' power: each LED, each strip, over voltage, over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.laws import Law, Seen
from evanesce.optics.led import led_positions, scale_leds
from evanesce.rig import Scene

Array = NDArray[Any]


def plane(scene: Scene, rng: np.random.Generator) -> Scene:
    """Return LEDs whose power is a plane over the plate: warm side, long cable."""
    angle, contrast = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.05, 0.2)
    half = np.array(scene.plate.size_mm) / 2
    return _scaled(scene, lambda x, y: 1.0 + contrast * (x * np.cos(angle) / half[0] + y * np.sin(angle) / half[1]) / 2)


def strips(scene: Scene, rng: np.random.Generator) -> Scene:
    """Return strips of one power each: they are fed and soldered one by one."""
    places = led_positions(scene.plate, scene.leds)
    factors = {edge: np.full(along.size, np.exp(0.1 * rng.standard_normal())) for edge, along in places.items()}
    return scene.model_copy(update={"leds": scale_leds(scene.plate, scene.leds, factors)})


def single(scene: Scene, rng: np.random.Generator) -> Scene:
    """Return LEDs whose powers scatter one by one: flux bins are 10 to 20 % wide."""
    places = led_positions(scene.plate, scene.leds)
    factors = {edge: np.exp(0.08 * rng.standard_normal(along.size)) for edge, along in places.items()}
    return scene.model_copy(update={"leds": scale_leds(scene.plate, scene.leds, factors)})


def _scaled(scene: Scene, power: Any) -> Scene:
    half_x, half_y = scene.plate.size_mm[0] / 2, scene.plate.size_mm[1] / 2
    factors = {}
    for edge, along in led_positions(scene.plate, scene.leds).items():
        place: tuple[Any, Any]
        match edge:
            case "left" | "right":
                place = (half_x if edge == "right" else -half_x, along)
            case _:
                place = (along, half_y if edge == "bottom" else -half_y)
        factors[edge] = np.maximum(power(*place) + np.zeros(along.size), 0.05)
    return scene.model_copy(update={"leds": scale_leds(scene.plate, scene.leds, factors)})


def droop_by_power(exponent: float) -> Any:
    """Return a law by which the light falls below the current's share as the current rises."""

    def change(seen: Seen, rng: np.random.Generator) -> Array:
        highest = max((v.voltage_V for v in seen.views), default=1.0) or 1.0
        return seen.under_leds(-rng.uniform(0.05, 0.2) * seen.per_view(lambda v: (v.voltage_V / highest) ** exponent))

    return change


def warming(seen: Seen, rng: np.random.Generator) -> Array:
    """Return light that falls exponentially with the time since the LEDs were switched on."""
    last = max((v.time_s for v in seen.views), default=1.0) or 1.0
    tau = last * rng.uniform(0.1, 1.0)
    return seen.under_leds(-0.1 * (1.0 - np.exp(-seen.per_view(lambda v: v.time_s) / tau)))


def drifting(seen: Seen, rng: np.random.Generator) -> Array:
    """Return light that falls with the logarithm of time: heat that spreads into a large sink."""
    return seen.under_leds(-0.05 * np.log1p(seen.per_view(lambda v: v.time_s) / rng.uniform(1.0, 30.0)))


LAWS = {
    "led_imbalance": (Law("plane", "assumed: temperature and cable fall evenly along a strip", rig=plane),) * 3
    + (Law("strips", "assumed: strips fed one by one", rig=strips),) * 3,
    "led_spread": (Law("flux bins", "data sheets: flux bins of 10 to 20 %", rig=single),) * 6,
    "led_droop": tuple(
        Law(f"droop, power {n:g} of the voltage", "Verzellesi et al. 2013, J. Appl. Phys. 114, 071101",
            change=droop_by_power(n))
        for n in (2.0, 4.0, 8.0)
    ),
    "led_warmup": (
        Law("one time constant", "Newton's law of cooling, one heat capacity", change=warming),
        Law("logarithm of time", "heat into a large sink: Carslaw and Jaeger, 10.4", change=drifting),
    ),
}  # fmt: skip
