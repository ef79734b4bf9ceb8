"""``evanesce bench sensor --terms``: what the scene's sensor model lacks, by evidence and by held-out rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from evanesce.cli.common import console, progress
from evanesce.core.errors import InputError

if TYPE_CHECKING:
    from evanesce.bench.sensor import Dark, Transfer
    from evanesce.inference.sensor.law import Kind, VarianceSeries
    from evanesce.rig.camera import Pixel

LEAST_ROWS = 15
"""Rows of a series below which five stretches of it say nothing."""


def lacking_terms(transfers: Sequence[Transfer], gains: Sequence[float], dark: Dark, pixel: Pixel) -> dict[str, Any]:
    """Return and print which terms the sensor model lacks, for photon transfer and for dark series.

    Parameters
    ----------
    transfers : sequence of Transfer
    gains : sequence of float
        Analogue gain of each.
    dark : Dark
    pixel : Pixel
        Nominal.

    Returns
    -------
    dict
        By ``transfer`` and ``dark``.

    Raises
    ------
    InputError
        If no series has fifteen rows.
    """
    data: Mapping[Kind, list[VarianceSeries]] = {
        "transfer": _of_transfers(transfers, gains), "dark": _of_dark(dark)
    }  # fmt: skip
    if not any(data.values()):
        raise InputError("no series of 15 rows", key="--terms", allowed=f"tables or stacks of {LEAST_ROWS} exposures")
    found: dict[str, Any] = {}
    for kind, series in data.items():
        if not series:
            continue
        found[kind] = _compared(series, kind, pixel)
        _print(found[kind])
    return found


def _compared(series: list[VarianceSeries], kind: Kind, pixel: Pixel) -> dict[str, Any]:
    from evanesce.inference.sensor.compare import compare

    with progress() as bar:
        task = bar.add_task(f"terms of {kind} rows", total=None)
        result = compare(series, kind, pixel, lambda done, of: bar.update(task, completed=done, total=of))
    return result.as_dict()


def _of_transfers(transfers: Sequence[Transfer], gains: Sequence[float]) -> list[VarianceSeries]:
    from evanesce.inference.sensor.law import VarianceSeries

    series = []
    for one, gain in zip(transfers, gains, strict=True):
        order = np.argsort(one.signal_DN)
        x, variance = one.signal_DN[order], one.variance_DN2[order]
        used = (x <= one.fit.limit_DN) & (variance > 0.0)
        if used.sum() >= LEAST_ROWS:
            pixels = one.name.rpartition(": ")[2]
            series.append(VarianceSeries(one.name, pixels, x[used], variance[used], gain))
    return series


def _of_dark(dark: Dark) -> list[VarianceSeries]:
    from evanesce.inference.sensor.law import VarianceSeries

    several = len({one.name for one in dark.series}) > 1
    return [
        VarianceSeries(
            f"{one.name}, {one.temperature_C:g} degC", one.name, one.exposure_s, one.variance_DN2,
            one.analogue_gain, one.temperature_C,
        )
        for one in dark.series
        if one.exposure_s.size >= LEAST_ROWS and not (several and one.name == "all")
    ]  # fmt: skip


def _print(found: dict[str, Any]) -> None:
    gain, rms = found["held_out_gain"], found["held_out_rms"]
    shown = Table(
        title=f"what the sensor model lacks, by {found['rows']} {found['rows_of']} rows",
        caption=(
            f"held-out rows: log score {gain[0]:+.4g} nats over the nominal model (95 %: {gain[1]:+.4g} to"
            f" {gain[2]:+.4g}); variance off by {100 * rms[1]:.3g} % RMS in the logarithm, before {100 * rms[0]:.3g} %"
        ),
    )
    for heading in ("term", "key of camera.pixel", "value", "log evidence", "folds", "held-out gain [nats]"):
        shown.add_column(heading)
    for term in found["terms"]:
        values = list(term["values"].values())
        value = f"{values[0]:.4g}" if len(values) == 1 else f"{min(values):.4g} to {max(values):.4g}"
        low = term["held_out_gain"]
        shown.add_row(
            term["words"], term["key"] or "none", value, f"{term['log_evidence']:+.4g}",
            f"{term['chosen_in_folds']} of {found['folds']}", f"{low[0]:+.4g} ({low[1]:+.4g} to {low[2]:+.4g})",
        )  # fmt: skip
    if not found["terms"]:
        shown.add_row("none: the nominal model predicts the rows", "", "", "", "", "")
    console.print(shown)
