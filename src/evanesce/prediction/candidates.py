"""The library's effects as candidates: which numbers of each a fit may vary, and how each is entered from nothing."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from evanesce.effects import Effect, active_effects, all_effects
from evanesce.prediction.parameters import STEP_SHARE, Parameter
from evanesce.rig import Scene

MAX_STARTS = 24


@dataclass(frozen=True)
class Candidate:
    """One effect away from what is believed of it.

    Attributes
    ----------
    effect : Effect
    parameters : tuple of Parameter
    starts : tuple of mapping
        Points to enter by where the effect has no derivative at null; empty where it has.
    missing : tuple of str
        Observables that it needs and that were not measured.
    penalty : float
        Evidence that the choice of places in the data costs [nats].
    unseen : str
        Why it was looked for and not found; empty where it is a candidate.
    """

    effect: Effect
    parameters: tuple[Parameter, ...]
    starts: tuple[Mapping[str, float], ...]
    missing: tuple[str, ...] = ()
    penalty: float = 0.0
    unseen: str = ""

    @property
    def id(self) -> str:
        """Of the effect."""
        return self.effect.id

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return tuple(p.name for p in self.parameters)


def candidates_of(scene: Scene, available: Collection[str], exclude: Collection[str] = ()) -> tuple[Candidate, ...]:
    """Return a candidate for every effect of the library; one more file there is one more candidate.

    Parameters
    ----------
    scene : Scene
        Believed; effects that it has are candidates for being stronger or weaker.
    available : collection of str
        Observables that were measured.
    exclude : collection of str
        Left out.
    """
    believed = {entry.effect.id: entry.parameters for entry in active_effects(scene)}
    found = []
    for name, effect in all_effects().items():
        if name in exclude:
            continue
        own = believed.get(name)
        values = {} if own is None else _numbers(own.model_dump())
        parameters, starts = [], {}
        for entry in effect.candidate_parameters():
            entry, of = replace(entry, null=float(values.get(entry.name, entry.null))), entry.coordinate.of
            full = f"{name}:{entry.name}"
            parameters.append(
                Parameter(
                    name=full,
                    unit=entry.unit,
                    coordinate=entry.coordinate,
                    null=of(entry.null),
                    deviation=entry.spread,
                    bounds=(of(entry.bounds[0]), of(entry.bounds[1])),
                    step=STEP_SHARE * entry.spread,
                )
            )
            if entry.start and own is None:
                starts[full] = tuple(of(value) for value in entry.start)
        points = [dict(zip(starts, values, strict=True)) for values in itertools.product(*starts.values())]
        missing = tuple(n for n in effect.needs if n not in available)
        found.append(Candidate(effect, tuple(parameters), tuple(points[:MAX_STARTS]) if starts else (), missing))
    return tuple(found)


def _numbers(table: Mapping[str, object]) -> dict[str, float]:
    """Return the numbers of a table, those of a tuple by ``name[i]``."""
    found: dict[str, float] = {}
    for name, value in table.items():
        if isinstance(value, tuple | list):
            found |= {f"{name}[{i}]": float(v) for i, v in enumerate(value)}
        elif isinstance(value, int | float):
            found[name] = float(value)
    return found
