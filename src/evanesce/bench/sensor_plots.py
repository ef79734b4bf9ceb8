"""Figures of a sensor's bench test: photon transfer with its residuals, dark variance against exposure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from evanesce.bench.sensor import Dark, Transfer


def transfer_figure(transfers: Sequence[Transfer]) -> Figure:
    """Return variance against signal with the fits, and what each fit leaves.

    Parameters
    ----------
    transfers : sequence of Transfer

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(10.4, 4.1), layout="constrained")
    left, right = figure.subplots(1, 2)
    for i, one in enumerate(transfers):
        color, order = f"C{i % 10}", np.argsort(one.signal_DN)
        x, v = one.signal_DN[order], one.variance_DN2[order]
        used = (x <= one.fit.limit_DN) & (v > 0.0)
        left.plot(x[used], v[used], ".", ms=4, color=color, label=one.name)
        left.plot(x[~used], v[~used], "x", ms=3, alpha=0.4, color=color)
        curve = np.linspace(max(x[used].min(), 0.0), one.fit.limit_DN, 200)
        left.plot(curve, one.fit.variance(curve), lw=1, color=color)
        right.plot(x[used], 100.0 * (v[used] / one.fit.variance(x[used]) - 1.0), ".-", ms=4, lw=0.5, color=color)
    left.set(xlabel="signal above the black level [DN]", ylabel="variance [DN²]")
    right.set(xlabel="signal above the black level [DN]", ylabel="measured over fitted variance - 1 [%]")
    left.legend(frameon=False, fontsize=8, ncols=1 + len(transfers) // 8, title="pixels; x: not fitted")
    for axis in (left, right):
        axis.grid(alpha=0.3)
    return figure


def dark_figure(dark: Dark) -> Figure:
    """Return dark variance against exposure, and against exposure scaled to the warmest of its kind's temperatures.

    Parameters
    ----------
    dark : Dark

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(10.4, 4.1), layout="constrained")
    left, right = figure.subplots(1, 2)
    names = list(dict.fromkeys(one.name for one in dark.series))
    temperatures = sorted({one.temperature_C for one in dark.series})
    for one, fit in zip(dark.series, dark.fits, strict=True):
        color, marker = f"C{names.index(one.name) % 10}", "ox^sv"[temperatures.index(one.temperature_C) % 5]
        left.plot(
            one.exposure_s, one.variance_DN2, marker, ms=3, color=color, label=f"{one.name}, {one.temperature_C:g} °C"
        )
        t = np.linspace(0.0, one.exposure_s[-1], 200)
        if one.spatial_DN2 is None:
            parabola = fit.offset_DN2 + fit.shot_DN2_per_s * t + (fit.nonuniformity_DN_per_s * t) ** 2
        else:
            parabola = fit.offset_DN2 + fit.shot_DN2_per_s * t
        left.plot(t, parabola, lw=0.8, color=color)
        if dark.factors and one.name not in {factor.name for factor in dark.factors}:
            continue
        scale = np.prod([f.factor for f in dark.factors if f.name == one.name and f.low_C >= one.temperature_C])
        right.plot(one.exposure_s / scale, one.variance_DN2 - one.variance_DN2[0], marker, ms=3, color=color)
    left.set(xlabel="exposure [s]", ylabel="dark variance [DN²]")
    right.set(xlabel="exposure over the temperature's factor [s]", ylabel="excess over no exposure [DN²]")
    left.legend(frameon=False, fontsize=7, ncols=2)
    for axis in (left, right):
        axis.grid(alpha=0.3)
    return figure
