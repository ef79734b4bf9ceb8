"""Loading programme of a trial whose finger slides on a path, turns, sticks and slips, or is put down twice."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from evanesce.dataset.config import AWAY, LIFT, Trial
from evanesce.dataset.design import TrialPlan
from evanesce.dataset.directional import ridge_friction
from evanesce.dataset.programme import Floats, Sampled, moves, sample_programme, slide_speed

FIRST_LEG_BY = 0.55
"""Share of a slide's time within which a finger that changes direction does so."""
HALF_WAY = 0.5
"""Share of the time for sliding after which at the latest speed and force change, and a finger is lifted to be put
down elsewhere."""
CYCLES = 3.0
"""Cycles of stick-slip that a stroke and the time leave room for."""
FRAMES_A_CYCLE = 6.0
"""Least duration of a cycle of stick-slip."""
TURNED_BY = 0.8
"""Share of the time within which the kind ``spin`` turns its finger."""


@dataclass(frozen=True)
class PlanarSampled(Sampled):
    """A programme on a path.

    Attributes
    ----------
    x, y : ndarray (n,)
        Displacement of the finger's top over the plate [mm]; ``drive`` is the way along its path.
    rotation : ndarray (n,)
        [rad].
    """

    x: Floats
    y: Floats
    rotation: Floats


@dataclass(frozen=True)
class Path:
    """Path of a drive: one leg, or two with a change of direction between them.

    Attributes
    ----------
    legs : tuple of float
        Their lengths [mm].
    angles : tuple of float
        Their directions [rad].
    """

    legs: tuple[float, ...]
    angles: tuple[float, ...]

    @property
    def length(self) -> float:
        """[mm]."""
        return sum(self.legs)

    def at(self, way: Floats) -> tuple[Floats, Floats]:
        """Return the points (x, y) after a way [mm]."""
        x, y, start = np.zeros_like(way), np.zeros_like(way), 0.0
        for leg, angle in zip(self.legs, self.angles, strict=True):
            gone = np.clip(way - start, 0.0, leg)
            x, y, start = x + gone * math.cos(angle), y + gone * math.sin(angle), start + leg
        return x, y


def is_planar(plan: TrialPlan) -> bool:
    """Return whether a trial needs :class:`PlanarSampled`."""
    aside = plan.kind in ("slide", "wiggle") and ridge_friction(plan)[0] != 1.0
    return bool(plan.motion) or plan.kind == "regrasp" or aside


def path_of(plan: TrialPlan, reach_mm: float, cycle_mm: float) -> Path:
    """Return the path of a plan's drive.

    Parameters
    ----------
    plan : TrialPlan
    reach_mm : float
        Way from rest to gross slip [mm].
    cycle_mm : float
        Way of a cycle of stick-slip [mm]; 0 without.
    """
    p, m = plan.programme, plan.motion
    angle = math.radians(p["direction_deg"])
    beyond = max(p["distance_mm"], CYCLES * cycle_mm)
    if "turn_deg" not in m:
        return Path((reach_mm + beyond,), (angle,))
    # turned back, the contact is first unloaded, then loaded
    again = reach_mm * (1.0 + abs(m["turn_deg"]) / 180.0)
    return Path((reach_mm + beyond, again + beyond), (angle, angle + math.radians(m["turn_deg"])))


def cycle_of(plan: TrialPlan, limit_N: float, stiffness: float) -> float:
    """Return the way of the drive in a cycle of stick-slip [mm], which loads again what a jump has lost."""
    return plan.motion.get("stick_slip_drop", 0.0) * limit_N / stiffness


def planar_programme(plan: TrialPlan, trial: Trial, reach_mm: float, stiffness: float, limit_N: float) -> PlanarSampled:
    """Return the programme of a plan with motions, or with ridges that pull aside.

    Parameters
    ----------
    plan : TrialPlan
    trial : Trial
    reach_mm : float
        Way of the drive from rest to gross slip [mm].
    stiffness : float
        Of contact and shaft in series [N/mm].
    limit_N : float
        Friction at gross slip [N].
    """
    p, m = plan.programme, plan.motion
    time = np.arange(trial.frames) / trial.frame_rate_hz
    load, press = p["normal_force_N"], p["press_time_s"]
    rest = press + p["hold_time_s"]
    end = max(float(time[-1]), rest + 1.0 / trial.frame_rate_hz)
    middle = rest + HALF_WAY * (end - rest)
    knots, loads = [0.0, press], [min(p["preload_N"], load), load]
    zero, placement = np.zeros_like(time), np.zeros(time.shape, np.int64)
    if plan.kind == "spin":
        share = np.clip((time - rest) / (TURNED_BY * (end - rest)), 0.0, 1.0)
        turned = math.radians(m["spin_deg"]) * share
        return PlanarSampled(time, np.interp(time, knots, loads), zero, zero, placement, zero, zero, zero, turned)
    if plan.kind == "wiggle":
        line = sample_programme(plan, trial, stiffness, reach_mm, limit_N)
        angle = math.radians(p["direction_deg"])
        x, y = math.cos(angle) * line.drive, math.sin(angle) * line.drive
        return PlanarSampled(time, line.force, line.drive, zero, placement, line.speed, x, y, zero)
    cycle = cycle_of(plan, limit_N, stiffness)
    path = path_of(plan, reach_mm, cycle)
    speed = _speed(plan, trial, path, reach_mm, cycle, end - rest)
    if plan.kind == "regrasp":
        between = (LIFT + AWAY + 1.0) * press
        middle = rest + HALF_WAY * max(end - rest - between, 1.0 / trial.frame_rate_hz)
        lift = middle + LIFT * press
        again = lift + AWAY * press
        knots += [middle, lift, again, again + press]
        loads += [load, 0.0, 0.0, p["second_force_share"] * load]
        placement = (time >= lift).astype(np.int64)
        # two slides: until the finger is lifted, and from when it is pressed on again
        speed = max(speed, path.length / (0.8 * (middle - rest)))
        way = speed * np.where(
            placement == 1, np.maximum(time - again - press, 0.0), np.clip(time - rest, 0.0, lift - rest)
        )
        way = np.minimum(way, path.length)
        # the second slide begins anew from no way at all
        fast = np.where(moves(way) | moves(np.where(placement == 1, way, 0.0)), speed, 0.0)
    else:
        # in gross slip on the first leg, if that comes sooner
        middle = min(middle, rest + 0.5 * (reach_mm + path.legs[0]) / speed)
        slow, rest_of_it = np.clip(time - rest, 0.0, middle - rest), np.maximum(time - middle, 0.0)
        way = speed * (slow + m.get("speed_factor", 1.0) * rest_of_it)
        way = np.minimum(way, (1 + round(p["reversals"])) * path.length)
        fast = np.where(moves(way), np.where(time > middle, m.get("speed_factor", 1.0) * speed, speed), 0.0)
    if "force_factor" in m:
        knots, loads = [*knots, middle, middle + press], [*loads, load, m["force_factor"] * load]
    along = path.length - np.abs(path.length - way % (2.0 * path.length))
    x, y = path.at(along)
    turned = math.radians(m.get("torsion_deg", 0.0)) * along / path.length
    return PlanarSampled(time, np.interp(time, knots, loads), along, zero, placement, fast, x, y, turned)


def _speed(plan: TrialPlan, trial: Trial, path: Path, reach_mm: float, cycle_mm: float, left_s: float) -> float:
    """Return the speed [mm/s]: that of a slide, and as much more or less as direction and cycles need."""
    speed = slide_speed(plan, trial, reach_mm)
    if len(path.legs) > 1:
        speed = max(speed, path.legs[0] / (FIRST_LEG_BY * left_s))
    if cycle_mm > 0.0:
        factor = plan.motion.get("speed_factor", 1.0)
        fastest = cycle_mm * trial.frame_rate_hz / (FRAMES_A_CYCLE * max(1.0, factor))
        speed = min(max(speed, (reach_mm + CYCLES * cycle_mm) / (TURNED_BY * left_s)), fastest)
    return speed
