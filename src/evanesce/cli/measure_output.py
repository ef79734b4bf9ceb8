"""What ``evanesce measure`` writes and prints."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from rich.markup import escape
from rich.table import Table

from evanesce.cli.common import console, messages, out_dir, write_json, write_text
from evanesce.cli.measure_job import Job, Result
from evanesce.core import provenance
from evanesce.measurement.plots import (
    area_figure,
    histogram_figure,
    intensity_figure,
    overlay_figure,
    save_figure,
    threshold_figure,
)
from evanesce.measurement.reference.area import summary, to_csv, to_plain
from evanesce.measurement.uncertainty.table import budget_table

TABLE_ROWS = 24
NAMES = {"reference": "reference segmentation", "refined": "refined estimator"}


def record(job: Job, result: Result) -> dict[str, Any]:
    """Return everything of a result as JSON-able data."""
    pipeline, chain = job.pipeline, job.pipeline.settings
    settings = {
        "threshold": chain.threshold,
        "min_blob_px": chain.min_blob,
        "blur_px": chain.blur,
        "dilation_radius_px": chain.radius,
        "crop": str(chain.crop),
        "mm2_per_px": pipeline.scale_mm2_per_px,
        "undistort": pipeline.rectified is not None,
        "estimator": pipeline.estimator,
    }
    if pipeline.refined is not None:
        scattering, blur = pipeline.refined.settings.scattering, pipeline.refined.settings.blur
        settings |= {
            "tune": str(job.tune) if job.tune else None,
            "scattering": asdict(scattering) if scattering else None,
            "camera_blur": blur.as_dict(),
        }
    view = pipeline.rectified
    extra: dict[str, Any] = {}
    if job.free is not None:
        extra["dark_frames"] = list(job.free)
    if result.levels is not None:
        extra["edge_levels"] = {"frame": result.peak.estimate.index, **result.levels.as_dict()}
        extra["area_against_threshold"] = result.curve
    if job.beside is not None:
        extra["reference"] = {
            "mm2_per_px": job.beside.scale_mm2_per_px, "threshold": job.beside.settings.threshold,
            "apart": asdict(result.apart) if result.apart else None,
        }  # fmt: skip
    return {
        "frames": to_plain(result.rows),
        "complete": job.stream.complete,
        "summary": summary(result.rows),
        "budget": {"frame": result.peak.estimate.index, **budget_table(result.budget)},
        **extra,
        "warnings": [{"code": w.code, "text": w.text} for w in result.warnings],
        "settings": settings,
        "input": str(job.path),
        "calibration": str(job.calibration) if job.calibration else None,
        "view": {"origin_px": list(view.origin), "shape_px": list(view.shape)} if view else None,
        "provenance": dict(provenance.record(config=settings)),
    }


def write_files(job: Job, result: Result, data: dict[str, Any]) -> None:
    """Write table, record and pictures into the output folder."""
    folder = out_dir(job.out, "measure")
    index = f"{result.peak.estimate.index:06d}"
    chain, scale = job.pipeline.settings, job.pipeline.scale_mm2_per_px
    write_text(folder / "area.csv", to_csv(result.rows))
    save_figure(area_figure(result.rows, NAMES[job.pipeline.estimator]), folder / "area.png")
    save_figure(overlay_figure(result.peak, scale), folder / f"overlay_{index}.png")
    save_figure(intensity_figure(result.peak, scale), folder / f"intensity_{index}.png")
    save_figure(histogram_figure(result.peak, chain.threshold, chain.blur), folder / f"histogram_{index}.png")
    if result.levels is not None and result.curve:
        figure = threshold_figure(result.curve, chain.threshold, result.levels.half, result.peak.estimate.index)
        save_figure(figure, folder / "threshold.png")
    write_json(folder / "result.json", data)


def show(job: Job, result: Result) -> None:
    """Print the table, thinned if it is long, what explains it, and the warnings."""
    threshold = job.pipeline.settings.threshold
    name = NAMES[job.pipeline.estimator]
    counted = job.pipeline.estimator == "reference"
    table = Table(title=f"contact area by the {name}" + (f", threshold {threshold:.4g}" if counted else ""),
                  title_justify="left")  # fmt: skip
    beside = any(not math.isnan(row.reference_mm2) for row in result.rows)
    names = ["frame", "time [s]", "pixels", "area [mm²]"]
    names += [*(["corrected [mm²]"] if counted else []), "95 % interval [mm²]", "blobs"]
    names += [f"reference at {threshold:.3g} [mm²]", "difference [%]"] if beside else []
    for column in names:
        table.add_column(escape(column), justify="right")  # "[s]" would be read as a style
    step = max(1, math.ceil(len(result.rows) / TABLE_ROWS))
    for row in result.rows[::step]:
        time = "" if math.isnan(row.time_s) else f"{row.time_s:.3f}"
        cells = [str(row.index), time, str(row.pixels), f"{row.area_mm2:.3f}" + ("*" if row.outside else "")]
        cells += [f"{row.corrected_mm2:.3f}"] if counted else []
        cells += [f"{row.area_low_mm2:.3f} to {row.area_high_mm2:.3f}", str(row.blobs)]
        if beside:
            more = 100.0 * (row.reference_mm2 / row.area_mm2 - 1.0) if row.area_mm2 > 0 else math.nan
            cells += [f"{row.reference_mm2:.3f}", "" if math.isnan(more) else f"{more:+.1f}"]
        table.add_row(*cells)
    console.print(table)
    total = summary(result.rows)
    thinned = f" (every {step}th shown)" if step > 1 else ""
    console.print(
        f"{total['frames']} frames{thinned}, area {total['area_min_mm2']:.3f} to {total['area_max_mm2']:.3f} mm², "
        f"greatest in frame {total['area_max_index']}"
    )
    for line in _explained(job, result):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    if result.budget.area_mm2 > 0:
        _show_budget(result)
    for warning in result.warnings:
        line = f"warning: {warning.code}: {warning.text}"
        messages.print(line, style="yellow", markup=False, highlight=False, soft_wrap=True)


def _explained(job: Job, result: Result) -> list[str]:
    """Return the lines that say what the table's figures rest on."""
    lines = []
    outside = sum(row.outside for row in result.rows)
    if outside:
        parts = [part for part in result.budget.components if part.role in ("boundary", "height")]
        cause = max(parts, key=lambda part: abs(part.mean) * (part.role == "boundary"), default=None)
        why = f" ({cause.name}: {cause.origin})" if cause is not None else ""
        lines.append(
            f"* in {outside} of {len(result.rows)} frame(s) the area as read lies outside the interval, which"
            f" is that of the area corrected for known deviations{why}"
        )
    if job.free:
        lines.append(f"dark frame: mean of {len(job.free)} frame(s) without a finger, {job.free[0]} to {job.free[-1]};"
                     " --dark none leaves it out")  # fmt: skip
    elif job.free is not None:
        lines.append("dark frame: none, no frames without a finger were found; dust beside the contact may count")
    if result.apart is not None and result.levels is not None:
        lines.append(result.apart.text(job.pipeline.settings.threshold, result.levels))
    return [*job.notes, *lines]


def _show_budget(result: Result) -> None:
    plain = budget_table(result.budget)
    title = f"standard uncertainty of the area in frame {result.peak.estimate.index}, and of the conversion factor"
    table = Table(title=title, title_justify="left")
    for name in ("component", "area [%]", "conversion factor [%]"):
        table.add_column(escape(name), justify="left" if name == "component" else "right")
    for row in [*plain["components"], {"name": "together", **plain["together"]}]:
        factor = row["factor_percent"]
        table.add_row(row["name"], f"{row['area_percent']:.3f}", "" if factor is None else f"{factor:.3f}")
    console.print(table)
