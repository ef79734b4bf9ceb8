"""What an effect is: a stage, strict parameters with a null, and a pure function.

A file of this folder that holds an ``EFFECT`` is an effect; nothing else needs to change to add one. Its parameters
stand in a scene's table ``[effects.<id>]``. Stages are the places of the chain that :mod:`evanesce.simulate` spells
out in physical order; effects of one stage act in the order in which the scene lists them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from evanesce import rng
from evanesce.quantities import Strict
from evanesce.rig import Scene

ANY_SCENE = Path("scene")
"""Named in errors where a scene did not come from a file."""


class Stage(StrEnum):
    """A place in the chain, and the value that an effect receives there and returns."""

    RIG = "rig"
    """:class:`~evanesce.rig.Scene`: plate, LEDs, finger and camera as they really are."""
    CONTACT = "contact"
    """:class:`~evanesce.states.ContactState`; not called when nothing touches."""
    PLATE_LIGHT = "plate_light"
    """:class:`~evanesce.states.PlateLight`: radiance towards the lens."""
    SENSOR_LIGHT = "sensor_light"
    """:class:`~evanesce.states.SensorLight`: irradiance behind the lens."""
    CHARGE = "charge"
    """ndarray (rows, cols): mean charge before shot noise [e-]."""
    READOUT = "readout"
    """ndarray (rows, cols): signal before quantisation [DN]."""
    FRAME = "frame"
    """:class:`~evanesce.states.Frame`."""


@dataclass(frozen=True)
class Context:
    """What an effect may know of the moment.

    Attributes
    ----------
    scene : Scene
        The rig, after effects of the stage ``rig``.
    seed : int
        The run's seed.
    time_s : float
        Mid-exposure time [s].
    index : int
        Number of the frame.
    """

    scene: Scene
    seed: int
    time_s: float = 0.0
    index: int = 0

    def generator(self, effect: str, *, per_frame: bool) -> np.random.Generator:
        """Return the effect's own random stream: the same for all frames of a rig, or new for each frame."""
        names: tuple[str | int, ...] = ("effect", effect, self.index) if per_frame else ("effect", effect)
        return rng.generator(self.seed, *names)


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A departure from the ideal rig.

    Attributes
    ----------
    id : str
        Name of its table in a scene; also its file's name.
    stage : Stage
    parameters : type of Strict
        Model with a default for every field; fields are declared by :func:`evanesce.quantities.field`.
    amplitudes : tuple of str
        Parameters that have a null; with any one of them at its null the effect is absent, bit for bit.
    apply : callable
        ``apply(value, parameters, context) -> value``: pure, and the identity at null.
    """

    id: str
    stage: Stage
    parameters: type[Strict]
    amplitudes: tuple[str, ...]
    apply: Callable[[Any, Any, Context], Any]

    def __post_init__(self) -> None:
        nulls = {name: quantity.null for name, quantity in self.parameters.quantities()}
        for name in self.amplitudes:
            if nulls.get(name) is None:
                raise TypeError(f"effect {self.id}: amplitude {name} declares no null")
        if not self.amplitudes:
            raise TypeError(f"effect {self.id}: no amplitude, so it could not be switched off")

    def is_null(self, parameters: Strict) -> bool:
        """Tell whether the effect is absent with these parameters."""
        nulls = {name: quantity.null for name, quantity in self.parameters.quantities()}
        return any(getattr(parameters, name) == nulls[name] for name in self.amplitudes)


@dataclass(frozen=True)
class Active:
    """An effect with the parameters of a scene."""

    effect: Effect
    parameters: Strict


def apply_stage(stage: Stage, value: Any, active: tuple[Active, ...], context: Context) -> Any:
    """Pass ``value`` through the effects of one stage, in the scene's order; those at null are skipped."""
    for entry in active:
        if entry.effect.stage is stage and not entry.effect.is_null(entry.parameters):
            value = entry.effect.apply(value, entry.parameters, context)
    return value
