"""Which LEDs are lit in a rendering, at which powers, and in which groups their light is separated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.optics.led import each_led_power, led_positions
from evanesce.rig import Scene

Powers = float | NDArray[np.float64]
LedChoice = Literal["all", "left", "right", "top", "bottom"]


@dataclass(frozen=True)
class LedGroups:
    """LEDs whose light is separated in one rendering.

    Attributes
    ----------
    names : tuple of str
    numbers : mapping of ndarray of int
        Index into ``names`` of each LED, by edge, in the order of :func:`evanesce.optics.led.led_positions`.
    """

    names: tuple[str, ...]
    numbers: Mapping[str, NDArray[np.int64]]

    @classmethod
    def of(cls, scene: Scene, membership: Mapping[str, str | Sequence[str]] | None = None) -> LedGroups:
        """Return groups from the name of each LED's group, by edge: one for all LEDs there, or one each.

        Without ``membership`` every edge is a group.

        Raises
        ------
        InputError
            If an edge is missing or its names do not fit its LEDs.
        """
        positions = led_positions(scene.plate, scene.leds)
        wanted = {edge: edge for edge in positions} if membership is None else dict(membership)
        if set(wanted) != set(positions):
            raise InputError(f"{sorted(wanted)}", key="led groups", allowed="the lit edges: " + ", ".join(positions))
        each = {}
        for edge, centres in positions.items():
            given = wanted[edge]
            each[edge] = [given] * centres.size if isinstance(given, str) else list(given)
            if len(each[edge]) != centres.size:
                raise InputError(f"{len(each[edge])} names", key=f"led groups, {edge}", allowed=f"{centres.size} names")
        names = tuple(dict.fromkeys(name for edge in each.values() for name in edge))
        return cls(names, {edge: np.array([names.index(n) for n in own], np.int64) for edge, own in each.items()})


def lit_powers(scene: Scene, leds: LedChoice) -> dict[str, Powers]:
    """Return the radiant power of each LED [W] on the edges that are lit in this rendering.

    Parameters
    ----------
    scene : Scene
    leds : {"all", "left", "right", "top", "bottom"}

    Returns
    -------
    dict of ndarray (leds,)
    """
    powers: dict[str, Powers] = dict(each_led_power(scene.plate, scene.leds))
    if leds == "all":
        return powers
    if leds not in powers:
        raise InputError(f"'{leds}'", key="leds", allowed=", ".join(["all", *powers]))
    return {leds: powers[leds]}


def in_units(powers: Mapping[str, Powers]) -> tuple[dict[str, Powers], float]:
    """Return powers over a power of two that makes them of order one, and that unit.

    Light is linear in them and the division is exact, but below the knee of the LEDs' characteristic they fall out of
    the range of the renderer's 32-bit numbers.

    Parameters
    ----------
    powers : mapping
        By edge [W].
    """
    largest = max((float(np.max(p, initial=0.0)) for p in powers.values()), default=0.0)
    unit = 2.0 ** np.floor(np.log2(largest)) if largest > 0 else 1.0
    return {edge: np.asarray(p) / unit for edge, p in powers.items()}, float(unit)
