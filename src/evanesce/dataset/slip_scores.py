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
RELEASE_S = 0.1
"""After which an alarm that goes on while everything sticks again counts as false: features look back as far."""
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
        :func:`false_alarms` per minute of frames without slip [1/min].
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


def false_alarms(series: Series, threshold: float, hold: int = 2) -> int:
    """Return the number of alarms without slip: raised while all sticks, or kept up :data:`RELEASE_S` after slip ended.

    Parameters
    ----------
    series : Series
    threshold : float
    hold : int

    Returns
    -------
    int
        Each stretch of sticking counts every alarm raised in it, and once one that was kept up.
    """
    above, sticking = series.evidence > threshold, series.stick_ratio >= STICKING
    raised = sticking[alarms(series.evidence, threshold, hold)].sum()
    begins = np.flatnonzero(sticking[1:] & ~sticking[:-1]) + 1
    kept = 0
    for begin in begins:
        ends = np.flatnonzero(~(above & sticking)[begin:])
        last = begin + (int(ends[0]) if ends.size else len(above) - begin) - 1
        kept += int(last >= begin and above[begin - 1] and series.time[last] - series.time[begin] >= RELEASE_S)
    return int(raised) + kept


def score(trials: Sequence[Series], threshold: float, hold: int = 2) -> Score:
    """Return the scores of a detector at one threshold."""
    latencies, leads, false, without_slip_s, slides = [], [], 0, 0.0, 0
    for trial in trials:
        raised = alarms(trial.evidence, threshold, hold)
        step = float(np.median(np.diff(trial.time)))
        sticking = trial.stick_ratio >= STICKING
        without_slip_s += float(sticking.sum()) * step
        false += false_alarms(trial, threshold, hold)
        if not np.isfinite(trial.onset_gross):
            continue
        slides += 1
        true = [float(trial.time[i]) for i in raised if not sticking[i]]
        if true:
            latencies.append(true[0] - trial.onset_first)
            if true[0] <= trial.onset_gross + 1e-9:
                leads.append(trial.onset_gross - true[0])
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
