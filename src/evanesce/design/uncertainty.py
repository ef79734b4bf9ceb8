"""Draw rigs as built: parameters of effects within their stated uncertainty, and errors of the calibration's cards.

Each effect states a standard deviation of each of its parameters; a drawn rig has them all at once. Draws are
quasi-random and the same for every design (common random numbers).
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

from evanesce.contact.solve import contact_state
from evanesce.core import rng
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState
from evanesce.effects import Candidate, Context, Effect, Stage, active_effects, all_effects, apply_stage
from evanesce.effects.inference_hints import Observable
from evanesce.evaluation.calibrated_rig import SQUARE_EDGE_PX, CardErrors
from evanesce.measurement.uncertainty.components import CARD_HEIGHT_MM, PRINT_TOLERANCE
from evanesce.optics.seen import seen_at
from evanesce.render.fast.rig_fields import unit_digest
from evanesce.rig import Scene
from evanesce.rig.finger import HertzLaw

Array = NDArray[np.float64]

STATIC: frozenset[Observable] = frozenset({"press", "force", "voltage"})
"""Observables in one frame of a held press; the rest needs time, sliding or a printed card."""

CARDS = ("checkerboard print", "square print", "card height", "square edge")
MAX_BYTES = 1_000_000
BISECTIONS = 12
"""Of a range, to a four-thousandth of it."""


@dataclass(frozen=True)
class UncertainParameter:
    """One parameter of an effect, uncertain about its null.

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

    def value(self, probability: float) -> float:
        """Return the quantile at a probability: of a normal distribution about the null, truncated at the bounds.

        In the parameter's coordinate; where the null lies on a bound this is half a normal distribution.
        """
        c = self.candidate
        null, *bounds = (c.coordinate.of(value) for value in (c.null, *c.bounds))
        low, high = (float(ndtr((bound - null) / c.spread)) for bound in bounds)
        return c.away(float(ndtri(low + probability * (high - low))))


@dataclass(frozen=True)
class Uncertainty:
    """Uncertain parameters of a scene's rig, and the effects that were left out.

    Attributes
    ----------
    parameters : tuple of UncertainParameter
    new_fields : tuple of UncertainParameter
        Those that change the light in the empty plate: a new set of fields for every draw, seconds each. A search
        leaves them out; tolerances have them.
    left_out : mapping
        Effect -> why it does not act.
    excluded : frozenset of str
        Effects that are drawn and then left out: the other draws stay as they are.
    """

    parameters: tuple[UncertainParameter, ...]
    new_fields: tuple[UncertainParameter, ...]
    left_out: Mapping[str, str]
    excluded: frozenset[str] = frozenset()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the dimensions of a draw: parameters, then cards."""
        return (*(d.name for d in self.parameters), *CARDS)


@dataclass(frozen=True)
class Draw:
    """One rig as built, and the errors of its calibration.

    Attributes
    ----------
    effects : mapping
        Effect -> parameter -> value, as in a scene.
    cards : CardErrors
        Without the corners' scatter, which depends on the camera.
    square_edge_px : float
        Displacement of the square's edge in the frame [px of the camera at full resolution].
    """

    effects: Mapping[str, Mapping[str, float]]
    cards: CardErrors
    square_edge_px: float


def uncertainty_of(scene: Scene, standard_deviations: Mapping[str, Mapping[str, float]] | None = None) -> Uncertainty:
    """Return the uncertain parameters of a scene's rig.

    Parameters
    ----------
    scene : Scene
        Effects that it has already stay as they are.
    standard_deviations : mapping, optional
        Effect -> parameter -> standard deviation; only these act then. By default every effect at its own.
    """
    found: list[UncertainParameter] = []
    heavy: list[UncertainParameter] = []
    left_out: dict[str, str] = {}
    for name, effect in all_effects().items():
        if standard_deviations is not None and name not in standard_deviations:
            left_out[name] = "not among the stated uncertainties"
        elif name in scene.effects:
            left_out[name] = "known: the scene has it"
        elif not set(effect.needs) <= STATIC:
            cards = {"square", "checkerboard"} & set(effect.needs)
            left_out[name] = "drawn with the cards" if cards else "does not show in one frame of a held press"
        else:
            wanted = (
                effect.candidate_parameters()
                if standard_deviations is None
                else _stated(effect, standard_deviations[name])
            )
            wanted = tuple(_within_scene(scene, effect, wanted, c) for c in wanted)
            how = _acts(scene, effect, wanted)
            if how == "light":
                heavy += [UncertainParameter(name, c) for c in wanted]
            elif how:
                left_out[name] = how
            else:
                found += [UncertainParameter(name, c) for c in wanted]
    return Uncertainty(tuple(found), tuple(heavy), left_out)


def _stated(effect: Effect, standard_deviations: Mapping[str, float]) -> tuple[Candidate, ...]:
    """Return the parameters of an effect with the user's standard deviations."""
    known = {c.name: c for c in effect.candidate_parameters()}
    found = []
    for name, size in standard_deviations.items():
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
    """Refuse parameters of an effect that multiply one which is not named and null by default."""
    named, start = {c.name for c in stated if c.amplitude}, effect.parameters()
    if not named or effect.null_when != "any":
        return
    nulls = {name: quantity.null for name, quantity in effect.parameters.quantities()}
    for name in effect.amplitudes:
        if name not in named and getattr(start, name) == nulls[name]:
            raise InputError(f"does nothing without {name}", key=effect.id, allowed=f"{name} stated, too")


def _acts(scene: Scene, effect: Effect, wanted: tuple[Candidate, ...]) -> str:
    """Return "" if an effect can be drawn for each rig, "light" if it needs new fields, else why it does not act."""
    values = {c.name: UncertainParameter(effect.id, c).value(0.84) for c in wanted}
    try:
        tried = scene.model_copy(update={"effects": {effect.id: effect.with_values(values).model_dump()}})
        if effect.stage is Stage.CONTACT:
            apply_stage(Stage.CONTACT, _touching(scene), active_effects(tried), Context(tried, 0))
        if effect.stage is not Stage.RIG:
            return ""
        real = apply_stage(Stage.RIG, tried, active_effects(tried), Context(tried, 0))
    except InputError as error:
        return error.what
    return "light" if unit_digest(seen_at(real)) != unit_digest(seen_at(scene)) else ""


def _touching(scene: Scene) -> ContactState:
    """Return a contact on which effects show whether they know the scene's finger: that of its smooth twin, Hertz's."""
    smooth = {"ridges": None, "fingerprint": None, "height_map": None}
    finger = scene.finger.model_copy(update=smooth)
    twin = scene.model_copy(update={"finger": finger, "contact": HertzLaw(law="hertz"), "slide": None, "effects": {}})
    return contact_state(twin, 1.0)


def _within_scene(scene: Scene, effect: Effect, wanted: tuple[Candidate, ...], one: Candidate) -> Candidate:
    """Return a candidate with its bounds drawn in to what the scene has, as to the number of its last LED."""
    if effect.stage is not Stage.RIG:
        return one

    others = {c.name: UncertainParameter(effect.id, c).value(0.84) if c.amplitude else c.null for c in wanted}

    def possible(value: float) -> bool:
        try:
            table = effect.with_values({**others, one.name: value}).model_dump()
            tried = scene.model_copy(update={"effects": {effect.id: table}})
            apply_stage(Stage.RIG, tried, active_effects(tried), Context(tried, 0))
        except InputError:
            return False
        return True

    ends: list[float] = []
    for tail in (1e-9, 1.0 - 1e-9):
        inside, end = one.null, UncertainParameter(effect.id, one).value(tail)
        if possible(end) or not possible(inside):
            ends.append(one.bounds[len(ends)])
            continue
        for _ in range(BISECTIONS):
            middle = 0.5 * (inside + end)
            inside, end = (middle, end) if possible(middle) else (inside, middle)
        # No step at all is the effect's own refusal, which :func:`_acts` tells.
        ends.append(one.bounds[len(ends)] if inside == one.null else inside)
    return replace(one, bounds=(ends[0], ends[1]))


def sobol_points(uncertainty: Uncertainty, count: int, seed: int) -> Array:
    """Return points (count, dimensions) of a Sobol' sequence within 0 to 1, scrambled by the seed.

    References
    ----------
    A. B. Owen, "Scrambling Sobol' and Niederreiter-Xing points", Journal of Complexity 14 (1998) 466.
    """
    sample = qmc.Sobol(len(uncertainty.names), scramble=True, rng=rng.generator(seed, "departures"))
    power = max(0, int(np.ceil(np.log2(count))))
    return np.asarray(np.clip(sample.random_base2(power)[:count], 1e-9, 1 - 1e-9))


def draw(uncertainty: Uncertainty, point: Array) -> Draw:
    """Return the rig at one point (dimensions,) of :func:`sobol_points`."""
    drawn = zip(uncertainty.parameters, point, strict=False)
    effects = effects_at({p: p.value(float(u)) for p, u in drawn if p.effect not in uncertainty.excluded})
    board, square, height, edge = (float(u) for u in point[-len(CARDS) :])
    cards = CardErrors(
        board_scale=1.0 + PRINT_TOLERANCE * (2 * board - 1),
        square_scale=1.0 + PRINT_TOLERANCE * (2 * square - 1),
        height_mm=CARD_HEIGHT_MM * height,
    )
    return Draw(effects, cards, SQUARE_EDGE_PX * (2 * edge - 1))


def effects_at(values: Mapping[UncertainParameter, float]) -> dict[str, dict[str, Any]]:
    """Return the effects' tables of a scene for values of some parameters."""
    by_effect: dict[str, dict[str, float]] = {}
    for parameter, value in values.items():
        by_effect.setdefault(parameter.effect, {})[parameter.candidate.name] = value
    known = all_effects()
    tables = {name: known[name].with_values(found).model_dump(mode="json") for name, found in by_effect.items()}
    return {name: table for name, table in tables.items() if not known[name].is_null(_parameters(name, table))}


def _parameters(name: str, table: Mapping[str, Any]) -> Any:
    effect = all_effects()[name]
    return effect.parameters.model_validate(
        {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}
    )


def read_standard_deviations(path: Path) -> dict[str, dict[str, float]]:
    """Read standard deviations of effects' parameters: TOML tables named like the effects.

    Raises
    ------
    InputError
        If the file is not readable as that, or names an unknown effect; parameters are checked when they are used.
    """
    if not path.is_file():
        raise InputError("no such file", file=path, key="uncertainty", allowed="a TOML file")
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


def built_scene(scene: Scene, drawn: Draw) -> Scene:
    """Return a scene with a draw's effects beside its own."""
    return scene.model_copy(update={"effects": {**scene.effects, **drawn.effects}})
