"""A sensor's bench test reduced: photon transfer, dark signal, PRNU, DSNU, linearity of each kind of pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from evanesce.bench.dark_signal import (
    Acceleration,
    DarkFit,
    DarkSeries,
    TemperatureLaw,
    acceleration,
    fit_dark,
    temperature_law,
)
from evanesce.bench.frame_stack import StackRow
from evanesce.bench.photon_transfer import USED_SHARE, Linearity, PhotonTransfer, fit_photon_transfer, linearity
from evanesce.bench.sensor_tables import TransferTable, by_kind
from evanesce.core.errors import InputError, WorkError

Floats = NDArray[np.float64]

CLIPPED = 1e-3
"""Share of samples at an end of the converter above which a row's variance is cut: such rows are in saturation."""
LEAST_COVERED = 5
"""Exposures of covered frames that a fit of three coefficients and an exponent needs."""


@dataclass(frozen=True)
class Transfer:
    """Photon transfer of one kind of pixels, with the rows that it is of.

    Attributes
    ----------
    name : str
    signal_DN, variance_DN2 : ndarray (n,)
        Above the black level [DN], [DN^2].
    fit : PhotonTransfer
    prnu, prnu_se : float
        Of a stack, from the spatial variance; of a table, that of the quadratic term [1].
    dsnu_e : float
        Of a stack: spatial standard deviation of the shortest covered exposure [e-]; NaN otherwise.
    line : Linearity or None
        Where exposures are known.
    correlation : tuple of float
        Of the temporal noise of neighbours of one kind along rows and columns, mean over the lit rows; NaN of a table.
    correlation_se : float
        Of each of the two [1].
    doubts : tuple of str
        What makes the figures doubtful.
    """

    name: str
    signal_DN: Floats
    variance_DN2: Floats
    fit: PhotonTransfer
    prnu: float
    prnu_se: float
    dsnu_e: float = float("nan")
    line: Linearity | None = None
    correlation: tuple[float, float] = (float("nan"), float("nan"))
    correlation_se: float = float("nan")
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Dark:
    """Dark signal of one sensor.

    Attributes
    ----------
    series : tuple of DarkSeries
    fits : tuple of DarkFit
        One for each series.
    factors : tuple of Acceleration
        For each kind of pixels, of each pair of neighbouring temperatures.
    law : TemperatureLaw or None
        None for one temperature.
    """

    series: tuple[DarkSeries, ...] = ()
    fits: tuple[DarkFit, ...] = ()
    factors: tuple[Acceleration, ...] = ()
    law: TemperatureLaw | None = None


@dataclass(frozen=True)
class SensorFigures:
    """Everything a bench test of a sensor gives.

    Attributes
    ----------
    transfers : tuple of Transfer
    dark : Dark
    black_DN : float
        Mean of the shortest covered exposure; NaN without one [DN].
    notes : tuple of str
        What was measured and could not be reduced.
    """

    transfers: tuple[Transfer, ...] = ()
    dark: Dark = field(default_factory=Dark)
    black_DN: float = float("nan")
    notes: tuple[str, ...] = ()


def of_table(table: TransferTable, black_DN: float) -> Transfer:
    """Reduce the rows of one kind of pixels; the variance may be of one frame's pixels or of differences.

    Parameters
    ----------
    table : TransferTable
    black_DN : float
        Black level [DN].

    Returns
    -------
    Transfer

    Raises
    ------
    InputError
        If most means lie below the black level.
    WorkError
        As :func:`evanesce.bench.photon_transfer.fit_photon_transfer`.
    """
    signal = table.mean_DN - black_DN
    if np.median(signal) <= 0.0:
        raise InputError(
            f"most means lie below the black level of {black_DN:g} DN: {table.mean_DN.min():.4g} to"
            f" {table.mean_DN.max():.4g} DN", key="--black-level-DN", allowed="that of the same frames",
        )  # fmt: skip
    fit = fit_photon_transfer(signal, table.variance_DN2)
    doubts = []
    if signal.min() < -1.0:
        doubts.append(f"means down to {table.mean_DN.min():.1f} DN lie below the black level of {black_DN:g} DN")
    if not np.isfinite(fit.prnu):
        doubts.append("the variance grows less than in proportion: frames were filtered, or light saturates pixels")
    elif fit.prnu > 3.0 * fit.prnu_se:
        doubts.append("the quadratic term holds what the light varies by over the region as well as PRNU")
    if not np.isfinite(fit.read_noise_e):
        doubts.append("no variance is left without light: no read noise")
    return Transfer(table.name, signal, table.variance_DN2, fit, fit.prnu, fit.prnu_se, doubts=tuple(doubts))


def of_stack(rows: Sequence[StackRow], black_DN: float) -> SensorFigures:
    """Reduce the rows of a stack of frames.

    Parameters
    ----------
    rows : sequence of StackRow
    black_DN : float
        Black level where no frame is covered [DN].

    Returns
    -------
    SensorFigures

    Raises
    ------
    WorkError
        If neither a photon transfer curve nor a dark series can be made of them.
    """
    names = list(dict.fromkeys(row.name for row in rows))
    transfers = [_transfer([r for r in rows if r.name == n], black_DN) for n in names if _lit(rows, n)]
    series, notes = [], []
    for name in names:
        made, short = _dark_series([r for r in rows if r.name == name])
        series += made
        notes += short
    if not transfers and not series:
        raise WorkError(
            f"neither 6 lit exposures nor {LEAST_COVERED} covered ones: nothing to reduce"
            + "".join(f"; {n}" for n in notes)
        )
    covered = [row for row in rows if row.light == 0.0]
    shortest = min((row.exposure_s for row in covered), default=None)
    black = [row.mean_DN for row in covered if row.exposure_s == shortest]
    return SensorFigures(
        tuple(transfers), of_dark(series), float(np.mean(black)) if black else float("nan"), tuple(dict.fromkeys(notes))
    )


def of_dark(series: Sequence[DarkSeries]) -> Dark:
    """Fit each dark series and, over temperatures, the law of the dark current.

    Parameters
    ----------
    series : sequence of DarkSeries
        ``all`` is left out of the temperature law where there are other kinds: it consists of them.

    Returns
    -------
    Dark
    """
    fits = tuple(fit_dark(one) for one in series)
    kinds = by_kind(list(series))
    factors = []
    for name, ordered in kinds.items():
        if name == "all" and len(kinds) > 1:
            continue
        factors += [acceleration(cold, warm) for cold, warm in pairwise(ordered)]
    return Dark(tuple(series), fits, tuple(factors), temperature_law(factors) if factors else None)


def _lit(rows: Sequence[StackRow], name: str) -> bool:
    return any(row.light > 0.0 and row.exposure_s > 0.0 for row in rows if row.name == name)


def _transfer(rows: Sequence[StackRow], black_DN: float) -> Transfer:
    """Return the photon transfer of the lit rows of one kind, each less the dark signal of its exposure."""
    lit = sorted((r for r in rows if r.light > 0.0 and r.exposure_s > 0.0), key=lambda r: r.mean_DN)
    covered = sorted((r for r in rows if r.light == 0.0), key=lambda r: r.exposure_s)
    black = np.full(len(lit), black_DN)
    if covered:
        black = np.interp([r.exposure_s for r in lit], [r.exposure_s for r in covered], [r.mean_DN for r in covered])
    signal = np.array([r.mean_DN for r in lit]) - black
    variance = np.array([r.temporal_DN2 for r in lit])
    unclipped = np.array([r.clipped < CLIPPED for r in lit])
    doubts = [] if covered else [f"no covered frames: a black level of {black_DN:g} DN is assumed"]
    limit = None if unclipped.all() else USED_SHARE * float(signal[~unclipped].min())
    # The shortest covered exposure is the curve's foot.
    foot = covered[:1]
    fit = fit_photon_transfer(
        np.append(signal, [0.0] * len(foot)), np.append(variance, [r.temporal_DN2 for r in foot]), quadratic=False,
        limit_DN=limit,
    )  # fmt: skip
    if fit.saturation_DN is None and limit is not None:
        fit = replace(fit, saturation_DN=float(signal[~unclipped].min()))
    used = signal <= fit.limit_DN
    prnu, prnu_se = _prnu(signal[used], np.array([r.spatial_DN2 for r in lit])[used], foot)
    dsnu = float(np.sqrt(max(foot[0].spatial_DN2, 0.0)) * fit.gain_e_per_DN) if foot else float("nan")
    line = None
    exposure = np.array([r.exposure_s * r.light for r in lit])
    if np.unique(exposure).size > 3:
        try:
            line = linearity(exposure, signal, fit.saturation_DN)
        except WorkError as error:
            doubts.append(str(error))
    both = [np.array([r.correlation[k] for r in lit])[used] for k in (0, 1)]
    correlation = (float(both[0].mean()), float(both[1].mean()))
    correlation_se = float(np.sqrt(np.mean([1.0 / (r.pixels * (r.frames - 1)) for r in lit]) / max(used.sum(), 1)))
    if max(map(abs, correlation)) > max(5.0 * correlation_se, 0.01):
        doubts.append(
            f"noise of neighbours is correlated ({correlation[0]:+.3f} along rows, {correlation[1]:+.3f} along"
            " columns): frames were filtered, gain and read noise are not the pixel's own"
        )
    return Transfer(
        rows[0].name, signal, variance, fit, prnu, prnu_se, dsnu, line, correlation, correlation_se,
        tuple(doubts),
    )  # fmt: skip


def _prnu(signal: Floats, spatial: Floats, foot: Sequence[StackRow]) -> tuple[float, float]:
    """Return PRNU from spatial variance = dsnu^2 + (prnu signal)^2, and its standard error by the rows' scatter."""
    dark = foot[0].spatial_DN2 if foot else 0.0
    ratio = (spatial - dark) / np.maximum(signal, 1e-9) ** 2
    # Sampling noise of a spatial variance weighs as its temporal share: rows of much signal say most.
    weight = signal**2
    square = float(np.sum(weight * ratio) / np.sum(weight))
    error = float(np.sqrt(np.sum(weight**2 * (ratio - square) ** 2)) / np.sum(weight))
    if not square > 0.0:
        return 0.0, float(np.sqrt(error))
    return float(np.sqrt(square)), float(error / (2.0 * np.sqrt(square)))


def _dark_series(rows: Sequence[StackRow]) -> tuple[list[DarkSeries], list[str]]:
    """Return the covered rows of one kind, a series for each temperature, and what is said of those too short."""
    found, short = [], []
    covered = [row for row in rows if row.light == 0.0]
    for at in sorted({float(np.nan_to_num(row.temperature_C, nan=20.0)) for row in covered}):
        here = sorted(
            (r for r in covered if np.nan_to_num(r.temperature_C, nan=20.0) == at), key=lambda r: r.exposure_s
        )
        exposures = len({r.exposure_s for r in here})
        if exposures < LEAST_COVERED:
            if exposures > 1:
                short.append(
                    f"no dark current at {at:g} degC: covered frames of {exposures} exposures, {LEAST_COVERED} needed"
                )
            continue
        columns = np.array([(r.exposure_s, r.temporal_DN2, r.mean_DN, r.spatial_DN2) for r in here]).T
        found.append(DarkSeries(rows[0].name, at, *columns))
    return found, short
