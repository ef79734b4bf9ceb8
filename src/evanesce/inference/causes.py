"""Causes that the joint fit considers: the effects of the library with their parameters, and how each is entered."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.effects import Context, Stage, active_effects, apply_stage
from evanesce.inference.model import Model
from evanesce.prediction.candidates import Candidate, candidates_of
from evanesce.prediction.observe import Observation
from evanesce.prediction.parameters import Parameter
from evanesce.prediction.point import scene_with
from evanesce.rig import Scene

Array = NDArray[Any]


@dataclass(frozen=True)
class Cause:
    """An effect of the library as a candidate.

    Attributes
    ----------
    candidate : Candidate
    costly : bool
        Whether it changes the paths of light in the plate, of which each evaluation takes seconds: it then enters
        linearly, along the change that its prior deviation makes.
    """

    candidate: Candidate
    costly: bool

    @property
    def id(self) -> str:
        """Of the effect."""
        return self.candidate.id

    @property
    def placed(self) -> bool:
        """Whether only data know its places (or frequency), so that it has no form before they are found."""
        effect = self.candidate.effect
        return effect.marks is not None or effect.line is not None or effect.bands is not None

    @property
    def local(self) -> bool:
        """Whether defects are sought for it."""
        return self.placed or self.candidate.effect.blot is not None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Of the effect."""
        return self.candidate.parameters

    @property
    def one_sided(self) -> bool:
        """Whether its amplitudes (or all parameters, where it has none) can only grow, or only fall, from nothing."""
        grown = [p for p in self.parameters if p.name in self.amplitudes] or list(self.parameters)
        return all(p.null in p.bounds for p in grown)

    @property
    def amplitudes(self) -> frozenset[str]:
        """Names of the parameters that grow from nothing."""
        return frozenset(f"{self.id}:{name}" for name in self.candidate.effect.amplitudes)


@dataclass(frozen=True)
class Entry:
    """A way into a cause: what the data change by per unit of one or more coordinates.

    Attributes
    ----------
    cause : Cause
    rows : ndarray (k, bins)
        Whitened.
    deviation, low, high : ndarray (k,)
        Prior standard deviation and bounds of the coordinates, less their null.
    start : mapping of str to float
        Empty where coordinates are the parameters themselves; otherwise the one coordinate is a share of the way from
        nothing to this point.
    """

    cause: Cause
    rows: Array
    deviation: Array
    low: Array
    high: Array
    start: Mapping[str, float] = field(default_factory=dict)

    def point(self, coordinates: Array) -> dict[str, float]:
        """Return the cause's parameter values at some coordinates (k,)."""
        if not self.start:
            return {p.name: p.null + float(c) for p, c in zip(self.cause.parameters, coordinates, strict=True)}
        null = {p.name: p.null for p in self.cause.parameters}
        share = float(coordinates[0])
        return {
            name: null[name] + share * (value - null[name]) if name in self.cause.amplitudes else value
            for name, value in self.start.items()
        }


def causes_of(observation: Observation, exclude: Collection[str] = ()) -> tuple[tuple[Cause, ...], dict[str, str]]:
    """Return the causes that these data can be asked for, and why the others are left out.

    Parameters
    ----------
    observation : Observation
    exclude : collection of str
        Ids of effects that are not considered.

    Returns
    -------
    causes : tuple of Cause
    left_out : dict of str to str
    """
    found, left_out = [], {}
    for candidate in candidates_of(observation.scene, observation.available, exclude):
        if candidate.missing:
            left_out[candidate.id] = "needs " + ", ".join(candidate.missing)
        else:
            found.append(Cause(candidate, changes_plate_light(observation.scene, candidate)))
    return tuple(found), left_out


def changes_plate_light(scene: Scene, candidate: Candidate) -> bool:
    """Return whether a candidate changes what sums over the plate's paths depend on: they take seconds to make anew.

    They serve all absorption coefficients and shares of LEDs behind an air film, and the LEDs' powers.
    """
    if candidate.effect.stage is not Stage.RIG:
        return False
    point = dict(candidate.starts[0]) if candidate.starts else {p.name: p.null + p.step for p in candidate.parameters}
    changed = scene_with(scene, point)
    try:
        rig = apply_stage(Stage.RIG, changed, active_effects(changed), Context(changed, 0))
    except InputError:
        return False

    def guide(of: Scene) -> tuple[object, ...]:
        plate = of.plate.model_copy(update={"absorption_coefficient_per_mm": 0.0})
        return repr(plate), of.leds.emitting_width_mm, of.leds.emitting_height_mm, of.finger.refractive_index

    return guide(rig) != guide(scene)


def entries_of(
    model: Model,
    point: Mapping[str, float],
    base: Array,
    cause: Cause,
    only: Sequence[Mapping[str, float]] | None = None,
) -> list[Entry]:
    """Return the ways into a cause at a point.

    Where the amplitude's null silences all else there is no derivative: the change from nothing to each start of the
    effect is taken instead, as one coordinate each.

    Parameters
    ----------
    model : Model
    point : mapping
    base : ndarray (bins,)
        Whitened prediction there.
    cause : Cause
    only : sequence of mapping, optional
        The only starts to be evaluated.

    Returns
    -------
    list of Entry
        Empty if the rig cannot have the cause, or no plausible amount of it shows.
    """
    starts = tuple(cause.candidate.starts if only is None else only)
    if not starts and cause.costly:
        starts = tuple({p.name: p.null + side * p.deviation} for p in cause.parameters for side in [_side(p)])
    found = []
    if not starts:
        made = model.derivatives([(point, p) for p in cause.parameters])
        rows = [row for row in made if not isinstance(row, InputError)]
        if len(rows) < len(made):
            return []
        deviation, low, high = (np.array(x) for x in zip(*map(_prior, cause.parameters), strict=True))
        found = [Entry(cause, np.array(rows), deviation, low, high)]
    found += [entry for start in starts for entry in by_departure(model, point, base, cause, start)]
    return [entry for entry in found if _shows(entry)]


def _side(parameter: Parameter) -> float:
    return 1.0 if parameter.null + parameter.deviation <= parameter.bounds[1] else -1.0


def _prior(parameter: Parameter) -> tuple[float, float, float]:
    low, high = parameter.bounds
    return parameter.deviation, low - parameter.null, high - parameter.null


def by_departure(
    model: Model, point: Mapping[str, float], base: Array, cause: Cause, start: Mapping[str, float]
) -> list[Entry]:
    """Return the way into a cause along its change from nothing to a start; none if the rig cannot have it.

    Parameters
    ----------
    model : Model
    point : mapping
    base : ndarray (bins,)
        Whitened prediction there.
    cause : Cause
    start : mapping
        Of its parameters, and of nuisances that gave way to it.
    """
    try:
        row = model.vector({**point, **start}) - base
    except InputError:
        return []
    return [departure(cause, row, start)]


def departure(cause: Cause, row: Array, start: Mapping[str, float]) -> Entry:
    """Return the way into a cause along its change from nothing to a point.

    Parameters
    ----------
    cause : Cause
    row : ndarray (bins,)
        Whitened change.
    start : mapping of str to float
        The point.
    """
    # The coordinate is a share of the start: amplitudes scale alike, so that bounds follow from the first of them.
    grown = [p for p in cause.parameters if p.name in start and p.name in cause.amplitudes]
    shares = [sorted((b - p.null) / (start[p.name] - p.null) for b in p.bounds) for p in grown]
    low, high = max(s[0] for s in shares), min(s[1] for s in shares)
    deviation = max(p.deviation / abs(start[p.name] - p.null) for p in grown)
    one = [np.array([x]) for x in (deviation, low, high)]
    return Entry(cause, row[None].astype(np.float32), one[0], one[1], one[2], dict(start))


def _shows(entry: Entry) -> bool:
    """Return whether any plausible amount moves the whitened data by more than a tenth of a standard deviation."""
    sizes = np.sqrt(np.einsum("kd,kd->k", entry.rows, entry.rows, dtype=float)) * entry.deviation
    return bool(sizes.size and sizes.max() > 0.1)
