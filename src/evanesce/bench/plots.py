"""Figures of the bench tests: one function a test, axes with units, measured points beside the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from evanesce.bench.compression import MooneyRivlinFit
from evanesce.bench.dma import DmaTable
from evanesce.bench.friction import FrictionResult, FrictionTrace, Spectrum, coefficient_of_friction
from evanesce.bench.friction_lines import Line
from evanesce.bench.indentation import IndentationResult
from evanesce.bench.profile import RidgeResult
from evanesce.bench.statistics import histogram, kernel_density_mode
from evanesce.materials.prony import PronySeries

Floats = NDArray[np.float64]


def _figure(columns: int) -> tuple[Figure, list]:
    figure = Figure(figsize=(5.2 * columns, 3.9), layout="constrained")
    axes = figure.subplots(1, columns, squeeze=False)[0]
    for axis in axes:
        axis.grid(alpha=0.3)
    return figure, list(axes)


def indentation_figure(result: IndentationResult) -> Figure:
    """Return depth, reduced modulus and pressures against force.

    Parameters
    ----------
    result : IndentationResult

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, (left, middle, right) = _figure(3)
    order = np.argsort(result.force)
    force = result.force[order]
    left.plot(result.depth, result.force, ".", ms=3, color="0.5")
    left.set(xlabel="depth from first contact [mm]", ylabel="normal force [N]")
    middle.plot(result.force, result.reduced_modulus, ".", ms=3, color="0.6", label="each sample")
    middle.plot(force, result.intercept + result.slope * force, "C0", label="fit: intercept + slope F")
    middle.plot(force, result.youngs_modulus[order], "C1", label="Young's modulus")
    middle.set(
        xlabel="normal force [N]", ylabel="modulus [MPa]", ylim=(0, 2.0 * float(np.nanmedian(result.reduced_modulus)))
    )
    middle.legend(frameon=False)
    right.plot(force, result.peak_pressure[order], label="peak, 3F/(2 pi a b)")
    right.plot(force, result.mean_pressure[order], label="mean, F/(pi a b)")
    right.set(xlabel="normal force [N]", ylabel="contact pressure [MPa]")
    right.legend(frameon=False)
    return figure


def compression_figure(stretch: Floats, stress: Floats, fit: MooneyRivlinFit) -> Figure:
    """Return the compression curve with its fit and confidence band, in magnitudes.

    Parameters
    ----------
    stretch : ndarray (n,)
        Below 1.
    stress : ndarray (n,)
        Nominal [MPa], negative.
    fit : MooneyRivlinFit

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, (axis,) = _figure(1)
    s = np.linspace(*fit.stretch_range, 200)
    curve, band = -fit.material.uniaxial(s), fit.band(s)
    axis.plot(1 - stretch, -stress, ".", ms=3, color="0.5", label="measured")
    axis.plot(1 - s, curve, "C0", label="Mooney-Rivlin")
    axis.fill_between(1 - s, curve - band, curve + band, color="C0", alpha=0.25, lw=0, label="95 % of the mean")
    axis.set(xlabel="compressive strain [1]", ylabel="compressive nominal stress [MPa]")
    axis.legend(frameon=False)
    return figure


def dma_figure(table: DmaTable, series: PronySeries, reduced_frequency: Floats) -> Figure:
    """Return storage modulus and loss factor against reduced frequency, with the Prony series.

    Parameters
    ----------
    table : DmaTable
    series : PronySeries
    reduced_frequency : ndarray (n,)
        [Hz].

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, (left, right) = _figure(2)
    f = np.geomspace(reduced_frequency.min(), reduced_frequency.max(), 300)
    for axis, values, curve, label in (
        (left, table.storage, series.storage(f), "storage modulus [MPa]"),
        (right, table.loss_factor, series.loss_factor(f), "loss factor [1]"),
    ):
        points = axis.scatter(reduced_frequency, values, c=table.temperature, s=9, cmap="coolwarm")
        axis.plot(f, curve, "k", lw=1, label="Prony series")
        axis.set(xscale="log", xlabel="reduced frequency [Hz]", ylabel=label)
        axis.legend(frameon=False)
    figure.colorbar(points, ax=right, label="temperature [degC]")
    return figure


def friction_figure(traces: Sequence[FrictionTrace], results: Sequence[FrictionResult], names: Sequence[str]) -> Figure:
    """Return the coefficient of each slide against time, static peak and stable region marked.

    Parameters
    ----------
    traces : sequence of FrictionTrace
    results : sequence of FrictionResult
    names : sequence of str
        Of one length each.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, (axis,) = _figure(1)
    for i, (trace, result, name) in enumerate(zip(traces, results, names, strict=True)):
        color = f"C{i % 10}"
        axis.plot(trace.time, coefficient_of_friction(trace), lw=0.6, alpha=0.7, color=color, label=name)
        axis.plot(result.peak_time, result.static, "v", color=color)
        axis.plot(result.stable, [result.dynamic] * 2, color=color, lw=2)
    top = max(result.static for result in results)
    axis.set(xlabel="time [s]", ylabel="coefficient of friction [1]", ylim=(0, 1.3 * top))
    if len(names) <= 12:
        axis.legend(frameon=False, fontsize=8)
    return figure


def histogram_figure(values: Mapping[str, Floats], label: str) -> Figure:
    """Return Freedman-Diaconis histograms, each with its kernel density mode; ``label`` carries the unit.

    Parameters
    ----------
    values : mapping of str to ndarray
        Samples by name.
    label : str

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, (axis,) = _figure(1)
    for i, (name, sample) in enumerate(values.items()):
        density, edges = histogram(sample)
        axis.stairs(density, edges, fill=True, alpha=0.35, color=f"C{i % 10}", label=name)
        axis.axvline(kernel_density_mode(sample), color=f"C{i % 10}", lw=1)
    axis.set(xlabel=label, ylabel="probability density")
    if len(values) <= 12:
        axis.legend(frameon=False, fontsize=8)
    return figure


def spectrum_figure(spectrum: Spectrum, label: str, line: Line | None = None) -> Figure:
    """Return a power spectral density on logarithmic axes, its peak marked; ``label`` names the unit.

    Parameters
    ----------
    spectrum : Spectrum
    label : str
    line : Line, optional
        Background of coloured noise, and what of noise alone hardly exceeds it.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, (axis,) = _figure(1)
    shown = spectrum.frequency > 0
    axis.loglog(spectrum.frequency[shown], np.maximum(spectrum.density[shown], 1e-30), lw=0.8)
    if line is not None and line.background.any():
        axis.loglog(spectrum.frequency[shown], line.background[shown], lw=1, color="0.3", label="red and white noise")
        most = line.threshold * line.background[shown]
        axis.loglog(
            spectrum.frequency[shown], most, "--", lw=1, color="0.3", label="noise alone exceeds it once in 100"
        )
        axis.legend(frameon=False)
    if np.isfinite(spectrum.peak):
        axis.axvline(spectrum.peak, color="C1", lw=1, label=f"peak at {spectrum.peak:.4g} Hz")
        axis.legend(frameon=False)
        top = spectrum.density[shown].max()
        axis.set_ylim(1e-9 * top, 3 * top)
    axis.set(xlabel="frequency [Hz]", ylabel=f"power spectral density [{label}^2/Hz]")
    return figure


def profile_figure(x: Floats, z: Floats, result: RidgeResult) -> Figure:
    """Return a levelled profile with the mean height and width of its ridges in the title.

    Parameters
    ----------
    x : ndarray (n,)
        [mm].
    z : ndarray (n,)
        [mm].
    result : RidgeResult

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, (axis,) = _figure(1)
    axis.plot(x, 1e3 * z, lw=0.7)
    height, width = 1e3 * result.height.mean, 1e3 * result.width.mean
    title = f"height {height:.2f} um, width {width:.1f} um, n = {result.height.count}"
    axis.set(xlabel="position [mm]", ylabel="height [um]", title=title)
    return figure


def map_figure(height: Floats, pitch: float, result: RidgeResult) -> Figure:
    """Return a height map with the direction along its ridges.

    Parameters
    ----------
    height : ndarray (rows, cols)
        [mm].
    pitch : float
        [mm].
    result : RidgeResult

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, (axis,) = _figure(1)
    axis.grid(visible=False)
    rows, cols = height.shape
    step = max(1, max(rows, cols) // 1024)
    image = axis.imshow(1e3 * height[::step, ::step], extent=(0, cols * pitch, rows * pitch, 0), cmap="cividis")
    half = 0.4 * min(rows, cols) * pitch
    middle = np.array([cols, rows]) * pitch / 2
    along = half * np.array([np.cos(result.orientation), np.sin(result.orientation)])
    axis.plot(*np.stack([middle - along, middle + along], axis=1), "w--", lw=1)
    axis.set(xlabel="x [mm]", ylabel="y [mm]")
    figure.colorbar(image, ax=axis, label="height [um]")
    return figure
