"""The soft spot of marks that explains most of what a model leaves: a film, a fingerprint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage, stats

from evanesce.criticism.features import smoothed
from evanesce.criticism.problem import Problem
from evanesce.prediction.linear import Metric

Array = NDArray[Any]

RADII_BINS = (3.0, 4.2, 6.0, 8.5, 12.0, 17.0, 24.0)
"""Of the spots that are tried, where they have fallen to exp(-1/2); smaller ones are marks, larger ones no spots."""


@dataclass(frozen=True)
class FoundBlot:
    """A spot.

    Attributes
    ----------
    middle : tuple of float
        (column, row), integer = a bin's middle.
    radius : float
        [bins].
    amount : float
        In its middle, in a bin [of the template's unit].
    penalty : float
        What the choice of the spot costs [nats].
    """

    middle: tuple[float, float]
    radius: float
    amount: float
    penalty: float


def brightest_blot(residual: Array, template: Array) -> FoundBlot | None:
    """Return the bright spot that explains most, None where that is not worth its choice.

    Parameters
    ----------
    residual, template : ndarray (views, rows, cols)
        Whitened; the template per unit of a mark in each bin.
    """
    product = np.einsum("vrc,vrc->rc", residual, template).astype(np.float32)
    information = np.einsum("vrc,vrc->rc", template, template).astype(np.float32)
    best, found = 0.0, (0, 0.0, 0.0)
    for radius in RADII_BINS:
        # Sums with weights exp(-r^2/2R^2), and with their squares, which are as wide as R over the root of 2.
        total = smoothed(product, radius) * 2 * np.pi * radius**2
        size = smoothed(information, radius / np.sqrt(2)) * np.pi * radius**2
        seen = (total > 0) & (size > 0)
        square = np.where(seen, total**2 / np.where(seen, size, 1.0), 0.0)
        k = int(np.argmax(square))
        if square.flat[k] > best:
            best, found = float(square.flat[k]), (k, radius, float(total.flat[k] / size.flat[k]))
    # Spots nearer than their radius are one and the same.
    number = sum(max(product.size / (2 * np.pi * radius**2), 1.0) for radius in RADII_BINS)
    penalty = float(np.log(number) + 0.5 * np.log1p(best))
    if 0.5 * best <= penalty:
        return None
    k, radius, amount = found
    return FoundBlot((float(k % product.shape[1]), float(k // product.shape[1])), radius, amount, penalty)


MOVES, STRIPED = "moving", "striped"
"""Begin the names of what a fitted spot leaves that no film does."""

COVARIATES = "voltage_V", "force_N", "time_s"

SLOWEST = 4.0
"""Stripes have at least so many waves in 2 pi of the spot's radius: slower ones are the spot's own form."""

SHIFTS, GOLDEN = 12, 0.618
"""Places of the spot from which the power of waves is taken where there is none, and how far apart they are."""

MOST_PACES = 50
"""That are tried to either side."""


def left_of_spot(problem: Problem, metric: Metric, row: Array, residual: Array) -> dict[str, float]:
    """Return what a fitted spot leaves that tells it from a film, over its standard deviation.

    A film stays where it is. Whatever form it has, what a fit leaves of it is the same in all frames but for the
    LEDs' power, so that a spot which walks, widens or brightens otherwise as force, voltage or time go on is none, and
    none has stripes.

    Parameters
    ----------
    problem : Problem
    metric : Metric
        Of all that was fitted.
    row : ndarray (bins,)
        Whitened change that the spot makes.
    residual : ndarray (bins,)
        Whitened, of the fit with it.
    """
    touched = [k for k, view in enumerate(problem.kinds) if view.touches and view.force_N is not None]
    change = problem.unwhitened(row)
    if len(touched) < 4 or not np.any(change[touched]):
        return {}
    return _moving(problem, metric, change, touched, residual) | _stripes(problem, change, touched, residual)


def _moving(problem: Problem, metric: Metric, change: Array, touched: list[int], residual: Array) -> dict[str, float]:
    sd = problem.sd[list(problem.views)]
    level = change * sd
    down, right = np.gradient(level, axis=(1, 2))
    shapes = {"down": down, "right": right, "wider": _laplacian(level), "brighter": level}
    views = [problem.kinds[k] for k in touched]
    weight = (change[touched] ** 2).sum(axis=(1, 2))
    voltage, force, time = (np.array([getattr(v, of) for v in views], float) for of in COVARIATES)
    names, rows = [], []
    for covariate, values in (("force", force), ("voltage", voltage), ("time", np.log1p(time - time.min()))):
        away = values - np.average(values, weights=weight)
        size = float(np.sqrt(np.average(away**2, weights=weight)))
        if size <= 1e-6 * float(np.abs(values).max()):
            continue
        for name, shape in shapes.items():
            cube = np.zeros_like(level)
            cube[touched] = shape[touched] * (away / size)[:, None, None] / sd[touched]
            names.append(f"{MOVES} {name} with {covariate}")
            rows.append(cube[problem.valid[list(problem.views)]])
    if not rows:
        return {}
    projected = metric.project(np.array(rows))
    size = np.sqrt(np.maximum(np.einsum("kd,kd->k", projected, np.array(rows)), 1e-300))
    alike = projected @ np.array(rows).T / np.outer(size, size)
    # Each beyond those before it, so that their squares add: a press is harder the later it comes.
    factor = np.linalg.cholesky(alike + 1e-6 * np.eye(len(rows)))
    return dict(zip(names, (float(z) for z in np.linalg.solve(factor, projected @ residual / size)), strict=True))


def _laplacian(level: Array) -> Array:
    return np.asarray(np.gradient(np.gradient(level, axis=1), axis=1) + np.gradient(np.gradient(level, axis=2), axis=2))


def _stripes(problem: Problem, change: Array, touched: list[int], residual: Array) -> dict[str, float]:
    """Return the largest power of waves within the spot that stand or creep at a steady pace.

    Its law comes from the measured fields of noise, within the same spot.
    """
    window = change[touched] / np.sqrt((change[touched] ** 2).sum())
    waves = fft.rfft2(problem.unwhitened(residual)[touched] * window)
    spot = np.sqrt((window**2).sum(axis=0))
    noise = np.zeros(waves.shape[1:])
    for k in range(SHIFTS):
        # Each place shows other waves of the few fields that were measured.
        elsewhere = np.roll(spot, [round(GOLDEN * k * n) for n in spot.shape], axis=(0, 1))
        noise += (np.abs(fft.rfft2(problem.noise.fields * elsewhere)) ** 2).mean(axis=0) / SHIFTS
    noise = ndimage.uniform_filter(noise, 7, mode="nearest")
    fast = _frequencies(waves.shape[1:], change.shape[2]) > SLOWEST / (2 * np.pi * _radius(window))
    paces = _paces(np.array([problem.kinds[k].time_s for k in touched]))
    power = np.abs(paces @ (waves[:, fast] / np.sqrt(noise[fast]))) ** 2
    if power.size < 20:
        return {}
    # Exponential under noise; of what is neither noise nor wave there is as much everywhere.
    most = float(power.max() / np.median(power)) * np.log(2.0)
    return {STRIPED: float(stats.norm.isf(min(0.5, max(power.size * np.exp(-most), 1e-300))))}


def _frequencies(shape: tuple[int, ...], cols: int) -> Array:
    """Return the frequency of each element of a real transform (rows, ...) [1/bin]."""
    return np.asarray(np.hypot(fft.fftfreq(shape[0])[:, None], fft.rfftfreq(cols)[None, :]))


def _radius(window: Array) -> float:
    """Return the root mean square distance of a window's (views, rows, cols) power from its middle [bins]."""
    share = (window**2).sum(axis=0) / (window**2).sum()
    row, col = (np.arange(n) @ share.sum(axis=1 - k) for k, n in enumerate(share.shape))
    v, u = np.mgrid[: share.shape[0], : share.shape[1]]
    return float(np.sqrt((share * ((v - row) ** 2 + (u - col) ** 2)).sum()))


def _paces(time_s: Array) -> Array:
    """Return the turns (paces, views) of waves that creep, from standing to half a wave between two frames."""
    spread, steps = float(np.ptp(time_s)), np.diff(np.unique(time_s))
    if spread <= 0.0:
        return np.ones((1, time_s.size))
    number = min(int(spread / float(np.median(steps))), MOST_PACES)
    turns = np.arange(-number, number + 1) / (2.0 * spread)
    return np.asarray(np.exp(-2j * np.pi * turns[:, None] * (time_s - time_s.mean())))
