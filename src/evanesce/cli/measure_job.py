"""The work behind ``evanesce measure``, apart from its options so that asking for help stays quick."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.markup import escape
from rich.table import Table

from evanesce.api.measure import Measurement, Pipeline
from evanesce.cli.common import console, messages, named_options, out_dir, progress, write_json, write_text
from evanesce.core import provenance
from evanesce.core.errors import InputError
from evanesce.measurement.calibration.model import load_calibration
from evanesce.measurement.io.frames import FrameStream, open_frames
from evanesce.measurement.plots import (
    OverlayVideo,
    area_figure,
    histogram_figure,
    intensity_figure,
    overlay,
    overlay_figure,
    save_figure,
)
from evanesce.measurement.reference.area import AreaRow, Measured, summary, to_csv, to_plain
from evanesce.measurement.reference.segment import Chain
from evanesce.measurement.uncertainty.budget import Finger, Uncertain
from evanesce.measurement.uncertainty.table import budget_table
from evanesce.measurement.warnings import EdgeLog, FrameLog, Warning, scale_warning

TABLE_ROWS = 24
VIEWING_RATE = 30.0
"""Frame rate of an overlay video whose source states none [Hz]; it is for the eye only."""


MAX_DARK_FRAMES = 64
"""Number of dark or flat frames that are averaged: with more their noise is below the resolution of 8 bits."""


OPTIONS = {"calibration": "--calibration", "scale_mm2_per_px": "--mm2-per-px", "tune": "--tune",
           "camera_model": "--camera-model"}  # fmt: skip
"""Parameters of :class:`evanesce.api.measure.Pipeline` by the options that set them."""


@dataclass(frozen=True)
class Refined:
    """Options of the refined estimator: dark and flat frames, finger, and the frame that it is tuned on."""

    dark: Path | None
    flat: Path | None
    finger: Finger
    tune: Path | None = None
    camera_model: str | None = None


def refined_options(
    estimator: str, dark: Path | None, flat: Path | None, finger: str, tune: Path | None = None,
    camera_model: str | None = None,
) -> Refined | None:  # fmt: skip
    """Check the choice of an estimator; None is the reference segmentation.

    Raises
    ------
    InputError
        If the name is not known, or shots are given that the reference segmentation does not use.
    """
    if estimator not in ("reference", "refined"):
        raise InputError(f"'{estimator}'", key="--estimator", allowed="reference, refined")
    if estimator == "refined":
        kinds: dict[str, Finger] = {"ridged": "ridged", "smooth": "smooth"}
        if finger in kinds:
            return Refined(dark, flat, kinds[finger], tune, camera_model)
        raise InputError(f"'{finger}'", key="--finger", allowed="ridged, smooth")
    for key, path in (("--dark", dark), ("--flat", flat), ("--tune", tune), ("--camera-model", camera_model)):
        if path is not None:
            raise InputError("the reference segmentation does not use it", key=key, allowed="with --estimator refined")
    return None


@dataclass(frozen=True)
class Job:
    """What is to be done, checked."""

    path: Path
    pipeline: Pipeline
    calibration: Path | None
    out: Path | None
    stream: FrameStream
    warnings: tuple[Warning, ...]
    tune: Path | None = None


@dataclass(frozen=True)
class Result:
    """What came of it: the table, the frame of the largest area with its budget, the warnings."""

    rows: list[AreaRow]
    peak: Measured
    warnings: list[Warning]
    budget: Uncertain


def prepare(
    path: Path,
    chain: Chain,
    *,
    calibration: Path | None,
    fps: float | None,
    mm2_per_px: float | None,
    undistort: bool,
    out: Path | None,
    refined: Refined | None = None,
) -> Job:
    """Check everything that can be checked before a frame is read.

    Raises
    ------
    InputError
        If something is missing, unreadable or out of range.
    """
    if out is not None and out.exists() and not out.is_dir():
        raise InputError("is a file", file=out, key="--out", allowed="a folder")
    if not path.exists():  # before the options: it is the first thing to say
        open_frames(path, fps)
    stored = load_calibration(calibration) if calibration is not None else None
    shots = [_shots(path) for path in ((None, None) if refined is None else (refined.dark, refined.flat))]
    with named_options(OPTIONS):
        pipeline = Pipeline(
            calibration=stored, scale_mm2_per_px=mm2_per_px, threshold=chain.threshold, undistort=undistort,
            estimator="reference" if refined is None else "refined", min_blob_px=chain.min_blob, blur_px=chain.blur,
            dilation_px=chain.radius, crop=chain.crop, dark=shots[0], flat=shots[1],
            tune=None if refined is None else refined.tune, finger="ridged" if refined is None else refined.finger,
            camera_model=None if refined is None else refined.camera_model,
        )  # fmt: skip
    if undistort and stored is None:
        raise InputError("is needed to undistort", key="--calibration", allowed="a calibration file, or --no-undistort")
    extra = scale_warning(stored.mm2_per_px if stored else None, mm2_per_px)
    return Job(
        path=path,
        pipeline=pipeline,
        calibration=calibration,
        out=out,
        stream=open_frames(path, fps),
        warnings=(extra,) if extra else (),
        tune=None if refined is None else refined.tune,
    )


def _shots(path: Path | None) -> list[NDArray[np.uint8]]:
    return [frame.data for frame in islice(open_frames(path), MAX_DARK_FRAMES)] if path else []


def run(job: Job) -> Result:
    """Measure every frame, holding one at a time and that of the largest area.

    Raises
    ------
    InputError
        If there is no readable frame, or the crop or calibration does not fit.
    """
    stream = job.stream
    rows: list[AreaRow] = []
    refined = job.pipeline.refined
    known = refined is None or refined.settings.blur.origin != "nominal"
    log, edges = FrameLog(job.pipeline.settings.threshold), EdgeLog(blur_known=known)
    peak: Measurement | None = None
    with ExitStack() as stack:
        bar = stack.enter_context(progress())
        task = bar.add_task("measure", total=stream.count)
        video: OverlayVideo | None = None
        for frame in stream:
            found = job.pipeline.measure(frame, lossy=stream.stated_rate is not None)
            if job.out is not None and stream.count != 1:
                if video is None:  # only now is it known that the input is good, so that a folder may be made
                    folder = out_dir(job.out, "measure")
                    rate = stream.given_rate or stream.stated_rate or VIEWING_RATE
                    video = stack.enter_context(OverlayVideo(folder / "overlay.mp4", rate))
                video.add(overlay(found.view, found.mask))
            rows.append(AreaRow.of(found.measured, found.interval_mm2))
            log.add(found.measured.figures)
            if found.refined is not None:
                edges.add(found.index, found.refined.unseen, found.refined.colour_unread)
            if peak is None or found.pixels > peak.pixels:
                peak = found
            bar.advance(task)
    if peak is None:
        stream.finish()
        raise InputError("no readable frame", file=job.path)
    warnings = [*job.warnings, *stream.warnings, *log.warnings(), *edges.warnings(len(rows))]
    return Result(rows, peak.measured, warnings, peak.uncertainty)


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
    return {
        "frames": to_plain(result.rows),
        "complete": job.stream.complete,
        "summary": summary(result.rows),
        "budget": {"frame": result.peak.estimate.index, **budget_table(result.budget)},
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
    save_figure(area_figure(result.rows), folder / "area.png")
    save_figure(overlay_figure(result.peak, scale), folder / f"overlay_{index}.png")
    save_figure(intensity_figure(result.peak, scale), folder / f"intensity_{index}.png")
    save_figure(histogram_figure(result.peak, chain.threshold, chain.blur), folder / f"histogram_{index}.png")
    write_json(folder / "result.json", data)


def show(result: Result) -> None:
    """Print the table, thinned if it is long, and the warnings."""
    table = Table(title="contact area", title_justify="left")
    for name in ("frame", "time [s]", "pixels", "area [mm²]", "95 % interval [mm²]", "blobs"):
        table.add_column(escape(name), justify="right")  # "[s]" would be read as a style
    step = max(1, math.ceil(len(result.rows) / TABLE_ROWS))
    for row in result.rows[::step]:
        time = "" if math.isnan(row.time_s) else f"{row.time_s:.3f}"
        between = f"{row.area_low_mm2:.3f} to {row.area_high_mm2:.3f}"
        table.add_row(str(row.index), time, str(row.pixels), f"{row.area_mm2:.3f}", between, str(row.blobs))
    console.print(table)
    total = summary(result.rows)
    thinned = f" (every {step}th shown)" if step > 1 else ""
    console.print(
        f"{total['frames']} frames{thinned}, area {total['area_min_mm2']:.3f} to {total['area_max_mm2']:.3f} mm², "
        f"greatest in frame {total['area_max_index']}"
    )
    if result.budget.area_mm2 > 0:
        _show_budget(result)
    for warning in result.warnings:
        line = f"warning: {warning.code}: {warning.text}"
        messages.print(line, style="yellow", markup=False, highlight=False, soft_wrap=True)


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
