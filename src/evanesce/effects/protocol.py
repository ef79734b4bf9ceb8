"""What an effect is: a stage, strict parameters with a null, and a pure function.

A file in a subfolder that holds an ``EFFECT`` is an effect; nothing else needs to change to add one. Its parameters
stand in a scene's table ``[effects.<id>]``. Stages are the steps of the chain that :mod:`evanesce.chain.simulate`
spells out in physical order; effects of one stage act in the order in which the scene lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from evanesce.core import rng
from evanesce.core.quantities import Strict
from evanesce.effects.inference_hints import (
    OBSERVABLES,
    Candidate,
    InferenceHints,
    candidates,
    default_deviations,
    parameter_of,
)
from evanesce.rig import Scene
from evanesce.rig.load import validate

ANY_SCENE = Path("scene")
"""Named in errors where a scene did not come from a file."""


class Stage(StrEnum):
    """A step of the chain, and the value that an effect receives there and returns."""

    RIG = "rig"
    """:class:`~evanesce.rig.Scene`: plate, LEDs, finger, camera and cards as they really are."""
    LOAD = "load"
    """float: normal force on the finger [N]; not called when the finger is away."""
    CONTACT = "contact"
    """:class:`~evanesce.core.states.ContactState`; not called when nothing touches."""
    PLATE_LIGHT = "plate_light"
    """:class:`~evanesce.core.states.PlateLight`: radiance towards the lens."""
    SENSOR_LIGHT = "sensor_light"
    """:class:`~evanesce.core.states.SensorLight`: irradiance behind the lens."""
    CHARGE = "charge"
    """ndarray (rows, cols): mean charge before shot noise [e-]."""
    READOUT = "readout"
    """ndarray (rows, cols): signal before quantisation [DN]."""
    FRAME = "frame"
    """:class:`~evanesce.core.states.Frame`."""


@dataclass(frozen=True)
class Context:
    """What an effect may know of the rig and the frame.

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
        """Return the effect's own random stream.

        Parameters
        ----------
        effect : str
            Its id.
        per_frame : bool
            New for each frame; otherwise the same for all frames of a rig.

        Returns
        -------
        numpy.random.Generator
        """
        names: tuple[str | int, ...] = ("effect", effect, self.index) if per_frame else ("effect", effect)
        return rng.generator(self.seed, *names)


@dataclass(frozen=True, kw_only=True)
class Effect(InferenceHints):
    """A departure from the ideal rig, with what inference may know of it (:class:`InferenceHints`).

    Attributes
    ----------
    id : str
        Name of its table in a scene; also its file's name.
    stage : Stage
    parameters : type of Strict
        Model with a default for every field; fields are declared by :func:`evanesce.core.quantities.field`.
    amplitudes : tuple of str
        Parameters that have a null.
    apply : callable
        ``apply(value, parameters, context) -> value``: pure, and the identity at null.
    null_when : {"any", "all"}
        Absent, bit for bit, where any one amplitude is at its null (they multiply: how many, how bright), or only
        where all are (they add: two angles).
    pointwise : bool
        Of the stages behind the charge: whether each pixel is changed by what it holds alone.
    """

    id: str
    stage: Stage
    parameters: type[Strict]
    amplitudes: tuple[str, ...]
    apply: Callable[[Any, Any, Context], Any]
    null_when: Literal["any", "all"] = "any"
    pointwise: bool = False

    def __post_init__(self) -> None:
        nulls = self._nulls()
        for name in self.amplitudes:
            if nulls.get(name) is None:
                raise TypeError(f"effect {self.id}: amplitude {name} declares no null")
        if not self.amplitudes:
            raise TypeError(f"effect {self.id}: no amplitude, so it could not be switched off")
        if unknown := set(self.needs) - set(OBSERVABLES):
            raise TypeError(f"effect {self.id}: needs {sorted(unknown)}; known: {', '.join(OBSERVABLES)}")
        declared = self.fitted if self.fitted is not None else default_deviations(self)
        object.__setattr__(self, "fitted", MappingProxyType(dict(declared)))
        object.__setattr__(self, "start", MappingProxyType(dict(self.start)))
        self.candidate_parameters()

    def is_null(self, parameters: Strict) -> bool:
        """Return whether the effect is absent with these parameters.

        Parameters
        ----------
        parameters : Strict

        Returns
        -------
        bool
        """
        nulls = self._nulls()
        at_null = [getattr(parameters, name) == nulls[name] for name in self.amplitudes]
        return any(at_null) if self.null_when == "any" else all(at_null)

    def candidate_parameters(self) -> tuple[Candidate, ...]:
        """Return what a fit may vary (:func:`~evanesce.effects.inference_hints.candidates`).

        Returns
        -------
        tuple of Candidate
        """
        return candidates(self)

    def with_values(self, values: Mapping[str, float]) -> Strict:
        """Return parameters with some numbers set and all others at their default.

        Parameters
        ----------
        values : mapping of str to float
            By ``name`` or ``name[i]``.

        Returns
        -------
        Strict
            The effect's parameters.

        Raises
        ------
        InputError
            For a value out of bounds.
        TypeError
            For a name that is no parameter.
        """
        table = self.parameters().model_dump()
        for name, value in values.items():
            key, index = parameter_of(self, name)
            if index is None:
                whole = isinstance(table[key], int) and not isinstance(table[key], bool)
                table[key] = round(value) if whole else float(value)
            else:
                table[key] = tuple(float(value) if i == index else old for i, old in enumerate(table[key]))
        return validate(self.parameters, table, f"effects.{self.id}")

    def _nulls(self) -> dict[str, float | None]:
        return {name: quantity.null for name, quantity in self.parameters.quantities()}


@dataclass(frozen=True)
class Active:
    """An effect with the parameters of a scene.

    Attributes
    ----------
    effect : Effect
    parameters : Strict
    """

    effect: Effect
    parameters: Strict


def apply_stage(stage: Stage, value: Any, active: tuple[Active, ...], context: Context) -> Any:
    """Apply the effects of one stage, in the scene's order; those at null are skipped.

    Parameters
    ----------
    stage : Stage
    value : object
        What an effect of this stage receives (:class:`Stage`).
    active : tuple of Active
    context : Context

    Returns
    -------
    object
        Of the type of ``value``.
    """
    for entry in active:
        if entry.effect.stage is stage and not entry.effect.is_null(entry.parameters):
            value = entry.effect.apply(value, entry.parameters, context)
    return value
