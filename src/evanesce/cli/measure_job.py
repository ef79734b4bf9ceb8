"""The work behind ``evanesce measure``, apart from its options so that asking for help stays quick."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evanesce.api.measure import EstimatorName, Measurement, Pipeline
from evanesce.cli.common import named_options, out_dir, progress
from evanesce.core.errors import InputError
from evanesce.core.states import Frame
from evanesce.evaluation.camera_model import raw_model
from evanesce.measurement.apart import Apart, apart
from evanesce.measurement.calibration.model import load_calibration
from evanesce.measurement.doubts import FilmLog, dark_warning
from evanesce.measurement.io.frames import FrameStream, open_frames
from evanesce.measurement.levels import EdgeLevels, edge_levels, luma_light, threshold_curve, threshold_warning
from evanesce.measurement.plots import OverlayVideo, overlay
from evanesce.measurement.reference.area import AreaRow, Measured
from evanesce.measurement.reference.segment import Chain, Crop
from evanesce.measurement.refined.light import tone_table
from evanesce.measurement.refined.raw import RawModel
from evanesce.measurement.survey import Scene, is_free, look_through
from evanesce.measurement.uncertainty.budget import Finger, Uncertain
from evanesce.measurement.warnings import EdgeLog, FrameLog, Warning, scale_warning

VIEWING_RATE = 30.0
"""Frame rate of an overlay video whose source states none [Hz]; it is for the eye only."""


MAX_DARK_FRAMES = 64
"""Number of dark or flat frames that are averaged: with more their noise is below the resolution of 8 bits."""


DARK_WORDS = ("auto", "none")
"""Values of ``--dark`` that are no path: the recording's own frames without a finger, the default; none."""


OPTIONS = {"calibration": "--calibration", "scale_mm2_per_px": "--mm2-per-px", "tune": "--tune",
           "camera_model": "--camera-model", "mosaic": "--mosaic", "raw": "--raw"}  # fmt: skip
"""Parameters of :class:`evanesce.api.measure.Pipeline` by the options that set them."""


@dataclass(frozen=True)
class Refined:
    """Options of the refined estimator: dark and flat frames, finger, the frame that it is tuned on, and whether it
    stands alone or with the reference segmentation beside it."""

    dark: Path | None
    flat: Path | None
    finger: Finger
    tune: Path | None = None
    camera_model: str | RawModel | None = None
    alone: bool = True

    @property
    def raw(self) -> bool:
        """Whether frames are raw mosaics."""
        return isinstance(self.camera_model, RawModel)


def camera(source: str | None, raw: bool, mosaic: str | None, automatic: bool) -> str | RawModel | None:
    """Return what reads colours: ``--camera-model`` itself, or the model of its scene's raw mosaics.

    Raises
    ------
    InputError
        If options do not go together, or the scene is not known or not in colour.
    """
    if not raw:
        if mosaic is not None:
            raise InputError(f"'{mosaic}'", key="--mosaic", allowed="with --raw")
        return source
    if source is None or source.lower().endswith(".csv"):
        what = "is missing" if source is None else f"'{source}' is a table"
        raise InputError(what, key="--camera-model", allowed="a scene in colour, for raw mosaics")
    if automatic:
        raise InputError("'auto'", key="--threshold", allowed="none with --raw: the reference segmentation is not run")
    with named_options(OPTIONS):
        return raw_model(source, mosaic)


def refined_options(
    estimator: str,
    dark: Path | None,
    flat: Path | None,
    finger: str,
    tune: Path | None = None,
    camera_model: str | RawModel | None = None,
    *,
    possible: bool = True,
) -> Refined | None:
    """Check the choice of an estimator; None is the reference segmentation.

    ``possible`` says whether ``auto`` may lead with the refined estimator: it has a calibration and no area per pixel.

    Raises
    ------
    InputError
        If the name is not known, or shots are given that the reference segmentation does not use.
    """
    if estimator not in ("auto", "reference", "refined"):
        raise InputError(f"'{estimator}'", key="--estimator", allowed="auto, reference, refined")
    raw = isinstance(camera_model, RawModel)
    for key, path in (("--dark", dark), ("--flat", flat), ("--tune", tune)):
        if raw and path is not None and str(path) != "none":
            raise InputError(f"'{path}' is not used by raw mosaics", key=key, allowed="none with --raw")
    if estimator == "refined" or (estimator == "auto" and possible):
        kinds: dict[str, Finger] = {"ridged": "ridged", "smooth": "smooth"}
        if finger in kinds:
            return Refined(dark, flat, kinds[finger], tune, camera_model, alone=raw or estimator == "refined")
        raise InputError(f"'{finger}'", key="--finger", allowed="ridged, smooth")
    given = (("--dark", dark), ("--flat", flat), ("--tune", tune), ("--camera-model", camera_model))
    for key, value in given:
        if value is not None and not (key == "--dark" and str(value) in DARK_WORDS):
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
    beside: Pipeline | None = None
    free: tuple[int, ...] | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Result:
    """What came of it: the table, the frame of the largest area with its budget, the warnings."""

    rows: list[AreaRow]
    peak: Measured
    warnings: list[Warning]
    budget: Uncertain
    levels: EdgeLevels | None = None
    curve: tuple[dict[str, float], ...] = ()
    apart: Apart | None = None


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
    auto_threshold: bool = False,
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
    raw = refined is not None and refined.raw
    stored = load_calibration(calibration) if calibration is not None else None
    dark = None if refined is None else refined.dark
    shots = [
        _shots(None if dark is None or str(dark) in DARK_WORDS else dark),
        _shots(refined.flat if refined else None),
    ]
    scene: Scene | None = None
    free: tuple[int, ...] | None = None
    notes: list[str] = []
    if undistort and stored is None:
        raise InputError("is needed to undistort", key="--calibration", allowed="a calibration file, or --no-undistort")

    def made(estimator: EstimatorName, chain: Chain) -> Pipeline:
        fine = estimator == "refined"
        with named_options(OPTIONS):
            return Pipeline(
                calibration=stored, scale_mm2_per_px=mm2_per_px, threshold=chain.threshold, undistort=undistort,
                estimator=estimator, min_blob_px=chain.min_blob, blur_px=chain.blur, dilation_px=chain.radius,
                crop=chain.crop, dark=shots[0] if fine else (), flat=shots[1] if fine else (),
                tune=refined.tune if fine and refined else None, finger=refined.finger if refined else "ridged",
                camera_model=refined.camera_model if fine and refined else None,
            )  # fmt: skip

    pipeline = made("reference" if refined is None else "refined", chain)
    beside = None
    if refined is not None and not refined.alone and pipeline.calibration and pipeline.calibration.mm2_per_px:
        beside = made("reference", chain)
    own = refined is not None and not raw and (dark is None or str(dark) == "auto") and _several(path, fps)
    given = refined is not None and bool(shots[0]) and not own and _several(path, fps)
    if own or given or auto_threshold:
        scene = _looked_through(path, fps, pipeline, chain)
    if scene is not None and own:
        free, shots[0] = scene.free, scene.dark
    if scene is not None and auto_threshold:
        chain = replace(chain, threshold=_half_way(scene.brightest, beside or pipeline, notes))
    if beside is not None:
        beside = made("reference", chain)
    pipeline = made(pipeline.estimator, _in_frame(chain, pipeline, beside))
    found = [scale_warning(stored.mm2_per_px if stored else None, mm2_per_px)]
    if given and scene is not None and refined is not None:
        found.append(_dark_doubt(refined, shots[0], scene, pipeline, chain))
    return Job(
        path=path,
        pipeline=pipeline,
        calibration=calibration,
        out=out,
        stream=_opened(path, fps, pipeline),
        warnings=tuple(warning for warning in found if warning is not None),
        tune=None if refined is None else refined.tune,
        beside=beside,
        free=free,
        notes=tuple(notes),
    )


def _dark_doubt(
    refined: Refined, shots: list[NDArray[np.uint8]], scene: Scene, pipeline: Pipeline, chain: Chain
) -> Warning | None:
    """Return the warning about dark shots with a finger in them."""
    details = pipeline.calibration.details if pipeline.calibration else {}
    tone = tone_table(details.get("tone_curve", "bt709"))
    mean = np.mean([luma_light(shot, tone) for shot in shots], axis=0)
    free = is_free(mean, scene.brightest.data, tone, radius=chain.radius, min_blob=chain.min_blob)
    return dark_warning(free, f"--dark {refined.dark}")


def _opened(path: Path, fps: float | None, pipeline: Pipeline) -> FrameStream:
    with named_options(OPTIONS):
        return open_frames(path, fps, pipeline.mosaic)


def _several(path: Path, fps: float | None) -> bool:
    """Return whether a source may hold frames without a finger beside others: more than a single image."""
    return open_frames(path, fps).count != 1


def _looked_through(path: Path, fps: float | None, pipeline: Pipeline, chain: Chain) -> Scene | None:
    details = pipeline.calibration.details if pipeline.calibration else {}
    stream = open_frames(path, fps)
    with progress() as bar:
        task = bar.add_task("look through", total=stream.count)

        def frames() -> Iterator[Frame]:
            return iter(open_frames(path, fps))

        return look_through(
            frames, tone_table(details.get("tone_curve", "bt709")), count=stream.count, radius=chain.radius,
            min_blob=chain.min_blob, tick=lambda: bar.advance(task),
        )  # fmt: skip


def _half_way(frame: Frame, pipeline: Pipeline, notes: list[str]) -> float:
    """Return the threshold half-way between ground and contact in the frame of the largest contact."""
    details = pipeline.calibration.details if pipeline.calibration else {}
    levels = edge_levels(pipeline.measure(frame).view, details.get("tone_curve", "bt709"))
    if levels is None:
        raise InputError("no contact shows in any frame", key="--threshold", allowed="a grey level, 0 to 1")
    notes.append(
        f"threshold {levels.half:.4f}: half-way in linear light between ground ({levels.grey(levels.ground):.3f}) and"
        f" contact ({levels.grey(levels.contact):.3f}) along the edge in frame {frame.index}"
    )
    return levels.half


def _in_frame(chain: Chain, pipeline: Pipeline, beside: Pipeline | None) -> Chain:
    """Return the chain whose crop of the undistorted view is one of the frame as taken: the rectangle around it."""
    view = None if beside is None else beside.rectified
    if view is None or chain.crop == Crop():
        return chain
    x, y = chain.crop.apply(view.map_x), chain.crop.apply(view.map_y)
    rows, cols = view.source_shape
    r0, r1 = max(int(y.min()), 0), min(int(y.max()) + 2, rows)
    c0, c1 = max(int(x.min()), 0), min(int(x.max()) + 2, cols)
    return replace(chain, crop=Crop(r0, r1, c0, c1))


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
    log, edges = FrameLog(None if refined else job.pipeline.settings.threshold), EdgeLog(blur_known=known)
    film = None if refined is None else FilmLog(refined.settings.blur)
    peak: Measurement | None = None
    beside_peak: Measured | None = None
    lossy = stream.stated_rate is not None and job.pipeline.mosaic is None
    with ExitStack() as stack:
        stack.enter_context(named_options(OPTIONS))
        bar = stack.enter_context(progress())
        task = bar.add_task("measure", total=stream.count)
        video: OverlayVideo | None = None
        for frame in stream:
            found = job.pipeline.measure(frame, lossy=lossy)
            if job.out is not None and stream.count != 1:
                if video is None:  # only now is it known that the input is good, so that a folder may be made
                    folder = out_dir(job.out, "measure")
                    rate = stream.given_rate or stream.stated_rate or VIEWING_RATE
                    video = stack.enter_context(OverlayVideo(folder / "overlay.mp4", rate))
                video.add(overlay(found.view, found.mask))
            row = replace(AreaRow.of(found.measured, found.interval_mm2), corrected_mm2=found.uncertainty.corrected_mm2)
            other = None if job.beside is None else job.beside.measure(frame).measured
            rows.append(row if other is None else replace(row, reference_mm2=other.estimate.area))
            if found.pixels or frame.index not in (job.free or ()):  # a frame without a finger may be empty
                log.add(found.measured.figures)
            if found.refined is not None:
                edges.add(found.index, found.refined.unseen, found.refined.colour_unread, found.refined.unresolved)
            if film is not None and found.refined is not None:
                film.add(found.index, frame.data if frame.raw is None else frame.raw, found.refined)
            if peak is None or found.pixels > peak.pixels:
                peak, beside_peak = found, other
            bar.advance(task)
    if peak is None:
        stream.finish()
        raise InputError("no readable frame", file=job.path)
    warnings = [*job.warnings, *stream.warnings, *log.warnings(), *edges.warnings(len(rows))]
    warnings += film.warnings() if film is not None else []
    result = Result(rows, peak.measured, warnings, peak.uncertainty)
    counted = beside_peak if job.pipeline.refined is not None else peak.measured
    return result if counted is None else _explained(job, result, counted)


def _explained(job: Job, result: Result, counted: Measured) -> Result:
    """Add what the threshold does in the frame of the largest area."""
    pipeline = job.beside or job.pipeline
    details = pipeline.calibration.details if pipeline.calibration else {}
    levels = edge_levels(counted.view, details.get("tone_curve", "bt709"))
    if levels is None:
        return result
    chain, scale = pipeline.settings, pipeline.scale_mm2_per_px
    far = threshold_warning(chain.threshold, levels, counted.estimate.index)
    refined = result.peak.estimate.area
    return replace(
        result,
        levels=levels,
        curve=tuple(threshold_curve(counted.view, chain, scale, levels)),
        apart=apart(counted, chain, scale, refined, levels) if job.beside is not None else None,
        warnings=[*result.warnings, *([far] if far is not None else [])],
    )
