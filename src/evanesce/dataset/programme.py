"""Loading programme of a trial sampled at the frames: normal force, drive, twist, and placement of the finger."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.dataset.config import AWAY, LIFT, Trial
from evanesce.dataset.design import TrialPlan

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sampled:
    """A programme sampled at the frames.

    Attributes
    ----------
    time : ndarray (n,)
        [s].
    force : ndarray (n,)
        Commanded normal force [N]; 0 where the finger is lifted.
    drive : ndarray (n,)
        Displacement of the finger's top along the slide [mm].
    twist_share : ndarray (n,)
        Torque over that of full sliding, 0 to below 1.
    placement : ndarray of int (n,)
        0 at the first position, 1 after the finger was lifted and placed at another one.
    speed : ndarray (n,)
        Of the drive while it moves in the time since the frame before [mm/s].
    """

    time: Floats
    force: Floats
    drive: Floats
    twist_share: Floats
    placement: NDArray[np.int64]
    speed: Floats


GROSS_SLIP_BY = 0.6
"""Share of a slide's time after press and hold within which the drive is to reach gross slip."""


def sample_programme(plan: TrialPlan, trial: Trial, stiffness: float, reach_mm: float, limit_N: float) -> Sampled:
    """Return the programme of a plan.

    Parameters
    ----------
    plan : TrialPlan
    trial : Trial
        Number of frames and their rate.
    stiffness : float
        Of contact and shaft in series under full stick [N/mm]; determines the amplitude of a wiggle.
    reach_mm : float
        Way of the drive to gross slip [mm]; determines the stroke of a slide, and its least speed.
    limit_N : float
        Friction at gross slip [N]; a wiggle stays below.
    """
    p = plan.programme
    time = np.arange(trial.frames) / trial.frame_rate_hz
    load, press, hold = p["normal_force_N"], p["press_time_s"], p["hold_time_s"]
    preload = min(p["preload_N"], load)
    rest = press + hold
    force = np.interp(time, [0.0, press], [preload, load])
    drive, twist, placement = np.zeros_like(time), np.zeros_like(time), np.zeros(time.shape, np.int64)
    speed = np.zeros_like(time)
    end = max(float(time[-1]), rest + 1.0 / trial.frame_rate_hz)
    match plan.kind:
        case "slide":
            stroke = reach_mm + p["distance_mm"]
            fast = slide_speed(plan, trial, reach_mm)
            way = np.minimum(np.maximum(time - rest, 0.0) * fast, (1 + round(p["reversals"])) * stroke)
            speed = np.where(moves(way), fast, 0.0)
            drive = stroke - np.abs(stroke - way % (2.0 * stroke))
        case "wiggle":
            amplitude = p["wiggle_share"] * limit_N / stiffness
            phase = 2.0 * math.pi * p["wiggle_frequency_hz"] * np.maximum(time - rest, 0.0)
            drive = amplitude * np.sin(phase)
            speed = np.append(0.0, np.abs(np.diff(drive)) * trial.frame_rate_hz)
        case "rotation":
            twist = p["rotation_share"] * np.clip((time - rest) / max(end - rest, 1e-9), 0.0, 1.0)
        case "ramp":
            low = load * min(p["second_force_share"], 1.0 / p["second_force_share"])
            turns = np.linspace(press, end, 4)
            force = np.interp(time, [0.0, *turns], [preload, load, low, load, low])
        case "release":
            force = np.interp(time, [0.0, press, rest, rest + press], [preload, load, load, 0.0])
        case "change":
            lift = rest + LIFT * press
            again = lift + AWAY * press
            second = p["second_force_share"] * load
            force = np.interp(
                time, [0.0, press, rest, lift, again, again + press], [preload, load, load, 0.0, 0.0, second]
            )
            placement = (time >= lift).astype(np.int64)
    return Sampled(time, force, drive, twist, placement, speed)


def moves(way: Floats) -> NDArray[np.bool_]:
    """Return in which frames a drive has moved since the one before, by its way so far, turns included (n,)."""
    return np.append(False, np.diff(way) > 0.0)


def slide_speed(plan: TrialPlan, trial: Trial, reach_mm: float) -> float:
    """Return the speed of a slide's drive [mm/s]: the one drawn, or the least that reaches gross slip in time.

    Parameters
    ----------
    plan : TrialPlan
    trial : Trial
    reach_mm : float
        Way of the drive to gross slip [mm].
    """
    p = plan.programme
    left = (trial.frames - 1) / trial.frame_rate_hz - p["press_time_s"] - p["hold_time_s"]
    return max(p["speed_mm_per_s"], reach_mm / (GROSS_SLIP_BY * left)) if left > 0 else p["speed_mm_per_s"]
