"""What inference may vary of an effect: parameters with a prior, measurements that show it, locations that data give.

Physics does not read any of this: an effect acts the same without it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, get_args

from evanesce.core.quantities import Quantity
from evanesce.rig import Scene

if TYPE_CHECKING:
    from evanesce.effects.protocol import Effect

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
time; of a moving finger; with displacements; repeated frames of a held state; frames with LEDs off or lens capped;
shots of the cards; scalar series."""

OBSERVABLES: tuple[str, ...] = get_args(Observable)

PRIOR_SHARE_OF_BOUNDS = 0.1
"""Plausible departure of an amplitude that names none, over the width of its bounds."""


@dataclass(frozen=True)
class Coordinate:
    """In which a fit moves a parameter: one of which what is measured is nearly a straight line.

    Attributes
    ----------
    of : callable
        ``of(value)``: coordinate of a value.
    value : callable
        ``value(coordinate)``.
    """

    of: Callable[[float], float]
    value: Callable[[float], float]


def _itself(value: float) -> float:
    return value


def _square(value: float) -> float:
    return value * value


def _saturated(half: float, value: float) -> float:
    return value / (1.0 + value / half)


def _unsaturated(half: float, coordinate: float) -> float:
    return coordinate / (1.0 - coordinate / half)


def _power_of_ten(logarithm: float) -> float:
    return 10.0**logarithm


def saturating(half: float) -> Coordinate:
    """Return the coordinate of what acts by x / (x + half): by nearly x at first, and by ever less.

    Parameters
    ----------
    half : float
        Where half of all that it can do is done.
    """
    return Coordinate(partial(_saturated, half), partial(_unsaturated, half))


ITSELF = Coordinate(_itself, _itself)
ROOT = Coordinate(math.sqrt, _square)
"""Of what acts by its root from nothing on, where it has no finite slope."""
SQUARE = Coordinate(_square, math.sqrt)
"""Of what acts by its square, so that it has no slope at nothing."""
LOG10 = Coordinate(math.log10, _power_of_ten)
"""Of what is known to a factor."""


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
        Values to try where there is no derivative to start from; empty where none are needed.
    coordinate : Coordinate
        In which a fit moves it.
    """

    name: str
    unit: str
    null: float
    deviation: float
    bounds: tuple[float, float]
    amplitude: bool
    start: tuple[float, ...] = ()
    coordinate: Coordinate = ITSELF

    @property
    def spread(self) -> float:
        """Plausible size of a departure in its coordinate."""
        return self.coordinate.of(self.null + self.deviation) - self.coordinate.of(self.null)

    def away(self, departure: float) -> float:
        """Return its value at a departure of so many plausible ones from null, within its bounds.

        Parameters
        ----------
        departure : float
        """
        low, high = (self.coordinate.of(bound) for bound in self.bounds)
        there = self.coordinate.of(self.null) + departure * self.spread
        return self.coordinate.value(min(max(there, low), high))


@dataclass(frozen=True, kw_only=True)
class Marks:
    """How an effect lists localised defects that data showed, beside those that it draws.

    Attributes
    ----------
    scale : str
        Amplitude that multiplies all listed amounts.
    x, y : str
        Parameters that list the locations [mm].
    amount : str
        Parameter that lists how much there is at each, of whatever the signal is proportional to.
    where : {"plate", "sensor"}
        Whether locations are on the plate, or on the sensor from its first pixel's outer corner.
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
    """How an effect that is one straight line on the plate takes its location from data.

    Attributes
    ----------
    amount : str
        Amplitude: how strong the line is.
    middle, direction, length : str
        Parameters: a pair [mm], an angle from +x towards +y [deg], end to end [mm].
    like : str
        Id of an effect whose listed defects scatter as the line does.
    per_mm : callable
        ``per_mm(amount)``: what a millimetre of line adds up to, in their unit.
    """

    amount: str
    middle: str
    direction: str
    length: str
    like: str
    per_mm: Callable[[float], float]


@dataclass(frozen=True, kw_only=True)
class Blot:
    """How an effect that is one soft spot on the plate takes location and size from data.

    Attributes
    ----------
    amount : str
        Amplitude: in the spot's middle.
    middle, radius : str
        Parameters: a pair [mm]; where it has fallen to exp(-1/2) [mm].
    like : str
        Id of an effect whose listed defects scatter as the spot does, in its amount times mm^2.
    """

    amount: str
    middle: str
    radius: str
    like: str


@dataclass(frozen=True, kw_only=True)
class Bands:
    """How an effect that modulates the light of the LEDs from row to row takes frequency and phase from data.

    Neither a mean of frames of unknown phase has any, nor a card that no LED lights.

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


@dataclass(frozen=True, kw_only=True)
class InferenceHints:
    """What inference may know of an effect beside its physics.

    Attributes
    ----------
    fitted : mapping of str to float, optional
        Parameters that a fit may vary -> plausible size of a departure from null, in the parameter's unit. A tuple's
        numbers are named ``name[i]``. By default every amplitude, a tenth of its bounds' width.
    needs : tuple of :data:`Observable`
        What a measurement must hold for the effect to show at all.
    scaling : str
        How its signature goes with voltage, force and time, in one line.
    start : mapping of str to float or tuple of float
        Values to try where there is no derivative at null: amplitudes that multiply, numbers that count.
    coordinates : mapping of str to Coordinate
        Of parameters that a fit does not move by themselves.
    marks : Marks, optional
        Of an effect that is a set of localised defects, which data may show.
    line : Line, optional
        Of an effect that is a line, whose location data may show.
    blot : Blot, optional
        Of an effect that is a soft spot on the plate.
    bands : Bands, optional
        Of an effect that modulates the LEDs' light from row to row, whose frequency data may show.
    """

    fitted: Mapping[str, float] | None = None
    needs: tuple[Observable, ...] = ("press",)
    scaling: str = ""
    start: Mapping[str, float | tuple[float, ...]] = field(default_factory=dict)
    coordinates: Mapping[str, Coordinate] = field(default_factory=dict)
    marks: Marks | None = None
    line: Line | None = None
    blot: Blot | None = None
    bands: Bands | None = None


def default_deviations(effect: Effect) -> dict[str, float]:
    """Return the departures that an effect without ``fitted`` has: a tenth of each amplitude's bounds' width.

    Parameters
    ----------
    effect : Effect

    Returns
    -------
    dict of str to float
        By amplitude, in its unit.
    """
    quantities = dict(effect.parameters.quantities())
    return {
        name: PRIOR_SHARE_OF_BOUNDS * (quantities[name].bounds[1] - quantities[name].bounds[0])
        for name in effect.amplitudes
    }


def candidates(effect: Effect) -> tuple[Candidate, ...]:
    """Return what a fit may vary of an effect, in the order of ``fitted``.

    Parameters
    ----------
    effect : Effect

    Returns
    -------
    tuple of Candidate

    Raises
    ------
    TypeError
        If ``fitted``, ``start`` or ``coordinates`` names no parameter, a departure is not a positive number within the
        bounds' width, a start lies out of bounds, or a coordinate is none there.
    """
    deviations = effect.fitted or {}
    for what, named in (("start", effect.start), ("coordinate", effect.coordinates)):
        if astray := set(named) - set(deviations):
            raise TypeError(f"effect {effect.id}: {what} of {sorted(astray)}, which is not fitted")
    return tuple(_candidate(effect, name, deviation) for name, deviation in deviations.items())


def parameter_of(effect: Effect, name: str) -> tuple[str, int | None]:
    """Return the parameter and the index within it that a candidate's name means.

    Parameters
    ----------
    effect : Effect
    name : str
        ``name`` or ``name[i]``.

    Returns
    -------
    key : str
    index : int or None
        None for a parameter that is one number.

    Raises
    ------
    TypeError
        For a name that is no parameter, or not one number.
    """
    found = re.fullmatch(r"(\w+?)(?:\[(\d+)\])?", name)
    key = found.group(1) if found else name
    default = getattr(effect.parameters(), key, None)
    if found is None or key not in dict(effect.parameters.quantities()) or default is None:
        raise TypeError(f"effect {effect.id}: no parameter {name}")
    index = None if found.group(2) is None else int(found.group(2))
    if isinstance(default, tuple) != (index is not None) or (index is not None and index >= len(default)):
        raise TypeError(f"effect {effect.id}: {name} is not one number")
    return key, index


def _candidate(effect: Effect, name: str, deviation: float) -> Candidate:
    key, index = parameter_of(effect, name)
    quantity: Quantity = dict(effect.parameters.quantities())[key]
    low, high = quantity.bounds
    if not (math.isfinite(deviation) and 0 < deviation <= high - low):
        raise TypeError(f"effect {effect.id}: departure {deviation} of {name} (bounds {low:g} to {high:g})")
    given = effect.start.get(name, ())
    start = tuple(given) if isinstance(given, tuple) else (float(given),)
    if any(not low <= value <= high for value in start):
        raise TypeError(f"effect {effect.id}: start {start} of {name} (bounds {low:g} to {high:g})")
    coordinate = effect.coordinates.get(name, ITSELF)
    try:
        grows = coordinate.of(low) < coordinate.of(high)
    except ValueError:
        grows = False
    if not grows:
        raise TypeError(f"effect {effect.id}: no coordinate of {name} that grows from {low:g} to {high:g}")
    default = getattr(effect.parameters(), key)
    amplitude = quantity.null is not None and key in effect.amplitudes
    null: Any = quantity.null if amplitude else default if index is None else default[index]
    return Candidate(
        name=name,
        unit=quantity.unit,
        null=float(null),
        deviation=float(deviation),
        bounds=quantity.bounds,
        amplitude=amplitude,
        start=tuple(float(value) for value in start),
        coordinate=coordinate,
    )
