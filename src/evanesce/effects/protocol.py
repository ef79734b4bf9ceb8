"""What an effect is: a stage, strict parameters with a null, and a pure function.

A file of this folder that holds an ``EFFECT`` is an effect; nothing else needs to change to add one. Its parameters
stand in a scene's table ``[effects.<id>]``. Stages are the places of the chain that :mod:`evanesce.chain.simulate`
spells out in physical order; effects of one stage act in the order in which the scene lists them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np

from evanesce.core import rng
from evanesce.core.quantities import Quantity, Strict
from evanesce.rig import Scene
from evanesce.rig.load import validate

ANY_SCENE = Path("scene")
"""Named in errors where a scene did not come from a file."""


class Stage(StrEnum):
    """A place in the chain, and the value that an effect receives there and returns."""

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


Observable = Literal[
    "press",
    "voltage",
    "force",
    "time",
    "motion",
    "displacement",
    "replicates",
    "led_off",
    "lens_cap",
    "checkerboard",
    "square",
    "series",
]
"""What a measurement may hold: frames of presses; at two or more voltages; at two or more forces; of a held state over
time; of a finger on its way; with displacements; repeated frames of a held state; frames with LEDs off or lens capped;
shots of the cards; scalar series."""

OBSERVABLES: tuple[str, ...] = get_args(Observable)

PRIOR_SHARE_OF_BOUNDS = 0.1
"""Plausible departure of an amplitude that names none, over the width of its bounds."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One parameter that a fit may vary.

    Attributes
    ----------
    name : str
        Of the parameter; one number of a tuple parameter is named ``name[i]``.
    unit : str
    null : float
        Where a fit starts: an amplitude's null, another parameter's default.
    deviation : float
        Plausible size of a departure from there: standard deviation of the prior, in ``unit``.
    bounds : tuple of float
    amplitude : bool
        Whether the effect grows with it from nothing.
    start : tuple of float
        Values to try where there is no derivative to start from; empty: none are needed.
    """

    name: str
    unit: str
    null: float
    deviation: float
    bounds: tuple[float, float]
    amplitude: bool
    start: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Marks:
    """How an effect lists places that data showed, beside those that it draws.

    Attributes
    ----------
    scale : str
        Amplitude that multiplies all listed amounts.
    x, y : str
        Parameters that list the places [mm].
    amount : str
        Parameter that lists how much there is at each, of whatever the signal is proportional to.
    where : {"plate", "sensor"}
        Whether places are on the plate, or on the sensor from its first pixel's outer corner.
    unit : callable
        ``unit(scene, area_mm2)``: an amount that changes what a contact shows by about a per cent, if there is one in
        each cell of that area.
    fixed : mapping of str to float
        Other parameters that a list goes with.
    """

    scale: str
    x: str
    y: str
    amount: str
    where: Literal["plate", "sensor"]
    unit: Callable[[Scene, float], float]
    fixed: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Line:
    """How an effect that is one straight line on the plate takes its place from data.

    Attributes
    ----------
    amount : str
        Amplitude: how strong the line is.
    middle, direction, length : str
        Parameters: a pair [mm], an angle from +x towards +y [deg], end to end [mm].
    like : str
        Id of an effect whose marks scatter as the line does.
    per_mm : callable
        ``per_mm(amount)``: what a millimetre of line adds up to, in the unit of those marks.
    """

    amount: str
    middle: str
    direction: str
    length: str
    like: str
    per_mm: Callable[[float], float]


@dataclass(frozen=True, kw_only=True)
class Blot:
    """How an effect that is one soft spot on the plate takes place and size from data.

    Attributes
    ----------
    amount : str
        Amplitude: in the spot's middle.
    middle, radius : str
        Parameters: a pair [mm]; where it has fallen to exp(-1/2) [mm].
    like : str
        Id of an effect whose marks scatter as the spot does, in its amount times mm^2.
    """

    amount: str
    middle: str
    radius: str
    like: str


@dataclass(frozen=True, kw_only=True)
class Bands:
    """How an effect that modulates the light of the LEDs from row to row takes frequency and phase from data.

    Frames whose phase nobody notes have none in their mean, and a card that no LED lights has none.

    Attributes
    ----------
    amount : str
        Amplitude: of the light, over its mean.
    frequency, phase : str
        Parameters: [Hz]; of the crest at time 0 [deg].
    readout : str
        Parameter: from the first row's exposure to the last row's [ms].
    share : callable
        ``share(frequency_hz, exposure_s)``: what an exposure leaves of the amplitude, with its sign.
    """

    amount: str
    frequency: str
    phase: str
    readout: str
    share: Callable[[float, float], float]


def listed(lists: Mapping[str, tuple[float, ...]]) -> None:
    """Refuse lists of different lengths.

    Raises
    ------
    ValueError
        Naming them.
    """
    if len({len(values) for values in lists.values()}) > 1:
        lengths = ", ".join(f"{name} {len(values)}" for name, values in lists.items())
        raise ValueError(f"lists of one length each: {lengths}")


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A departure from the ideal rig.

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
    fitted : mapping of str to float, optional
        Parameters that a fit may vary -> plausible size of a departure from null, in the parameter's unit. A tuple's
        numbers are named ``name[i]``. By default every amplitude, a tenth of its bounds' width.
    needs : tuple of :data:`Observable`
        What a measurement must hold for the effect to show at all.
    scaling : str
        How its signature goes with voltage, force and time, in one line.
    start : mapping of str to float or tuple of float
        Values to try where there is no derivative at null: amplitudes that multiply, numbers that count.
    marks : Marks, optional
        Of an effect with places of its own, which data may show.
    line : Line, optional
        Of an effect that is a line, whose place data may show.
    blot : Blot, optional
        Of an effect that is a soft spot on the plate.
    bands : Bands, optional
        Of an effect that modulates the LEDs' light from row to row, whose frequency data may show.
    """

    id: str
    stage: Stage
    parameters: type[Strict]
    amplitudes: tuple[str, ...]
    apply: Callable[[Any, Any, Context], Any]
    null_when: Literal["any", "all"] = "any"
    fitted: Mapping[str, float] | None = None
    needs: tuple[Observable, ...] = ("press",)
    scaling: str = ""
    start: Mapping[str, float | tuple[float, ...]] = field(default_factory=dict)
    marks: Marks | None = None
    line: Line | None = None
    blot: Blot | None = None
    bands: Bands | None = None

    def __post_init__(self) -> None:
        nulls = self._nulls()
        for name in self.amplitudes:
            if nulls.get(name) is None:
                raise TypeError(f"effect {self.id}: amplitude {name} declares no null")
        if not self.amplitudes:
            raise TypeError(f"effect {self.id}: no amplitude, so it could not be switched off")
        if unknown := set(self.needs) - set(OBSERVABLES):
            raise TypeError(f"effect {self.id}: needs {sorted(unknown)}; known: {', '.join(OBSERVABLES)}")
        declared = self.fitted if self.fitted is not None else self._default_deviations()
        object.__setattr__(self, "fitted", MappingProxyType(dict(declared)))
        object.__setattr__(self, "start", MappingProxyType(dict(self.start)))
        self.candidate_parameters()

    def is_null(self, parameters: Strict) -> bool:
        """Tell whether the effect is absent with these parameters."""
        nulls = self._nulls()
        at_null = [getattr(parameters, name) == nulls[name] for name in self.amplitudes]
        return any(at_null) if self.null_when == "any" else all(at_null)

    def candidate_parameters(self) -> tuple[Candidate, ...]:
        """Return what a fit may vary, in the order of ``fitted``.

        Raises
        ------
        TypeError
            If ``fitted`` or ``start`` names no parameter, a departure is not a positive number within the bounds'
            width, or a start lies out of bounds.
        """
        deviations = self.fitted or {}
        if astray := set(self.start) - set(deviations):
            raise TypeError(f"effect {self.id}: start of {sorted(astray)}, which is not fitted")
        return tuple(self._candidate(name, deviation) for name, deviation in deviations.items())

    def with_values(self, values: Mapping[str, float]) -> Strict:
        """Return parameters with the named numbers set (``name`` or ``name[i]``) and all others at their default.

        Raises
        ------
        InputError
            For a value out of bounds.
        TypeError
            For a name that is no parameter.
        """
        table = self.parameters().model_dump()
        for name, value in values.items():
            key, index = self._split(name)
            if index is None:
                whole = isinstance(table[key], int) and not isinstance(table[key], bool)
                table[key] = round(value) if whole else float(value)
            else:
                table[key] = tuple(float(value) if i == index else old for i, old in enumerate(table[key]))
        return validate(self.parameters, table, f"effects.{self.id}")

    def _nulls(self) -> dict[str, float | None]:
        return {name: quantity.null for name, quantity in self.parameters.quantities()}

    def _default_deviations(self) -> dict[str, float]:
        quantities = dict(self.parameters.quantities())
        return {
            name: PRIOR_SHARE_OF_BOUNDS * (quantities[name].bounds[1] - quantities[name].bounds[0])
            for name in self.amplitudes
        }

    def _split(self, name: str) -> tuple[str, int | None]:
        """Return the parameter and the index within it that a candidate's name means."""
        found = re.fullmatch(r"(\w+?)(?:\[(\d+)\])?", name)
        key = found.group(1) if found else name
        default = getattr(self.parameters(), key, None)
        if found is None or key not in self._nulls() or default is None:
            raise TypeError(f"effect {self.id}: no parameter {name}")
        index = None if found.group(2) is None else int(found.group(2))
        if isinstance(default, tuple) != (index is not None) or (index is not None and index >= len(default)):
            raise TypeError(f"effect {self.id}: {name} is not one number")
        return key, index

    def _candidate(self, name: str, deviation: float) -> Candidate:
        key, index = self._split(name)
        quantity: Quantity = dict(self.parameters.quantities())[key]
        low, high = quantity.bounds
        if not (math.isfinite(deviation) and 0 < deviation <= high - low):
            raise TypeError(f"effect {self.id}: departure {deviation} of {name} (bounds {low:g} to {high:g})")
        given = self.start.get(name, ())
        start = tuple(given) if isinstance(given, tuple) else (float(given),)
        if any(not low <= value <= high for value in start):
            raise TypeError(f"effect {self.id}: start {start} of {name} (bounds {low:g} to {high:g})")
        default = getattr(self.parameters(), key)
        amplitude = quantity.null is not None and key in self.amplitudes
        null: Any = quantity.null if amplitude else default if index is None else default[index]
        return Candidate(
            name=name,
            unit=quantity.unit,
            null=float(null),
            deviation=float(deviation),
            bounds=quantity.bounds,
            amplitude=amplitude,
            start=tuple(float(value) for value in start),
        )


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
