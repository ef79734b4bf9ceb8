"""How a rig that is built departs from the one that was drawn: effects at their stated uncertainty, and the cards'.

Each effect states a plausible departure of each of its parameters; a drawn rig has them all at once. Draws are
quasi-random and the same for every design, so that two designs differ by what they are, not by luck.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

from evanesce.core import rng
from evanesce.core.errors import InputError
from evanesce.effects import Candidate, Context, Effect, Stage, active_effects, all_effects, apply_stage
from evanesce.effects.inference_hints import Observable
from evanesce.evaluation.calibrated_rig import SQUARE_EDGE_PX, CardErrors
from evanesce.measurement.uncertainty.components import CARD_HEIGHT_MM, PRINT_TOLERANCE
from evanesce.render.fast.rig_fields import unit_digest
from evanesce.rig import Scene

Array = NDArray[np.float64]

HELD: frozenset[Observable] = frozenset({"press", "force", "voltage"})
"""What acts on one frame of a held press; the rest needs time, sliding or a card."""

CARDS = ("checkerboard print", "square print", "card height", "square edge")
MAX_BYTES = 1_000_000


@dataclass(frozen=True)
class Departure:
    """One number of an effect, uncertain about its null.

    Attributes
    ----------
    effect : str
    candidate : Candidate
        With null, standard deviation and bounds.
    """

    effect: str
    candidate: Candidate

    @property
    def name(self) -> str:
        """``effect.parameter``."""
        return f"{self.effect}.{self.candidate.name}"

    def value(self, share: float) -> float:
        """Return the value at a share 0 to 1 of its distribution: normal about the null, cut at the bounds.

        Where the null lies on a bound this is half a normal distribution.
        """
        c = self.candidate
        low, high = (float(ndtr((bound - c.null) / c.deviation)) for bound in c.bounds)
        return float(np.clip(c.null + c.deviation * ndtri(low + share * (high - low)), *c.bounds))


@dataclass(frozen=True)
class Uncertainty:
    """What may depart in a scene's rig, and what was left out.

    Attributes
    ----------
    departures : tuple of Departure
    new_light : tuple of Departure
        Those that change where light goes in the empty plate: a new set of fields for every draw, seconds each. A
        search leaves them out; tolerances have them.
    left_out : mapping
        Effect -> why it does not act.
    held : frozenset of str
        Effects that are drawn and then left out: the other draws stay as they are.
    """

    departures: tuple[Departure, ...]
    new_light: tuple[Departure, ...]
    left_out: Mapping[str, str]
    held: frozenset[str] = frozenset()

    @property
    def names(self) -> tuple[str, ...]:
        """Of the dimensions of a draw: departures, then cards."""
        return (*(d.name for d in self.departures), *CARDS)


@dataclass(frozen=True)
class Draw:
    """One rig as it was built, and its calibration.

    Attributes
    ----------
    effects : mapping
        Effect -> parameter -> value, as in a scene.
    cards : CardErrors
        Without the corners' scatter, which depends on the camera.
    square_edge_px : float
        Way of the square card's edge [px of a whole camera].
    """

    effects: Mapping[str, Mapping[str, float]]
    cards: CardErrors
    square_edge_px: float


def uncertainty_of(scene: Scene, sizes: Mapping[str, Mapping[str, float]] | None = None) -> Uncertainty:
    """Return what may depart in a scene's rig.

    Parameters
    ----------
    scene : Scene
        Effects that it has already stay as they are and do not depart.
    sizes : mapping, optional
        Effect -> parameter -> standard deviation; only these act then. By default every effect at its own.
    """
    found: list[Departure] = []
    heavy: list[Departure] = []
    left_out: dict[str, str] = {}
    for name, effect in all_effects().items():
        if sizes is not None and name not in sizes:
            left_out[name] = "not among the stated uncertainties"
        elif name in scene.effects:
            left_out[name] = "known: the scene has it"
        elif not set(effect.needs) <= HELD:
            cards = {"square", "checkerboard"} & set(effect.needs)
            left_out[name] = "drawn with the cards" if cards else "does not show in one frame of a held press"
        else:
            wanted = effect.candidate_parameters() if sizes is None else _stated(effect, sizes[name])
            how = _acts(scene, effect, wanted)
            if how == "light":
                heavy += [Departure(name, c) for c in wanted]
            elif how:
                left_out[name] = how
            else:
                found += [Departure(name, c) for c in wanted]
    return Uncertainty(tuple(found), tuple(heavy), left_out)


def _stated(effect: Effect, sizes: Mapping[str, float]) -> tuple[Candidate, ...]:
    """Return the candidates of an effect with deviations of the user's own."""
    known = {c.name: c for c in effect.candidate_parameters()}
    found = []
    for name, size in sizes.items():
        key = f"{effect.id}.{name}"
        if name not in known:
            raise InputError("unknown parameter", key=key, allowed=", ".join(known))
        c = known[name]
        width = c.bounds[1] - c.bounds[0]
        if isinstance(size, bool) or not isinstance(size, int | float) or not 0 < size <= width:
            raise InputError(f"{size!r}", key=key, allowed=f"a standard deviation above 0 to {width:g} {c.unit}")
        found.append(Candidate(**{**vars(c), "deviation": float(size)}))
    _acts_at_all(effect, found)
    return tuple(found)


def _acts_at_all(effect: Effect, stated: list[Candidate]) -> None:
    """Refuse figures of an effect that multiply with one which is not named and is nothing by default."""
    named, start = {c.name for c in stated if c.amplitude}, effect.parameters()
    if not named or effect.null_when != "any":
        return
    nulls = {name: quantity.null for name, quantity in effect.parameters.quantities()}
    for name in effect.amplitudes:
        if name not in named and getattr(start, name) == nulls[name]:
            raise InputError(f"does nothing without {name}", key=effect.id, allowed=f"{name} stated, too")


def _acts(scene: Scene, effect: Effect, wanted: tuple[Candidate, ...]) -> str:
    """Return "" if an effect can be drawn for each rig, "light" if it needs new fields, else why it does not act."""
    values = {c.name: Departure(effect.id, c).value(0.84) for c in wanted}
    try:
        tried = scene.model_copy(update={"effects": {effect.id: effect.with_values(values).model_dump()}})
        if effect.stage is not Stage.RIG:
            return ""
        real = apply_stage(Stage.RIG, tried, active_effects(tried), Context(tried, 0))
    except InputError as error:
        return error.what
    return "light" if unit_digest(real) != unit_digest(scene) else ""


def shares(uncertainty: Uncertainty, count: int, seed: int) -> Array:
    """Return quasi-random points (count, dimensions) from 0 to 1, scrambled by the seed; each dimension is even alone.

    References
    ----------
    A. B. Owen, "Scrambling Sobol' and Niederreiter-Xing points", Journal of Complexity 14 (1998) 466.
    """
    sample = qmc.Sobol(len(uncertainty.names), scramble=True, rng=rng.generator(seed, "departures"))
    power = max(0, int(np.ceil(np.log2(count))))
    return np.asarray(np.clip(sample.random_base2(power)[:count], 1e-9, 1 - 1e-9))


def draw(uncertainty: Uncertainty, share: Array) -> Draw:
    """Return the rig at one point (dimensions,) of :func:`shares`."""
    drawn = zip(uncertainty.departures, share, strict=False)
    effects = with_departures({d: d.value(float(s)) for d, s in drawn if d.effect not in uncertainty.held})
    board, square, height, edge = (float(s) for s in share[-len(CARDS) :])
    cards = CardErrors(
        board_scale=1.0 + PRINT_TOLERANCE * (2 * board - 1),
        square_scale=1.0 + PRINT_TOLERANCE * (2 * square - 1),
        height_mm=CARD_HEIGHT_MM * height,
    )
    return Draw(effects, cards, SQUARE_EDGE_PX * (2 * edge - 1))


def with_departures(values: Mapping[Departure, float]) -> dict[str, dict[str, Any]]:
    """Return the effects' tables of a scene for values of some departures."""
    by_effect: dict[str, dict[str, float]] = {}
    for departure, value in values.items():
        by_effect.setdefault(departure.effect, {})[departure.candidate.name] = value
    known = all_effects()
    tables = {name: known[name].with_values(found).model_dump(mode="json") for name, found in by_effect.items()}
    return {name: table for name, table in tables.items() if not known[name].is_null(_parameters(name, table))}


def _parameters(name: str, table: Mapping[str, Any]) -> Any:
    effect = all_effects()[name]
    return effect.parameters.model_validate(
        {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}
    )


def read_sizes(path: Path) -> dict[str, dict[str, float]]:
    """Read standard deviations of effects' parameters: TOML tables named like the effects.

    Raises
    ------
    InputError
        If the file is not readable as that, or names an unknown effect; parameters are checked when they are used.
    """
    if not path.is_file():
        raise InputError("no such file", file=path, key="--uncertainty", allowed="a TOML file")
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_BYTES} bytes")
    try:
        data: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid TOML: {error}", file=path) from None
    for name, table in data.items():
        effect = all_effects().get(name)
        if effect is None:
            raise InputError("unknown effect", file=path, key=name, allowed=", ".join(all_effects()))
        if not isinstance(table, dict):
            raise InputError("is not a table", file=path, key=name, allowed="parameter = standard deviation")
        _stated(effect, table)
    return data


def real_scene(scene: Scene, drawn: Draw) -> Scene:
    """Return a scene with a draw's effects beside its own."""
    return scene.model_copy(update={"effects": {**scene.effects, **drawn.effects}})
