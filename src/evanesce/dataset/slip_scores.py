"""Score slip detectors on time series: detection rate, latency, lead before gross slip, false alarms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

Floats = NDArray[np.float64]

STICKING = 0.95
"""Stick ratio from which on an alarm counts as false."""
TOLERANCE_S = 0.1
"""Before a slip's begin, from which on an alarm is that slip's; after its end, until which it may go on: features look
back as far."""
CONFIDENCE = 0.84
"""One standard deviation, one-sided."""


@dataclass(frozen=True)
class Series:
    """Output of a detector on one trial.

    Attributes
    ----------
    time : ndarray (n,)
        [s].
    evidence : ndarray (n,)
        Grows with slip; an alarm is raised where it exceeds the threshold.
    stick_ratio : ndarray (n,)
        Ground truth.
    onset_first, onset_gross : float
        [s]; NaN where the trial has none.
    """

    time: Floats
    evidence: Floats
    stick_ratio: Floats
    onset_first: float
    onset_gross: float


@dataclass(frozen=True)
class Score:
    """Scores of a detector on a set of trials.

    Attributes
    ----------
    detected : float
        Share of the trials with gross slip that have an alarm no later than it [1].
    latency_s : float
        Median of alarm less first slip, over trials with an alarm after it [s]; NaN without any.
    lead_s : float
        Median of gross slip less alarm, over the detected trials [s]; NaN without any.
    false_per_minute : float
        False alarms (:func:`sorted_alarms`) per minute of frames without slip [1/min].
    slides : int
        Trials with gross slip.
    minutes : float
        Total duration of frames without slip [min].
    """

    detected: float
    latency_s: float
    lead_s: float
    false_per_minute: float
    slides: int
    minutes: float


def alarms(evidence: Floats, threshold: float, hold: int = 2) -> NDArray[np.int64]:
    """Return the frames of alarms: evidence above the threshold in ``hold`` consecutive frames."""
    above = evidence > threshold
    run = np.zeros(len(above), np.int64)
    for i, high in enumerate(above):
        run[i] = (run[i - 1] if i else 0) + 1 if high else 0
    return np.flatnonzero(run == hold)


def slips(sticking: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the frames (begin, end) of each slip; the end is the first one in which all sticks again."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], sticking, [True]]).astype(int)))
    return [(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


def sorted_alarms(series: Series, threshold: float, hold: int = 2) -> tuple[list[list[int]], int]:
    """Sort alarms into those of each slip, and false ones.

    An alarm is a slip's where it is raised while that lasts, or :data:`TOLERANCE_S` before. False are all others, and
    those that are kept up longer than that after a slip, once for each slip.

    Parameters
    ----------
    series : Series
    threshold : float
    hold : int

    Returns
    -------
    of_slips : list of list of int
        Frames in which alarms of each slip were raised, in the order of :func:`slips`.
    false : int
    """
    time, above, sticking = series.time, series.evidence > threshold, series.stick_ratio >= STICKING
    raised = alarms(series.evidence, threshold, hold)
    every, found, kept = slips(sticking), [], 0
    for begin, end in every:
        early = int(np.searchsorted(time, time[begin] - TOLERANCE_S - 1e-9))
        found.append([int(i) for i in raised if early <= i < end])
        silent = np.flatnonzero(~above[end:] | ~sticking[end:])
        last = end + (int(silent[0]) if silent.size else len(above) - end) - 1
        kept += int(above[end - 1] and last >= end and time[last] - time[end] >= TOLERANCE_S - 1e-9)
    mine = {i for some in found for i in some}
    return found, sum(int(i) not in mine for i in raised) + kept


def score(trials: Sequence[Series], threshold: float, hold: int = 2) -> Score:
    """Return the scores of a detector at one threshold."""
    latencies, leads, false, without_slip_s, slides = [], [], 0, 0.0, 0
    for trial in trials:
        found, wrong = sorted_alarms(trial, threshold, hold)
        step = float(np.median(np.diff(trial.time)))
        sticking = trial.stick_ratio >= STICKING
        without_slip_s += float(sticking.sum()) * step
        false += wrong
        if not np.isfinite(trial.onset_gross):
            continue
        slides += 1
        true = [float(trial.time[i]) for some in found for i in some]
        if true:
            latencies.append(min(true) - trial.onset_first)
            if min(true) <= trial.onset_gross + 1e-9:
                leads.append(trial.onset_gross - min(true))
    return Score(
        detected=len(leads) / slides if slides else float("nan"),
        latency_s=float(np.median(latencies)) if latencies else float("nan"),
        lead_s=float(np.median(leads)) if leads else float("nan"),
        false_per_minute=60.0 * false / without_slip_s if without_slip_s else float("nan"),
        slides=slides,
        minutes=without_slip_s / 60.0,
    )


def choose_threshold(trials: Sequence[Series], allowed_per_minute: float, hold: int = 2) -> float:
    """Return the threshold of the highest detection rate within a rate of false alarms; of equals, the longest lead.

    Parameters
    ----------
    trials : sequence of Series
        That the detector was not fitted to.
    allowed_per_minute : float
        Budget of false alarms [1/min].
    hold : int

    Returns
    -------
    float

    Notes
    -----
    A few minutes hold a few alarms, whose rate is that uncertain: the upper bound of the rate at :data:`CONFIDENCE`,
    by Poisson statistics, must be within the budget. Where no threshold does that, one of the fewest alarms is taken.
    """
    every = np.concatenate([trial.evidence for trial in trials])
    candidates = np.unique(np.quantile(every[np.isfinite(every)], np.linspace(0.02, 1.0, 197)))
    best, chosen = (-math.inf, -1.0, -math.inf), float(candidates[-1])
    for threshold in candidates:
        found = score(trials, float(threshold), hold)
        if not found.minutes or not found.slides:
            continue
        count = round(found.false_per_minute * found.minutes)
        within = float(gammaincinv(count + 1, CONFIDENCE)) <= allowed_per_minute * found.minutes
        lead = found.lead_s if math.isfinite(found.lead_s) else -math.inf
        rank = (1.0 if within else -float(count), found.detected, lead)
        if rank > best:
            best, chosen = rank, float(threshold)
    return chosen
