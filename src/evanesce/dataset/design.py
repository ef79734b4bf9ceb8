"""Draw the plan of a trial from seed and number: finger, friction level, rig and programme, quasi-random.

Every draw is a function of the seed, the name of its stream and its own number, whatever the process and the order.
"""

from __future__ import annotations

import functools
import warnings
from collections import Counter
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import qmc

from evanesce.core import rng
from evanesce.dataset.config import KINDS, DatasetConfig, Programme, Split
from evanesce.dataset.config_motion import MOTION_KEYS, MOTIONS
from evanesce.effects import all_effects
from evanesce.effects.protocol import Effect

COUNTED = 256
"""Trials whose splits are counted before a set is made."""
BLOCK = 64
"""Number of points of a sequence that are drawn at a time."""

ELAPSED: dict[str, tuple[str, float, float]] = {
    "creep": ("held_before_s", 0.1, 10.0),
    "led_warmup": ("on_before_s", 1.0, 3600.0),
}
"""Effects that grow over times much longer than a trial: the parameter with the time elapsed before the trial, and the
bounds of its log-uniform distribution [s]."""

ITS_TRIALS_MOTION = ("rolling_skew",)
"""Effects of motion: that of each trial, so that none of their own is drawn."""

SPEED_KINDS = ("slide", "regrasp")
"""Kinds whose friction follows the speed: what goes to and fro within its strength, or turns in place, has none."""

LATER_FRICTION = ("ridge_friction_ratio", "speed_exponent")
"""Drawn from streams of their own, so that they leave all other draws as they are."""

PROGRAMME_KEYS = tuple(Programme.model_fields)


@dataclass(frozen=True)
class FingerPlan:
    """One finger, in the units of the keys; ``pattern`` is empty for a smooth one."""

    index: int
    material: str
    tip_radius_mm: float
    pattern: str
    ridge_pitch_um: float
    ridge_width_um: float
    ridge_height_um: float
    ridge_orientation_deg: float
    shaft_stiffness_N_per_mm: float
    axial_stiffness_N_per_mm: float
    tilt_deg: float = 0.0
    tilt_direction_deg: float = 0.0


@dataclass(frozen=True)
class FrictionPlan:
    """One frictional interface."""

    index: int
    friction_coefficient: float
    adhesive_share: float
    dynamic_ratio: float
    weakening_distance_mm: float
    area_left: float
    ridge_friction_ratio: float = 1.0
    speed_exponent: float = 0.0


@dataclass(frozen=True)
class RigPlan:
    """One rig: changes of the scene by dotted key, and effects with their parameters."""

    index: int
    seed: int
    changes: dict[str, Any]
    effects: dict[str, dict[str, Any]]


@dataclass(frozen=True)
class TrialPlan:
    """Plan of one trial; ``motion`` holds the figures of what its finger does besides, by their keys."""

    index: int
    kind: str
    split: str
    finger: FingerPlan
    friction: FrictionPlan
    rig: RigPlan
    programme: dict[str, float]
    motion: dict[str, float] = field(default_factory=dict)
    liquid: dict[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON-able data."""
        return asdict(self)


def quantiles(seed: int, stream: str, dimensions: int, index: int) -> np.ndarray:
    """Return point ``index`` of a stream's scrambled Sobol sequence, shape (dimensions,), in [0, 1)."""
    return _points(seed, stream, dimensions, index // BLOCK)[index % BLOCK]


def stratum(seed: int, stream: str, index: int) -> float:
    """Return a stratified random number in (0, 1): every :data:`BLOCK` of them are evenly spaced, in random order.

    For what goes on with the number of a trial while its own draws do: two Sobol sequences over indices that share
    their binary digits are not independent, so that a split would have some kinds of trial only.
    """
    return float((_order(seed, stream, index // BLOCK)[index % BLOCK] + 0.5) / BLOCK)


@functools.lru_cache(maxsize=64)
def _order(seed: int, stream: str, block: int) -> np.ndarray:
    return rng.generator(seed, "dataset", stream, block).permutation(BLOCK)


@functools.lru_cache(maxsize=64)
def _points(seed: int, stream: str, dimensions: int, block: int) -> np.ndarray:
    generator = rng.generator(seed, "dataset", stream)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the balance of a part of the sequence is not needed
        sampler = qmc.Sobol(dimensions, scramble=True, rng=generator)
        if block:
            sampler.fast_forward(block * BLOCK)
        return np.asarray(sampler.random(BLOCK))


def finger_plan(config: DatasetConfig, seed: int, index: int) -> FingerPlan:
    """Draw a finger."""
    f = config.finger
    u = iter(quantiles(seed, "finger", 10, index))
    ridged = next(u) < f.ridged_share
    material, tip = str(f.material.at(next(u))), float(f.tip_radius_mm.at(next(u)))
    pattern, pitch = str(f.pattern.at(next(u))), float(f.ridge_pitch_um.at(next(u)))
    width = pitch * float(f.ridge_width_share.at(next(u)))
    height, orientation = float(f.ridge_height_um.at(next(u))), float(f.ridge_orientation_deg.at(next(u)))
    bending = float(f.shaft_stiffness_N_per_mm.at(next(u)))
    axial = bending * float(f.axial_over_bending.at(next(u)))
    if not ridged:
        pattern, pitch, width, height, orientation = "", 0.0, 0.0, 0.0, 0.0
    tilt, leans = (
        float(d.at(stratum(seed, name, index))) for name, d in (("tilt", f.tilt_deg), ("lean", f.tilt_direction_deg))
    )
    leans = leans if tilt else 0.0
    return FingerPlan(index, material, tip, pattern, pitch, width, height, orientation, bending, axial, tilt, leans)


def friction_plan(config: DatasetConfig, seed: int, index: int) -> FrictionPlan:
    """Draw an interface."""
    f = config.friction
    names = ("friction_coefficient", "adhesive_share", "dynamic_ratio", "weakening_distance_mm", "area_left")
    values = [float(getattr(f, n).at(u)) for n, u in zip(names, quantiles(seed, "friction", 5, index), strict=True)]
    later = [float(getattr(f, n).at(stratum(seed, f"friction.{n}", index))) for n in LATER_FRICTION]
    return FrictionPlan(index, *values, *later)


def rig_plan(config: DatasetConfig, seed: int, index: int) -> RigPlan:
    """Draw a rig: scene keys by their distributions, effects by :class:`~evanesce.dataset.config.Randomisation`."""
    draw = config.rig.draw
    u = quantiles(seed, "rig", max(len(draw), 1), index)
    changes = {key: draw[key].at(float(q)) for key, q in zip(sorted(draw), u, strict=False)}
    options, effects = config.randomisation, {}
    for name in options.candidates:
        stream = rng.generator(seed, "dataset", "effect", index, name)
        if stream.random() < options.probability_of(name):
            effects[name] = draw_effect(all_effects()[name], options.strength_of(name), stream)
    return RigPlan(index, rng.integer_seed(seed, "dataset", "rig", index), changes, effects)


def draw_effect(effect: Effect, strength: float, stream: np.random.Generator) -> dict[str, Any]:
    """Draw an effect's parameters about their null, by their stated standard deviations.

    A parameter with start values (it has no derivative at null) is drawn about one of them; others are normal about
    their null, folded where the null lies on a bound. Effects that grow with time get a time of :data:`ELAPSED`.
    """
    if effect.id in ITS_TRIALS_MOTION:
        return dict(effect.parameters().model_dump(mode="json"))
    values: dict[str, float] = {}
    for candidate in effect.candidate_parameters():
        low, high = candidate.bounds
        normal = float(stream.standard_normal())
        if candidate.start:
            start = candidate.start[int(stream.integers(len(candidate.start)))]
            value = (
                start if float(start).is_integer() and start >= 1 else start * float(np.exp(0.5 * normal * strength))
            )
        else:
            step = strength * normal
            value = candidate.away(
                abs(step) if candidate.null == low else -abs(step) if candidate.null == high else step
            )
        values[candidate.name] = float(np.clip(value, low, high))
    if effect.id in ELAPSED:
        name, low, high = ELAPSED[effect.id]
        values[name] = float(np.exp(stream.uniform(np.log(low), np.log(high))))
    table: dict[str, Any] = effect.with_values(values).model_dump(mode="json")
    return table


SPLITS = ("train", "validation", "test")


@dataclass(frozen=True)
class SplitGroups:
    """The groups of each split, in the order of :data:`SPLITS`.

    Attributes
    ----------
    finger, rig, friction : tuple of tuple of int
        Indices; a split without one of them has no trials.
    """

    finger: tuple[tuple[int, ...], ...]
    rig: tuple[tuple[int, ...], ...]
    friction: tuple[tuple[int, ...], ...]

    def split_at(self, quantile: float, split: Split) -> int:
        """Return the number of the split at a quantile; training takes the share of those without groups."""
        for number, share in ((2, split.test), (1, split.validation)):
            if self.finger[number] and self.rig[number] and self.friction[number]:
                if quantile < share:
                    return number
                quantile -= share
        return 0


def split_groups(config: DatasetConfig, seed: int) -> SplitGroups:
    """Divide fingers, rigs and, where asked for, friction levels among the splits."""
    s = config.split
    counts = {"finger": config.finger.count, "rig": config.rig.count, "friction": config.friction.levels}
    found = {
        name: _divided(count, name, s.validation, s.test, seed)
        if name in s.by.split("_")
        else (tuple(range(count)),) * len(SPLITS)
        for name, count in counts.items()
    }
    return SplitGroups(**found)


@functools.lru_cache(maxsize=64)
def _divided(count: int, name: str, validation: float, test: float, seed: int) -> tuple[tuple[int, ...], ...]:
    """Return the groups of each split: a seeded permutation, divided by shares; each split gets one if there are."""
    order = [int(i) for i in rng.generator(seed, "dataset", "split", name).permutation(count)]
    tested = min(max(round(test * count), test > 0), count - 1)
    validated = min(max(round(validation * count), validation > 0), count - 1 - tested)
    parts = order[tested + validated :], order[tested : tested + validated], order[:tested]
    return tuple(tuple(sorted(part)) for part in parts)


def split_warning(config: DatasetConfig, seed: int, trials: int) -> str:
    """Return a sentence where a split that is asked for has no trial; empty if all have.

    Parameters
    ----------
    config : DatasetConfig
    seed : int
    trials : int
        Of more than :data:`COUNTED` the first ones count.
    """
    counts = Counter(trial_plan(config, seed, index).split for index in range(min(trials, COUNTED)))
    wanted = {"validation": config.split.validation, "test": config.split.test}
    empty = [name for name, share in wanted.items() if share and not counts[name]]
    if not empty:
        return ""
    shares = ", ".join(f"{name} {counts[name]}" for name in SPLITS)
    return f"no trial is in {' and '.join(empty)} ({shares}): whole fingers and rigs are split, ask for more trials"


def trial_plan(config: DatasetConfig, seed: int, index: int) -> TrialPlan:
    """Draw trial ``index``: first the split of its block of trials on one rig, then groups of that split."""
    u = quantiles(seed, "trial", 3 + len(PROGRAMME_KEYS), index)
    weights = np.cumsum(config.kinds.weights)
    kind = KINDS[int(np.searchsorted(weights / weights[-1], u[0], side="right"))]
    groups, block = split_groups(config, seed), index // config.rig.trials_in_a_row
    split = groups.split_at(stratum(seed, "block_split", block), config.split)
    finger, friction = _pick(groups.finger[split], u[1]), _pick(groups.friction[split], u[2])
    rig = _pick(groups.rig[split], stratum(seed, "block_rig", block))
    programme = {
        key: float(getattr(config.programme, key).at(float(q))) for key, q in zip(PROGRAMME_KEYS, u[3:], strict=True)
    }
    drawn = finger_plan(config, seed, finger)
    return TrialPlan(
        index=index,
        kind=kind,
        split=SPLITS[split],
        finger=drawn,
        friction=_acting(friction_plan(config, seed, friction), kind, drawn.pattern),
        rig=rig_plan(config, seed, rig),
        programme=programme,
        motion=trial_motion(config, seed, index, kind),
        liquid=trial_liquid(config, seed, index),
    )


def _acting(friction: FrictionPlan, kind: str, pattern: str) -> FrictionPlan:
    """Return an interface without what does not act: ridges' direction without parallel ones, speed but in slides."""
    ratio = friction.ridge_friction_ratio if pattern == "parallel" else 1.0
    exponent = friction.speed_exponent if kind in SPEED_KINDS else 0.0
    return replace(friction, ridge_friction_ratio=ratio, speed_exponent=exponent)


_FIGURES = dict(zip(MOTIONS, MOTION_KEYS, strict=False)) | {"spin": "spin_deg"}


def trial_motion(config: DatasetConfig, seed: int, index: int, kind: str) -> dict[str, float]:
    """Draw the motions of a trial by their shares of the slides; ``spin`` has its own angle.

    A stream of its own for each, so that a share leaves all other draws as they are.
    """
    drawn = {"spin"} if kind == "spin" else set()
    if kind == "slide":
        shares = {name: getattr(config.motion, name) for name in MOTIONS}
        drawn = {name for name, share in shares.items() if share > stratum(seed, f"motion_{name}", index)}
    return {
        key: float(getattr(config.motion, key).at(stratum(seed, key, index)))
        for name, key in _FIGURES.items()
        if name in drawn
    }


def trial_liquid(config: DatasetConfig, seed: int, index: int) -> dict[str, float]:
    """Draw the liquid of a trial; empty for a dry one."""
    if config.liquid.share <= stratum(seed, "liquid", index):
        return {}
    keys = [key for key in type(config.liquid).model_fields if key != "share"]
    return {key: float(getattr(config.liquid, key).at(stratum(seed, f"liquid.{key}", index))) for key in keys}


def _pick(groups: tuple[int, ...], quantile: float) -> int:
    return groups[min(int(quantile * len(groups)), len(groups) - 1)]
