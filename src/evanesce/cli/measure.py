"""``evanesce measure``: contact area of a video or a folder of images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from evanesce.cli.common import JsonOption, OutOption, check_json_target, handles_errors, write_json

CalibrationOption = Annotated[
    Path | None, typer.Option("--calibration", help="JSON file of `evanesce calibrate`; needed to undistort.")
]
CropOption = Annotated[
    str, typer.Option("--crop", help="r0:r1,c0:c1, half-open, in the undistorted view; an end may be empty.")
]
FpsOption = Annotated[float | None, typer.Option("--fps", help="Frame rate in Hz; overrides the file's own.")]
ScaleOption = Annotated[
    float | None, typer.Option("--mm2-per-px", help="Area of a pixel in mm^2; overrides the calibration's.")
]
UndistortOption = Annotated[
    bool, typer.Option("--undistort/--no-undistort", help="Undistort to the valid view before cropping.")
]
EstimatorOption = Annotated[
    str,
    typer.Option(
        "--estimator",
        help="auto: refined, the reference segmentation beside it, where there is a --calibration; reference:"
        " the thesis's segmentation alone; refined: sub-pixel boundary alone.",
    ),
]
DarkOption = Annotated[
    Path | None,
    typer.Option(
        "--dark",
        help="refined: video, image or folder with LEDs on and no contact; auto: the recording's own frames without"
        " a finger (default); none.",
    ),
]
FlatOption = Annotated[
    Path | None, typer.Option("--flat", help="refined: video, image or folder of an evenly lit target.")
]
TuneOption = Annotated[
    Path | None,
    typer.Option(
        "--tune",
        metavar="IMAGE",
        help="refined: a frame of the same finger without saturation, to fit its scattering length and"
        " the edge profile of its contact.",
    ),
]
ForceOption = Annotated[
    Path | None, typer.Option("--force", metavar="CSV", help="Load cell: columns time_s and force_N, at its own rate.")
]
OffsetOption = Annotated[
    str,
    typer.Option("--offset-s", help="Added to a frame's time to get the load cell's \\[s]; auto: by the loading."),
]
CameraModelOption = Annotated[
    str | None,
    typer.Option(
        "--camera-model",
        metavar="SCENE_OR_CSV",
        help="refined, colour frames: scene whose camera took them, or a CSV level,red,green,blue; reads the light"
        " where red is clipped.",
    ),
]
RawOption = Annotated[
    bool,
    typer.Option(
        "--raw",
        help="refined: the images are raw mosaics, PNG or TIFF of 16 bits, of the camera of --camera-model's scene;"
        " read without demosaicing.",
    ),
]
MosaicOption = Annotated[
    str | None,
    typer.Option("--mosaic", help="--raw: order of the first 2 x 2 pixels, RGGB, GRBG, GBRG or BGGR; the scene's."),
]
FingerOption = Annotated[str, typer.Option("--finger", help="refined: ridged or smooth; smooth narrows the interval.")]


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(handles_errors(measure))


def measure(
    path: Annotated[Path, typer.Argument(metavar="VIDEO_OR_FOLDER", help="Video, image or folder of images.")],
    calibration: CalibrationOption = None,
    threshold: Annotated[
        str,
        typer.Option(
            "--threshold",
            help="Grey level 0 to 1; brighter is contact. auto: half-way in linear light between ground and contact.",
        ),
    ] = "0.15",
    min_blob: Annotated[int, typer.Option("--min-blob", help="Minimum size of a dilated blob, in px.")] = 2000,
    crop: CropOption = ":,:",
    fps: FpsOption = None,
    mm2_per_px: ScaleOption = None,
    undistort: UndistortOption = True,
    blur: Annotated[float, typer.Option("--blur", help="Standard deviation of the Gaussian, in px.")] = 1.0,
    radius: Annotated[int, typer.Option("--radius", help="Radius of the dilating disk, in px.")] = 10,
    estimator: EstimatorOption = "auto",
    dark: DarkOption = None,
    flat: FlatOption = None,
    tune: TuneOption = None,
    finger: FingerOption = "ridged",
    force: ForceOption = None,
    offset_s: OffsetOption = "auto",
    camera_model: CameraModelOption = None,
    raw: RawOption = False,
    mosaic: MosaicOption = None,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Measure contact area against time: by the refined estimator, with the reference segmentation beside it.

    Without a calibration the reference segmentation alone measures, with --mm2-per-px and --no-undistort.

    Prints a table; --json writes it as JSON, --out adds CSV, overlays, intensity map and plots.
    """
    from evanesce.cli import measure_force, measure_job, measure_output
    from evanesce.core.errors import InputError
    from evanesce.measurement.reference.segment import Chain, Crop

    check_json_target(json_file)
    automatic = threshold.strip().lower() == "auto"
    try:
        level = 0.15 if automatic else float(threshold)
    except ValueError:
        raise InputError(f"'{threshold}'", key="--threshold", allowed="0 to 1, or auto") from None
    chain = Chain(threshold=level, min_blob=min_blob, blur=blur, radius=radius, crop=Crop.parse(crop))
    log, offset = measure_force.read(force, offset_s)
    job = measure_job.prepare(
        path, chain, calibration=calibration, fps=fps, mm2_per_px=mm2_per_px, undistort=undistort, out=out,
        refined=measure_job.refined_options(
            estimator, dark, flat, finger, tune, measure_job.camera(camera_model, raw, mosaic, automatic),
            possible=calibration is not None and mm2_per_px is None,
        ),
        auto_threshold=automatic,
    )  # fmt: skip
    result = measure_job.run(job)
    joined = None if log is None else measure_force.join(result.rows, log, offset)
    data = measure_output.record(job, result) | ({} if joined is None else {"area_force": joined.as_dict()})
    if out is not None:
        measure_output.write_files(job, result, data)
        measure_force.write_files(out, job, joined)
    write_json(json_file, data)
    measure_output.show(job, result)
    measure_force.show(joined, log)
    job.stream.finish()
