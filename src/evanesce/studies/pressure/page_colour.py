"""Findings and page of the pressure study of a scene with a colour camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.report.charts import Map, Maps
from evanesce.report.html import Table
from evanesce.studies.pressure.colour import ColourPressure
from evanesce.studies.registry import Findings

Floats = NDArray[np.float64]

GREY, BLUE, RED = "grey of the frame", "blue of the frame", "raw red, at less exposure"
MODEL = "raw red at less exposure, roughness model"


def colour_findings(found: ColourPressure) -> Findings:
    """Return table, maps and verdict.

    Parameters
    ----------
    found : ColourPressure

    Returns
    -------
    Findings
    """
    rows = [asdict(row) for row in found.rows]
    verdict = [
        f"Correlation with the true pressure: {_span(rows, GREY)} of the grey, {_span(rows, BLUE)} of blue alone, "
        f"{_span(rows, RED)} of raw red at an exposure that does not clip; by the roughness model "
        f"{_span(rows, MODEL)} (smallest and largest over the presses).",
        f"RMS error of the map scaled to the force: {_span(rows, GREY, 'rms_percent', '.0f')} % of the peak of the "
        f"grey, {_span(rows, RED, 'rms_percent', '.1f')} % of raw red, {_span(rows, MODEL, 'rms_percent', '.1f')} % by "
        "the roughness model.",
    ]
    maps = [_maps(found.maps)] if found.maps else []
    return Findings(verdict=verdict, maps=maps, tables=[_table(rows)], data={"colour_rows": rows})


def _span(rows: Sequence[Mapping[str, Any]], what: str, key: str = "correlation", form: str = ".2f") -> str:
    values = [row[key] for row in rows if row["what"] == what and row[key] is not None]
    return f"{min(values):{form}} to {max(values):{form}}" if values else "none"


def _maps(maps: Mapping[str, Floats]) -> Maps:
    top = float(maps["true"].max())
    shown = [Map(title=name, values=maps[name], top=top) for name in ("true", GREY, BLUE, RED) if name in maps]
    caption = "Pressure of the first press, and maps that are scaled to the force."
    return Maps(rows=[shown], labels=["pressure [MPa]"], caption=caption)


def _table(rows: Sequence[Mapping[str, Any]]) -> Table:
    return Table(
        columns=("RMS slope [1]", "force [N]", "exposure x gain [ms]", "map of", "correlation", "RMS [% of peak]",
                 "at full scale [%]", "5 to 95 % of the contact"),
        rows=[
            (
                f"{r['rms_slope']:g}", f"{r['force_N']:g}", f"{r['exposure']:.3g}", r["what"],
                "flat" if r["correlation"] is None else f"{r['correlation']:.3f}", f"{r['rms_percent']:.1f}",
                f"{100 * r['full_share']:.0f}", f"{r['span'][0]:.2f} to {r['span'][1]:.2f}",
            )
            for r in rows
        ],
        caption="Over the true contact's pixels. A map is scaled to the force within the dilated mask.",
    )  # fmt: skip
