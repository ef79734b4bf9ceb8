"""Analysis of the voltage study's samples: where the thesis's observation holds; the setting of smallest error."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core import rng
from evanesce.core.extras import require
from evanesce.studies.voltage.unknowns import (
    FLAT,
    GRID_MM,
    RATIOS,
    SEEN,
    THRESHOLDS,
    UNKNOWNS,
    Samples,
    Unknown,
    problem,
)

Array = NDArray[np.float64]

ONSET_V = (7.5, 8.25)
"""Where the thesis loses the patch: "below 8 V", read as between these."""
CONVERGED_V = 9.25
"""Latest voltage of convergence that still counts as "from about 9 V"."""
FILLED_MM2 = np.pi / 4 * GRID_MM**2
"""An estimate this large has reached the border of the sampled skin: it converges there on nothing but that border."""
RISE = 0.05
"""Smallest growth of the estimate, over the true area, that counts as rising."""


def onset(voltages: Sequence[float] | Array, area: Array, true_area: Array) -> Array:
    """Return the voltage above which there is something to segment [V].

    Parameters
    ----------
    voltages : sequence of float
        Ascending [V].
    area : ndarray (..., voltages)
        [mm^2].
    true_area : ndarray (...)
        [mm^2].

    Returns
    -------
    ndarray (...)
        Where the area crosses :data:`SEEN` of the truth, between voltages linearly; the first voltage where it is seen
        there already, and one step beyond the last where it never is.
    """
    v, share = np.asarray(voltages, float), area / np.maximum(true_area, 1e-12)[..., None]
    seen = share >= SEEN
    first = np.where(seen.any(axis=-1), seen.argmax(axis=-1), v.size)
    at = np.clip(first, 1, v.size - 1)[..., None]
    low, high = np.take_along_axis(share, at - 1, -1)[..., 0], np.take_along_axis(share, at, -1)[..., 0]
    part = np.clip((SEEN - low) / np.maximum(high - low, 1e-12), 0.0, 1.0)
    between = v[at[..., 0] - 1] + part * (v[at[..., 0]] - v[at[..., 0] - 1])
    return np.where(first == 0, v[0], np.where(first == v.size, 2 * v[-1] - v[-2], between))


def converged(voltages: Sequence[float] | Array, area: Array) -> Array:
    """Return the lowest voltage from which the area stays within :data:`FLAT` of that at the last one [V].

    Parameters
    ----------
    voltages : sequence of float
        Ascending [V].
    area : ndarray (..., voltages)
        [mm^2].

    Returns
    -------
    ndarray (...)
        [V].
    """
    v, last = np.asarray(voltages, float), area[..., -1:]
    away = np.abs(area - last) > FLAT * np.maximum(last, 1e-12)
    # the first voltage after the last that is away
    after = np.where(away.any(axis=-1), v.size - away[..., ::-1].argmax(axis=-1), 0)
    return np.asarray(v[np.minimum(after, v.size - 1)])


@dataclass(frozen=True)
class Claims:
    """Whether each sample shows what the thesis saw, at every force.

    Attributes
    ----------
    vanishes, rises, settles : ndarray of bool (samples,)
        Nothing to segment below about 8 V; the estimate grows by :data:`RISE` of the true area or more from where it
        appears; it has converged by about 9 V, on
        something, and not because it has reached the border of the sampled skin (:data:`FILLED_MM2`).
    onset, settled : ndarray (samples,)
        The voltages, mean over the forces [V].
    excess : ndarray (samples,)
        Estimate over truth less 1, mean over the forces, at the voltage nearest 9 V [1].
    """

    vanishes: NDArray[np.bool_]
    rises: NDArray[np.bool_]
    settles: NDArray[np.bool_]
    onset: Array
    settled: Array
    excess: Array

    @property
    def all(self) -> NDArray[np.bool_]:
        """Samples that show all three."""
        return np.asarray(self.vanishes & self.rises & self.settles)


def up_to(samples: Samples, voltage: float) -> Samples:
    """Return the samples as if the study had ended at a voltage [V].

    Parameters
    ----------
    samples : Samples
    voltage : float
        [V].

    Returns
    -------
    Samples
    """
    v = tuple(x for x in samples.plan.voltages if x <= voltage + 1e-9)
    plan = replace(samples.plan, voltages=v)
    return replace(samples, plan=plan, own=samples.own[..., : len(v)], area=samples.area[:, :, : len(v)])


def held_from(samples: Samples, voltage: float) -> Samples:
    """Return the samples as if the camera's own exposure control kept the light constant from a voltage on [V].

    Parameters
    ----------
    samples : Samples
    voltage : float
        [V].

    Returns
    -------
    Samples
    """
    v = np.asarray(samples.plan.voltages)
    at = np.minimum(np.arange(v.size), max(int(np.searchsorted(v, voltage + 1e-9)) - 1, 0))
    return replace(samples, own=samples.own[..., at], area=samples.area[:, :, at])


def claims(samples: Samples) -> Claims:
    """Evaluate every sample at its own threshold.

    Parameters
    ----------
    samples : Samples

    Returns
    -------
    Claims
    """
    v = np.asarray(samples.plan.voltages)
    first = onset(v, samples.own, samples.true_area)
    settled = converged(v, samples.own)
    # the first voltage at which there is surely something
    start = np.clip(np.searchsorted(v, first), 0, v.size - 1)
    at_start = np.take_along_axis(samples.own, start[..., None], -1)[..., 0]
    growth = (samples.own.max(axis=-1) - at_start) / samples.true_area
    falls = np.diff(samples.own, axis=-1).min(axis=-1) < -FLAT * samples.true_area
    nine = int(np.argmin(np.abs(v - 9.0)))
    excess = (samples.own[..., nine] / samples.true_area - 1.0).mean(axis=1)
    inside = (first >= ONSET_V[0]) & (first <= ONSET_V[1])
    last = samples.own[..., -1]
    real = (last >= SEEN * samples.true_area) & (last < FILLED_MM2)
    rises, settles = (growth >= RISE) & ~falls, (settled <= CONVERGED_V) & real
    return Claims(
        np.all(inside, axis=1), np.all(rises, axis=1), np.all(settles, axis=1),
        first.mean(axis=1), settled.mean(axis=1), excess,
    )  # fmt: skip


def sensitivity(output: Array, seed: int, unknowns: tuple[Unknown, ...] = UNKNOWNS) -> list[dict[str, Any]]:
    """Return Sobol' indices of one output: for each unknown first order, total, and their 95 % half-widths.

    Parameters
    ----------
    output : ndarray (samples,)
        In Saltelli's order, finite.
    seed : int
        Of the bootstrap behind the half-widths.
    unknowns : tuple of Unknown
        Of the samples.

    Returns
    -------
    list of dict
    """
    require("design", "Sobol' indices", "SALib")
    from SALib.analyze import sobol  # type: ignore[import-untyped]

    if not np.ptp(output) > 0:
        return [{"unknown": u.name, "first": 0.0, "first_95": 0.0, "total": 0.0, "total_95": 0.0} for u in unknowns]
    # centred: the estimators are exact in the mean only for large samples
    with warnings.catch_warnings():
        # an unknown to which a small sample is insensitive has a constant part, whose index is rightly 0
        warnings.filterwarnings("ignore", "Constant values encountered", UserWarning)
        found = sobol.analyze(problem(unknowns), output - output.mean(), calc_second_order=False, seed=seed)
    return [
        {
            "unknown": u.name,
            "first": float(found["S1"][k]),
            "first_95": float(found["S1_conf"][k]),
            "total": float(found["ST"][k]),
            "total_95": float(found["ST_conf"][k]),
        }
        for k, u in enumerate(unknowns)
    ]


def where_it_holds(samples: Samples, holds: NDArray[np.bool_], parts: int = 3) -> list[dict[str, Any]]:
    """Return for each unknown the share of independent samples that hold, in equal parts of its range.

    Parameters
    ----------
    samples : Samples
    holds : ndarray of bool (samples,)
    parts : int

    Returns
    -------
    list of dict
    """
    rows = []
    some = samples.independent
    for k, unknown in enumerate(samples.plan.unknowns):
        count = min(parts, unknown.choices or parts)
        borders = unknown.value(np.linspace(0.0, 1.0, count + 1))
        place = np.clip(np.searchsorted(borders, samples.values[some, k], side="right") - 1, 0, count - 1)
        shares = [float(holds[some][place == p].mean()) if (place == p).any() else float("nan") for p in range(count)]
        rows.append({"unknown": unknown.name, "unit": unknown.unit, "borders": borders.tolist(), "share": shares})
    return rows


@dataclass(frozen=True, kw_only=True)
class BestSetting:
    """The setting of smallest area error. An error here is a rig's relative one, RMS over the forces.

    Attributes
    ----------
    voltage_V, threshold, error : float
        The one setting whose median error over the rigs is smallest.
    voltage_interval_V, threshold_interval, error_interval : tuple of float
        5 and 95 % of the same on bootstrap samples of the rigs.
    own_voltage_V, own_threshold, own_error : tuple of float
        5, 50 and 95 % of the best setting of each rig by itself, and of its error there.
    ratio, ratio_error : float
        Cut at one share of the contact's own linear light instead: the best share, and its median error.
    ratio_interval, ratio_error_interval : tuple of float
        By bootstrap, 5 and 95 %.
    ratio_errors : tuple of float
        5, 50 and 95 % of the rigs' errors with that share.
    rigs : int
    """

    voltage_V: float
    threshold: float
    error: float
    voltage_interval_V: tuple[float, float]
    threshold_interval: tuple[float, float]
    error_interval: tuple[float, float]
    own_voltage_V: tuple[float, float, float]
    own_threshold: tuple[float, float, float]
    own_error: tuple[float, float, float]
    ratio: float
    ratio_error: float
    ratio_interval: tuple[float, float]
    ratio_error_interval: tuple[float, float]
    ratio_errors: tuple[float, float, float]
    rigs: int


def best_setting(samples: Samples, which: NDArray[np.bool_], *, bootstraps: int = 300, seed: int = 0) -> BestSetting:
    """Find the setting of smallest error over the independent samples in ``which``.

    Parameters
    ----------
    samples : Samples
    which : ndarray of bool (samples,)
    bootstraps, seed : int

    Returns
    -------
    BestSetting

    Raises
    ------
    ValueError
        If no sample is left.
    """
    rows = samples.independent[which[samples.independent]]
    if not rows.size:
        raise ValueError("no sample is left")
    v, t = np.asarray(samples.plan.voltages), np.asarray(THRESHOLDS)
    truth = samples.true_area[rows]
    # median over rigs: a few with several times the true area in their grooves would decide a mean
    error = np.sqrt(((samples.area[rows] / truth[..., None, None] - 1.0) ** 2).mean(axis=1)).reshape(rows.size, -1)
    by_ratio = np.sqrt(((samples.by_ratio[rows] / truth[..., None] - 1.0) ** 2).mean(axis=1))

    def best_of(some: NDArray[np.intp]) -> tuple[float, ...]:
        middle, ratio = np.median(error[some], axis=0), np.median(by_ratio[some], axis=0)
        i, j = int(middle.argmin()), int(ratio.argmin())
        return float(v[i // t.size]), float(t[i % t.size]), float(middle[i]), RATIOS[j], float(ratio[j])

    random = rng.generator(seed, "voltage", "bootstrap")
    again = np.array([best_of(random.integers(0, rows.size, rows.size)) for _ in range(bootstraps)])
    low, high = np.percentile(again, (5, 95), axis=0)
    best = best_of(np.arange(rows.size))
    span = [(float(a), float(b)) for a, b in zip(low, high, strict=True)]
    own = error.argmin(axis=1)
    return BestSetting(
        voltage_V=best[0], threshold=best[1], error=best[2], ratio=best[3], ratio_error=best[4],
        voltage_interval_V=span[0], threshold_interval=span[1], error_interval=span[2],
        ratio_interval=span[3], ratio_error_interval=span[4],
        own_voltage_V=_spread(v[own // t.size]), own_threshold=_spread(t[own % t.size]),
        own_error=_spread(error.min(axis=1)), ratio_errors=_spread(by_ratio[:, RATIOS.index(best[3])]),
        rigs=int(rows.size),
    )  # fmt: skip


def _spread(values: Array) -> tuple[float, float, float]:
    low, middle, high = np.percentile(values, (5, 50, 95))
    return float(low), float(middle), float(high)
